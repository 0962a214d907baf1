"""Features of observed signals: their noise, and where contact begins, ends and jumps."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxwhisker._inverse.observations import Observations
from jaxwhisker._scan.route import route_of, turns_of

JUMPS = 16  # largest number of jumps
ABOVE_NOISE = 5.0  # standard deviations from which a signal counts as contact
LEAST_CONTACT = 2e-3  # of the peak: smallest signal that counts as contact, even if noise is unknown or smaller
STEEPER = 4.0  # least ratio of the slope of a jump to that of the signal on either side
AROUND = 4  # samples on either side whose median slope counts, too
LEAST_JUMP = 0.02  # of the peak
BEFORE = 5  # widths of a jump over which the steep signal before it may look like another jump
AFTER_TURN = 4  # samples after a turn of the drive within which friction changes signals as suddenly as a jump
LARGER = 2.0  # least ratio of such a jump to one before it that is discarded
EARLY = 0.2  # of the peak, up to which a signal after a touch is treated as a parabola
ONSETS = 60  # positions of the touch that are tried
LEAST_SAMPLES = 6  # least number of samples from which a touch is estimated

ALTERNATING = 0.5  # share of pairs of neighbouring differences of opposite sign: 0.77 of white noise, 0 if smooth
LEAST_DIFFERENCES = 12  # from which this share is known; a jump causes three
LARGEST_GROWTH = 3.0  # of the differences of noise without every second sample: 1 to 2; of smooth signals, 8
TINY_NOISE = 1e-9  # of the peaks
ZERO_DIFFERENCE = 1e-14  # of the peak: smaller differences are zero
MAD_TO_SIGMA = 1.4826  # ratio of a normal distribution's standard deviation to its median absolute deviation


class Features(NamedTuple):
    """Where signals begin, end and jump; travel is the distance that the drive has moved since the first sample."""

    travel: Float[np.ndarray, " steps"]
    low: Float[np.ndarray, " jumps"]  # travel before each jump; NaN beyond their number
    high: Float[np.ndarray, " jumps"]  # travel after each jump
    touch: Float[np.ndarray, " whiskers"]  # travel at the first touch; NaN if it is not visible
    touch_error: Float[np.ndarray, " whiskers"]  # standard error of `touch`
    release: Float[np.ndarray, " whiskers"]  # travel at the end of the last contact; NaN if it is not visible


class Scatter(NamedTuple):
    """Noise estimated from neighbouring samples."""

    sigma: Float[np.ndarray, " kinds"]  # standard deviation of each kind of signal; 0 if nothing is known
    count: int  # number of differences in the estimate of the kind with the fewest
    noisy: Bool[np.ndarray, " kinds"]  # whether it is noise, and not the curvature of signals between few samples


def features(observations: Observations, *, snaps: bool = True, friction: bool = False) -> Features:
    """Find touches, releases and, if these are snaps, jumps in the signals alone.

    With friction, contacts stick where the drive turns, and signals may jump there without a snap.
    """
    travel = np.asarray(route_of(observations.control).travel)
    noise = np.nan_to_num(observations.sigma)
    values = observations.values if snaps else np.zeros_like(observations.values)
    low, high = _jumps(travel, values / observations.peaks, noise / observations.peaks)
    if friction:
        turns = turns_of(observations.control)
        begin, end = travel[turns], travel[np.minimum(turns + AFTER_TURN, travel.size - 1)]
        sticks = np.any((low >= begin[:, None]) & (low < end[:, None]), axis=0)
        low, high = np.where(sticks, np.nan, low), np.where(sticks, np.nan, high)
    contact = in_contact(observations)
    ends = [_contact(travel, observations.values[:, k], contact[:, k]) for k in range(contact.shape[1])]
    touch, touch_error, release = np.array(ends).T
    return Features(travel, low, high, touch, touch_error, release)


def in_contact(observations: Observations) -> Bool[np.ndarray, "steps whiskers kinds"]:
    """Where a signal is clear of its noise."""
    noise = np.nan_to_num(observations.sigma)
    return np.abs(observations.values) > np.maximum(ABOVE_NOISE * noise, LEAST_CONTACT * observations.peaks)


def neighbour_scatter(*recordings: Observations) -> Scatter:
    """Estimate the noise of each kind of signal from third differences of neighbouring samples.

    For smooth signals these differences nearly vanish. Divided differences allow for gaps and unequal steps; each is
    divided by the standard deviation that noise of size one gives it. Jumps and corners hardly affect their median.
    Signals that are still curved on the scale of four samples make the estimate too large, never too small. Their
    differences grow if every second sample is left out, and keep their signs, while those of noise do neither. Noise
    that is correlated between samples (by a low-pass filter) makes the estimate too small. Exact signals have none.
    """
    sigma, counts = np.zeros(recordings[0].values.shape[2]), []
    noisy = np.zeros(sigma.size, dtype=bool)
    peaks = np.max([observations.peaks for observations in recordings], axis=0)
    for c in range(sigma.size):
        signals = [(one.control, signal) for one in recordings if not one.exact for signal in one.values[:, :, c].T]
        rough = _differences(signals, ZERO_DIFFERENCE * peaks[c])
        if rough.size:
            sigma[c] = MAD_TO_SIGMA * np.median(np.abs(rough))
            counts.append(rough.size)
            thinned = [(u[k::2], signal[k::2]) for u, signal in signals for k in range(2)]
            thinned = _differences(thinned, ZERO_DIFFERENCE * peaks[c])
            if min(rough.size, thinned.size) >= LEAST_DIFFERENCES:
                alternates = np.mean(rough[1:] * rough[:-1] < 0) > ALTERNATING
                noisy[c] = alternates & (MAD_TO_SIGMA * np.median(np.abs(thinned)) < LARGEST_GROWTH * sigma[c])
    return Scatter(sigma, min(counts, default=0), noisy)


def least_scatter(observations: Observations) -> Float[np.ndarray, " kinds"]:
    """Standard deviation of the noise of each kind of signal from its scatter; positive."""
    return np.maximum(neighbour_scatter(observations).sigma, TINY_NOISE * observations.peaks)


def noise_of(observations: Observations) -> Float[np.ndarray, " kinds"] | None:
    """Standard deviation of the noise of each kind of signal from its scatter; None for exact signals."""
    return least_scatter(observations) if neighbour_scatter(observations).noisy.any() else None


def with_scatter(observations: Observations, scattered: Observations | None = None) -> Observations:
    """Observations with the noise that their scatter shows, or that of others; unchanged if it shows none."""
    noise = noise_of(observations if scattered is None else scattered)
    return observations if noise is None else observations.with_sigma(noise)


def _differences(signals: list[tuple[np.ndarray, np.ndarray]], zero: float) -> np.ndarray:
    """Third differences of signals over their controls, without exact zeros, as those of free whiskers."""
    rough = np.concatenate([_third_differences(*pair) for pair in signals]) if signals else np.zeros(0)
    return rough[np.abs(rough) > zero]


def _third_differences(control: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """Third divided differences of a signal, divided by their standard deviation for noise of size one."""
    known = np.isfinite(signal)
    signal = signal[known]
    if signal.size < 4:
        return np.zeros(0)
    window = np.lib.stride_tricks.sliding_window_view
    at = window(route_of(control).travel[known], 4)
    size = np.where(at[:, -1:] > at[:, :1], at[:, -1:] - at[:, :1], 1.0)
    apart = (at[:, :, None] - at[:, None, :]) / size[:, :, None]
    apart[:, range(4), range(4)] = 1.0
    product = np.prod(apart, axis=2)
    apart_everywhere = np.all(product != 0, axis=1)  # False where the drive stood still
    weight = 1 / product[apart_everywhere]
    return np.sum(weight * window(signal, 4)[apart_everywhere], axis=1) / np.linalg.norm(weight, axis=1)


def _jumps(
    travel: Float[np.ndarray, " steps"], values: np.ndarray, noise: np.ndarray
) -> tuple[Float[np.ndarray, " jumps"], Float[np.ndarray, " jumps"]]:
    """Travel before and after the largest jumps, in order of travel."""
    jumps: list[tuple[float, float, float]] = []
    for channel in np.ndindex(values.shape[1:]):
        jumps += _jumps_of(travel, values[:, *channel], noise[:, *channel])
    # Channels have gaps, so a jump is narrowed down to where all of them agree.
    merged: list[tuple[float, float, float]] = []
    for low, high, size in sorted(jumps):
        if merged and low < merged[-1][1]:
            last = merged.pop()
            low, high, size = max(low, last[0]), min(high, last[1]), max(size, last[2])
        merged.append((low, high, size))
    merged = [jump for jump in merged if not any(_leads_to(jump, snap) for snap in merged)]
    largest = sorted(sorted(merged, key=lambda jump: -jump[2])[:JUMPS])
    low, high, _ = np.array(largest + [(np.nan,) * 3] * (JUMPS - len(largest))).T
    return low, high


def _leads_to(jump: tuple[float, float, float], snap: tuple[float, float, float]) -> bool:
    """Whether an apparent jump is the steep signal before a larger one: at a fold the slope grows without bound."""
    return snap[2] > LARGER * jump[2] and 0 <= snap[0] - jump[1] < BEFORE * (snap[1] - snap[0])


def _jumps_of(travel: np.ndarray, signal: np.ndarray, noise: np.ndarray) -> list[tuple[float, float, float]]:
    """Travel before and after the jumps of one signal, and their sizes."""
    known = np.flatnonzero(np.isfinite(signal))
    if known.size < 3:
        return []
    size, gap = np.abs(np.diff(signal[known])), np.diff(travel[known])
    slope = np.where(gap > 0, size / np.where(gap > 0, gap, 1.0), 0.0)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(slope, AROUND), 2 * AROUND + 1)
    # Noise may make both slopes beside a steep one small, but not most of those around it.
    beside = np.max([np.append(0.0, slope[:-1]), np.append(slope[1:], 0.0), np.median(around, axis=1)], axis=0)
    loud = size > np.maximum(6 * np.sqrt(2) * noise[known[1:]], LEAST_JUMP)
    at = np.flatnonzero(loud & (slope > STEEPER * beside))
    return [(float(travel[known[k]]), float(travel[known[k + 1]]), float(size[k])) for k in at]


def _contact(travel: np.ndarray, values: np.ndarray, contact: np.ndarray) -> tuple[float, float, float]:
    """Travel at the first touch of one whisker, its error, and travel at the last contact; NaN if not visible."""
    steps = np.flatnonzero(contact.any(axis=1))
    if steps.size == 0:
        return np.nan, np.nan, np.nan
    first, last = steps[0], steps[-1]
    release = float("nan") if last == travel.size - 1 else float(travel[last + 1])
    if first == 0:
        return np.nan, np.nan, release
    # Noise hides the touch itself: extrapolate the parabola that follows, in the channel that shows it best.
    onsets = [_onset(travel, signal, clear) for signal, clear in zip(values.T, contact.T, strict=True)]
    error, touch = min((error, touch) for touch, error in onsets)
    return (touch, error, release) if np.isfinite(error) else (float(travel[max(first - 1, 0)]), 0.0, release)


def _onset(travel: np.ndarray, signal: np.ndarray, contact: np.ndarray) -> tuple[float, float]:
    """Where a zero signal turns into a parabola, by least squares, and its error; infinite if unknown."""
    size = np.nan_to_num(np.abs(signal))
    part = np.flatnonzero(np.isfinite(signal[: int(np.argmax(contact & (size > EARLY * size.max()))) + 1]))
    if part.size < LEAST_SAMPLES:
        return np.nan, np.inf
    travel, signal = travel[part], signal[part]

    def misfit(onset: float) -> float:
        past = np.maximum(travel - onset, 0.0)
        columns = np.stack([past, past**2], axis=1)
        curve, *_ = np.linalg.lstsq(columns, signal, rcond=None)
        return float(np.sum((columns @ curve - signal) ** 2))

    onsets = np.linspace(travel[0], travel[-1], ONSETS + 1)[:-1]
    misfits = np.array([misfit(onset) for onset in onsets])
    near = onsets[misfits <= misfits.min() * (1 + 1 / part.size)]  # one standard deviation
    return float(onsets[np.argmin(misfits)]), float(near[-1] - near[0] + onsets[1] - onsets[0]) / 2
