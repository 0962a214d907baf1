"""A scan in words and columns: aligned tables of events and peaks, and CSV files."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from jaxwhisker._model.scene import Scene, units
from jaxwhisker._path.path import Status
from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker._scan.result import Result

NOISE = 1e-9  # share of a unit below which a number is shown as zero


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns: words to the left, numbers to the right."""
    columns = list(zip(header, *rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    numeric = [all(_is_number(cell) for cell in column[1:]) for column in columns]

    def line(cells):
        aligned = [c.rjust(w) if n else c.ljust(w) for c, w, n in zip(cells, widths, numeric, strict=True)]
        return "  ".join(aligned).rstrip()

    return "\n".join([line(header), line(["-" * w for w in widths]), *map(line, rows)])


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return cell in ("", "-")
    return True


def number(value: float, digits: int = 5) -> str:
    """A number with that many decimals; no minus sign before a zero."""
    return (
        f"{float(value) + 0.0:.{digits}f}"
        if abs(value) >= 0.5 * 10.0**-digits or np.isnan(value)
        else f"{0:.{digits}f}"
    )


def _in(unit: float, digits: int = 6) -> Callable[[float], str]:
    """How to write quantities of a unit's size, in powers of ten where it is very small or large."""
    decade = math.floor(math.log10(unit))
    if -3 <= decade <= 5:
        return lambda value: number(value, digits - 1 - decade)
    return lambda value: f"{value:.{digits - 1}e}" if abs(value) > NOISE * unit else "0"


def _formats(scene: Scene) -> dict[str, Callable[[float], str]]:
    unit = units(scene)
    length, force, moment = (_in(float(size)) for size in (unit.length, unit.force, unit.moment))
    control = _in(float(unit.length), digits=7)  # events are worth another one
    return {"control": control, "base_x": length, "fx": force, "fy": force, "mz": moment}


def event_rows(result: Result) -> list[list[str]]:
    """Header and one row per event and whisker; a snap has one before and one after it."""
    formats = _formats(result.scene)
    rows = [["control", "event", "whisker", "", "base_x", *REACTIONS]]
    for event in result.events:
        # A snap of the network as a whole names no whisker: all of them move.
        whiskers = event.whiskers or tuple(range(1, np.asarray(event.before.fx).shape[0] + 1))
        snap = event.kind.name.startswith("snap")
        for when in ("before", "after") if snap else ("before",):
            state = getattr(event, when)
            for whisker in whiskers:
                values = [
                    formats[name](float(np.asarray(getattr(state, name))[whisker - 1]))
                    for name in ("base_x", *REACTIONS)
                ]
                at = formats["control"](event.control)
                rows.append([at, event.kind.name, str(whisker), when if snap else "", *values])
    return rows


def peak_rows(result: Result) -> list[list[str]]:
    """Header and one row per whisker and reaction: extremes and where the drive then is."""
    formats = _formats(result.scene)
    control = np.asarray(result.control)
    rows = [["whisker", "reaction", "minimum", "at control", "maximum", "at control"]]
    for whisker in range(np.asarray(result.fx).shape[1]):
        for name in REACTIONS:
            column = np.asarray(getattr(result, name))[:, whisker]
            row = [str(whisker + 1), name]
            for pick in (np.nanargmin, np.nanargmax):
                if np.isfinite(column).any():
                    step = pick(column)
                    # A zero is wherever the whisker is free, nowhere in particular.
                    at = formats["control"](control[step]) if column[step] != 0 else "-"
                    row += [formats[name](float(column[step])), at]
                else:
                    row += ["-", "-"]
            rows.append(row)
    return rows


def status_line(result: Result) -> tuple[int, str]:
    """Number of failed steps and a sentence that counts them by status."""
    status = np.asarray(result.status)
    kinds, counts = np.unique(status, return_counts=True)
    failed = int(np.sum(status != Status.ok))
    parts = [f"{count} {Status(int(kind)).name}" for kind, count in zip(kinds, counts, strict=True)]
    return failed, f"{status.size} steps: {', '.join(parts)}"


def write_columns(columns: dict[str, np.ndarray], path: Path, comment: str) -> None:
    """Write columns of one length as CSV below a comment line."""
    kinds = ["%d" if np.asarray(c).dtype.kind in "iu" else "%.9g" for c in columns.values()]
    header = f"# {comment}\n{','.join(columns)}"
    values = np.column_stack(list(columns.values())) + 0.0  # no minus sign before a zero
    np.savetxt(path, values, kinds, delimiter=",", header=header, comments="")


def write_rows(rows: Sequence[Sequence[str]], path: Path) -> None:
    """Write a table of words as CSV; a cell without a value stays empty."""
    lines = [",".join("" if cell == "-" else cell for cell in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
