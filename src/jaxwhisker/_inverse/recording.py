"""Checks of a recording that need no compilation: information, units, signs and the direction of time."""

import warnings
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from jaxwhisker._base import checks
from jaxwhisker._inverse.features import ABOVE_NOISE, in_contact, neighbour_scatter
from jaxwhisker._inverse.observations import Channel, Observations, read_observations
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.motion import Translation
from jaxwhisker._model.scene import Scene, Sensor, units_of
from jaxwhisker._path.path import Status
from jaxwhisker._scan.quantities import REACTIONS, REACTIONS_IN_SPACE
from jaxwhisker._scan.route import across, turns_of
from jaxwhisker._scan.scan import mechanics_of, scan

LEAST_POSITIONS = 5  # drive positions from which a scan is recognised
ENOUGH_DIFFERENCES = 30  # between neighbours, whose scatter then distinguishes contact from noise
CONTROL_RATIO = 1e-2, 1e3  # plausible ranges, in the units of the scene
REACTION_RATIO = 1e-3, 1e4
NEGATIVE_WORK = 0.1  # of the sum of |work|: negative work beyond it is significant; reversed scans reach 0.4 to 0.8
OPPOSITE = -0.5  # of the sum of |values|: a sum below it has the wrong sign; negated signals reach -0.9
PREFIX, CLOSE = 3.0, 1.4  # how close a ratio must be to a factor between units
# Of prefixes, of inches to millimetres, and of kilograms to newtons.
UNIT_FACTORS = {1e3: PREFIX, 1e-3: PREFIX, 25.4: CLOSE, 1 / 25.4: CLOSE, 9.81: CLOSE, 1 / 9.81: CLOSE}
SAMPLES = 64  # of the signals of a guess
FEW_MOVES = 3  # of the drive between two turns that may be noise
LARGEST_JITTER = 0.01  # of the range, which noise of the control does not exceed
LEAST_WAY = 1.5  # times the noise: the drive has turned back
CONSTANT = 1e-12  # relative change of a constant signal


def check_recording(
    observations: Observations, sensor: AbstractScene | Sensor, unknowns: int, *, in_units: bool = True
) -> None:
    """Check that observations can be a scan with this sensor, and that they suffice for this number of unknowns.

    Args:
        observations: of one scan.
        sensor: the sensor, or a scene with it.
        unknowns: number of unknowns that only this recording can determine.
        in_units: whether the signals are reactions in the units of the sensor.

    Raises:
        ValueError: if there are too few values or drive positions, no contact, values in another unit, negated
            signals, or values in reversed order.
    """
    _check_count(observations, unknowns)
    if not np.isfinite(observations.sigma).any():
        scatter = neighbour_scatter(observations)
        observations = observations.with_sigma(scatter.sigma if scatter.count >= ENOUGH_DIFFERENCES else 0.0)
    if not any(_changes(observations, channel) for channel in observations.channels):
        raise ValueError(
            "`measured` must show a contact, got signals of which none changes by more than five standard deviations "
            "of its noise."
        )
    _check_units(observations, sensor, observations.kinds if in_units else ())
    if in_units and observations.kinds == REACTIONS:  # no sign is known in space, where objects may be anywhere
        check_signs(observations, sensor)


def _check_count(observations: Observations, unknowns: int) -> None:
    known = observations.known
    if known.sum() <= unknowns:
        raise ValueError(
            f"`measured` must hold more values than there are unknowns ({unknowns}), got {known.sum()} finite values."
        )
    positions, least = np.unique(observations.control[known.any(axis=(1, 2))]).size, max(LEAST_POSITIONS, unknowns + 1)
    if positions < least:
        raise ValueError(
            f"`measured` must hold values at {least} or more drive positions for {unknowns} unknowns, got {positions}."
        )


def _changes(observations: Observations, channel: Channel) -> bool:
    """Whether a signal changes by more than its noise and rounding."""
    signal = observations.values[:, channel.whisker, channel.kind]
    noise = observations.sigma[:, channel.whisker, channel.kind]
    away = np.abs(signal - np.nanmedian(signal)) - ABOVE_NOISE * noise
    return bool(np.nanmax(away) > CONSTANT * np.nanmax(np.abs(signal)))


