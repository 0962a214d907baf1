"""Contacts of whiskers in space, from the reactions at their bases.

The states of a whisker on a base are a family: the rod in the frame of its contact has a force, a roll, an angle chi to
the object and an arc length, and the rotation of its base turns the frame of the contact in space. In tip contact, the
arc is the whisker's length; on the shaft, chi vanishes. Both leave three parameters. With friction, the force has any
direction, and a contact on the shaft has four. A base that may turn adds three, which must satisfy its springs.

Residuals are whitened, so that correlated noise, missing channels and channels in the frame of the base need nothing
else: see nearest.py.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.rotation import left_jacobian, matrix_of, rotation_matrix
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.dimensionless import stacked_or_each
from jaxwhisker._inverse.inverse_rod import LARGEST_ANGLE, POINTED, START, each_whisker
from jaxwhisker._inverse.mechanics import Contacts, Judgement, StepSignals, whitened
from jaxwhisker._inverse.nearest import LocatedContact, PhaseCandidate, WhiskerState, locate, value_and_jacobian
from jaxwhisker._inverse.observations import OWN_REACTIONS
from jaxwhisker._inverse.points import perpendicular
from jaxwhisker._model.drives import Placement, SpaceMotion, mount_in_space
from jaxwhisker._model.motion import AbstractMotion
from jaxwhisker._model.scene import Units
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker, with_equal_breaks
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, points
from jaxwhisker._rod.space_end import space_rod_end
from jaxwhisker._scan.quantities import REACTIONS_IN_SPACE
from jaxwhisker._space.section import space_section

STEPS = 12  # of a uniform rod, others take twice as many: an error of 1e-9 for a cone
INTERVALS = 32  # of the rod that are searched for the zero of the moment
NEAR_ZERO = 0.05  # of the largest moment: a smaller one counts as zero
TURNS = 8  # Newton steps for the rotation of a base under the measured load
NUMBERS = "x", "y", "z", "arc", "force_x", "force_y", "force_z"  # that describe a contact
CONTACT = len(NUMBERS)
UNTWISTED = ("f1", "f2", "f3", "m1", "m2")
LEVERS = (0.9, 0.6, 0.3)  # lengths: contacts from which the search for that of an axial force and a moment starts
PARALLEL = 1e-3  # squared cosine of the angle to the base's tangent of a force that hardly shows the twisting moment
BENT = np.array([-0.8795, 0.0, 0.4758, 0.0, -0.9755, 0.0])  # reaction of a bent whisker along d1, d2 and d3

Vector = Float[Array, "3"]


class SpaceSensor(eqx.Module):
    """A scene in space without its surface."""

    whiskers: tuple[Whisker, ...]
    support: Support
    motion: SpaceMotion | AbstractMotion
    friction: bool = eqx.field(static=True)  # whether contact forces may lean


class BaseTurning(NamedTuple):
    """How a base turns, in the frame of the drive."""

    rest: Vector  # its rotation vector without a load
    flexibility: Float[Array, "3 3"]  # rotation per moment

    def excess(self, turn: Vector, moment: Vector) -> Vector:
        """Rotation vector of the base minus that under this moment."""
        return turn - self.rest - _turned(self.flexibility, _turned(left_jacobian(turn).T, moment))


class BaseFrame(eqx.Module):
    """The base of a whisker."""

    drive: Float[Array, "3 3"]  # rotation of the drive in the scene
    mount: Float[Array, "3 3"]  # directors of the base in the frame of the drive, where it is not turned
    turning: BaseTurning | None  # None if it cannot turn
    own: bool = eqx.field(static=True)  # whether reactions are in its own frame

    def directors(self, turn: Vector | None) -> Float[Array, "3 3"]:
        """Directors of the base in the scene."""
        turned = self.drive if turn is None else _product(self.drive, rotation_matrix(turn))
        return _product(turned, self.mount)

    def excess(self, turn: Vector, moment: Vector) -> Vector:
        """Rotation vector of the base minus that under this moment in the scene."""
        assert self.turning is not None
        return self.turning.excess(turn, _turned(self.drive.T, moment))

    def turn(self, reaction: Float[Array, "6"]) -> Vector | None:
        """Rotation vector of the base under a reaction, by Newton's method."""
        if self.turning is None:
            return None

        def excess(turn):
            moment = -reaction[3:]
            return self.excess(turn, _turned(self.directors(turn), moment) if self.own else moment)

        def newton(_, turn):
            value, slope = value_and_jacobian(excess, turn)
            return turn - solve(slope, value[:, None])[:, 0]

        return jax.lax.fori_loop(0, TURNS, newton, self.turning.rest)


