"""Reconstruct: from measured support reactions back to where every whisker touches the object.

A base stands where drive, mount and springs under the measured load want it. From there the rod is known to where its
moment vanishes: that is the contact, and the force there is normal to the object. Three reactions say more than is
needed, which tells the phase, and noise from signal: see inverse_rod.py.

Source: Will, Behn, Steigenberger (2017), ZAMM, "Object contour scanning using elastically supported technical
vibrissae" (for exact signals).
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.jit import COMPILER_OPTIONS
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.problem import sections
from jaxwhisker._inverse import inverse_rod
from jaxwhisker._inverse.inverse_rod import Told
from jaxwhisker._inverse.measured import CHANNELS, measured_of
from jaxwhisker._inverse.points import PointStatus, Reconstruction, Step
from jaxwhisker._model.motion import AbstractMotion
from jaxwhisker._model.scene import Scene, Sensor, Units, units_of
from jaxwhisker._rod.rod import Section

STEPS_AT_ONCE = 512  # lengths of scans are rounded up to multiples: most are then compiled for already
FREE = 16.266  # chi^2 of three reactions, 99.9 %: below it they may be nothing but noise
EXACTLY_FREE = 1e-18  # the same, relative to the peaks, where nothing is known of the noise

Known = Mapping[str, Any]


class Instrument(NamedTuple):
    """A sensor without dimensions."""

    unit: Units
    length: Float[Array, " whiskers"]
    stiffness: Float[Array, " whiskers"]
    section: Section | tuple[Section, ...] | None
    flexibility: Float[Array, "whiskers 3 whiskers 3"]  # in the drive's frame
    offset: Float[Array, "whiskers 3"]
    mount: Float[Array, "whiskers 3"]  # x, y, angle
    motion: AbstractMotion


def reconstruct(
    measured: Any,
    sensor: Sensor | Scene | Callable[..., Sensor | Scene],
    *,
    sigma: Any = None,
    parameters: Known | None = None,
    covariance: Any = None,
    base: tuple[Any, Any, Any] | None = None,
) -> Reconstruction:
    """Where every whisker touches the object, at every step, and how exactly that is known.

    Args:
        measured: control and support reactions fx, fy, mz of every whisker: a Result, a Dataset, a DataFrame, a CSV
            file or a mapping of arrays, (steps,) or (steps, whiskers). A whisker of which one of the three is NaN is
            `missing` there. Within jit and vmap: a mapping of arrays.
        sensor: the instrument; of a Scene all but the object; or a function of named parameters that makes either.
        sigma: standard deviation of the signals' noise: a number for all, or a mapping from channels to numbers or
            arrays. None for signals without noise, of which the phases are decided to rounding.
        parameters: what the function is called with, by name.
        covariance: of the parameters in their order, (p, p): what is not known of them widens the bands.
        base: measured poses (x, y, angle) of the bases, each (steps,) or (steps, whiskers), in place of those that
            drive, mounts and springs give.

    Returns:
        A Reconstruction; NaN where a whisker is free, where signals are missing, or where no state fits (`failed`).

    Raises:
        ValueError: if an argument is not of that kind.
    """
    checks.float64_mode()
    if (parameters is None) != (not _is_function(sensor)):
        raise ValueError(
            f"`parameters` must be given with a function for `sensor`, and only then, but is {parameters}."
        )
    values = None if parameters is None else _values_of(parameters)
    made: Any = sensor
    if parameters is not None and values is not None:
        made = made(**dict(zip(parameters, values, strict=True)))
    if covariance is not None:
        covariance = _covariance_of(covariance, values)
    known = _sensor_of(made)
    control, signals, noise = _signals(measured, sigma, len(known.whiskers))
    poses = None if base is None else _poses(base, (signals.shape[0], signals.shape[1]))
    steps = control.shape[0]
    spare = -steps % STEPS_AT_ONCE

    def padded(array):
        return jnp.concatenate([array, jnp.broadcast_to(array[-1], (spare, *array.shape[1:]))])

    control, (signals, noise, poses) = padded(control), jax.tree.map(padded, (signals, noise, poses))
    if steps + spare > steps:
        signals = signals.at[steps:].set(jnp.nan)
    if values is None or covariance is None:
        known = jax.tree.map(checks.as_float, known)
        inside = checks.is_traced((known, control, signals, noise, poses))
        found = (_of_sensor if inside else _of_sensor_now)(known, control, signals, noise, poses)
    else:
        assert parameters is not None
        found = _of_parameters(sensor, tuple(parameters), values, covariance, control, signals, noise, poses)
    found = jax.tree.map(lambda leaf: leaf[:steps], found)
    fields = {field.name: getattr(found, field.name) for field in dataclasses.fields(Step)}
    return Reconstruction(control=control[:steps], **fields)


def _is_function(sensor: Any) -> bool:
    return callable(sensor) and not isinstance(sensor, (Sensor, Scene))


def _values_of(parameters: Known) -> Float[Array, " p"]:
    if not isinstance(parameters, Mapping) or not parameters:
        raise ValueError(f"`parameters` must be a mapping from names to numbers, but is {parameters!r}.")
    for name, value in parameters.items():
        checks.number(name, value)
    return jnp.stack([jnp.asarray(value, dtype=float) for value in parameters.values()])


def _covariance_of(covariance: Any, values: Float[Array, " p"] | None) -> Float[Array, "p p"]:
    size = 0 if values is None else values.size
    covariance = jnp.asarray(covariance, dtype=float)
    if covariance.shape != (size, size):
        raise ValueError(
            f"`covariance` must be of the {size} parameters, ({size}, {size}), but its shape is {covariance.shape}."
        )
    return covariance


def _sensor_of(sensor: Any) -> Sensor:
    if isinstance(sensor, Scene):
        return Sensor.of(sensor)
    if not isinstance(sensor, Sensor):
        raise ValueError(f"`sensor` must be a Sensor, a Scene or a function that makes one, but is {sensor!r}.")
    return sensor


def _signals(measured: Any, sigma: Any, whiskers: int):
    """Control (steps,), reactions and their noise (steps, whiskers, 3); None for the noise where it is unknown."""
    if not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((measured, sigma))):
        read = measured_of(measured, sigma, whiskers=whiskers)
        noise = None if sigma is None else jnp.asarray(np.where(np.isnan(read.sigma), 1.0, read.sigma))
        return jnp.asarray(read.control), jnp.asarray(read.values), noise
    if not isinstance(measured, Mapping) or not {"control", *CHANNELS} <= set(measured):
        raise ValueError("`measured` must be a mapping with control, fx, fy and mz within jit, vmap and derivatives.")
    control = jnp.asarray(measured["control"], dtype=float)
    shape = control.shape[0], whiskers
    values = jnp.stack([jnp.reshape(jnp.asarray(measured[c], dtype=float), shape) for c in CHANNELS], axis=-1)
    if sigma is None:
        return control, values, None
    each = sigma if isinstance(sigma, Mapping) else dict.fromkeys(CHANNELS, sigma)
    noise = [jnp.broadcast_to(jnp.asarray(each[c], dtype=float), shape) for c in CHANNELS]
    return control, values, jnp.stack(noise, axis=-1)


def _poses(base: Any, shape: tuple[int, int]) -> Float[Array, "steps whiskers 3"]:
    if not (isinstance(base, (tuple, list)) and len(base) == 3):
        raise ValueError(f"`base` must be x, y and angle of the bases, but is {base!r}.")
    found = []
    for value in base:
        value = jnp.asarray(value, dtype=float)
        if value.shape not in (shape, shape[:1]):
            raise ValueError(f"`base` must hold arrays of shape {shape}, but one has the shape {value.shape}.")
        found.append(jnp.broadcast_to(value if value.ndim == 2 else value[:, None], shape))
    return jnp.stack(found, axis=-1)


@eqx.filter_jit
def _of_sensor(sensor: Sensor, control, signals, noise, poses) -> Step:
    return _steps(sensor, control, signals, noise, poses)


# Options of the compiler are allowed in no other function's jit.
_COMPILED: Any = {"compiler_options": COMPILER_OPTIONS}
_of_sensor_now = eqx.filter_jit(_of_sensor.__wrapped__, **_COMPILED)


@eqx.filter_jit
def _of_parameters(build, names, values, covariance, control, signals, noise, poses) -> Step:
    def at(values):
        sensor = _sensor_of(build(**dict(zip(names, values, strict=True))))
        found = _steps(sensor, control, signals, noise, poses)
        return jnp.stack([found.x, found.y, found.slope, found.arc], axis=-1), found

    by_values, found = jax.jacfwd(at, has_aux=True)(values)
    by_values = by_values[..., None, :]  # (steps, whiskers, 4, 1, p)
    moved = jnp.sum(by_values * covariance, axis=-1)  # (steps, whiskers, 4, p)
    own = jnp.sum(moved[..., :, None, :] * by_values[..., None, :, 0, :], axis=-1)
    noisy = 0.0 if noise is None else found.covariance
    return dataclasses.replace(found, covariance=own + noisy)


def instrument(sensor: Sensor) -> Instrument:
    """The sensor without dimensions: in units of the first whisker."""
    whiskers, support = sensor.whiskers, sensor.support
    unit = units_of(whiskers[0], sensor.motion)
    n = len(whiskers)
    flexibility, yields, offset = support.flexibility(), jnp.zeros((n, 3, n, 3)), jnp.zeros((n, 3))
    if flexibility is not None:
        flexibility = flexibility.in_frames(jnp.zeros(n), unit.length, unit.force)
        yields, offset = jnp.reshape(flexibility.matrix, (n, 3, n, 3)), jnp.reshape(flexibility.offset, (n, 3))
    mounts = [[mount.x / unit.length, mount.y / unit.length, mount.angle] for mount in support.mounts]
    return Instrument(
        unit,
        jnp.stack([jnp.asarray(w.length, dtype=float) for w in whiskers]) / unit.length,
        jnp.stack([jnp.asarray(w.base_stiffness, dtype=float) for w in whiskers]) / (unit.moment * unit.length),
        sections(whiskers, unit.length, unit.moment * unit.length),
        yields,
        offset,
        jnp.stack([jnp.stack([jnp.asarray(v, dtype=float) for v in mount]) for mount in mounts]),
        sensor.motion,
    )


def _steps(sensor: Sensor, control, signals, noise, poses) -> Step:
    known = instrument(sensor)
    unit = known.unit
    sizes = jnp.stack([jnp.asarray(size, dtype=float) for size in (unit.force, unit.force, unit.moment)])
    lengths = jnp.stack([jnp.asarray(size, dtype=float) for size in (unit.length, unit.length, 1.0)])
    reaction = signals / sizes
    if noise is None:
        peaks = jax.lax.stop_gradient(jnp.max(jnp.nan_to_num(jnp.abs(reaction)), axis=0))
        deviation = jnp.broadcast_to(jnp.where(peaks > 0, peaks, 1.0), reaction.shape)
    else:
        deviation = noise / sizes
    poses = None if poses is None else poses / lengths
    drive = jax.vmap(known.motion.pose)(control)
    drive = jnp.stack([drive.x / unit.length, drive.y / unit.length, drive.angle], axis=-1)
    nothing = FREE if noise is not None else EXACTLY_FREE
    within = None if poses is None else 0
    found = jax.vmap(lambda *at: _step(known, nothing, *at), in_axes=(0, 0, 0, within))(
        drive, reaction, deviation, poses
    )
    scale = jnp.stack([lengths[0], lengths[0], jnp.ones(()), lengths[0]])
    unknown = jnp.nan if noise is None else 1.0
    return dataclasses.replace(
        found,
        x=found.x * unit.length,
        y=found.y * unit.length,
        arc=found.arc * unit.length,
        force=found.force * unit.force,
        base_x=found.base_x * unit.length,
        base_y=found.base_y * unit.length,
        chi2=found.chi2 * unknown,
        significance=found.significance * unknown,
        covariance=found.covariance * scale[:, None] * scale * unknown,
    )


def _turned(vectors: Float[Array, "*batch 3"], angle: Scalar) -> Float[Array, "*batch 3"]:
    """Forces and moments, or shifts and angles, turned counter-clockwise."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y, rest = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y, rest], axis=-1)


