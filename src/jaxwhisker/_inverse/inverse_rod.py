"""Contacts of whiskers without springs on their shafts, from the reactions at their bases.

The states of a whisker on a base are a family with two parameters, y = (force, beyond): see nearest.py. For a uniform
straight upright whisker, tangential contact requires mz^2 = 2 EI fy. With friction, the contact force leans from the
object's normal by a known angle, against the slip. A base moves under the loads on all whiskers that springs couple.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.dimensionless import sections
from jaxwhisker._inverse.mechanics import Contacts, Judgement, StepSignals
from jaxwhisker._inverse.nearest import (
    Estimate,
    PhaseCandidate,
    WhiskerState,
    nearest_state,
    rotated,
    value_and_jacobian,
)
from jaxwhisker._model.scene import Sensor, Units
from jaxwhisker._rod import rod
from jaxwhisker._rod.elastica import AbstractRod, ClosedForm, Shooting, rod_end, uneven_rod_end
from jaxwhisker._rod.rod import Section

UNEVEN_STEPS = 12  # Shooting doubles it for rods that are not uniform: an error of 1e-8 for a cone
GUESSES = 16  # pieces of the rod that are searched for the zero of the moment
LARGEST_ANGLE = 3.0  # rad, between whisker and object at the tip
START = 0.02  # of the length: least initial arc beyond the contact, because pointed tips overflow
POINTED = 1e-4  # of the length: least distance of a contact from a tip without stiffness
BENT = np.array([-0.8795, 0.4758, 0.9755])  # reaction of a bent whisker


class PlaneObservation(NamedTuple):
    """What the state of a whisker is estimated from; dimensionless."""

    reaction: Float[Array, "3"]
    weight: Float[Array, "3"]  # 1 / standard deviation
    angle: Scalar  # of the base, without the effect of the whisker's own moment
    twist: Scalar  # rotation of the base per moment on it
    side: Scalar  # 1.0 if the object bends the whisker towards +x (mz >= 0), -1.0 towards -x
    length: Scalar
    stiffness: Scalar
    section: Section | None
    lean: Scalar | None = None  # of the contact force: slope of the object minus angle of the force; None: no friction

    phases = PhaseCandidate(np.array([True, False]), np.zeros(2))
    conditions = 0
    steps = 7  # 3 without noise
    handicaps = np.zeros(2)
    failed = np.array([1.0, 0.1])

    def state(self, y: Float[Array, "2"], phase: PhaseCandidate) -> WhiskerState:
        """The state with this force and angle (tip contact) or arc beyond the contact (tangential contact).

        Its values are the contact point relative to the base, the slope of the object there (rad), the arc length from
        base to contact, and the angle of the base to the upright (rad, counter-clockwise); dimensionless.
        """
        force, beyond = y
        angle, arc = jnp.where(phase.tip, beyond, 0.0) + self._turn, self.length - jnp.where(phase.tip, 0.0, beyond)
        method: AbstractRod = ClosedForm() if self.section is None else Shooting(steps=UNEVEN_STEPS)
        if self.section is None:
            end = rod_end(force / self.stiffness, arc, angle, method, method)
        else:
            section = dataclasses.replace(self.section, orientation=self.side)
            end = uneven_rod_end(force, arc, angle, section, method, method)
        x, up, cos, sin = self.side * end[0], end[1], self.side * end[2], end[3]
        base_angle = self.angle + self.twist * force * x
        base_cos, base_sin = jnp.cos(base_angle), jnp.sin(base_angle)
        # The rod is computed in the frame of the contact force; the direction of its base gives the angle of the force.
        force_cos, force_sin = base_cos * sin - base_sin * cos, base_cos * cos + base_sin * sin
        slope = jnp.arctan2(force_sin, force_cos) + (0.0 if self.lean is None else self.lean)
        where = [up * force_sin - x * force_cos, -x * force_sin - up * force_cos, slope, arc, base_angle]
        reaction = [-force * force_sin, force * force_cos, -force * x]
        return WhiskerState(jnp.stack(reaction), jnp.zeros(0), jnp.stack(where))

    @property
    def _turn(self) -> Scalar:
        """Angle from the frame of the contact force to that of the object, as the rod is bent."""
        return jnp.zeros(()) if self.lean is None else self.side * self.lean

    def limits(self, phase: PhaseCandidate) -> tuple[Scalar, Scalar]:
        """Least and largest angle or arc beyond the contact."""
        pointed = jnp.asarray(False) if self.section is None else ~(self.section.stiffness(self.length) > 0)
        largest = jnp.where(phase.tip, LARGEST_ANGLE, 0.999 * self.length)
        return jnp.where(pointed & ~phase.tip, POINTED * self.length, 0.0), largest

    def scale(self, y: Float[Array, "2"]) -> Float[Array, "1"]:
        """Size of the force."""
        return y[:1]

    def guesses(self) -> Float[Array, "phases 2"]:
        """Integrate from the base to the zero of the moment."""
        fx, fy, mz = self.reaction
        angle, zero = self.angle - self.twist * mz, jnp.zeros(())
        start = (zero, zero, -jnp.sin(angle), jnp.cos(angle))
        load = rod.Load(-fx, -fy, -mz)
        material = self.stiffness if self.section is None else self.section
        x, y, cos, sin = rod.points(start, -self.length, load, material, count=GUESSES + 1, from_base=zero)
        moment = -rod.moment(x, y, load) * jnp.where(mz < 0, -1.0, 1.0)
        last, share = zero_of(moment)
        arc = self.length * (last + jnp.clip(share, 0.0, 1.0)) / GUESSES
        end = jnp.where(jnp.isfinite(cos[last + 1]) & (share > 0.5), last + 1, last)
        force = jnp.sqrt(fx**2 + fy**2)
        slope_cos, slope_sin = fy / force, -fx / force
        across, along = sin[end] * slope_cos - cos[end] * slope_sin, cos[end] * slope_cos + sin[end] * slope_sin
        theta = jnp.clip(jnp.arctan2(across, self.side * along) - self._turn, 0.0, LARGEST_ANGLE)
        beyond = jnp.clip(self.length - arc, START * self.length, 0.9 * self.length)
        return jnp.stack([jnp.stack([force, theta]), jnp.stack([force, beyond])])


def zero_of(moment: Float[Array, " points"]) -> tuple[Any, Scalar]:
    """The interval of a grid in which a moment that begins positive vanishes, and where in it, in its length."""
    passed = ~(moment[1:] > 0)  # True for NaN: thin tips overflow where the moment does not vanish
    last = jnp.where(jnp.any(passed), jnp.argmax(passed), moment.size - 2)
    here, there = moment[last], moment[last + 1]
    return last, jnp.where(there <= 0, here / jnp.where(there <= 0, here - there, 1.0), 1.0)


class Located(NamedTuple):
    """The contact of a whisker relative to its base, and its derivatives."""

    state: WhiskerState
    by_y_angle: WhiskerState  # with respect to y and the angle of the base
    follows: Float[Array, "*whiskers 2 4"]  # of y with respect to the reaction and the angle of the base
    ambiguous: Float[Array, "*whiskers 4 4"]  # covariance that the other phase adds
    near: Estimate


def locate(section: Section | None, lean: Scalar | None, *fields) -> Located:
    """Locate the contact of one whisker from the other fields of its PlaneObservation."""
    observed = PlaneObservation(*fields, section, lean)  # pyright: ignore[reportCallIssue]
    near = nearest_state(observed)

    def at(y_angle: Float[Array, "3"]) -> WhiskerState:
        return observed._replace(angle=y_angle[2]).state(y_angle[:2], near.phase)

    state, by_y_angle = value_and_jacobian(at, jnp.append(near.y, observed.angle))
    residuals = jnp.concatenate([-jnp.diag(observed.weight), by_y_angle.reaction[:, 2:] * observed.weight[:, None]], 1)
    return Located(state, by_y_angle, near.follows(residuals), near.ambiguity(observed, state.values[:4]), near)


class Instrument(NamedTuple):
    """A dimensionless sensor."""

    length: Float[Array, " whiskers"]
    stiffness: Float[Array, " whiskers"]
    section: Section | tuple[Section, ...] | None
    flexibility: Float[Array, "whiskers 3 whiskers 3"]  # in the drive's frame
    rest: Float[Array, "whiskers 3"]  # x, y, angle of the unloaded bases in the drive's frame

    def peaks(self, largest: Float[Array, "whiskers 3"]) -> Float[Array, "whiskers 3"]:
        """The size of each channel."""
        return largest

    def unloaded(self, drive: Float[Array, "3"]) -> None:
        """Without a contact, reactions vanish."""

    def bent(self, drive: Float[Array, "3"]) -> Float[np.ndarray, "3"]:
        """Reaction of a bent whisker."""
        return BENT

    def contacts(self, drive: Float[Array, "3"], signals: StepSignals, judgement: Judgement) -> Contacts:
        """The contacts of all whiskers at one step."""
        known = self if signals.pose is None else self._replace(flexibility=jnp.zeros_like(self.flexibility))
        located = each_whisker(self.section, locate, signals.lean, *known._observations(drive, signals))
        ok = signals.touching & located.near.ok
        if judgement.explained is not None:
            ok &= located.near.chi2 < judgement.explained[0]
            ok &= located.near.phase.tip | ~self._keep_integral()
        reactions = jnp.where(ok[:, None], located.state.reaction, signals.measured)
        bases = known._base_poses(drive, reactions) if signals.pose is None else signals.pose
        x, y, slope, arc, base_angle = located.state.values.T
        base_x, base_y, angle = bases.T
        base = {"base_x": base_x, "base_y": base_y, "base_angle": jnp.where(ok, base_angle, angle)}
        contact = {"x": base_x + x, "y": base_y + y, "slope": slope, "arc": arc, "force": located.near.y[:, 0]}
        covariance = known._covariance(located, drive[2], jnp.where(ok[:, None], signals.noise, 0.0))
        near = located.near
        return Contacts(contact, base, near.phase.tip, ok, near.chi2, covariance + located.ambiguous)

    def _keep_integral(self) -> Bool[np.ndarray, "*whiskers"]:
        """For which whiskers one contact on the shaft explains several."""
        sections = self.section if isinstance(self.section, tuple) else (self.section,)
        return np.array([keeps_integral(section) for section in sections])

    def _observations(self, drive, signals: StepSignals) -> tuple:
        """The fields of a PlaneObservation of every whisker, except the section."""
        loads = rotated(-signals.measured, -drive[2])  # in the drive's frame
        rotation = self.flexibility[:, 2]  # (whiskers, whiskers, 3): of every base by all loads
        own = jnp.eye(self.length.size, dtype=bool)
        by_others = jnp.sum(jnp.where(own[:, :, None], 0.0, rotation * loads), axis=(1, 2))
        angle = drive[2] + self.rest[:, 2] + by_others if signals.pose is None else signals.pose[:, 2]
        twist = jnp.sum(jnp.where(own, rotation[:, :, 2], 0.0), axis=1)
        side = jnp.where(signals.reaction[:, 2] < 0, -1.0, 1.0)
        return signals.reaction, signals.weight, angle, twist, side, self.length, self.stiffness

    def _base_poses(self, drive, reactions) -> Float[Array, "whiskers 3"]:
        """Poses of the bases that follow from drive, mounts and springs under these reactions."""
        loads = rotated(-reactions, -drive[2])
        return drive + rotated(self.rest + jnp.sum(self.flexibility * loads, axis=(2, 3)), drive[2])

    def _covariance(self, located: Located, drive_angle: Scalar, deviation) -> Float[Array, "whiskers 4 4"]:
        """Covariance of x, y, slope and arc from the noise of all whiskers; one with zero deviation adds nothing."""
        others = ~jnp.eye(deviation.shape[0], dtype=bool)[:, :, None]
        # Derivatives with respect to the reactions of all whiskers: of base angles, (j, k, 1, 3), and of y and angle.
        angle = jnp.where(others, -rotated(self.flexibility[:, 2], drive_angle), 0.0)[:, :, None, :]
        own = jnp.where(others[..., None], 0.0, located.follows[:, None, :, :3])
        y_angle = jnp.concatenate([own + located.follows[:, None, :, 3:] * angle, angle], axis=2)
        by_y_angle = jnp.concatenate([located.by_y_angle.values[:, :4], located.by_y_angle.reaction], axis=1)
        out = jnp.sum(by_y_angle[:, None, :, :, None] * y_angle[:, :, None, :, :], axis=3)  # (j, k, 7, 3)

        def rotate_rows(matrices, angle):
            return jnp.swapaxes(rotated(jnp.swapaxes(matrices, 2, 3), angle), 2, 3)

        # The bases move under all loads, which are the negative reactions.
        loads = jnp.swapaxes(rotate_rows(-out[:, :, 4:], -drive_angle), 0, 1)  # (k, j, 3, 3)
        moved = jnp.sum(self.flexibility[:, None, :, :, :, None] * loads[None, :, None], axis=(3, 4))
        out = out[:, :, :4].at[:, :, :2].add(rotate_rows(moved, drive_angle)[:, :, :2]) * deviation[None, :, None, :]
        return jnp.sum(out[:, :, :, None, :] * out[:, :, None, :, :], axis=(1, 4))


def instrument(sensor: Sensor, unit: Units) -> Instrument:
    """The sensor, dimensionless."""
    whiskers, support = sensor.whiskers, sensor.support
    bending_unit, n = unit.moment * unit.length, len(whiskers)
    mounts = [[mount.x / unit.length, mount.y / unit.length, mount.angle] for mount in support.mounts]
    rest = jnp.stack([jnp.stack([jnp.asarray(v, dtype=float) for v in mount]) for mount in mounts])
    flexibility = support.flexibility().in_frames(jnp.zeros(n), unit.length, unit.force)
    return Instrument(
        jnp.stack([jnp.asarray(w.length, dtype=float) for w in whiskers]) / unit.length,
        jnp.stack([jnp.asarray(w.base_stiffness, dtype=float) for w in whiskers]) / bending_unit,
        sections(whiskers, unit.length, bending_unit),
        flexibility.matrix.reshape(n, 3, n, 3),
        rest + flexibility.offset.reshape(n, 3),
    )


def keeps_integral(section: Section | None) -> bool:
    """Whether R . t + m^2 / (2 EI) + kappa0 m is the same all along a whisker.

    R is the internal force, t the direction of the whisker. The sum is constant between contacts if stiffness and
    curvature are. It does not change at contacts on the shaft without friction, whose force is perpendicular to it, and
    vanishes at the outermost one. However many there are, the reaction is therefore one that a single contact causes.
    """
    return section is None or not (callable(section.bending_stiffness) or callable(section.intrinsic_curvature))


def each_whisker(section: Any, function: Callable, *args):
    """Apply a function of section and arguments to every whisker."""
    if not isinstance(section, tuple):
        return jax.vmap(function, in_axes=(None if section is None else 0, *[0] * len(args)))(section, *args)
    each = [function(own, *jax.tree.map(lambda leaf, k=k: leaf[k], args)) for k, own in enumerate(section)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
