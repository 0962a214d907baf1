"""Reconstruction: compute the contact point of every whisker from measured support reactions.

Drive, mount and springs determine the pose of a base under the measured load. From there the rod is known up to the
point at which its moment vanishes. That is the contact, and the force there is normal to the object. Three reactions
are one more than needed, which decides the phase and separates noise from signal: see inverse_rod.py.

Source: Will, Behn, Steigenberger (2017), ZAMM, "Object contour scanning using elastically supported technical
vibrissae" (for exact signals).
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.dimensionless import sections
from jaxwhisker._inverse.features import noise_of
from jaxwhisker._inverse.inverse_rod import REACTION, LocatedContact, each_whisker, locate
from jaxwhisker._inverse.observations import Observations, channels_of, read_observations
from jaxwhisker._inverse.parameters import check_traceable, read_parameters
from jaxwhisker._inverse.points import PointStatus, Reconstruction, Step
from jaxwhisker._inverse.reconstruct_held import alone, check_held, held_contacts
from jaxwhisker._inverse.recording import check_signs
from jaxwhisker._model.scene import Scene, Sensor, Units, units_of
from jaxwhisker._rod.rod import Section
from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker._scan.scan import BLOCK

FREE = 16.266  # 99.9 % quantile of chi-squared of three reactions: below it they may be only noise
EXACTLY_FREE = 1e-18  # the same with the peaks in place of the noise, if the noise is unknown

# Reactions of a bent whisker replace those of whiskers without a contact, because every derivative must be finite.
PLACEHOLDER = np.array([-0.8795, 0.4758, 0.9755])


@with_own_settings
def reconstruct(
    measured: Any,
    sensor: Sensor | Scene | Callable[..., Sensor | Scene],
    *,
    sigma: Any = None,
    parameters: Mapping[str, Any] | None = None,
    covariance: Any = None,
    base: tuple[Any, Any, Any] | None = None,
    slip: Any = None,
) -> Reconstruction:
    """Locate the contact of every whisker at every step, with its uncertainty.

    Args:
        measured: control and support reactions fx, fy, mz of every whisker: a Result, a Dataset, a DataFrame, a CSV
            file (see `identify`) or a mapping of arrays, (steps,) or (steps, whiskers). A whisker is `missing` where
            one of its three reactions is NaN. Within jit and vmap: a mapping of arrays.
        sensor: the sensor; or a Scene, whose object is ignored; or a function of named parameters that returns either.
        sigma: standard deviation of the noise: a number for all channels, or a mapping from channels to numbers or
            arrays. Default: one number per kind of signal, estimated from the scatter between neighbouring samples.
            Signals that hardly scatter, such as those of a scan, and all signals within jit and vmap count as exact:
            their phases are decided up to rounding, and errors follow from `covariance` only.
        parameters: arguments of the function, by name.
        covariance: covariance of the parameters in their order, (p, p); it widens the bands.
        base: measured poses of the bases, which replace those that follow from drive, mounts and springs: x, y
            (lengths) and the angle of the whisker there to the upright (rad, positive counter-clockwise), each (steps,)
            or (steps, whiskers).
        slip: with friction, the direction in which contacts slip along the object: +1 towards +x, -1 towards -x, and
            values between them where contacts stick, for the share of the friction that acts; (steps,) or (steps,
            whiskers). Default: contacts slip with the drive, which is wrong while they stick after a reversal.

    Returns:
        A Reconstruction; NaN where a whisker is `free`, where signals are `missing`, or where no state fits (`failed`).

    Raises:
        ValueError: if an argument is wrong, JAX cannot trace the function, or signals are missing or negated; if
            springs hold shafts, also if springs connect whiskers, or if only springs above a base hold it and `base` is
            not given.
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
    known = sensor_of(made)
    if known.support.on_shafts:
        check_held(known, base)
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


def sensor_of(sensor: Any) -> Sensor:
    """The sensor, or that of a scene.

    Raises:
        ValueError: if it is neither.
    """
    if isinstance(sensor, Scene):
        return Sensor.of(sensor)
    if not isinstance(sensor, Sensor):
        raise ValueError(f"`sensor` must be a Sensor, a Scene or a function that returns one, got {sensor!r}.")
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


class Instrument(NamedTuple):
    """A dimensionless sensor."""

    unit: Units
    length: Float[Array, " whiskers"]
    stiffness: Float[Array, " whiskers"]
    section: Section | tuple[Section, ...] | None
    flexibility: Float[Array, "whiskers 3 whiskers 3"]  # in the drive's frame
    rest: Float[Array, "whiskers 3"]  # x, y, angle of the unloaded bases in the drive's frame
    friction_angle: Scalar | None  # None without friction


