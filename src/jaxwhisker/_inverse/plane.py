"""Reconstruction in the plane: sensors, their signals fx, fy and mz, poses of bases and directions of slip."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._inverse.features import with_scatter
from jaxwhisker._inverse.inverse_held import held_instrument
from jaxwhisker._inverse.inverse_rod import instrument
from jaxwhisker._inverse.mechanics import InverseMechanics, Readings
from jaxwhisker._inverse.observations import Observations, channels_of, read_observations
from jaxwhisker._inverse.points import Reconstruction
from jaxwhisker._inverse.recording import check_signs
from jaxwhisker._model.scene import Scene, Sensor
from jaxwhisker._model.support import Support
from jaxwhisker._scan.contacts import check_one_contact
from jaxwhisker._scan.quantities import REACTIONS


class InversePlane(InverseMechanics):
    """Whiskers in the plane."""

    result, numbers = Reconstruction, ("x", "y", "slope", "arc")
    correlated = shared = False

    @staticmethod
    def sensor(made):
        return sensor_of(made)

    @classmethod
    def read(cls, measured, sigma, sensor, base, slip):
        if sensor.support.on_shafts:
            _check_held(sensor, base)
        whiskers = len(sensor.whiskers)
        if checks.is_traced((measured, sigma)):
            if not isinstance(measured, Mapping) or not {"control", *REACTIONS} <= set(measured):
                allowed = "a mapping with control, fx, fy and mz within jit, vmap and derivatives"
                raise ValueError(f"`measured` must be {allowed}.")
            readings = Readings.traced(measured, sigma, REACTIONS, whiskers)
        else:
            if not cls.several:
                check_one_contact("measured", measured)
            observed = read_observations(measured, sigma, whiskers=whiskers)
            _check_complete(observed, coupled=base is None and any(0 not in s.between for s in sensor.support.springs))
            observed = with_scatter(observed) if sigma is None else observed
            if base is None and not checks.is_traced(sensor):  # measured poses may be those of another motion
                check_signs(observed, sensor)
            readings = Readings.of(observed)
        shape = readings.signals.shape[:2]
        poses = None if base is None else _poses(base, shape)
        return REACTIONS, readings._replace(poses=poses, slips=_slips(sensor, slip, readings.control, shape))

    @staticmethod
    def parts(sensor):
        # Springs do not couple whiskers whose shafts they hold.
        return _alone(sensor) if sensor.support.on_shafts and len(sensor.whiskers) > 1 else (sensor,)

    @staticmethod
    def dimensionless(sensor, unit, kinds, readings):
        known = held_instrument(sensor) if sensor.support.on_shafts else instrument(sensor, unit)
        lengths, poses, slips = jnp.stack([unit.length, unit.length, 1.0]), readings.poses, readings.slips
        drive = jnp.stack(jax.vmap(sensor.motion.pose)(readings.control), axis=-1) / lengths
        leans = None if slips is None else slips * jnp.arctan(jnp.asarray(sensor.friction, dtype=float))
        return known, drive, None if poses is None else poses / lengths, leans


def sensor_of(sensor: Any, *, several: bool = False) -> Sensor:
    """The sensor, or that of a scene.

    Raises:
        ValueError: if it is neither, or its whiskers may have several contacts, unless this is expected.
    """
    if isinstance(sensor, Scene):
        if not several:
            check_one_contact("sensor", sensor)
        return Sensor.of(sensor)
    checks.instance("sensor", sensor, Sensor, "a Sensor, a Scene or a function that returns one")
    return sensor


def _check_complete(observations: Observations, *, coupled: bool) -> None:
    """Check that fx, fy and mz of every whisker are there, or of every measured one if springs do not couple them."""
    known = np.asarray(observations.known.any(axis=0))
    needed = np.asarray(coupled | np.any(known, axis=1))
    lacking = [c.name for c in channels_of(len(known)) if needed[c.whisker] and not known[c.whisker, c.kind]]
    if lacking or not known.any():
        words = f"no value of {', '.join(lacking)}" if lacking else "no values"
        raise ValueError(
            f"`measured` must hold fx, fy and mz of every whisker for a reconstruction, got {words}; `identify` and "
            "`fit_contour` fit fewer signals."
        )


def _poses(base: Any, shape: tuple[int, int]) -> Float[Array, "steps whiskers 3"]:
    if not (isinstance(base, (tuple, list)) and len(base) == 3):
        raise ValueError(f"`base` must be x, y and angle of the bases, got {base!r}.")
    poses = []
    for value in base:
        value = jnp.asarray(value, dtype=float)
        if value.shape not in (shape, shape[:1]):
            raise ValueError(f"`base` must hold arrays of shape {shape}, got shape {value.shape}.")
        poses.append(jnp.broadcast_to(value if value.ndim == 2 else value[:, None], shape))
    return jnp.stack(poses, axis=-1)


def _slips(
    sensor: Sensor | Scene, slip: Any, control: Any, shape: tuple[int, int]
) -> Float[Array, "steps whiskers"] | None:
    """Directions of slip; None without friction."""
    if slip is not None and sensor.friction is None:
        raise ValueError("`slip` must be given for a sensor with friction only, got one for a sensor without friction.")
    if sensor.friction is None:
        return None
    if slip is not None:
        slip = jnp.asarray(slip, dtype=float)
        if slip.shape not in (shape, shape[:1]):
            raise ValueError(f"`slip` must be an array of shape {shape}, got shape {slip.shape}.")
        return jnp.broadcast_to(slip if slip.ndim == 2 else slip[:, None], shape)
    moves = jnp.sign(jnp.diff(control))
    # While the drive stands still, the direction stays.
    moves = jax.lax.associative_scan(lambda a, b: jnp.where(b == 0, a, b), moves)
    with_drive = -sensor.motion.onwards * jnp.concatenate([moves[:1], moves])
    return jnp.broadcast_to(with_drive[:, None], shape)


def _check_held(sensor: Sensor, base: Any) -> None:
    """Check that whiskers can be reconstructed one by one, and that signals determine the poses of their bases."""
    for spring in sensor.support.springs:
        if 0 not in spring.between:
            allowed = "one whose springs do not connect whiskers, if springs or foundations hold shafts"
            checks.fail("sensor", allowed, f"a spring between {spring.between}")
    for k, own in enumerate(_alone(sensor)):
        support = own.support
        held = [axis for axis in support.axes if not support.along(axis)]
        places = [at for spring in support.attached for _, at in spring.ends]
        below = [at for at in places if checks.is_traced(at) or float(at) <= 0]
        if base is None and len(held) > len(below):
            raise ValueError(
                f"`base` must be given, because no signal shows where the springs above the base of whisker {k + 1} "
                f"hold it along {', '.join(held)}, got None."
            )


def _alone(sensor: Sensor) -> tuple[Sensor, ...]:
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
