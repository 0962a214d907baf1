"""Observations: measured signals read from experiments, tables, files and scans, with the noise they contain."""

import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.columns import cells_of, floats
from jaxwhisker._scan.quantities import MOTION, QUANTITIES, REACTIONS, REACTIONS_IN_SPACE
from jaxwhisker._scan.result import AbstractResult, Result

# Other columns of scans, studies and simulations, and the unnamed index of a table, which are ignored silently.
_NAMES = "|".join((*QUANTITIES, *MOTION, "spring", "event_.*", "n_events"))
_IGNORED = re.compile(rf"(?:{_NAMES})(?:_\d+){{0,2}}(?:_[xyz]_d[123])?|(?:Unnamed: \d+)?")
VANISHING = 1e-9  # of the largest signal
OWN_REACTIONS = ("f1", "f2", "f3", "m1", "m2", "m3")  # along the directors of the displaced base
OF_WHISKERS = (REACTIONS, REACTIONS_IN_SPACE, OWN_REACTIONS)  # channels of which every whisker has its own


class Observations(eqx.Module):
    """Measured signals over the control, in the units of the scene; NaN where nothing was measured.

    Signals are fx, fy, mz of the support on each whisker. If a function computes what is measured, the axis of whiskers
    has length 1 and the last axis holds its channels.
    """

    control: Float[np.ndarray, " steps"]  # drive positions in the order in which they were visited
    values: Float[np.ndarray, "steps whiskers kinds"]
    sigma: Float[np.ndarray, "steps whiskers kinds"]  # standard deviation of their noise; NaN if unknown
    kinds: tuple[str, ...] = eqx.field(default=REACTIONS, static=True)  # names along the last axis
    exact: bool = eqx.field(default=False, static=True)  # the signals of a computed scan, which have no noise

    @property
    def known(self) -> Bool[np.ndarray, "steps whiskers kinds"]:
        """Where a value was measured."""
        return np.isfinite(self.values)

    @property
    def channels(self) -> list["Channel"]:
        """The channels that hold a value, in the order of the last two axes."""
        return [c for c in channels_of(self.values.shape[1], self.kinds) if self.known[:, c.whisker, c.kind].any()]

    @property
    def names(self) -> list[str]:
        """Names of the channels that hold a value: fx, or fx_1, fx_2 of several whiskers."""
        return [channel.name for channel in self.channels]

    @property
    def peaks(self) -> Float[np.ndarray, " kinds"]:
        """Largest magnitude of each kind of signal over all whiskers; 1 for one that is zero or not measured.

        In space, symmetry makes some vanish but for rounding; these have the largest magnitude of all.
        """
        peak = np.max(np.abs(np.where(self.known, self.values, 0.0)), axis=(0, 1), initial=0.0)
        if self.kinds == REACTIONS_IN_SPACE:
            peak = np.where(peak > VANISHING * np.max(peak), peak, np.max(peak))
        return np.where(peak > 0, peak, 1.0)

    def at(self, steps: Any) -> "Observations":
        """The observations at some steps, which a slice or indices select."""
        return Observations(self.control[steps], self.values[steps], self.sigma[steps], self.kinds, self.exact)

    def with_sigma(self, sigma: Any) -> "Observations":
        """The same observations with another standard deviation of the noise, broadcast to (steps, whiskers, 3)."""
        sigma = np.array(np.broadcast_to(sigma, self.values.shape), dtype=float)
        return Observations(self.control, self.values, sigma, self.kinds)


class Channel(NamedTuple):
    """One kind of signal of one whisker."""

    whisker: int  # index
    kind: int  # index along the last axis of the values
    name: str  # fx, or fx_1, fx_2, ... of several whiskers


def channels_of(whiskers: int, kinds: tuple[str, ...] = REACTIONS) -> list[Channel]:
    """All channels of a number of whiskers."""
    return [
        Channel(k, c, f"{name}_{k + 1}" if whiskers > 1 else name)
        for k in range(whiskers)
        for c, name in enumerate(kinds)
    ]