class SpaceObservation(eqx.Module):
    """What the state of a whisker is estimated from; dimensionless."""

    section: SpaceSection
    length: Scalar
    base: BaseFrame
    reaction: Float[Array, " channels"]  # whitened
    whiten: Float[Array, "channels 6"]  # from a reaction to whitened channels
    complete: Float[Array, "starts 6"]  # reactions to start from
    handicap: Scalar  # of the shaft, where friction gives it a parameter more
    friction: bool = eqx.field(static=True)

    steps = 12  # 4 without noise

    @property
    def weight(self) -> Float[Array, " channels"]:
        """1 / standard deviation of the whitened channels."""
        return jnp.ones_like(self.reaction)

    @property
    def phases(self) -> PhaseCandidate:
        """Tip and shaft, from every start."""
        tip = np.repeat([True, False], len(self.complete))
        return PhaseCandidate(tip, np.zeros(tip.size))

    @property
    def handicaps(self) -> Float[Array, " phases"]:
        """Handicaps of the phases."""
        return jnp.where(self.phases.tip, 0.0, self.handicap)

    @property
    def conditions(self) -> int:
        """The rotation of the base has three."""
        return 0 if self.base.turning is None else 3

    @property
    def failed(self) -> Float[Array, " size"]:
        """A state that replaces those of failed fits."""
        turn = jnp.zeros(0) if self.base.turning is None else self.base.turning.rest
        return jnp.concatenate([jnp.array([1.0, *[0.1] * (1 + self.friction)]), turn, jnp.array([0.1]), 0 * turn])

    def state(self, y: Float[Array, " n"], phase: PhaseCandidate) -> WhiskerState:
        """The state with this force, roll, angle (with friction), rotation of the base, and angle or arc beyond.

        Its values are the contact point relative to the base, the arc length from base to contact, the force, the
        tangent there and the directors of the base; all in the scene.
        """
        beyond = y[-1]
        chi = y[2] if self.friction else jnp.where(phase.tip, beyond, 0.0)
        arc = self.length - (beyond if self.friction else jnp.where(phase.tip, 0.0, beyond))
        steps = STEPS if self.section.uniform else 2 * STEPS
        end = space_rod_end(y[0], arc, chi, y[1], self.section, steps, steps)
        turn = None if self.base.turning is None else y[-4:-1]
        directors = self.base.directors(turn)
        frame = _product(directors, matrix_of(end[3:]).T)
        force, contact = y[0] * frame[:, 2], -_turned(frame, end[:3])
        moment = jnp.cross(contact, force)
        tangent = jnp.cos(chi) * frame[:, 0] - jnp.sin(chi) * frame[:, 2]
        excess = jnp.zeros(0) if turn is None else self.base.excess(turn, moment)
        reaction = jnp.concatenate([-force, -moment])
        reaction = in_frame(directors, reaction) if self.base.own else reaction
        values = jnp.concatenate([contact, arc[None], force, tangent, jnp.ravel(directors)])
        return WhiskerState(_turned(self.whiten, reaction), excess, values)

    def limits(self, phase: PhaseCandidate) -> tuple[Scalar, Scalar]:
        """Least and largest angle or arc beyond the contact."""
        pointed = ~(self.section.compliance(self.length) > 0)
        at_tip = 0.0 if self.friction else LARGEST_ANGLE
        least = jnp.where(pointed & ~phase.tip, POINTED * self.length, 0.0)
        return least, jnp.where(phase.tip, at_tip, 0.98 * self.length)

    def scale(self, y: Float[Array, " n"]) -> Float[Array, " others"]:
        """Size of the force and of angles."""
        return jnp.ones(y.size - 1).at[0].set(y[0])

    def guesses(self) -> Float[Array, "phases n"]:
        """Integrate from the base to where the moment is least."""
        tip, shaft = jax.vmap(self._guess)(self.complete)
        return jnp.concatenate([tip, shaft])

    def _guess(self, reaction: Float[Array, "6"]) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        """Guesses for tip and shaft from a reaction."""
        turn, zero = self.base.turn(reaction), jnp.zeros(())
        reaction = reaction if self.base.own else in_frame(self.base.directors(turn), reaction)
        force, about = -reaction[:3], -reaction[3:]
        load = SpaceLoad(tuple(force), tuple(about))
        start = (zero, zero, zero), (zero + 1, zero, zero, zero)
        at = jnp.linspace(0.0, 1.0, INTERVALS + 1)
        r, q = points(start, -self.length, load, self.section, at=at, from_base=zero)
        place, end = nearest_zero(about + jnp.cross(force, jnp.stack(r, axis=-1)))
        first, _, tangent = jax.tree.map(lambda leaf: leaf[end], matrix_of(q)).T
        size = jnp.sqrt(jnp.sum(force**2))
        out = force / size
        chi = jnp.arcsin(jnp.clip(-jnp.sum(tangent * out), -1.0, 1.0))
        ahead = tangent + jnp.sin(chi) * out
        across = jnp.cross(out, ahead)
        roll = jnp.arctan2(jnp.sum(first * across), jnp.sum(first * jnp.cross(across, tangent)))
        chi = jnp.where(jnp.isfinite(chi), chi, 0.1)
        kept = jnp.stack([size, jnp.where(jnp.isfinite(roll), roll, 0.0), *[chi] * self.friction])
        kept = kept if turn is None else jnp.concatenate([kept, turn])
        arc = self.length * place / INTERVALS
        beyond = jnp.clip(self.length - arc, START * self.length, 0.9 * self.length)
        return jnp.append(kept, 0.0 if self.friction else jnp.maximum(chi, 0.0)), jnp.append(kept, beyond)


