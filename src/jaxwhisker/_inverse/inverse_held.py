"""Contact of one whisker with springs or a foundation on its shaft, from the reaction at its base.

Everything happens in the drive's frame, in which the springs are at rest. The loads p on the springs between drive and
base determine the pose of the base and the reaction: pose = rest + C p, reaction = -p + (forces of the springs at the
base and below). From there the rod is integrated outwards, past all springs, to the contact. Two conditions hold there:
the moment vanishes, and the angle between whisker and object is that of the phase. The states y = (p, beyond) with
these conditions are compared with the measured reaction: see nearest.py. A tangential whisker leans against the object
from one side or the other, which makes three candidates.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.shaft_springs import past
from jaxwhisker._inverse.inverse_rod import BENT, GUESSES, START, zero_of
from jaxwhisker._inverse.mechanics import Contacts, Judgement, StepSignals
from jaxwhisker._inverse.nearest import PhaseCandidate, WhiskerState, locate, rotated, value_and_jacobian
from jaxwhisker._model.loads import PointForce
from jaxwhisker._model.motion import Pose
from jaxwhisker._model.scene import Sensor
from jaxwhisker._path.deflection import branch_of
from jaxwhisker._rod import rod
from jaxwhisker._scan.loaded_rod import DRIVE, LoadedRod, bent, loaded_rod
from jaxwhisker._scan.springs import Held, at_base, walk_outwards

WALK_STEPS = 12  # of the rod between two springs
NEWTON_STEPS = 8  # for the pose of the base under the measured reaction


class HeldObservation(NamedTuple):
    """What the state of a whisker is estimated from; dimensionless."""

    reaction: Float[Array, "3"]  # in the scene
    weight: Float[Array, "3"]  # 1 / standard deviation
    drive: Float[Array, "3"]  # pose of the drive in the scene
    equations: LoadedRod  # of the whisker in the drive's frame; its loads are not used
    pose: Float[Array, "3"] | None  # measured pose of the base in the drive's frame; None: it follows from the springs
    lean: Scalar | None  # of the contact force: slope of the object minus angle of the force; None: no friction

    phases = PhaseCandidate(np.array([True, False, False]), np.array([0.0, 0.0, np.pi]))
    conditions = 2
    steps = 8
    handicaps = np.zeros(3)
    failed = np.append(-BENT, [0.1, 0.0, 0.0])

    def state(self, y: Float[Array, "4"], phase: PhaseCandidate) -> WhiskerState:
        """The state with these loads on the base and this angle or arc beyond the contact.

        Its values are x, y, slope and arc of the contact, the pose of the base and the contact force. The conditions
        are the moment at the contact, and the angle of the whisker minus that of its phase.
        """
        loads, beyond = y[:3], y[3]
        pose, reaction = self._base(loads)
        arc = 1.0 - jnp.where(phase.tip, 0.0, beyond)
        passed, load = self._walked(pose, reaction, jnp.reshape(arc, 1))
        (x, y_, cos, sin), load = jax.tree.map(lambda leaf: leaf[0], (passed, load))
        fx, fy, about = _components(load)
        slope = jnp.arctan2(fx, -fy) + (0.0 if self.lean is None else self.lean)
        angle = jnp.arctan2(sin, cos) - slope - jnp.where(phase.tip, beyond, phase.angle)
        conditions = jnp.stack([about - x * fy + y_ * fx, _wrapped(angle)])
        contact, base = (self._in_scene(at) for at in (jnp.stack([x, y_, slope]), pose))
        contact = contact.at[2].set(_wrapped(contact[2]))
        values = jnp.concatenate([contact, jnp.stack([arc]), base, jnp.sqrt(fx**2 + fy**2)[None]])
        return WhiskerState(rotated(reaction, self.drive[2]), conditions, values)

    def limits(self, phase: PhaseCandidate) -> tuple[Scalar, Scalar]:
        """Least and largest angle or arc beyond the contact, which lies above all springs."""
        return 0.0, jnp.where(phase.tip, jnp.pi, jnp.minimum(0.999, 1 - self._top))

    def scale(self, y: Float[Array, "4"]) -> Float[Array, "3"]:
        """Size of the loads."""
        return 1 + jnp.abs(y[:3])

    def guesses(self) -> Float[Array, "phases 4"]:
        """Loads on the base that give the measured reaction; from there, integrate to the zero of the moment."""
        loads = self.loads()
        # Above all springs, the moment falls to zero.
        s = self._top + (1 - self._top) * jnp.linspace(0.0, 1.0, GUESSES + 1)
        (x, y, cos, sin), load = self._walked(self._base(loads)[0], self._measured, s)
        moment = jnp.asarray(rod.moment(x, y, load))
        last, share = zero_of(moment * jnp.where(moment[0] < 0, -1.0, 1.0))
        arc = s[last] + (s[last + 1] - s[last]) * jnp.clip(share, 0.0, 1.0)
        end = jnp.where(share > 0.5, last + 1, last)
        slope = jnp.arctan2(load.force_x, -load.force_y)[end] + (0.0 if self.lean is None else self.lean)
        theta = jnp.clip(_wrapped(jnp.arctan2(sin, cos)[end] - slope), 0.0, jnp.pi)
        tip, tangential = (jnp.append(loads, beyond) for beyond in (theta, jnp.maximum(1 - arc, START)))
        return jnp.stack([tip, tangential, tangential])

    def loads(self) -> Float[Array, "3"]:
        """Loads on the base that give the measured reaction, whether or not that is possible."""

        def newton(loads, observed):
            value, gradient = value_and_jacobian(lambda loads: observed._base(loads)[1], loads)
            return loads + solve(gradient, (observed._measured - value)[:, None])[:, 0]

        constant = jax.lax.stop_gradient(self)
        loads = jax.lax.fori_loop(0, NEWTON_STEPS, lambda _, loads: newton(loads, constant), -constant._measured)
        return newton(loads, self)  # a step from the solution has its derivatives

    def base(self) -> Float[Array, "3"]:
        """Pose of the base in the scene under the measured reaction."""
        return self._in_scene(self._base(self.loads())[0])

    @property
    def _measured(self) -> Float[Array, "3"]:
        """The reaction in the drive's frame."""
        return rotated(self.reaction, -self.drive[2])

    @property
    def _top(self) -> Scalar:
        assert self.equations.held_by is not None
        return self.equations.held_by.top

    def _in_scene(self, pose: Float[Array, "3"]) -> Float[Array, "3"]:
        return self.drive + rotated(pose, self.drive[2])

    def _base(self, loads: Float[Array, "3"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """Pose of the base under these loads on its springs, and the reaction of everything at the base and below."""
        known = self.equations
        if self.pose is not None:
            return self.pose, -loads
        moved = known.compliance * loads
        x, y, angle = pose = known.rest + moved
        assert known.held_by is not None
        springs = known.held_by.springs.below
        none, state = rod.Load(*[jnp.zeros(())] * 3), (x, y, -jnp.sin(angle), jnp.cos(angle))
        each = jax.vmap(lambda spring: _components(past(none, spring, known.laws, state, DRIVE, 1.0)))(springs)
        fx, fy, about = jnp.sum(each, axis=0)
        below = jnp.stack([fx, fy, about - x * fy + y * fx])
        return pose, below + known.held * moved - loads

    def _walked(self, pose: Float[Array, "3"], reaction: Float[Array, "3"], at: Float[Array, " places"]):
        """States and loads at places along the whisker, from its base pose and the reaction there."""
        known = self.equations
        assert known.held_by is not None
        held_by, places = known.held_by.with_places(at)
        start, load = at_base(Pose(*pose), tuple(reaction))
        walked = walk_outwards(known.section, start, load, Held(held_by, known.laws, DRIVE), steps=WALK_STEPS)
        return jax.tree.map(lambda leaf: leaf[places], (walked.passed, walked.loads))


def _components(load: rod.Load) -> Float[Array, "3"]:
    return jnp.stack([*map(jnp.asarray, (load.force_x, load.force_y, load.moment))])


def _wrapped(angle: Scalar) -> Float[Array, ""]:
    return jnp.arctan2(jnp.sin(angle), jnp.cos(angle))


class HeldInstrument(NamedTuple):
    """A dimensionless sensor of one whisker."""

    equations: LoadedRod
    free: Float[Array, "1 3"]  # reaction of the free whisker in the drive's frame; without derivatives

    flexibility = None

    def peaks(self, largest: Float[Array, "1 3"]) -> Float[Array, ""]:
        """One size for all channels: a base that is free along an axis has no reaction along it."""
        return jnp.max(largest)

    def unloaded(self, drive: Float[Array, "3"]) -> Float[Array, "1 3"]:
        """Reaction of the free whisker."""
        return rotated(self.free, drive[2])

    def bent(self, drive: Float[Array, "3"]) -> Float[np.ndarray, "3"]:
        """Reaction of a bent whisker."""
        return BENT

    def contacts(self, drive: Float[Array, "3"], signals: StepSignals, judgement: Judgement) -> Contacts:
        """The contact at one step."""
        one = jax.tree.map(lambda leaf: leaf[0], signals)
        pose = None if one.pose is None else rotated(one.pose - drive, -drive[2])
        observed = HeldObservation(one.reaction, one.weight, drive, self.equations, pose, one.lean)
        located = locate(observed, 4)
        values, spread, ok = located.values, located.by_channels, one.touching & located.ok
        covariance = jnp.sum(spread[:, None, :] * spread, axis=-1) + located.ambiguous
        as_measured = observed._replace(reaction=one.measured).base()
        base = zip(("base_x", "base_y", "base_angle"), jnp.where(ok, values[4:7], as_measured), strict=True)
        contact = dict(zip(("x", "y", "slope", "arc"), values[:4], strict=True)) | {"force": values[7]}
        found = Contacts(contact, {name: value for name, value in base}, located.tip, ok, located.chi2, covariance)
        return jax.tree.map(lambda leaf: leaf[None], found)


def held_instrument(sensor: Sensor) -> HeldInstrument:
    """The sensor of one whisker, dimensionless."""
    equations = loaded_rod(sensor.whiskers[0], (PointForce(0.0),), sensor.support)
    constant = jax.lax.stop_gradient(equations)
    return HeldInstrument(equations, -bent(constant, branch_of(constant).unknowns, 2).load[None])
