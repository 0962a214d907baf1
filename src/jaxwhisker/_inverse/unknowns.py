"""Everything that a fit estimates, and which of it each recording shares with others."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from jaxwhisker._inverse.channels import Channels
from jaxwhisker._inverse.gains import Gains

GROUPS = {"offset_": "offsets", "gain_": "gains"}  # names of the unknowns of channels, by the prefix of each


class Unknowns(NamedTuple):
    """The unknowns of one recording, and their places among those of all recordings.

    Those of a recording are, in this order: parameters of `build`, parameters of the channels' function, constant
    offsets of channels, unknown entries of the gain matrix, a shift of the control.
    """

    build: tuple[str, ...]
    channels: Channels
    offsets: tuple[tuple[int, int], ...]  # (whisker, channel)
    gains: Gains
    shift: bool
    all_names: tuple[str, ...]  # of all recordings, in the order of the fit's variables
    columns: tuple[Int[np.ndarray, " own"], ...]  # places of each recording's unknowns among all

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters of the scene and of the channels' function."""
        return self.build + self.channels.parameters

    @property
    def own_names(self) -> tuple[str, ...]:
        """Names of the unknowns of one recording."""
        return _own_names(self.names, self.offsets, self.gains, self.shift)

    @property
    def own_index(self) -> Int[np.ndarray, " unknowns"]:
        """Place of each unknown of all recordings among those of one recording."""
        index = np.zeros(len(self.all_names), dtype=int)
        for columns in self.columns:
            index[columns] = np.arange(columns.size)
        return index

    @property
    def linear(self) -> Bool[np.ndarray, " unknowns"]:
        """Which unknowns of all recordings the signals depend on linearly: gains and offsets."""
        return self._among_all(len(self.names) + np.arange(len(self.offsets) + len(self.gains.unknown)))

    @property
    def crosstalk(self) -> Bool[np.ndarray, " unknowns"]:
        """Which unknowns of all recordings are gains of another signal than the channel's own."""
        return self._among_all(len(self.names) + len(self.offsets) + np.flatnonzero(self.gains.crosstalk))

    def _among_all(self, own: Int[np.ndarray, " some"]) -> Bool[np.ndarray, " unknowns"]:
        """Which unknowns of all recordings have one of these places among those of a recording."""
        return np.isin(self.own_index, own)

    def by_own(self, slopes: np.ndarray) -> np.ndarray:
        """Derivatives by the unknowns of one recording, from those along the directions of a linearised scan."""
        count = len(self.names)
        columns = np.zeros((*slopes.shape[:-1], len(self.own_names)))
        columns[..., :count] = slopes[..., :count]
        if self.shift:
            columns[..., -1] = slopes[..., count]
        return columns

    def measured(self, own: np.ndarray, signals: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The measured channels of one recording, and their derivatives by its unknowns.

        Args:
            own: the unknowns, (own,).
            signals: of the model, (steps, whiskers, signals).
            slopes: their derivatives along the directions of a linearised scan.
        """
        count, gains = len(self.names), split(self, own).gains
        by_own = self.gains.applied(self.by_own(slopes), gains)
        for k, (whisker, channel, signal) in enumerate(self.gains.unknown, start=count + len(self.offsets)):
            by_own[:, whisker, channel, k] = signals[:, whisker, signal]
        values = self.gains.applied(signals, gains).copy()
        for k, (whisker, channel) in enumerate(self.offsets, start=count):
            by_own[:, whisker, channel, k] = 1.0
            values[:, whisker, channel] += own[k]
        return values, by_own

    def scene_values(self, x: Any, recording: int = 0) -> dict[str, Any]:
        """The arguments of `build` for one recording, from all unknowns."""
        return {name: x[k] for name, k in zip(self.build, self.columns[recording], strict=False)}


class Parts(NamedTuple):
    """The unknowns of one recording by what they act on."""

    build: Any
    channels: Any
    offsets: Any
    gains: Any
    shift: Any


def split(unknowns: Unknowns, own: Any) -> Parts:
    """The unknowns of one recording, an array or a list, by what they act on."""
    parts = unknowns.build, unknowns.channels.parameters, unknowns.offsets, unknowns.gains.unknown
    sizes = [len(part) for part in parts]
    ends = np.cumsum(sizes)
    return Parts(*(own[a:b] for a, b in zip([0, *ends], [*ends, len(own)], strict=True)))


def _own_names(names, offsets, gains: Gains, shift: bool) -> tuple[str, ...]:
    several = len({k for k, *_ in (*offsets, *gains.unknown)}) > 1
    channels = [("offset_" + gains.names[c], k) for k, c in offsets]
    channels += [("gain_" + gains.name(entry), entry[0]) for entry in gains.unknown]
    return (*names, *(name + (f"_{k + 1}" if several else "") for name, k in channels), *["shift"] * shift)


def unknowns_of(
    names: Sequence[str],
    channels: Channels,
    offsets: Sequence[tuple[int, int]],
    gains: Gains,
    shift: bool,
    individual: Any,
    recordings: int,
) -> Unknowns:
    """The unknowns of several recordings.

    Args:
        names: parameters of `build`.
        channels: what is measured, with its own parameters.
        offsets: channels with an unknown constant.
        gains: of the channels.
        shift: whether the control is off by an unknown constant.
        individual: names of unknowns that recordings do not share, or a mapping from such names to one label for each
            recording: recordings with the same label share the value.
        recordings: their number.

    Raises:
        ValueError: if `individual` names an unknown that does not exist, or has not one label for each recording.
    """
    build, moved = tuple(names), tuple(offsets)
    own = _own_names(build + channels.parameters, moved, gains, shift)
    groups = [next((g for prefix, g in GROUPS.items() if name.startswith(prefix)), name) for name in own]
    groups[: len(names) + len(channels.parameters)] = build + channels.parameters
    labels = _labels_of(individual, list(dict.fromkeys(groups)), recordings)
    table = [
        [f"{name}[{labels[group][r]}]" if group in labels else name for name, group in zip(own, groups, strict=True)]
        for r in range(recordings)
    ]
    all_names = list(dict.fromkeys(table[r][k] for k in range(len(own)) for r in range(recordings)))
    columns = tuple(np.array([all_names.index(name) for name in row], dtype=int) for row in table)
    return Unknowns(build, channels, moved, gains, shift, tuple(all_names), columns)


def _labels_of(individual: Any, groups: list[str], recordings: int) -> dict[str, list[str]]:
    """One label per recording for each name."""
    if isinstance(individual, str) or not isinstance(individual, (Mapping, Sequence)):
        raise ValueError(f"`individual` must be names of unknowns, or a mapping to labels, got {individual!r}.")
    numbers = range(1, recordings + 1)
    given = individual if isinstance(individual, Mapping) else dict.fromkeys(individual, numbers)
    labels = {}
    for name, of_each in given.items():
        if name not in groups:
            raise ValueError(f"`individual` must name unknowns of the fit ({', '.join(groups)}), got {name!r}.")
        if isinstance(of_each, str) or not isinstance(of_each, Sequence) or len(of_each) != recordings:
            raise ValueError(
                f"`individual` must hold a label for each of the {recordings} recordings, got {of_each!r} for {name}."
            )
        labels[name] = [str(label) for label in of_each]
    return labels
