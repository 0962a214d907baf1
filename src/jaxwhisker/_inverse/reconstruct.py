"""Reconstruction: compute the contact point of every whisker from measured support reactions.

Drive, mount and springs determine the pose of a base under the measured load. From there the rod is known up to the
point at which its moment vanishes. That is the contact, and the force there is normal to the object. Three reactions
are one more than needed, which decides the phase and separates noise from signal: see nearest.py. In space there are
up to six: see space.py.

Source: Will, Behn, Steigenberger (2017), ZAMM, "Object contour scanning using elastically supported technical
vibrissae" (for exact signals).
"""

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from jaxwhisker._base import checks
from jaxwhisker._base.linear_algebra import inverse
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._inverse.mechanics import (
    AnyDrive,
    AnyInstrument,
    AnySensor,
    Contacts,
    InverseMechanics,
    Judgement,
    Readings,
    StepSignals,
    root_of,
    whitened,
)
from jaxwhisker._inverse.parameters import check_traceable, read_parameters
from jaxwhisker._inverse.plane import InversePlane
from jaxwhisker._inverse.points import ContactsReconstruction, PointStatus, Reconstruction, SpaceReconstruction
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, Sensor, Units, units_of
from jaxwhisker._scan.blocks import BLOCK, in_blocks

if TYPE_CHECKING:
    from jaxwhisker._model.space_scene import SpaceScene

