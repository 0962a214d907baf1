"""Reconstruction: compute the contact point of every whisker from measured support reactions.

Drive, mount and springs determine the pose of a base under the measured load. From there the rod is known up to the
point at which its moment vanishes. That is the contact, and the force there is normal to the object. Three reactions
are one more than needed, which decides the phase and separates noise from signal: see nearest.py.

Source: Will, Behn, Steigenberger (2017), ZAMM, "Object contour scanning using elastically supported technical
vibrissae" (for exact signals).
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._inverse.features import noise_of
from jaxwhisker._inverse.inverse_held import HeldInstrument, held_instrument
from jaxwhisker._inverse.inverse_rod import Instrument, instrument
from jaxwhisker._inverse.nearest import StepSignals, rotated
from jaxwhisker._inverse.observations import Observations, channels_of, read_observations
from jaxwhisker._inverse.parameters import check_traceable, read_parameters
from jaxwhisker._inverse.points import PointStatus, Reconstruction, Step
from jaxwhisker._inverse.recording import check_signs
from jaxwhisker._model.scene import Scene, Sensor, Units, units_of
from jaxwhisker._model.support import Support
from jaxwhisker._scan.blocks import BLOCK
from jaxwhisker._scan.quantities import REACTIONS

if TYPE_CHECKING:
    from jaxwhisker._inverse.points_in_space import SpaceReconstruction
    from jaxwhisker._model.space_scene import SpaceScene

InPlane: TypeAlias = Sensor | Scene | Callable[..., Sensor | Scene]
Names: TypeAlias = Mapping[str, Any] | None
FREE = 16.266  # 99.9 % quantile of chi-squared of three reactions: below it they may be only noise
# The same with the peaks in place of the noise, if the noise is unknown. Without contact, reactions vanish, or differ
# from those that springs on shafts cause by rounding: by 2e-12 of the peak for a pointed cone, and less for others.
EXACTLY_FREE = 1e-18

# Reactions of a bent whisker replace those of whiskers without a contact, because every derivative must be finite.
PLACEHOLDER = np.array([-0.8795, 0.4758, 0.9755])


@overload
def reconstruct(
    measured: Any,
    sensor: InPlane,
    *,
    sigma: Any = None,
    parameters: Names = None,
    covariance: Any = None,
    base: tuple[Any, Any, Any] | None = None,
    slip: Any = None,
) -> Reconstruction: ...
@overload
def reconstruct(
    measured: Any,
    sensor: "SpaceScene | Callable[..., SpaceScene]",
    *,
    sigma: Any = None,
    parameters: Names = None,
    covariance: Any = None,
) -> "SpaceReconstruction": ...
@with_own_settings
def reconstruct(
    measured: Any,
    sensor: Any,
    *,
    sigma: Any = None,
    parameters: Names = None,
    covariance: Any = None,
    base: tuple[Any, Any, Any] | None = None,
    slip: Any = None,
) -> Any:
    """Locate the contact of every whisker at every step, with its uncertainty.

    Args:
        measured: control and support reactions fx, fy, mz of every whisker: a Result, a Dataset, a DataFrame, a CSV
            file (see `identify`) or a mapping of arrays, (steps,) or (steps, whiskers). A whisker is `missing` where
            one of its three reactions is NaN. Within jit and vmap: a mapping of arrays. In space: fx, fy, fz, mx, my,
            mz, or the components along the directors d1, d2, d3 of the displaced base, f1, f2, f3, m1, m2 and m3; of
            these, f1 to m2 suffice, and without friction f3, m1 and m2 of whiskers whose stiffness varies.
        sensor: the sensor; or a Scene, whose object is ignored; or a function of named parameters that returns either.
            In space: a scene with any surface.
        sigma: standard deviation of the noise: a number for all channels, or a mapping from channels to numbers or
            arrays; in space also the covariance of the channels in the order above, such as (6, 6). Default: one number
            per kind of signal, estimated from the scatter between neighbouring samples. Signals that hardly scatter,
            such as those of a scan, and all signals within jit and vmap count as exact: their phases are decided up to
            rounding, and errors follow from `covariance` only.
        parameters: arguments of the function, by name.
        covariance: covariance of the parameters in their order, (p, p); it widens the bands.
        base: measured poses of the bases, which replace those that follow from drive, mounts and springs: x, y
            (lengths) and the angle of the whisker there to the upright (rad, positive counter-clockwise), each (steps,)
            or (steps, whiskers).
        slip: with friction, the direction in which contacts slip along the object: +1 towards +x, -1 towards -x, and
            values between them where contacts stick, for the share of the friction that acts; (steps,) or (steps,
            whiskers). Default: contacts slip with the drive, which is wrong while they stick after a reversal.

    Returns:
        A Reconstruction, in space a SpaceReconstruction; NaN where a whisker is `free`, where signals are `missing`, or
        where no state fits (`failed`).

    Raises:
        ValueError: if an argument is wrong, JAX cannot trace the function, or signals are missing or negated; if
            springs hold shafts, also if springs connect whiskers, or if only springs above a base hold it and `base` is
            not given. In space: if the channels do not determine a contact, torsion springs connect whiskers, or
            `base` or `slip` is given.
    """
    checks.float64_mode()
    is_function = callable(sensor) and not isinstance(sensor, (Sensor, Scene))
    if (parameters is None) == is_function:
        raise ValueError(f"`parameters` must be given if `sensor` is a function, and only then, got {parameters}.")
    made: Any = sensor
    names, values = (), jnp.zeros(0)
    if parameters is not None:
        parameters = read_parameters("parameters", parameters)
        names, values = tuple(parameters), jnp.stack([jnp.asarray(v, dtype=float) for v in parameters.values()])
        checks.arguments("parameters", sensor, names, called="sensor")
        made = made(**dict(zip(names, values, strict=True)))
    if covariance is not None and np.shape(covariance) != (values.size,) * 2:
        allowed = f"of the {values.size} parameters, ({values.size}, {values.size})"
        checks.fail("covariance", allowed, f"shape {np.shape(covariance)}")
    if getattr(made, "in_space", False):
        return _in_space(measured, made, sigma, base, slip, (sensor, names, values, covariance))
    known = sensor_of(made)
    if known.support.on_shafts:
        _check_held(known, base)
    if covariance is not None and parameters is not None and not checks.is_traced(values):
        check_traceable(sensor, parameters, called="sensor")  # pyright: ignore[reportArgumentType]
    readings = _signals(measured, sigma, known, base)
    control, signals, _ = readings
    shape = signals.shape[0], signals.shape[1]
    readings = *readings, None if base is None else _poses(base, shape), _slips(known, slip, control, shape)
    # Recordings of similar length share a compilation.
    padding = -control.size % BLOCK
    readings = jax.tree.map(
        lambda array: jnp.pad(array, [(0, padding)] + [(0, 0)] * (array.ndim - 1), mode="edge"), readings
    )
    if parameters is None or covariance is None:
        points = _contacts_now(jax.tree.map(checks.as_float, known), *readings)
    else:
        points = _contacts_of_parameters(sensor, names, values, jnp.asarray(covariance, dtype=float), readings)
    points = jax.tree.map(lambda leaf: leaf[: control.size], points)
    return Reconstruction(**vars(points), control=control, length=jnp.asarray(known.whiskers[0].length, dtype=float))


def _in_space(measured: Any, made: Any, sigma: Any, base: Any, slip: Any, parameters: tuple) -> Any:
    from jaxwhisker._inverse.reconstruct_in_space import reconstruct_in_space

    if base is not None:
        checks.fail("base", "None in space", "poses")
    if slip is not None:
        checks.fail("slip", "None in space, where the direction of the force is measured", "one")
    build, names, values, covariance = parameters
    widened = None if covariance is None else (build, names, values, jnp.asarray(covariance, dtype=float))
    if widened and not checks.is_traced(values):
        check_traceable(build, dict(zip(names, map(float, values), strict=True)), called="sensor")
    return reconstruct_in_space(measured, made, sigma, widened)


def sensor_of(sensor: Any) -> Sensor:
    """The sensor, or that of a scene.

    Raises:
        ValueError: if it is neither.
    """
    if isinstance(sensor, Scene):
        return Sensor.of(sensor)
    checks.instance("sensor", sensor, Sensor, "a Sensor, a Scene or a function that returns one")
    return sensor


def _signals(measured: Any, sigma: Any, known: Sensor, base: Any):
    """Control (steps,), reactions and their noise (steps, whiskers, 3); None for exact signals."""
    whiskers = len(known.whiskers)
    if not checks.is_traced((measured, sigma)):
        observations = read_observations(measured, sigma, whiskers=whiskers)
        _check_complete(observations, coupled=base is None and any(0 not in s.between for s in known.support.springs))
        if sigma is None and (noise := noise_of(observations)) is not None:
            observations = observations.with_sigma(noise)
        if base is None and not checks.is_traced(known):  # measured poses may be those of another motion
            check_signs(observations, known)
        exact = np.isnan(observations.sigma).all()
        noise = None if exact else jnp.asarray(np.where(np.isnan(observations.sigma), 1.0, observations.sigma))
        return jnp.asarray(observations.control), jnp.asarray(observations.values), noise
    if not isinstance(measured, Mapping) or not {"control", *REACTIONS} <= set(measured):
        raise ValueError("`measured` must be a mapping with control, fx, fy and mz within jit, vmap and derivatives.")
    control = jnp.asarray(measured["control"], dtype=float)
    shape = control.shape[0], whiskers
    values = jnp.stack([jnp.reshape(jnp.asarray(measured[c], dtype=float), shape) for c in REACTIONS], axis=-1)
    if sigma is None:
        return control, values, None
    each = sigma if isinstance(sigma, Mapping) else dict.fromkeys(REACTIONS, sigma)
    noise = [jnp.broadcast_to(jnp.asarray(each[c], dtype=float), shape) for c in REACTIONS]
    return control, values, jnp.stack(noise, axis=-1)


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


@Program
def _contacts_of_parameters(build, names, values, covariance, readings) -> Step:
    """The points, with the uncertainty of the parameters added to their covariance."""

    def at(values):
        points = _contacts(sensor_of(build(**dict(zip(names, values, strict=True)))), *readings)
        return jnp.stack([points.x, points.y, points.slope, points.arc], axis=-1), points

    by_values, points = jax.jacfwd(at, has_aux=True)(values)
    of_values = jnp.einsum("...ip,pq,...jq->...ij", by_values, covariance, by_values)
    of_noise = jnp.zeros(()) if readings[2] is None else points.covariance
    return dataclasses.replace(points, covariance=of_values + of_noise)


def _slips(sensor: Sensor, slip: Any, control: Any, shape: tuple[int, int]) -> Float[Array, "steps whiskers"] | None:
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


def _contacts(sensor: Sensor, control, signals, noise, poses, slips) -> Step:
    """Contacts at all steps, in the sensor's units."""
    held, whiskers = sensor.support.on_shafts, len(sensor.whiskers)
    if held and whiskers > 1:  # which are not coupled
        each = []
        for k, own in enumerate(_alone(sensor)):
            of_own = (None if v is None else v[:, k : k + 1] for v in (signals, noise, poses, slips))
            each.append(_contacts(own, control, *of_own))
        return jax.tree.map(lambda *leaves: jnp.concatenate(leaves, axis=1), *each)
    unit = jax.tree.map(checks.as_float, units_of(sensor.whiskers[0], sensor.motion))
    known = held_instrument(sensor) if held else instrument(sensor, unit)
    sizes, lengths = jnp.stack([unit.force, unit.force, unit.moment]), jnp.stack([unit.length, unit.length, 1.0])
    reaction = signals / sizes
    if noise is None:
        peaks = jax.lax.stop_gradient(jnp.max(jnp.nan_to_num(jnp.abs(reaction)), axis=0))
        if held:  # a base that is free along an axis has no reaction along it
            peaks = jnp.max(peaks)
        deviation = jnp.broadcast_to(jnp.where(peaks > 0, peaks, 1.0), reaction.shape)
    else:
        deviation = noise / sizes
    drive = jnp.stack(jax.vmap(sensor.motion.pose)(control), axis=-1) / lengths
    leans = None if slips is None else slips * jnp.arctan(jnp.asarray(sensor.friction, dtype=float))
    each = drive, reaction, deviation, None if poses is None else poses / lengths, leans
    return jax.vmap(lambda *at: _step(known, unit, noise is not None, *at))(*each)


