"""Checks of a recording that need no compilation: information, units, signs and the direction of time."""

import numpy as np

from jaxwhisker._inverse.features import ABOVE_NOISE, in_contact, neighbour_scatter
from jaxwhisker._inverse.observations import Channel, Observations
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.motion import Translation
from jaxwhisker._model.scene import Sensor, units_of
from jaxwhisker._scan.quantities import REACTIONS, REACTIONS_IN_SPACE
from jaxwhisker._scan.route import turns_of

LEAST_POSITIONS = 5  # drive positions from which a scan is recognised
ENOUGH_DIFFERENCES = 30  # between neighbours, whose scatter then distinguishes contact from noise
CONTROL_RATIO = 1e-2, 1e3  # plausible ranges, in the units of the scene
REACTION_RATIO = 1e-3, 1e4
NEGATIVE_WORK = 0.1  # of the sum of |work|: negative work beyond it is significant; reversed scans reach 0.4 to 0.8
OPPOSITE = -0.5  # of the sum of |values|: a sum below it has the wrong sign; negated signals reach -0.9
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
    control, mz = observations.control, observations.values[:, :, 2]
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
