"""Reconstruction with springs or a foundation on the shaft of a whisker, one whisker at a time."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._inverse.inverse_held import HeldObservation, base_under, nearest_held_state
from jaxwhisker._inverse.points import PointStatus, Step
from jaxwhisker._model.loads import PointForce
from jaxwhisker._model.scene import Sensor, units_of
from jaxwhisker._model.support import Support
from jaxwhisker._scan.deflect import solved_top
from jaxwhisker._scan.loaded_rod import LoadedRod, bent, loaded_rod

# Chi-squared of exact signals that may show no contact: a prestressed whisker's reaction is accurate to 1e-8.
EXACTLY_FREE = 1e-14


# Reactions of a bent whisker replace those of whiskers without a contact, because every derivative must be finite.
PLACEHOLDER = np.array([-0.8795, 0.4758, 0.9755])


def check_held(sensor: Sensor, base: Any) -> None:
    """Check that whiskers can be reconstructed one by one, and that signals determine the poses of their bases.

    Raises:
        ValueError: if springs couple whiskers, or springs above a base alone hold it and `base` is None.
    """
    for spring in sensor.support.springs:
        if 0 not in spring.between:
            allowed = "one whose springs do not connect whiskers, if springs or foundations hold shafts"
            checks.fail("sensor", allowed, f"a spring between {spring.between}")
    for k, own in enumerate(alone(sensor)):
        support = own.support
        held = [axis for axis in support.axes if not support.along(axis)]
        places = [at for spring in support.attached for _, at in spring.ends]
        below = [at for at in places if checks.is_traced(at) or float(at) <= 0]
        if base is None and len(held) > len(below):
            raise ValueError(
                f"`base` must be given, because no signal shows where the springs above the base of whisker {k + 1} "
                f"hold it along {', '.join(held)}, got None."
            )


def alone(sensor: Sensor) -> tuple[Sensor, ...]:
    """A sensor for each whisker."""
    support, each = sensor.support, []
    for k, whisker in enumerate(sensor.whiskers):
        own = [s for s in support.springs if s.between in ((0, k + 1), (k + 1, 0))]
        springs = tuple(dataclasses.replace(s, between=(0, 1) if s.between[0] == 0 else (1, 0)) for s in own)
        tissue = support.foundations[k]
        attached = tissue is not None or not all(spring.linear for spring in springs)
        held = Support(springs, support.mounts[k], foundation=tissue, free=support.free if attached else ())
        each.append(Sensor(whisker, held, sensor.motion, sensor.friction))
    return tuple(each)


def held_contacts(sensor: Sensor, threshold: float, control, signals, noise, poses, slips) -> Step:
    """Contacts of one whisker at all steps, in the sensor's units; arguments have shape (steps, 1, ...)."""
    (whisker,), unit = sensor.whiskers, jax.tree.map(checks.as_float, units_of(sensor.whiskers[0], sensor.motion))
    equations, _ = loaded_rod(whisker, (PointForce(0.0),), sensor.support)
    sizes, lengths = jnp.stack([unit.force, unit.force, unit.moment]), jnp.stack([unit.length, unit.length, 1.0])
    reaction = signals[:, 0] / sizes
    if noise is None:
        # One for all three: a base that is free along an axis has no reaction along it.
        peak = jax.lax.stop_gradient(jnp.max(jnp.nan_to_num(jnp.abs(reaction))))
        deviation = jnp.broadcast_to(jnp.where(peak > 0, peak, 1.0), reaction.shape)
        threshold = EXACTLY_FREE
    else:
        deviation = noise[:, 0] / sizes
    drive = jnp.stack(jax.vmap(sensor.motion.pose)(control), axis=-1) / lengths
    lean = None if slips is None else slips[:, 0] * jnp.arctan(jnp.asarray(sensor.friction, dtype=float))
    free = _unloaded(equations)

    def one(drive, reaction, deviation, pose, lean):
        return _step(equations, free, threshold, drive, reaction, deviation, pose, lean)

    step = jax.vmap(one)(drive, reaction, deviation, None if poses is None else poses[:, 0] / lengths, lean)
    length, if_noisy = unit.length, 1.0 if noise is not None else jnp.nan
    sizes = jnp.stack([length, length, 1.0, length])
    return dataclasses.replace(
        step,
        **{name: getattr(step, name) * length for name in ("x", "y", "arc", "base_x", "base_y")},
        force=step.force * unit.force,
        chi2=step.chi2 * if_noisy,
        significance=step.significance * if_noisy,
        covariance=step.covariance * sizes[:, None] * sizes * if_noisy,
    )


def _unloaded(equations: LoadedRod) -> Float[Array, "3"]:
    """Reaction of the free whisker in the drive's frame; without derivatives."""
    equations = jax.lax.stop_gradient(equations)
    return -bent(equations, solved_top(equations).unknowns, 2).load


def _turned(vector: Float[Array, "3"], angle: Scalar) -> Float[Array, "3"]:
    cos, sin, (x, y, rest) = jnp.cos(angle), jnp.sin(angle), vector
    return jnp.stack([cos * x - sin * y, sin * x + cos * y, rest])


def _step(equations: LoadedRod, free, threshold: float, drive, reaction, deviation, pose, lean) -> Step:
    """Contact of the one whisker at one step, dimensionless."""
    missing = jnp.any(jnp.isnan(reaction))
    if pose is not None:
        missing |= jnp.any(jnp.isnan(pose))
        frame = pose - drive
        pose = jnp.where(missing, equations.rest, _turned(frame, -drive[2]))
    loaded = reaction - _turned(free, drive[2])
    significance = jnp.where(missing, 0.0, jnp.sum((jnp.where(missing, 0.0, loaded) / deviation) ** 2))
    touching = ~missing & ~(significance < threshold)
    observed = HeldObservation(
        jnp.where(touching, reaction, PLACEHOLDER),
        1 / jnp.where(touching, deviation, 1.0),
        drive,
        equations,
        pose,
        lean,
    )
    near = nearest_held_state(observed)
    ok = touching & near.ok
    x, y, slope, arc, *_, force = near.values
    as_measured = base_under(observed._replace(reaction=jnp.where(missing, PLACEHOLDER, reaction)))
    base = jnp.where(missing, jnp.nan, jnp.where(ok, near.values[4:7], as_measured))
    codes = [PointStatus.missing, PointStatus.free, PointStatus.failed]

    def where_ok(value):
        return jnp.where(ok, value, jnp.nan)

    fields = {
        "x": where_ok(x),
        "y": where_ok(y),
        "slope": where_ok(slope),
        "arc": where_ok(arc),
        "force": where_ok(force),
        "phase": jnp.where(ok, jnp.where(near.tip, Phase.tip, Phase.tangential), Phase.free),
        "base_x": base[0],
        "base_y": base[1],
        "base_angle": base[2],
        "chi2": where_ok(near.chi2),
        "significance": jnp.where(missing, jnp.nan, jnp.sqrt(significance)),
        "status": jnp.select([missing, ~touching, ~ok], codes, PointStatus.ok),
        "covariance": where_ok(near.covariance),
    }
    return Step(**{name: value[None] for name, value in fields.items()})