def _of_each(section: Any, function: Callable, *args):
    """What a function of section and arguments says of every whisker."""
    if not isinstance(section, tuple):
        return jax.vmap(function, in_axes=(None if section is None else 0, *[0] * len(args)))(section, *args)
    each = [function(own, *jax.tree.map(lambda leaf, k=k: leaf[k], args)) for k, own in enumerate(section)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)


# A bent whisker in place of one of which there is nothing to tell: every derivative has to be finite.
_SOME = np.array([-0.8795, 0.4758, 0.9755])


def _step(known: Instrument, nothing: float, drive, reaction, deviation, pose) -> Step:
    """All whiskers at one step; dimensionless."""
    n = known.length.size
    missing = jnp.any(jnp.isnan(reaction), axis=-1)
    yields = known.flexibility if pose is None else jnp.zeros_like(known.flexibility)
    if pose is None:
        # A base stands where the loads on others want it, too.
        coupled = jnp.any(yields != 0, axis=(1, 3))
        missing = missing | jnp.any(coupled & missing, axis=-1)
    else:
        missing = missing | jnp.any(jnp.isnan(pose), axis=-1)
        pose = jnp.where(missing[:, None], 0.0, pose)
    told_of = jnp.where(missing[:, None], _SOME, reaction)
    # Contacts that are lost in the noise move the bases of others all the same.
    measured = jnp.where(missing[:, None], 0.0, reaction)
    significance = jnp.sum((told_of / jnp.where(missing[:, None], 1.0, deviation)) ** 2, axis=-1)
    free = ~missing & (significance < nothing)
    touching = ~missing & ~free
    told_of = jnp.where(touching[:, None], told_of, _SOME)

    rest = known.mount + known.offset
    loads = _turned(-measured, -drive[2])  # in the drive's frame
    by_angle = yields[:, 2]  # (whiskers, whiskers, 3): how bases turn
    own = jnp.eye(n, dtype=bool)
    turned = rest[:, 2] + jnp.sum(jnp.where(own[:, :, None], 0.0, by_angle * loads), axis=(1, 2))
    angle = drive[2] + turned if pose is None else pose[:, 2]
    twist = jnp.sum(jnp.where(own, by_angle[:, :, 2], 0.0), axis=1)
    weight = 1 / jnp.where(touching[:, None], deviation, 1.0)
    side = jnp.where(told_of[:, 2] < 0, -1.0, 1.0)

    def whisker(section, *fields):
        told = Told(*fields, section)  # pyright: ignore[reportCallIssue]
        near = inverse_rod.found(told)

        def at(z_angle: Float[Array, "3"], tip: Any = near.tip):
            there = inverse_rod.state(z_angle[:2], tip, told._replace(angle=z_angle[2]))
            values = jnp.stack([there.x, there.y, there.slope, there.arc])
            return jnp.concatenate([values, there.reaction, there.angle[None]])  # pyright: ignore[reportIndexIssue]

        values, by_z_angle = inverse_rod.with_gradient(at, jnp.append(near.z, told.angle))
        apart = jnp.where(near.doubt > 0, at(jnp.append(near.other, told.angle), ~near.tip) - values, 0.0)[:4]
        ambiguous = near.doubt * apart[:, None] * apart
        # How the state follows the reaction and the angle: Gauss-Newton, as good as the noise is small.
        pulled = jnp.concatenate([-jnp.diag(told.weight), by_z_angle[4:7, 2:] * told.weight[:, None]], axis=1)
        pulled = jnp.sum(near.gradient[:, :, None] * pulled[:, None, :], axis=0)
        follows = -inverse_rod.solve2(inverse_rod.normal_of(near.gradient), pulled)  # (2, 4)
        return values, by_z_angle, follows, ambiguous, near

    fields = told_of, weight, angle, twist, side, known.length, known.stiffness
    values, by_z_angle, follows, ambiguous, near = _of_each(known.section, whisker, *fields)
    ok, failed = touching & near.good, touching & ~near.good

    loads = _turned(-jnp.where(ok[:, None], values[:, 4:7], measured), -drive[2])
    moved = rest + jnp.sum(yields * loads, axis=(2, 3))
    bases = drive + _turned(moved, drive[2])
    if pose is not None:
        bases = pose
    bases = bases.at[:, 2].set(jnp.where(ok, values[:, 7], bases[:, 2]))
    covariance = _covariance(by_z_angle, follows, yields, drive[2], jnp.where(ok[:, None], deviation, 0.0))

    def of_ok(values):
        return jnp.where(jnp.reshape(ok, (n, *[1] * (values.ndim - 1))), values, jnp.nan)

    at_base = jnp.where(missing[:, None], jnp.nan, bases)
    codes = [PointStatus.free, PointStatus.failed, PointStatus.missing]
    return Step(
        x=of_ok(bases[:, 0] + values[:, 0]),
        y=of_ok(bases[:, 1] + values[:, 1]),
        slope=of_ok(values[:, 2]),
        arc=of_ok(values[:, 3]),
        force=of_ok(near.z[:, 0]),
        phase=jnp.where(ok, jnp.where(near.tip, Phase.tip, Phase.tangential), Phase.free),
        base_x=at_base[:, 0],
        base_y=at_base[:, 1],
        base_angle=at_base[:, 2],
        chi2=of_ok(near.chi2),
        significance=jnp.where(missing, jnp.nan, jnp.sqrt(significance)),
        status=jnp.select([free, failed, missing], codes, PointStatus.ok),
        covariance=of_ok(covariance + ambiguous),
    )