_contacts_now = Program(_contacts)


def _step(known: Instrument | HeldInstrument, unit: Units, noisy: bool, drive, *measured) -> Step:
    """Contacts of all whiskers at one step, computed without dimensions and given in the sensor's units."""
    signals, significance = _sorted_signals(known, FREE if noisy else EXACTLY_FREE, drive, *measured)
    found, if_noisy = known.contacts(drive, signals), 1.0 if noisy else jnp.nan
    sizes = jnp.stack([unit.length, unit.length, 1.0, unit.length])
    values = (found.values * jnp.concatenate([sizes, sizes[:3], jnp.stack([unit.force])])).T
    at_base = jnp.where(signals.missing, jnp.nan, values[4:7])
    values, ok = jnp.where(found.ok, values, jnp.nan), found.ok
    codes = [PointStatus.missing, PointStatus.free, PointStatus.failed]
    return Step(
        *values[:4],
        force=values[7],
        phase=jnp.where(ok, jnp.where(found.tip, Phase.tip, Phase.tangential), Phase.free),
        base_x=at_base[0],
        base_y=at_base[1],
        base_angle=at_base[2],
        chi2=jnp.where(ok, found.chi2, jnp.nan) * if_noisy,
        significance=jnp.where(signals.missing, jnp.nan, jnp.sqrt(significance)) * if_noisy,
        status=jnp.select([signals.missing, ~signals.touching, ~ok], codes, PointStatus.ok),
        covariance=jnp.where(ok[:, None, None], found.covariance, jnp.nan) * sizes[:, None] * sizes * if_noisy,
    )


def _sorted_signals(known: Instrument | HeldInstrument, threshold: float, drive, reaction, deviation, pose, lean):
    """The signals of one step, and the chi-squared of no contact."""
    missing = jnp.any(jnp.isnan(reaction), axis=-1)
    if pose is None:
        # The position of a base depends on the loads on all whiskers that it is coupled to.
        missing = missing | jnp.any(known.coupled & missing, axis=-1)
    else:
        missing = missing | jnp.any(jnp.isnan(pose), axis=-1)
        pose = jnp.where(missing[:, None], drive, pose)
    loaded = reaction if known.unloaded is None else reaction - rotated(known.unloaded, drive[2])
    loaded = jnp.where(missing[:, None], PLACEHOLDER, loaded)
    significance = jnp.sum((loaded / jnp.where(missing[:, None], 1.0, deviation)) ** 2, axis=-1)
    touching = ~missing & ~(significance < threshold)
    measured = jnp.where(missing[:, None], 0.0, reaction)
    fitted = jnp.where(touching[:, None], measured, PLACEHOLDER)
    weight = 1 / jnp.where(touching[:, None], deviation, 1.0)
    return StepSignals(missing, touching, measured, deviation, fitted, weight, pose, lean), significance