def _check_units(observations: Observations, sensor: AbstractScene | Sensor, reactions: tuple[str, ...]) -> None:
    unit = units_of(sensor.whiskers[0], sensor.motion)
    sizes = {"the range of control": (float(np.ptp(observations.control)), float(unit.control), CONTROL_RATIO)}
    peaks = {name: np.nanmax(np.abs(observations.values[:, :, r]), initial=0.0) for r, name in enumerate(reactions)}
    if reactions == REACTIONS_IN_SPACE:  # of which some may vanish
        peaks = {", ".join(part): max(peaks[name] for name in part) for part in (reactions[:3], reactions[3:])}
    for name, peak in peaks.items():
        size, peak = unit.force if name[0] == "f" else unit.moment, float(peak)
        sizes[f"the peak of {name}"] = peak, float(size), REACTION_RATIO
    for name, (value, size, (low, high)) in sizes.items():
        if value > 0 and not low < value / size < high:
            raise ValueError(
                f"`measured` must be in the same units as the scene, got {value:.3g} for {name}, which is "
                f"{value / size:.2g} of the unit of the first whisker (L, EI/L^2 or EI/L) at the guess."
            )


def without_jitter(control: Float[np.ndarray, " steps"]) -> Float[np.ndarray, " steps"]:
    """A measured control without turns that are noise: where the drive stands still, or moves less than its noise.

    Turns are noise if only a few samples lie between them, and next to nothing of the range. On each way of the drive,
    a control that turns back is replaced by the middle of the highest position before and the lowest one after it.
    """
    ends = np.concatenate([[0], turns_of(control), [control.size - 1]])
    size = np.abs(np.diff(control[ends]))
    moves = np.add.reduceat(np.append(np.diff(control) != 0, False), ends[:-1]) if control.size > 1 else np.zeros(1)
    short = (moves <= FEW_MOVES) & (size <= LARGEST_JITTER * np.ptp(control))
    if ends.size < 3 or not short.any():
        return control
    noise, clean = LEAST_WAY * size[short].max(), control.copy()
    start, sign = 0, 0.0  # of the present way
    extreme = 0
    for k in range(1, control.size + 1):
        turned = k < control.size and sign * (control[extreme] - control[k]) > noise
        if k == control.size or turned:
            way = control[start : (extreme if turned else k - 1) + 1] * (sign or 1.0)
            highest, lowest = np.maximum.accumulate(way), np.minimum.accumulate(way[::-1])[::-1]
            clean[start : start + way.size] = (highest + lowest) / 2 * (sign or 1.0)
            start, sign = (extreme, -sign) if turned else (start, sign)
            extreme = k
        elif sign == 0.0 and abs(control[k] - control[0]) > noise:
            sign, extreme = float(np.sign(control[k] - control[0])), k
        elif sign * (control[k] - control[extreme]) >= 0:
            extreme = k
    return clean


def check_units_of_guess(observations: Observations, scene: AbstractScene) -> None:
    """Check that control, forces and moments are not in other units than those of the scene that was guessed.

    Compared are the range of the control in which whiskers touch, and the largest force and moment. A wrong guess makes
    them several times larger or smaller, but hardly ever two of them by nearly the same factor between units. Forces
    and moments alone may be ten times larger because a stiffness was guessed; a thousand times are a unit.

    Raises:
        ValueError: if two of them differ by such a factor; the message names it and them.
    """
    guessed = _at_guess(scene)
    if guessed is None:
        return
    measured, model = _sizes_of(observations), _sizes_of(guessed)
    ratio = {name: measured[name] / size for name, size in model.items() if measured[name] > 0 and size > 0}
    for factor, near in UNIT_FACTORS.items():
        off = [name for name, value in ratio.items() if factor / near < value < factor * near]
        if len(off) > 1 and ("control" in off or near == PREFIX):
            raise ValueError(
                f"`measured` must be in the same units as the scene, got {' and '.join(off)} that are "
                f"{' and '.join(f'{ratio[name]:.3g}' for name in off)} times as large as at the guess, near "
                f"{factor:.4g}, a ratio of two units."
            )


def _at_guess(scene: Any) -> Observations | None:
    """A few signals of a scene on the way right across its object, by the programs that a fit needs anyway.

    None if the scene cannot be scanned, which the fit will report.
    """
    mechanics, kinds = mechanics_of(scene), REACTIONS if isinstance(scene, Scene) else REACTIONS_IN_SPACE
    problem = mechanics.problem(jax.tree.map(checks.as_float, scene))
    path, start, stop = mechanics.follow(problem, *map(np.asarray, across()))
    if int(path.status) != Status.ok:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about the resolution of whiskers, which the fit repeats
        return read_observations(scan(scene, np.linspace(float(start), float(stop), SAMPLES)), kinds=kinds)