def instrument(sensor: Sensor) -> Instrument:
    """The sensor, dimensionless in the units of the first whisker."""
    whiskers, support = sensor.whiskers, sensor.support
    unit = jax.tree.map(checks.as_float, units_of(whiskers[0], sensor.motion))
    bending_unit, n = unit.moment * unit.length, len(whiskers)
    mounts = [[mount.x / unit.length, mount.y / unit.length, mount.angle] for mount in support.mounts]
    rest = jnp.stack([jnp.stack([jnp.asarray(v, dtype=float) for v in mount]) for mount in mounts])
    flexibility = support.flexibility().in_frames(jnp.zeros(n), unit.length, unit.force)
    return Instrument(
        unit,
        jnp.stack([jnp.asarray(w.length, dtype=float) for w in whiskers]) / unit.length,
        jnp.stack([jnp.asarray(w.base_stiffness, dtype=float) for w in whiskers]) / bending_unit,
        sections(whiskers, unit.length, bending_unit),
        flexibility.matrix.reshape(n, 3, n, 3),
        rest + flexibility.offset.reshape(n, 3),
        None if sensor.friction is None else jnp.arctan(jnp.asarray(sensor.friction, dtype=float)),
    )


def _contacts(sensor: Sensor, control, signals, noise, poses, slips) -> Step:
    """Contacts at all steps, in the sensor's units."""
    if sensor.support.on_shafts:
        return _contacts_one_by_one(sensor, control, signals, noise, poses, slips)
    known = instrument(sensor)
    unit = known.unit
    sizes, lengths = jnp.stack([unit.force, unit.force, unit.moment]), jnp.stack([unit.length, unit.length, 1.0])
    reaction = signals / sizes
    if noise is None:
        peaks = jax.lax.stop_gradient(jnp.max(jnp.nan_to_num(jnp.abs(reaction)), axis=0))
        deviation = jnp.broadcast_to(jnp.where(peaks > 0, peaks, 1.0), reaction.shape)
    else:
        deviation = noise / sizes
    drive = jnp.stack(jax.vmap(sensor.motion.pose)(control), axis=-1) / lengths
    leans = None if slips is None else slips * known.friction_angle
    each = drive, reaction, deviation, None if poses is None else poses / lengths, leans
    return jax.vmap(lambda *at: _step(known, noise is not None, *at))(*each)


def _contacts_one_by_one(sensor: Sensor, control, *per_whisker) -> Step:
    """The same for whiskers with springs on their shafts, which are not coupled, and others beside them."""
    each = []
    for k, own in enumerate(alone(sensor)):
        given = [None if values is None else values[:, k : k + 1] for values in per_whisker]
        threshold = EXACTLY_FREE if given[1] is None else FREE
        held = own.support.on_shafts
        each.append(held_contacts(own, threshold, control, *given) if held else _contacts(own, control, *given))
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves, axis=1), *each)


_contacts_now = Program(_contacts)


def _step(known: Instrument, noisy: bool, drive, reaction, deviation, pose, leans) -> Step:
    """Contacts of all whiskers at one step, computed without dimensions and given in the sensor's units."""
    flexibility = known.flexibility if pose is None else jnp.zeros_like(known.flexibility)
    signals = _sorted_signals(flexibility, FREE if noisy else EXACTLY_FREE, reaction, deviation, pose)
    observed = _observations(known, flexibility, drive, signals, deviation)
    located = each_whisker(known.section, locate, leans, *observed)
    ok = signals.touching & located.near.ok

    reactions = jnp.where(ok[:, None], located.values[:, REACTION], signals.measured)
    bases = _base_poses(known, flexibility, drive, reactions) if signals.pose is None else signals.pose
    bases = bases.at[:, 2].set(jnp.where(ok, located.values[:, 7], bases[:, 2]))
    covariance = _covariance(located, flexibility, drive[2], jnp.where(ok[:, None], deviation, 0.0))

    def where_ok(values):
        return jnp.where(jnp.reshape(ok, (ok.size, *[1] * (values.ndim - 1))), values, jnp.nan)

    length, if_noisy = known.unit.length, 1.0 if noisy else jnp.nan
    sizes = jnp.stack([length, length, 1.0, length])
    at_base = jnp.where(signals.missing[:, None], jnp.nan, bases * sizes[:3])
    codes = [PointStatus.missing, PointStatus.free, PointStatus.failed]
    return Step(
        x=where_ok(bases[:, 0] + located.values[:, 0]) * length,
        y=where_ok(bases[:, 1] + located.values[:, 1]) * length,
        slope=where_ok(located.values[:, 2]),
        arc=where_ok(located.values[:, 3]) * length,
        force=where_ok(located.near.z[:, 0]) * known.unit.force,
        phase=jnp.where(ok, jnp.where(located.near.tip, Phase.tip, Phase.tangential), Phase.free),
        base_x=at_base[:, 0],
        base_y=at_base[:, 1],
        base_angle=at_base[:, 2],
        chi2=where_ok(located.near.chi2) * if_noisy,
        significance=jnp.where(signals.missing, jnp.nan, jnp.sqrt(signals.significance)) * if_noisy,
        status=jnp.select([signals.missing, ~signals.touching, ~ok], codes, PointStatus.ok),
        covariance=where_ok(covariance + located.ambiguous) * sizes[:, None] * sizes * if_noisy,
    )