def nearest_zero(moment: Float[Array, "points 3"]) -> tuple[Scalar, Any]:
    """Where a moment along a rod first vanishes, or where it is least, in intervals, and the point before it."""
    here, change = moment[:-1], moment[1:] - moment[:-1]
    square = jnp.sum(change**2, axis=1)
    share = jnp.clip(-jnp.sum(here * change, axis=1) / jnp.where(square > 0, square, 1.0), 0.0, 1.0)
    least = jnp.sum((here + share[:, None] * change) ** 2, axis=1)
    least = jnp.where(jnp.isfinite(least), least, jnp.inf)  # thin tips overflow where the moment does not vanish
    zeros = least < (NEAR_ZERO**2) * jnp.max(jnp.where(jnp.isfinite(moment), moment**2, 0.0))
    first = jnp.where(jnp.any(zeros), jnp.argmax(zeros), jnp.argmin(least))
    # A zero may extend into the next interval.
    first = first + (
        (share[first] == 1) & (first + 1 < least.size) & (least[jnp.minimum(first + 1, least.size - 1)] < least[first])
    )
    return first + share[first], first


class SpaceInstrument(NamedTuple):
    """A dimensionless sensor."""

    length: Float[Array, " whiskers"]
    section: SpaceSection | tuple[SpaceSection, ...]
    mount: Placement  # in the frame of the drive; fields (whiskers, ...)
    offset: Float[Array, "whiskers 3"]  # displacement of the unloaded bases
    flexibility: Float[Array, "whiskers 3 whiskers 3"]  # displacement of bases per force on them
    turning: BaseTurning | None  # fields (whiskers, ...)
    kinds: tuple[str, ...]  # names of the channels
    friction: bool

    @property
    def own(self) -> bool:
        """Whether reactions are in the frames of the bases."""
        return self.kinds != REACTIONS_IN_SPACE

    @property
    def places(self) -> np.ndarray:
        """Places of the channels among the six reactions."""
        return np.array([(OWN_REACTIONS if self.own else REACTIONS_IN_SPACE).index(kind) for kind in self.kinds])

    def peaks(self, largest: Float[Array, "whiskers channels"]) -> Float[Array, "whiskers channels"]:
        """One size for all forces and one for all moments: symmetry makes some of them vanish but for rounding."""
        forces = np.array([kind[0] == "f" for kind in self.kinds])
        return jnp.stack([jnp.max(largest[:, forces == kind], axis=1) for kind in forces], axis=1)

    def unloaded(self, drive: Placement) -> None:
        """Without a contact, reactions vanish."""

    def bent(self, drive: Placement) -> Float[Array, "whiskers channels"]:
        """Reactions of bent whiskers."""
        bent = jnp.broadcast_to(BENT, (self.length.size, 6))
        if not self.own:
            upright = self.directors(drive, 0 * bent)
            bent = jax.vmap(lambda directors, bent: in_frame(directors.T, bent))(upright, bent)
        return bent[:, self.places]

    def contacts(self, drive: Placement, signals: StepSignals, judgement: Judgement) -> Contacts:
        """The contacts of all whiskers at one step."""
        complete = jax.vmap(lambda values, length: _complete(self.kinds, values, length))
        whiskers = self.length.size
        six = jnp.zeros((whiskers, len(self.kinds), 6)).at[:, :, self.places].set(signals.weight)
        reactions = complete(signals.reaction, self.length)
        handicap = jnp.full(whiskers, judgement.handicap)
        located = self._located(drive, (whitened(signals.weight, signals.reaction), six, reactions, handicap))
        ok, values = signals.touching & located.ok, located.values
        positions = self.positions(drive, jnp.where(ok[:, None], values[:, 4:7], 0.0))
        as_measured = self.directors(drive, complete(signals.measured, self.length)[:, 0])
        directors = jnp.where(ok[:, None, None], values[:, 10:].reshape(-1, 3, 3), as_measured)
        numbers = *(positions + values[:, :3]).T, *values[:, 3:CONTACT].T
        contact = dict(zip(NUMBERS, numbers, strict=True)) | {"tangent": values[:, CONTACT:10]}
        base = dict(zip(("base_x", "base_y", "base_z"), positions.T, strict=True)) | {"base_rotation": directors}
        cosine = score = jnp.full(whiskers, jnp.nan)
        if len(self.kinds) == 6:
            cosine, score = perpendicular(signals.measured, signals.noise, signals.missing)
        base |= {"force_moment": cosine, "force_moment_score": score * judgement.known}
        return Contacts(contact, base, located.tip, ok, located.chi2, self.covariance(drive, located, ok))

    def _located(self, drive: Placement, signals: tuple) -> LocatedContact:
        """Contacts of all whiskers relative to their bases, from the other fields of their SpaceObservation."""

        def one(section, length, mount, turning, *signals):
            base = BaseFrame(drive.rotation, mount, turning, self.own)
            observed = SpaceObservation(section, length, base, *signals, self.friction)  # pyright: ignore[reportCallIssue]
            return locate(observed, CONTACT)  # pyright: ignore[reportArgumentType]

        return each_whisker(self.section, one, self.length, self.mount.rotation, self.turning, *signals)

    def directors(self, drive: Placement, reaction: Float[Array, "whiskers 6"]) -> Float[Array, "whiskers 3 3"]:
        """Directors of the bases under these reactions, in the scene."""

        def one(mount, turning, reaction):
            base = BaseFrame(drive.rotation, mount, turning, self.own)
            return base.directors(base.turn(reaction))

        return jax.vmap(one)(self.mount.rotation, self.turning, reaction)

    def positions(self, drive: Placement, force: Float[Array, "whiskers 3"]) -> Float[Array, "whiskers 3"]:
        """Positions of the bases under these contact forces, in the scene."""
        load = jnp.sum(drive.rotation * force[:, :, None], axis=1)  # in the frame of the drive
        place = self.mount.position + self.offset + jnp.sum(self.flexibility * load, axis=(2, 3))
        return drive.position + jnp.sum(drive.rotation * place[:, None, :], axis=2)

    def covariance(self, drive: Placement, located: LocatedContact, known: Bool[Array, " whiskers"]) -> Array:
        """Covariance of point, arc and force, (whiskers, 7, 7), from the noise of all known whiskers."""
        own = jnp.where(known[:, None, None], located.by_channels, 0.0)
        out = jnp.eye(known.size)[:, None, :, None] * jnp.swapaxes(own, 0, 1)[None]  # (whisker, 7, whisker, channels)
        turn = drive.rotation
        moved = jnp.einsum("ia,kalb,jb->kilj", turn, self.flexibility, turn)
        out = out.at[:, :3].add(jnp.sum(moved[..., None] * own[None, None, :, 4:], axis=3))
        return jnp.einsum("kilc,kjlc->kij", out, out) + located.ambiguous