def _sizes_of(observations: Observations) -> dict[str, float]:
    """Range of the control in which whiskers touch, and the largest force and moment; zero if unknown."""
    touching = observations.control[in_contact(observations).any(axis=(1, 2))]
    peaks = {"control": float(np.ptp(touching)) if touching.size else 0.0, "forces": 0.0, "moments": 0.0}
    for name, values in zip(observations.kinds, np.moveaxis(observations.values, 2, 0), strict=True):
        kind = {"f": "forces", "m": "moments"}[name[0]]
        peaks[kind] = max(peaks[kind], float(np.max(np.abs(np.nan_to_num(values)), initial=0.0)))
    return peaks


def check_signs(observations: Observations, sensor: AbstractScene | Sensor) -> None:
    """Check that signals are reactions on the whiskers, in the order in which the drive moved.

    Args:
        observations: of one scan, with the standard deviation of their noise.
        sensor: the sensor, or a scene with it.

    Raises:
        ValueError: if the drive of whiskers that start free gains energy (fx), if the object pulls whiskers (fy), or if
            upright whiskers lean ahead of the drive (mz). The message names these signals.
    """
    found = {}
    if isinstance(sensor.motion, Translation) and _starts_free(observations):
        work = _work_on_drive(observations)
        found |= {"fx": f"whiskers that start free do the work {work:.3g} on the drive"} if work > 0 else {}
        if _is_upright(sensor) and _leans_ahead(observations):
            found |= {"mz": "whiskers lean ahead of the drive"}
    # Springs on shafts share the load: the base may carry the opposite one.
    if not sensor.support.on_shafts and _is_opposite(observations.values[:, :, 1]):
        found |= {"fy": "the object pulls whiskers"}
    if not found:
        return
    names = sorted(found)
    hint = "reverse the order of all arrays, or " if "fx" in found and "fy" not in found else ""
    thesis = "; the tables of the thesis negate mz" if names == ["mz"] else ""
    raise ValueError(
        "`measured` must be in the order in which the drive moved, with the forces and moments of the support on the "
        f"whiskers, got signals with which {' and '.join(found[name] for name in names)}: {hint}check the sign of "
        f"{', '.join(names)}{thesis}."
    )


def _starts_free(observations: Observations) -> bool:
    """Whether fx of all whiskers is known from the beginning, where none is in contact."""
    fx = observations.values[:, :, 0]
    complete = np.asarray(np.isfinite(fx).all(axis=1))
    return bool(complete.sum() >= LEAST_POSITIONS and complete[0] and not in_contact(observations)[0].any())


def _is_upright(sensor: AbstractScene | Sensor) -> bool:
    """Whether the unloaded whiskers are straight and upright, and only springs at their bases hold them."""
    straight = all(whisker.intrinsic_curvature is None for whisker in sensor.whiskers)
    angles = [mount.angle for mount in sensor.support.mounts]
    return straight and not sensor.support.on_shafts and not np.any(np.asarray(angles, dtype=float))


def _is_opposite(values: np.ndarray) -> bool:
    """Whether values that should be positive are mostly negative; NaN is skipped."""
    return bool(np.nansum(values) < OPPOSITE * np.nansum(np.abs(values)))


def _leans_ahead(observations: Observations) -> bool:
    """Whether the moment bends whiskers ahead of the drive, where it should bend them back.

    The moment mz on a base that moves towards -x is positive: the object holds the whisker back.
    """
    control, mz = without_jitter(observations.control), observations.values[:, :, 2]
    mz = np.where(in_contact(observations)[:, :, 2], mz, 0.0)
    leg = slice(0, min([*turns_of(control), control.size - 1]) + 1)
    return _is_opposite(mz[leg][1:] * -np.diff(control[leg])[:, None])


def _work_on_drive(observations: Observations) -> float:
    """Work of whiskers that start free on the drive, if it is significantly positive; else 0.

    The work of the drive is the integral of the sum of all fx over the control. If the order is reversed, a snap seems
    to create the energy that it dissipates.
    """
    fx = observations.values[:, :, 0]
    complete = np.isfinite(fx).all(axis=1)
    control, force = observations.control[complete], fx[complete].sum(axis=1)
    steps, middle = np.diff(control), (force[1:] + force[:-1]) / 2
    # An upper bound: between two samples, a monotonic force lies between their values.
    most = np.cumsum(middle * steps + np.abs(np.diff(force) * steps) / 2)
    noise = (observations.sigma[complete, :, 0] ** 2).sum(axis=1)
    deviation = np.sqrt(np.cumsum(noise[1:] * steps**2))
    scale = np.cumsum(np.abs(middle * steps))
    significant = np.any(most + ABOVE_NOISE * deviation < -NEGATIVE_WORK * scale[-1])
    return float(-most.min()) if significant else 0.0