def read_observations(
    data: Any, sigma: Any = None, *, whiskers: int | None = None, kinds: tuple[str, ...] = REACTIONS
) -> Observations:
    """Read signals from a Result, a Dataset, a DataFrame, a CSV file or a mapping of arrays.

    Args:
        data: holds `control` and any of fx, fy, mz: (steps,) for one whisker, (steps, whiskers) or columns fx_1, fx_2,
            ... for several. Other columns are ignored with a warning that names them. Files are read as by
            `read_columns`.
        sigma: standard deviation of the noise: a number for all channels, or a mapping from channels to numbers or
            arrays; None if unknown.
        whiskers: number of whiskers; the data may omit whiskers that were not measured.
        kinds: names of the channels if a function computes them; the data may omit some.

    Raises:
        ValueError: if the data have another type, lack `control` or all channels, or have a wrongly shaped column, or
            if sigma is not positive or is missing for a channel.
    """
    table = named_values(data, kinds)
    if "control" not in table:
        raise ValueError(f"`measured` must hold `control`, got {', '.join(table) or 'nothing'}.")
    control = _as_column(as_numbers("measured", "control", table["control"]))
    if control.ndim != 1 or control.size == 0 or not np.isfinite(control).all():
        raise ValueError(
            "`measured` must hold a non-empty one-dimensional `control` of finite numbers, got shape "
            f"{control.shape} with {int(np.sum(~np.isfinite(control)))} values that are not finite."
        )
    columns = _columns_of(table, control.size, kinds)
    if not columns:
        raise ValueError(f"`measured` must hold at least one of {', '.join(kinds)}, got {', '.join(table)}.")
    lowest, highest = 1 + min(k for k, _ in columns), 1 + max(k for k, _ in columns)
    if lowest < 1 or (whiskers is not None and highest > whiskers):
        raise ValueError(
            f"`measured` must hold channels of whiskers 1 to {whiskers or 'their number'}, got one of whisker "
            f"{highest if lowest > 0 else lowest}."
        )
    values = np.full((control.size, whiskers or highest, len(kinds)), np.nan)
    for (whisker, kind), column in columns.items():
        values[:, whisker, kind] = column
    values[~np.isfinite(values)] = np.nan
    exact = data.exact if isinstance(data, Observations) else isinstance(data, AbstractResult)
    return Observations(control, values, _sigma_of(sigma, values, kinds), kinds, exact)


def channel_pattern(kinds: tuple[str, ...]) -> re.Pattern:
    """What names of channels look like: those of reactions may end with the number of a whisker."""
    names = "|".join(map(re.escape, kinds))
    return re.compile(rf"({names})(?:_(\d+))?" if kinds in OF_WHISKERS else rf"({names})()")


def _columns_of(table: Mapping[str, Any], steps: int, kinds: tuple[str, ...]) -> dict[tuple[int, int], np.ndarray]:
    """The measured columns by whisker and kind."""
    columns: dict[tuple[int, int], np.ndarray] = {}
    pattern, ignored = channel_pattern(kinds), []
    for name, values in table.items():
        matched = pattern.fullmatch(name)
        if matched is None:
            ignored += [name] * (not _IGNORED.fullmatch(name))
            continue
        values = as_numbers("measured", name, values)
        values = values if values.shape[:1] == (steps,) else _as_column(values)
        if values.shape[:1] != (steps,) or values.ndim > 2:
            raise ValueError(
                f"`measured` must hold a value of {name} for each of the {steps} controls, got shape {values.shape}."
            )
        if (matched[2] or kinds not in OF_WHISKERS) and values.ndim > 1:
            raise ValueError(f"`measured` must hold one column for {name}, got shape {values.shape}.")
        first = int(matched[2] or 1) - 1
        for k, column in enumerate(values.reshape(steps, -1).T):
            columns[first + k, kinds.index(matched[1])] = column
    if ignored and columns:
        hint = f" (or {kinds[0]}_1, {kinds[0]}_2, ... of several whiskers)" if kinds in OF_WHISKERS else ""
        text = f"Columns of `measured` other than {', '.join(kinds)}{hint} are ignored: {', '.join(ignored)}."
        warnings.warn(text, stacklevel=4)
    return columns


