"""Measured signals: what is read from experiments, tables, files and scans, and how uncertain it is."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxwhisker._scan.result import Result

CHANNELS = ("fx", "fy", "mz")
# What scans and studies tell besides: known, and not looked at.
_BESIDE = re.compile(
    r"(base_(x|y|angle)|contact_(force|slope|arc|x|y)|spring|spring_length|phase)(_\d+)?|status|time|event_.*|n_events"
)
_NUMBERED = re.compile(r"(fx|fy|mz)(?:_(\d+))?")


class Measured(eqx.Module):
    """Signals over the control; NaN where there is none."""

    control: Float[np.ndarray, " steps"]  # in the order in which they were taken
    values: Float[np.ndarray, "steps whiskers 3"]  # fx, fy, mz of the support on the whisker
    sigma: Float[np.ndarray, "steps whiskers 3"]  # standard deviation of their noise; NaN where it is unknown

    @property
    def known(self) -> np.ndarray:
        """Where there is a value: (steps, whiskers, 3)."""
        return np.isfinite(self.values)

    @property
    def names(self) -> list[str]:
        """Names of the channels that hold a value, in the order of the last two axes: fx, or fx_1, fx_2 of several."""
        whiskers = self.values.shape[1]
        return [
            channel if whiskers == 1 else f"{channel}_{k + 1}"
            for k in range(whiskers)
            for c, channel in enumerate(CHANNELS)
            if self.known[:, k, c].any()
        ]


def measured_of(data: Any, sigma: Any = None, *, whiskers: int | None = None) -> Measured:
    """Signals from a Result, a Dataset, a DataFrame, a CSV file or a mapping of arrays.

    Args:
        data: has `control`, and any of fx, fy, mz: of one whisker (steps,), of several (steps, whiskers) or columns
            fx_1, fx_2, ...; lines of a file that begin with # are skipped.
        sigma: standard deviation of the noise: a number for all, or a mapping from channels to numbers or arrays.
        whiskers: how many there are; those of which nothing was measured may be left out of the data.

    Raises:
        ValueError: if a channel is unknown, too short or too long, or sigma is not positive.
    """
    table = _table_of(data)
    if "control" not in table:
        raise ValueError(f"`measured` must hold `control`, but holds {', '.join(table) or 'nothing'}.")
    control = _numbers("control", table["control"])
    if control.ndim != 1 or control.size == 0 or not np.isfinite(control).all():
        raise ValueError(
            f"`measured` must hold a non-empty one-dimensional `control` of finite numbers, but its shape is "
            f"{control.shape} with {int(np.sum(~np.isfinite(control)))} values that are not finite."
        )
    columns: dict[tuple[int, int], np.ndarray] = {}
    for name, values in table.items():
        if name == "control" or _BESIDE.fullmatch(name):
            continue
        matched = _NUMBERED.fullmatch(name)
        if matched is None:
            raise ValueError(
                f"`measured` must hold channels among {', '.join(CHANNELS)} (or fx_1, fx_2, ... of several whiskers), "
                f"but one is {name!r}."
            )
        values = _numbers(name, values)
        if values.shape[:1] != control.shape or values.ndim > 2:
            raise ValueError(
                f"`measured` must hold a value of {name} for each of the {control.size} controls, but its shape is "
                f"{values.shape}."
            )
        channel = CHANNELS.index(matched[1])
        if matched[2] is not None and values.ndim > 1:
            raise ValueError(f"`measured` must hold one column for {name}, but its shape is {values.shape}.")
        first = int(matched[2] or 1) - 1
        for k, column in enumerate(values.reshape(control.size, -1).T):
            columns[first + k, channel] = column
    if not columns:
        raise ValueError(f"`measured` must hold at least one of {', '.join(CHANNELS)}, but holds {', '.join(table)}.")
    least, found = 1 + min(k for k, _ in columns), 1 + max(k for k, _ in columns)
    if least < 1 or (whiskers is not None and found > whiskers):
        raise ValueError(
            f"`measured` must hold channels of whiskers 1 to {whiskers or 'their number'}, but holds one of whisker "
            f"{found if least > 0 else least}."
        )
    values = np.full((control.size, whiskers or found, len(CHANNELS)), np.nan)
    for (k, channel), column in columns.items():
        values[:, k, channel] = column
    values[~np.isfinite(values)] = np.nan
    return Measured(control, values, _sigma_of(sigma, values))


def _table_of(data: Any) -> dict[str, Any]:
    if isinstance(data, Measured):
        data = {"control": data.control} | {c: data.values[:, :, k] for k, c in enumerate(CHANNELS)}
    if isinstance(data, (str, Path)):
        return _read(Path(data))
    if isinstance(data, Result):
        return {name: getattr(data, name) for name in ("control", *CHANNELS)}
    if hasattr(data, "data_vars"):  # an xarray.Dataset
        return _of_dataset(data)
    if hasattr(data, "columns"):  # a DataFrame
        return {str(name): data[name] for name in data.columns}
    if isinstance(data, Mapping):
        return {str(name): values for name, values in data.items()}
    raise ValueError(
        "`measured` must be a mapping of arrays, a Result, a Dataset, a DataFrame or the path of a CSV file, but is "
        f"{data!r}."
    )


def _of_dataset(data: Any) -> dict[str, Any]:
    table = {}
    for name in (name for name in (*CHANNELS, "control") if name in data.variables):
        array = (
            data[name].squeeze([d for d in data[name].dims if d not in ("control", "whisker")], drop=True)
            if all(data.sizes[d] == 1 for d in data[name].dims if d not in ("control", "whisker"))
            else None
        )
        if array is None:
            several = [d for d in data[name].dims if d not in ("control", "whisker") and data.sizes[d] > 1]
            raise ValueError(
                f"`measured` must be one scan, but the Dataset holds several along {', '.join(map(str, several))}: "
                "pick one with .isel or .sel."
            )
        order = [d for d in ("control", "whisker") if d in array.dims]
        table[name] = array.transpose(*order).values
    return table


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise ValueError(f"`measured` must be the path of a CSV file, but there is none at {path}.")
    lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip() and line[0] != "#"]
    names = [name.strip().strip('"') for name in lines[0].split(",")] if lines else []
    try:
        rows = [[float(cell) if cell.strip() else np.nan for cell in line.split(",")] for line in lines[1:]]
    except ValueError as error:
        raise ValueError(f"`measured` must be columns of numbers below a line of names, but {path}: {error}.") from None
    if not rows or any(len(row) != len(names) for row in rows):
        raise ValueError(f"`measured` must be columns of one length below a line of names, but {path} is not.")
    return dict(zip(names, np.array(rows).T, strict=True))


def _numbers(name: str, values: Any) -> np.ndarray:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"`measured` must hold numbers, but {name} is {values!r}.") from None


def _sigma_of(sigma: Any, values: np.ndarray) -> np.ndarray:
    found = np.full(values.shape, np.nan)
    known = np.isfinite(values)
    if sigma is None:
        return found
    if not isinstance(sigma, Mapping):
        sigma = dict.fromkeys(CHANNELS, sigma)
    for name, value in sigma.items():
        matched = _NUMBERED.fullmatch(str(name))
        if matched is None:
            raise ValueError(f"`sigma` must name channels among {', '.join(CHANNELS)}, but one is {name!r}.")
        try:
            value = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise ValueError(f"`sigma` must hold numbers, but of {name} it is {value!r}.") from None
        if matched[2] is not None and not 1 <= int(matched[2]) <= values.shape[1]:
            raise ValueError(f"`sigma` must name channels of whiskers 1 to {values.shape[1]}, but one is {name!r}.")
        bad = value[~(np.isfinite(value) & (value > 0))]
        if bad.size:
            raise ValueError(f"`sigma` must be positive and finite, but of {name} it is {bad.ravel()[0]}.")
        channel = CHANNELS.index(matched[1])
        at = slice(None) if matched[2] is None else slice(int(matched[2]) - 1, int(matched[2]))
        try:
            part = found[:, at, channel]
            part[...] = value if value.ndim != 1 or value.shape == part.shape[1:] else value[:, None]
        except ValueError:
            raise ValueError(
                f"`sigma` must be a number or one per control for {name}, but its shape is {value.shape}."
            ) from None
    if np.isnan(found[known]).any():
        lacking = [c for k, c in enumerate(CHANNELS) if (np.isnan(found[:, :, k]) & known[:, :, k]).any()]
        raise ValueError(f"`sigma` must be given for every measured channel, but is missing for {', '.join(lacking)}.")
    return found


def has_contact(measured: Measured, threshold: float = 5.0) -> bool:
    """Whether any signal stands out of the noise, of which nothing is known beyond zero where sigma is NaN."""
    noise = np.where(np.isfinite(measured.sigma), measured.sigma, 0.0)
    return bool(np.nanmax(np.abs(measured.values) - threshold * noise, initial=0.0) > 0)