def space_instrument(sensor: SpaceSensor, unit: Units, kinds: tuple[str, ...]) -> SpaceInstrument:
    """The sensor, dimensionless."""
    whiskers, n = sensor.whiskers, len(sensor.whiskers)
    stiffness_unit = unit.moment * unit.length
    section = stacked_or_each([space_section(w, unit.length, stiffness_unit) for w in with_equal_breaks(whiskers)])
    mounts = [mount_in_space(mount) for mount in sensor.support.mounts]
    position, rotation = (jnp.stack(parts) for parts in zip(*mounts, strict=True))
    whole = sensor.support.flexibility_in_space().in_space(unit.length, unit.force)
    matrix, offset, turning = whole.matrix.reshape(n, 6, n, 6), whole.offset.reshape(n, 6), None
    if any(axis.startswith("phi") for axis in sensor.support.axes):
        turning = BaseTurning(offset[:, 3:], jnp.stack([matrix[k, 3:, k, 3:] for k in range(n)]))
    return SpaceInstrument(
        jnp.stack([jnp.asarray(w.length, dtype=float) for w in whiskers]) / unit.length,
        section,
        Placement(position / unit.length, rotation),
        offset[:, :3],
        matrix[:, :3, :, :3],
        turning,
        kinds,
        sensor.friction,
    )


