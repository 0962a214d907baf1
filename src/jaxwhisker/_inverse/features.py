"""Features of measured signals by which scans are laid over each other: where contact begins and ends, and jumps."""

from typing import NamedTuple

import numpy as np

from jaxwhisker._inverse.measured import CHANNELS, Measured

JUMPS = 16  # that are looked at, at most
ABOVE_NOISE = 5.0  # standard deviations, of what is called contact
LEAST = 2e-3  # of the peak, where noise is unknown or small
STEEPER = 4.0  # a jump than what is beside it
JUMP = 0.02  # of the peak, at least
BEFORE = 5  # samples before a jump that is
LARGER = 2.0  # times as large, there are no others
EARLY = 0.2  # of the peak, up to which a signal is a parabola after a touch
ONSETS = 60  # that are tried
FEWEST = 6  # samples that tell one


class Features(NamedTuple):
    """Where signals begin, end and jump; `way` is that of the drive since the first sample, a length."""

    way: np.ndarray  # (steps,)
    low: np.ndarray  # (JUMPS,) way before and behind each jump; NaN beyond their number
    high: np.ndarray
    touch: np.ndarray  # (whiskers,) way at the first touch, NaN where it is not seen
    touch_error: np.ndarray  # (whiskers,) its standard error
    release: np.ndarray  # (whiskers,) way where contact ends for good


def features(measured: Measured) -> Features:
    """What can be told from the signals alone."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(measured.control)))])
    peak = peaks(measured)
    noise = np.where(np.isfinite(measured.sigma), measured.sigma, 0.0)
    low, high = _jumps(way, measured.values / peak, noise / peak)
    loud = np.abs(measured.values) > np.maximum(ABOVE_NOISE * noise, LEAST * peak)
    ends = [_contact(way, measured.values[:, k], loud[:, k]) for k in range(loud.shape[1])]
    touch, touch_error, release = np.array(ends).T
    return Features(way, low, high, touch, touch_error, release)


def peaks(measured: Measured) -> np.ndarray:
    """The largest size of each channel, of all whiskers; 1 where there is none: (3,)."""
    with np.errstate(all="ignore"):
        peak = np.nanmax(np.where(measured.known, np.abs(measured.values), 0.0), axis=(0, 1), initial=0.0)
    return np.where(peak > 0, peak, 1.0)


def noise_of(measured: Measured) -> np.ndarray:
    """Standard deviation of each channel's noise, from what is rough in it: third differences of smooth signals vanish.

    Their median is taken, which neither jumps nor corners move: (3,).
    """
    found = np.zeros(len(CHANNELS))
    for c in range(len(CHANNELS)):
        rough = [np.diff(v[np.isfinite(v)], n=3) for v in measured.values[:, :, c].T]
        loud = np.concatenate([r[r != 0] for r in rough])
        found[c] = ROBUST * np.median(np.abs(loud)) / np.sqrt(THIRD) if loud.size else 0.0
    return found


ROBUST = 1.4826  # a normal distribution's standard deviation over its median deviation
THIRD = 1 + 9 + 9 + 1  # variance of third differences of noise of variance 1


def _jumps(way: np.ndarray, values: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ways before and behind the largest jumps, in order."""
    found: list[tuple[float, float, float]] = []
    for signal, rough in zip(values.reshape(way.size, -1).T, noise.reshape(way.size, -1).T, strict=True):
        found += _jumps_of(way, signal, rough)
    # Channels have gaps: what they agree on is where the signals jump.
    merged: list[tuple[float, float, float]] = []
    for low, high, size in sorted(found):
        if merged and low < merged[-1][1]:
            last = merged.pop()
            low, high, size = max(low, last[0]), min(high, last[1]), max(size, last[2])
        merged.append((low, high, size))
    merged = [jump for jump in merged if not any(_steepens(jump, snap) for snap in merged)]
    largest = sorted(sorted(merged, key=lambda jump: -jump[2])[:JUMPS])
    low, high = np.full(JUMPS, np.nan), np.full(JUMPS, np.nan)
    for k, jump in enumerate(largest):
        low[k], high[k] = jump[:2]
    return low, high


def _steepens(jump: tuple[float, float, float], snap: tuple[float, float, float]) -> bool:
    """Whether what looks like a jump is the steep signal before a larger one: at a fold it is steep without bound."""
    return snap[2] > LARGER * jump[2] and 0 <= snap[0] - jump[1] < BEFORE * (snap[1] - snap[0])


def _jumps_of(way: np.ndarray, signal: np.ndarray, noise: np.ndarray) -> list[tuple[float, float, float]]:
    """Ways before and behind the jumps of one signal, and their sizes."""
    seen = np.flatnonzero(np.isfinite(signal))
    if seen.size < 3:
        return []
    size, gap = np.abs(np.diff(signal[seen])), np.diff(way[seen])
    slope = np.where(gap > 0, size / np.where(gap > 0, gap, 1.0), 0.0)
    beside = np.maximum(np.append(0.0, slope[:-1]), np.append(slope[1:], 0.0))
    loud = size > np.maximum(6 * np.sqrt(2) * noise[seen[1:]], JUMP)
    at = np.flatnonzero(loud & (slope > STEEPER * beside))
    return [(float(way[seen[k]]), float(way[seen[k + 1]]), float(size[k])) for k in at]


def _contact(way: np.ndarray, values: np.ndarray, loud: np.ndarray) -> tuple[float, float, float]:
    """Way at the first touch, its error, and way at the last contact of one whisker; NaN where they are not shown."""
    steps = np.flatnonzero(loud.any(axis=1))
    if steps.size == 0:
        return np.nan, np.nan, np.nan
    first, last = steps[0], steps[-1]
    release = float("nan") if last == way.size - 1 else float(way[last + 1])
    if first == 0:
        return np.nan, np.nan, release
    # Noise hides the touch itself: it is where what follows, nearly a parabola, comes from. Of some channels it is one
    # for longer than of others.
    found = [_onset(way, signal, clear) for signal, clear in zip(values.T, loud.T, strict=True)]
    error, touch = min((error, touch) for touch, error in found)
    return (touch, error, release) if np.isfinite(error) else (float(way[max(first - 1, 0)]), 0.0, release)


def _onset(way: np.ndarray, signal: np.ndarray, loud: np.ndarray) -> tuple[float, float]:
    """Where a signal that was zero sets out along a parabola, by least squares, and its error; infinite if unknown."""
    size = np.nan_to_num(np.abs(signal))
    part = np.flatnonzero(np.isfinite(signal[: int(np.argmax(loud & (size > EARLY * size.max()))) + 1]))
    if part.size < FEWEST:
        return np.nan, np.inf
    way, signal = way[part], signal[part]

    def missed(onset: float) -> float:
        past = np.maximum(way - onset, 0.0)
        columns = np.stack([past, past**2], axis=1)
        curve, *_ = np.linalg.lstsq(columns, signal, rcond=None)
        return float(np.sum((columns @ curve - signal) ** 2))

    onsets = np.linspace(way[0], way[-1], ONSETS + 1)[:-1]
    misfit = np.array([missed(onset) for onset in onsets])
    near = onsets[misfit <= misfit.min() * (1 + 1 / part.size)]  # one standard deviation
    return float(onsets[np.argmin(misfit)]), float(near[-1] - near[0] + onsets[1] - onsets[0]) / 2