def named_values(data: Any, kinds: tuple[str, ...]) -> dict[str, Any]:
    """The columns of data of any form; those of a file that are neither control nor among `kinds` stay text."""
    if isinstance(data, Observations):
        return {"control": data.control} | {name: data.values[:, :, c] for c, name in enumerate(data.kinds)}
    if isinstance(data, (str, Path)):
        return _read_file(Path(data), kinds)
    if isinstance(data, AbstractResult if kinds == REACTIONS_IN_SPACE else Result):
        reactions = REACTIONS if isinstance(data, Result) else REACTIONS_IN_SPACE
        return {name: getattr(data, name) for name in ("control", *reactions)}
    if hasattr(data, "data_vars"):  # an xarray.Dataset
        return _table_of_dataset(data)
    if hasattr(data, "columns"):  # a DataFrame
        index = getattr(data, "index", None)  # frames of polars have none
        data = data.reset_index() if index is not None and index.name in ("control", *kinds) else data
        names = [str(name) for name in data.columns]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"`measured` must hold each column once, got several of {', '.join(twice)}.")
        return {str(name): data[name] for name in data.columns}
    allowed = "a mapping of arrays, a Result, a Dataset, a DataFrame or the path of a CSV file"
    checks.instance("measured", data, Mapping, allowed)
    return {str(name): values for name, values in data.items() if not str(name).startswith("__")}  # of MATLAB's files


def _table_of_dataset(data: Any) -> dict[str, Any]:
    along = data["control"].dims if "control" in data.variables else ("control",)  # or time, say
    table = {}
    for name in (name for name in (*REACTIONS_IN_SPACE, "control") if name in data.variables):
        others = [dim for dim in data[name].dims if dim not in (*along, "whisker")]
        several = [dim for dim in others if data.sizes[dim] > 1]
        if several:
            raise ValueError(
                f"`measured` must be one scan, got a Dataset with several along {', '.join(map(str, several))}: pick "
                "one with .isel or .sel."
            )
        array = data[name].squeeze(others, drop=True)
        table[name] = array.transpose(*(dim for dim in (*along, "whisker") if dim in array.dims)).values
    return table


def _read_file(path: Path, kinds: tuple[str, ...]) -> dict[str, Any]:
    """The columns of a file; those that are neither control nor channels stay text."""

    def wanted(name: str) -> bool:
        return name == "control" or channel_pattern(kinds).fullmatch(name) is not None

    cells = cells_of("measured", path, wanted)
    return {name: floats("measured", path, name, own) if wanted(name) else own for name, own in cells.items()}


def as_numbers(argument: str, name: str, values: Any) -> np.ndarray:
    """Values as floats; a ValueError names the argument and the column if they are not numbers."""
    try:
        if np.iscomplexobj(values):  # NumPy would drop the imaginary part
            raise TypeError
        return np.asarray(checks.unmasked(values), dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"`{argument}` must hold numbers, got {values!r} for {name}.") from None


def _as_column(values: np.ndarray) -> np.ndarray:
    """A row or column of a matrix, as in MATLAB's files, as a vector; other arrays stay as they are."""
    return values.ravel() if values.ndim == 2 and 1 in values.shape else values


def _sigma_of(sigma: Any, values: np.ndarray, kinds: tuple[str, ...]) -> np.ndarray:
    """Standard deviation of every value; NaN if unknown."""
    deviation = np.full(values.shape, np.nan)
    known = np.isfinite(values)
    if sigma is None:
        return deviation
    for name, value in (sigma if isinstance(sigma, Mapping) else dict.fromkeys(kinds, sigma)).items():
        matched = channel_pattern(kinds).fullmatch(str(name))
        if matched is None:
            raise ValueError(f"`sigma` must name channels among {', '.join(kinds)}, got {name!r}.")
        if matched[2] and not 1 <= int(matched[2]) <= values.shape[1]:
            raise ValueError(f"`sigma` must name channels of whiskers 1 to {values.shape[1]}, got {name!r}.")
        whiskers = slice(int(matched[2]) - 1, int(matched[2])) if matched[2] else slice(None)
        _fill(deviation[:, whiskers, kinds.index(matched[1])], name, value)
    if np.isnan(deviation[known]).any():
        lacking = [name for c, name in enumerate(kinds) if (np.isnan(deviation[:, :, c]) & known[:, :, c]).any()]
        raise ValueError(f"`sigma` must be given for every measured channel, got none for {', '.join(lacking)}.")
    return deviation


def _fill(part: np.ndarray, name: str, value: Any) -> None:
    """Set the standard deviation of a channel, (steps, whiskers)."""
    value = as_numbers("sigma", name, value)
    bad = value[~(np.isfinite(value) & (value > 0))]
    if bad.size:
        raise ValueError(f"`sigma` must be positive and finite, got {bad.ravel()[0]} for {name}.")
    try:
        part[...] = value if value.ndim != 1 or value.shape == part.shape[1:] else value[:, None]
    except ValueError:
        raise ValueError(f"`sigma` must be a number or one per control, got shape {value.shape} for {name}.") from None
