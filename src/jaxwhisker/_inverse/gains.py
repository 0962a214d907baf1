"""Gains of a sensor: the measured channels are G signals + offsets, with a gain matrix G that is known or fitted."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._inverse.channels import Channels
from jaxwhisker._inverse.observations import as_numbers

Entry = tuple[int, int, int]  # whisker, measured channel, signal
ROUNDING = 1e-12  # of the largest signal: smaller ones are rounding, such as the twist of a straight whisker


class Gains(NamedTuple):
    """The gain matrix of each whisker."""

    names: tuple[str, ...]  # of the measured channels
    signals: tuple[str, ...]  # of the model
    matrix: Float[np.ndarray, "whiskers channels signals"] | None = None  # NaN where unknown; None is the identity

    @property
    def unknown(self) -> tuple[Entry, ...]:
        """The entries that are unknown."""
        entries = () if self.matrix is None else np.argwhere(np.isnan(self.matrix)).tolist()
        return tuple((whisker, channel, signal) for whisker, channel, signal in entries)

    @property
    def crosstalk(self) -> Bool[np.ndarray, " unknown"]:
        """Which unknown entries are those of another signal than the channel's own, if that has a gain."""
        own = {name: k for k, name in enumerate(self.signals)}

        def has_own(whisker: int, channel: int) -> bool:
            signal = own.get(self.names[channel])
            return signal is not None and self.matrix is not None and bool(self.matrix[whisker, channel, signal])

        return np.array([self.names[r] != self.signals[c] and has_own(w, r) for w, r, c in self.unknown], bool)

    def name(self, entry: Entry) -> str:
        """Name of an entry: that of its channel, and that of the signal if it is another."""
        channel, signal = self.names[entry[1]], self.signals[entry[2]]
        return channel if channel == signal else f"{channel}_{signal}"

    def of_measured(self, present: Sequence[tuple[int, int]]) -> "Gains":
        """These gains without those of channels that are not measured; `present` are pairs (whisker, channel)."""
        if self.matrix is None:
            return self
        measured = np.zeros(self.matrix.shape[:2], bool)
        measured[tuple(np.transpose(present))] = True
        return self._replace(matrix=np.where(measured[..., None], self.matrix, 0.0))

    def filled(self, unknown: Any) -> Float[np.ndarray, "whiskers channels signals"]:
        """The matrix with values of its unknown entries."""
        matrix = np.eye(len(self.signals))[None] if self.matrix is None else self.matrix.copy()
        matrix[np.isnan(matrix)] = unknown
        return matrix

    def applied(self, signals: Any, unknown: Any, xp: Any = np) -> Any:
        """The channels without offsets, (steps, whiskers, channels, ...), from signals (steps, whiskers, signals, ...).

        Args:
            signals: of the model, or their derivatives.
            unknown: values of the unknown entries.
            xp: numpy or jax.numpy.
        """
        if (matrix := self.matrix) is None:
            return signals
        values = dict(zip(self.unknown, unknown, strict=True))

        def channel(w: int, r: int) -> Any:
            # Without products by zero: a signal may be NaN.
            used = [(c, values.get((w, r, c), gain)) for c, gain in enumerate(matrix[w, r]) if gain != 0]
            return sum((gain * signals[:, w, c] for c, gain in used), xp.zeros_like(signals[:, w, 0]))

        whiskers, channels, _ = matrix.shape
        return xp.stack([xp.stack([channel(w, r) for r in range(channels)], axis=1) for w in range(whiskers)], axis=1)

    def sizes(self, peaks: np.ndarray, signals: np.ndarray) -> tuple[list[float], list[float]]:
        """Natural sizes of the unknown entries, and values from which a fit starts: no crosstalk.

        Args:
            peaks: of the measured channels, (channels,).
            signals: of the model, (steps, whiskers, signals).
        """
        largest = np.max(np.abs(np.nan_to_num(signals)), axis=0)
        top = np.max(largest, axis=1, keepdims=True)
        largest = np.where(largest > ROUNDING * top, largest, np.where(top > 0, top, 1.0))
        sizes = [float(peaks[r] / largest[w, c]) for w, r, c in self.unknown]
        own = [self.names[r] == self.signals[c] for _, r, c in self.unknown]
        return sizes, [size * diagonal for size, diagonal in zip(sizes, own, strict=True)]


def gains_from(gains: Any, channels: Channels, whiskers: int) -> Gains:
    """The gains that an argument describes; see `identify`.

    Raises:
        ValueError: if it is neither True or False nor a matrix with a column for each signal.
    """
    signals, whiskers = channels.names, whiskers if channels.function is None else 1
    if isinstance(gains, (bool, np.bool_)):
        factors = np.where(np.eye(len(signals)) > 0, np.nan, np.zeros((whiskers, 1, 1)))
        return Gains(signals, signals, factors if gains else None)
    names, rows = signals, gains
    if isinstance(gains, Mapping):
        names, rows = tuple(str(name) for name in gains), list(gains.values())
        if whiskers > 1:
            checks.fail("gains", "a matrix for scenes of several whiskers", f"rows by name for {whiskers}")
    shape = len(names), len(signals)
    try:
        matrix = np.asarray(as_numbers("gains", "the matrix", rows))
    except ValueError:
        matrix = np.zeros(0)
    if matrix.shape not in (shape, (whiskers, *shape)) or np.isinf(matrix).any() or not names:
        allowed = (
            f"True, False, a {len(signals)} x {len(signals)} matrix, or a mapping from names of channels to its rows: "
            f"finite numbers, or NaN where unknown, for {', '.join(signals)}"
        )
        checks.fail("gains", allowed, repr(gains))
    return Gains(names, signals, np.array(np.broadcast_to(matrix, (whiskers, *shape))))