def _complete(kinds: tuple[str, ...], values: Float[Array, " channels"], length: Scalar) -> Float[Array, "starts 6"]:
    """All six reactions, from which the search for a contact starts."""
    if len(kinds) == 6:
        return values[None]
    if kinds == UNTWISTED:
        force, bending = values[:3], values[3:]
        sine = jnp.sum(force[:2] * bending)
        twisting = -sine * force[2] / (force[2] ** 2 + PARALLEL * jnp.sum(force**2))
        return jnp.append(values, twisting)[None]
    # As if the whisker were straight to where the object touches it.
    axial, first, second = values
    starts = [(second / at, -first / at, axial, first, second, jnp.zeros(())) for at in np.array(LEVERS) * length]
    return jnp.stack([jnp.stack(start) for start in starts])


def in_frame(directors: Float[Array, "3 3"], reaction: Float[Array, "6"]) -> Float[Array, "6"]:
    """A reaction in the frame of these directors."""
    return jnp.concatenate([_turned(directors.T, reaction[:3]), _turned(directors.T, reaction[3:])])


def _turned(matrix: Float[Array, "rows n"], vector: Float[Array, " n"]) -> Float[Array, " rows"]:
    return jnp.sum(matrix * vector, axis=1)  # sums: XLA compiles small products of matrices in batches to slow loops


def _product(a: Float[Array, "3 3"], b: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    return jnp.sum(a[:, :, None] * b, axis=1)