InPlane: TypeAlias = Sensor | Scene | Callable[..., Sensor | Scene]
Known: TypeAlias = AbstractProfile | tuple[AbstractProfile, ...] | Callable[..., Any]
Names: TypeAlias = Mapping[str, Any] | None
Points: TypeAlias = dict[str, Array]  # fields of the result
# Fields of a result by their unit; others are numbers.
LENGTHS, FORCES = ("x", "y", "z", "arc", "base_x", "base_y", "base_z"), ("force", "force_x", "force_y", "force_z")
# 99.9 % quantiles of chi-squared of so many reactions: below them they may be only noise.
FREE = {3: 16.266, 5: 20.515, 6: 22.458}
# The same with the peaks in place of the noise, if the noise is unknown. Without contact, reactions vanish, or differ
# from those that springs on shafts cause by rounding: by 2e-12 of the peak for a pointed cone, and less for others.
EXACTLY_FREE = 1e-18
# 99.9 % quantiles of chi-squared with one and three degrees of freedom: larger values are not only noise.
EXPLAINED = (10.828, 16.266)
# The same for exact signals, with the peaks in place of the noise: a millionth of the peak, for tables of seven digits.
EXACTLY_EXPLAINED = (1e-12, 1e-12)
# By how much chi-squared has to be smaller in a phase that has a parameter more (Akaike), with and without noise:
# signals of scans determine the arc to 1e-8.
HANDICAP, EXACT_HANDICAP = 2.0, 1e-14


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
    contacts: int | None = None,
    objects: None = None,
) -> Reconstruction: ...
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
    contacts: int | None = None,
    objects: Known,
) -> ContactsReconstruction: ...
@overload
def reconstruct(
    measured: Any,
    sensor: "SpaceScene | Callable[..., SpaceScene]",
    *,
    sigma: Any = None,
    parameters: Names = None,
    covariance: Any = None,
) -> SpaceReconstruction: ...
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
    contacts: int | None = None,
    objects: Known | None = None,
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
        contacts: largest number of contacts of one whisker. With more than 1, a state that one contact does not explain
            is `ambiguous`, and so is a contact on the shaft of a whisker whose stiffness and curvature are constant:
            one contact there has the same reactions as several. With `objects`: 2. Default: that of the Scene, or 1.
        objects: known objects that whiskers may touch, apart from something unknown that each may touch once: a
            profile, a tuple of profiles, or, if `sensor` is a function, a function of the same parameters that returns
            these. They are smooth.

    Returns:
        A Reconstruction, with `objects` a ContactsReconstruction, in space a SpaceReconstruction; NaN where a whisker
        is `free`, where signals are `missing`, where no state fits (`failed`), or where several contacts are possible
        and signals do not decide between them (`ambiguous`). Errors are of first order in the noise of all reactions at
        a step, and in the errors of the sensor's parameters if `covariance` is given. Where both phases are possible,
        the difference between them is added. Errors are NaN if neither the noise nor that covariance is known.

    Raises:
        ValueError: if an argument is wrong, JAX cannot trace the function, or signals are missing or negated; if
            springs hold shafts, also if springs connect whiskers, if only springs above a base hold it and `base` is
            not given, or if there may be several contacts; if there is friction and `objects` are given. In space: if
            the channels do not determine a contact, torsion springs connect whiskers, or `base`, `slip`, `contacts` or
            `objects` is given.
    """
    checks.float64_mode()
    is_function = callable(sensor) and not isinstance(sensor, (Sensor, Scene))
    if (parameters is None) == is_function:
        raise ValueError(f"`parameters` must be given if `sensor` is a function, and only then, got {parameters}.")
    names, values = (), jnp.zeros(0)
    if parameters is not None:
        parameters = read_parameters("parameters", parameters)
        names, values = tuple(parameters), jnp.stack([jnp.asarray(v, dtype=float) for v in parameters.values()])
        checks.arguments("parameters", sensor, names, called="sensor")
    build: Any = sensor if objects is None else _before(sensor, objects, contacts)
    made: Any = build(**dict(zip(names, values, strict=True))) if names or objects is not None else sensor
    if covariance is not None and np.shape(covariance) != (values.size,) * 2:
        allowed = f"of the {values.size} parameters, ({values.size}, {values.size})"
        checks.fail("covariance", allowed, f"shape {np.shape(covariance)}")
    mechanics = _mechanics_of(made, contacts, before=objects is not None)
    known = mechanics.sensor(made)
    if covariance is not None and parameters is not None and not checks.is_traced(values):
        check_traceable(build, parameters, called="sensor")  # pyright: ignore[reportArgumentType]
    kinds, readings = mechanics.read(measured, sigma, known, base, slip)
    readings = jax.tree.map(jnp.asarray, readings.with_roots() if mechanics.correlated else readings)
    control = readings.control
    padding = -control.size % mechanics.block  # recordings of similar length share a compilation
    readings = jax.tree.map(
        lambda array: jnp.pad(array, [(0, padding)] + [(0, 0)] * (array.ndim - 1), mode="edge"), readings
    )
    if parameters is None or covariance is None:
        points = _contacts_now(mechanics, known, kinds, readings)
    else:
        widened = _contacts_of_parameters if mechanics.shared else _contacts_of_parameters_now
        covariance = jnp.asarray(covariance, dtype=float)
        points = widened(mechanics, build, names, values, covariance, kinds, readings)
    points = jax.tree.map(lambda leaf: leaf[: control.size], points)
    return mechanics.result(control, jnp.asarray(known.whiskers[0].length, dtype=float), **points)


def _before(sensor: Any, objects: Any, contacts: int | None) -> Callable[..., Scene]:
    from jaxwhisker._inverse.several import BeforeObjects

    return BeforeObjects(sensor, objects, contacts)


def _mechanics_of(made: Any, contacts: int | None, *, before: bool) -> type[InverseMechanics]:
    """What a reconstruction asks of these whiskers, with so many contacts each; `before` known objects or not."""
    if contacts is not None:
        checks.count("contacts", contacts)
    if getattr(made, "in_space", False):
        each = getattr(made, "contacts", 1) if contacts is None else contacts
        if each > 1:
            checks.fail("contacts", "1 in space", f"{each}")
        from jaxwhisker._inverse.space import InverseSpace

        return InverseSpace
    if (getattr(made, "contacts", 1) if contacts is None else contacts) == 1:
        return InversePlane
    from jaxwhisker._inverse.several import InverseBeforeObjects, InverseSeveral

    return InverseBeforeObjects if before else InverseSeveral


class _Prepared(NamedTuple):
    """What the contacts at all steps follow from, without dimensions."""

    known: AnyInstrument
    unit: Units
    # Placements of the drive, reactions, their noise, poses of bases and leans of contact forces; fields (steps, ...).
    steps: tuple[AnyDrive, Any, Any, Any, Any]


def _judgement(mechanics: type[InverseMechanics], readings: Readings, kinds: tuple[str, ...]) -> Judgement:
    """How these signals are judged."""
    several = mechanics.several
    if readings.noise is None:
        return Judgement(EXACTLY_FREE, EXACT_HANDICAP, np.nan, EXACTLY_EXPLAINED if several else None)
    return Judgement(FREE[len(kinds)], HANDICAP, 1.0, EXPLAINED if several else None)


def _contacts(
    mechanics: type[InverseMechanics], sensor: AnySensor, kinds: tuple[str, ...], readings: Readings
) -> Points:
    """Contacts at all steps, in the sensor's units."""
    parts = mechanics.parts(sensor)
    if len(parts) == 1:
        return _located(
            mechanics, _prepared(mechanics, sensor, kinds, readings), _judgement(mechanics, readings, kinds)
        )
    each = []
    for k, part in enumerate(parts):
        of_part = jax.tree.map(lambda array, k=k: array if array.ndim == 1 else array[:, k : k + 1], readings)
        each.append(_contacts(mechanics, part, kinds, of_part))
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves, axis=1), *each)