class _Signals(NamedTuple):
    """The signals of one step, sorted by what they show; every field (whiskers, ...)."""

    missing: Bool[Array, " whiskers"]
    touching: Bool[Array, " whiskers"]
    significance: Float[Array, " whiskers"]  # chi-squared of no contact
    measured: Float[Array, "whiskers 3"]  # 0 where missing; below the noise, they still move other whiskers' bases
    pose: Float[Array, "whiskers 3"] | None  # 0 where missing


def _sorted_signals(flexibility, threshold: float, reaction, deviation, pose) -> _Signals:
    missing = jnp.any(jnp.isnan(reaction), axis=-1)
    if pose is None:
        # The position of a base depends on the loads on all whiskers that it is coupled to.
        coupled = jnp.any(flexibility != 0, axis=(1, 3))
        missing = missing | jnp.any(coupled & missing, axis=-1)
    else:
        missing = missing | jnp.any(jnp.isnan(pose), axis=-1)
        pose = jnp.where(missing[:, None], 0.0, pose)
    present = jnp.where(missing[:, None], PLACEHOLDER, reaction)
    significance = jnp.sum((present / jnp.where(missing[:, None], 1.0, deviation)) ** 2, axis=-1)
    touching = ~missing & ~(significance < threshold)
    return _Signals(missing, touching, significance, jnp.where(missing[:, None], 0.0, reaction), pose)


def _observations(known: Instrument, flexibility, drive, signals: _Signals, deviation) -> tuple:
    """The fields of an Observation of every whisker, except the section."""
    reaction = jnp.where(signals.touching[:, None], signals.measured, PLACEHOLDER)
    loads = _rotate(-signals.measured, -drive[2])  # in the drive's frame
    rotation = flexibility[:, 2]  # (whiskers, whiskers, 3): of every base by all loads
    own = jnp.eye(known.length.size, dtype=bool)
    by_others = jnp.sum(jnp.where(own[:, :, None], 0.0, rotation * loads), axis=(1, 2))
    angle = drive[2] + known.rest[:, 2] + by_others if signals.pose is None else signals.pose[:, 2]
    twist = jnp.sum(jnp.where(own, rotation[:, :, 2], 0.0), axis=1)
    weight = 1 / jnp.where(signals.touching[:, None], deviation, 1.0)
    side = jnp.where(reaction[:, 2] < 0, -1.0, 1.0)
    return reaction, weight, angle, twist, side, known.length, known.stiffness


def _base_poses(known: Instrument, flexibility, drive, reactions) -> Float[Array, "whiskers 3"]:
    """Poses of the bases that follow from drive, mounts and springs under these reactions."""
    loads = _rotate(-reactions, -drive[2])
    return drive + _rotate(known.rest + jnp.sum(flexibility * loads, axis=(2, 3)), drive[2])


def _rotate(vectors: Float[Array, "*batch 3"], angle: Scalar) -> Float[Array, "*batch 3"]:
    """Rotate forces with moments, or shifts with angles, counter-clockwise."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y, rest = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y, rest], axis=-1)


def _covariance(located: LocatedContact, flexibility, drive_angle: Scalar, deviation) -> Float[Array, "whiskers 4 4"]:
    """Covariance of x, y, slope and arc from the noise of all whiskers; a whisker with zero deviation adds nothing."""
    others = ~jnp.eye(deviation.shape[0], dtype=bool)[:, :, None]
    # Derivatives with respect to the reactions of all whiskers: of base angles, (j, k, 1, 3), and of z and angle.
    angle = jnp.where(others, -_rotate(flexibility[:, 2], drive_angle), 0.0)[:, :, None, :]
    own = jnp.where(others[..., None], 0.0, located.follows[:, None, :, :3])
    z_angle = jnp.concatenate([own + located.follows[:, None, :, 3:] * angle, angle], axis=2)
    out = jnp.sum(located.by_z_angle[:, None, :7, :, None] * z_angle[:, :, None, :, :], axis=3)  # (j, k, 7, 3)

    def rotate_rows(matrices, angle):
        return jnp.swapaxes(_rotate(jnp.swapaxes(matrices, 2, 3), angle), 2, 3)

    # The bases move under all loads, which are the negative reactions.
    loads = jnp.swapaxes(rotate_rows(-out[:, :, 4:7], -drive_angle), 0, 1)  # (k, j, 3, 3)
    moved = jnp.sum(flexibility[:, None, :, :, :, None] * loads[None, :, None], axis=(3, 4))
    out = out[:, :, :4].at[:, :, :2].add(rotate_rows(moved, drive_angle)[:, :, :2]) * deviation[None, :, None, :]
    return jnp.sum(out[:, :, :, None, :] * out[:, :, None, :, :], axis=(1, 4))