def _covariance(by_z_angle, follows, yields, turned: Scalar, deviation) -> Float[Array, "whiskers 4 4"]:
    """Of x, y, slope and arc from the noise of all whiskers; nothing from those whose deviation is zero."""
    others = ~jnp.eye(deviation.shape[0], dtype=bool)[:, :, None]
    # How base angles follow the reactions of other whiskers, (j, k, 3), and z and angle those of all, (j, k, 3, 3).
    angle = jnp.where(others, -_turned(yields[:, 2], turned), 0.0)[:, :, None, :]
    own = jnp.where(others[..., None], 0.0, follows[:, None, :, :3])
    z_angle = jnp.concatenate([own + follows[:, None, :, 3:] * angle, angle], axis=2)
    out = jnp.sum(by_z_angle[:, None, :7, :, None] * z_angle[:, :, None, :, :], axis=3)  # (j, k, 7, 3)

    def rows(matrices, angle):
        return jnp.swapaxes(_turned(jnp.swapaxes(matrices, 2, 3), angle), 2, 3)

    # Bases move with the loads on all of them, which are minus the reactions.
    loads = jnp.swapaxes(rows(-out[:, :, 4:7], -turned), 0, 1)  # (k, j, 3, 3)
    moved = rows(jnp.sum(yields[:, None, :, :, :, None] * loads[None, :, None], axis=(3, 4)), turned)
    out = out[:, :, :4].at[:, :, :2].add(moved[:, :, :2]) * deviation[None, :, None, :]
    return jnp.sum(out[:, :, :, None, :] * out[:, :, None, :, :], axis=(1, 4))