def _prepared(
    mechanics: type[InverseMechanics], sensor: AnySensor, kinds: tuple[str, ...], readings: Readings
) -> _Prepared:
    """The sensor and its signals without dimensions."""
    unit = jax.tree.map(checks.as_float, units_of(sensor.whiskers[0], sensor.motion))
    known, drive, poses, leans = mechanics.dimensionless(sensor, unit, kinds, readings)
    sizes = jnp.stack([unit.force if kind[0] == "f" else unit.moment for kind in kinds])
    reaction, noise = readings.signals / sizes, readings.noise
    if noise is None:
        peaks = known.peaks(jnp.max(jnp.nan_to_num(jnp.abs(jax.lax.stop_gradient(reaction))), axis=0))
        noise = jnp.broadcast_to(jnp.where(peaks > 0, peaks, 1.0), reaction.shape)
        noise = root_of(noise) if mechanics.correlated else noise
    else:
        noise = noise / (sizes[:, None] if mechanics.correlated else sizes)
    return _Prepared(known, unit, (drive, reaction, noise, poses, leans))


def _located(mechanics: type[InverseMechanics], prepared: _Prepared, judgement: Judgement) -> Points:
    """Contacts at all steps, in the sensor's units."""
    known, unit, steps = prepared
    located = jax.vmap(lambda *at: _step(mechanics, known, unit, judgement, *at))
    return mechanics.batches(located, steps)


_contacts_together, _prepared_now, _located_now = Program(_contacts), Program(_prepared), Program(_located)


def _contacts_now(
    mechanics: type[InverseMechanics], sensor: AnySensor, kinds: tuple[str, ...], readings: Readings
) -> Points:
    """Contacts at all steps by compiled programs."""
    sensor = jax.tree.map(checks.as_float, sensor)
    if not mechanics.shared:
        return _contacts_together(mechanics, sensor, kinds, readings)
    prepared = _prepared_now(mechanics, sensor, kinds, readings)
    judgement = jax.tree.map(np.asarray, _judgement(mechanics, readings, kinds))

    def block(*steps):
        return _located_now(mechanics, prepared._replace(steps=steps), judgement)

    return in_blocks(block, prepared.steps, BLOCK)


def _contacts_of_parameters(mechanics, build, names, values, covariance, kinds, readings) -> Points:
    """The points, with the uncertainty of the parameters added to their covariance."""
    contacts = _contacts_now if mechanics.shared else _contacts

    def at(values):
        sensor = mechanics.sensor(build(**dict(zip(names, values, strict=True))))
        points = contacts(mechanics, sensor, kinds, readings)
        return jnp.stack([points[name] for name in mechanics.numbers], axis=-1), points

    by_values, points = jax.jacfwd(at, has_aux=True)(values)
    of_values = jnp.einsum("...ip,pq,...jq->...ij", by_values, covariance, by_values)
    of_noise = jnp.zeros(()) if readings.noise is None else points["covariance"]
    return points | {"covariance": of_values + of_noise}


_contacts_of_parameters_now = Program(_contacts_of_parameters)


def _step(
    mechanics: type[InverseMechanics], known: AnyInstrument, unit: Units, judgement: Judgement, drive: AnyDrive, *at
) -> Points:
    """Contacts of all whiskers at one step, computed without dimensions and given in the sensor's units."""
    signals, significance = _sorted_signals(known, judgement, drive, *at)
    found, present, if_known = known.contacts(drive, signals, judgement), ~signals.missing, judgement.known
    ok, sizes = found.ok, _sizes(unit, mechanics.numbers)
    codes = [PointStatus.missing, PointStatus.free, PointStatus.ambiguous if mechanics.several else PointStatus.failed]
    return {
        **_in_units(unit, ok, found.contact),
        **_in_units(unit, present, found.base),
        "phase": _where(ok, _phases(found), Phase.free),
        "chi2": jnp.where(ok, found.chi2, jnp.nan) * if_known,
        "significance": jnp.where(present, jnp.sqrt(significance), jnp.nan) * if_known,
        "status": jnp.select([signals.missing, ~signals.touching, ~ok], codes, PointStatus.ok),
        "covariance": _where(ok, found.covariance * sizes[:, None] * sizes, jnp.nan) * if_known,
    }


def _phases(found: Contacts) -> Array:
    phases = jnp.where(found.tip, Phase.tip, Phase.tangential)
    return phases if found.used is None else jnp.where(found.used, phases, Phase.free)


def _sizes(unit: Units, names: Iterable[str]) -> Float[Array, " names"]:
    """Units of fields of the result."""
    sizes = dict.fromkeys(LENGTHS, unit.length) | dict.fromkeys(FORCES, unit.force)
    return jnp.stack([sizes.get(name, 1.0) for name in names])


def _in_units(unit: Units, known: Bool[Array, " whiskers"], fields: Points) -> Points:
    """Fields in the sensor's units, NaN where they are not known, and 0 for integers."""
    sizes = dict.fromkeys(LENGTHS, unit.length) | dict.fromkeys(FORCES, unit.force)
    vectors = {}
    for name, value in fields.items():
        if value.ndim > 1:
            value = value * sizes[name] if name in sizes else value
            vectors[name] = _where(known, value, jnp.nan if jnp.issubdtype(value.dtype, float) else 0)
    names = [name for name in fields if name not in vectors]
    if not names:
        return vectors
    numbers = jnp.stack([fields[name] for name in names]) * _sizes(unit, names)[:, None]
    return vectors | dict(zip(names, jnp.where(known, numbers, jnp.nan), strict=True))


def _sorted_signals(known: AnyInstrument, judgement: Judgement, drive: AnyDrive, reaction, noise, pose, lean):
    """The signals of one step, and the chi-squared of no contact."""
    missing = jnp.any(jnp.isnan(reaction), axis=-1)
    if pose is not None:
        missing = missing | jnp.any(jnp.isnan(pose), axis=-1)
        pose = jnp.where(missing[:, None], drive, pose)
    elif known.flexibility is not None:
        # The position of a base depends on the loads on all whiskers that it is coupled to.
        missing = missing | jnp.any(jnp.any(known.flexibility != 0, axis=(1, 3)) & missing, axis=-1)
    present, bent, unloaded = ~missing, known.bent(drive), known.unloaded(drive)
    correlated = noise.ndim > reaction.ndim
    one = jnp.eye(reaction.shape[-1]) if correlated else 1.0
    noise = _where(present, noise, one)
    weight = jax.vmap(inverse)(noise) if correlated else 1 / noise
    loaded = _where(present, reaction if unloaded is None else reaction - unloaded, bent)
    significance = jnp.sum(whitened(weight, loaded) ** 2, axis=-1)
    touching = present & ~(significance < judgement.free)
    measured = _where(present, reaction, 0.0)
    fitted, weight = _where(touching, measured, bent), _where(touching, weight, one)
    return StepSignals(missing, touching, measured, noise, fitted, weight, pose, lean), significance


def _where(whiskers: Bool[Array, " whiskers"], values: Shaped[Array, "whiskers *rest"], otherwise: Any) -> Array:
    """Values of some whiskers, and others elsewhere."""
    return jnp.where(jnp.expand_dims(whiskers, tuple(range(1, values.ndim))), values, otherwise)
