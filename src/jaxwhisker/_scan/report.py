"""Text output of scans: aligned tables of events and peaks, and CSV files."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.scene import units as natural_units
from jaxwhisker._path.path import Status
from jaxwhisker._scan.quantities import REACTIONS, UnitSystem, kind_of, unit_in_words
from jaxwhisker._scan.result import Result

NOISE = 1e-9  # relative to the unit; smaller numbers are printed as zero
LEAST_DECIMALS, MOST_DECIMALS = -1, 9  # decimals of six significant digits; outside, numbers get powers of ten


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Text in aligned columns: words are aligned on the left, numbers on the right."""
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
    """Format a number with this many decimals and without a minus sign before zero."""
    rounds_to_zero = abs(value) < 0.5 * 10.0**-digits
    return f"{0.0 if rounds_to_zero else value:.{digits}f}"


class _Printed:
    """Units and numbers of a scene's quantities in printed tables."""

    def __init__(self, scene: Scene, units: str):
        self._scene, self._system = scene, UnitSystem(scene, units)

    def heading(self, name: str) -> str:
        """Name and unit of a quantity."""
        unit = self._system.unit(name).name
        if self._system.dimensionless and not unit:
            unit = unit_in_words(kind_of(name, self._scene), dimensionless=True)
        return f"{name} ({unit})" if unit not in ("", "1") else name

    def cell(self, name: str, value: float) -> str:
        """Six significant digits relative to L, EI/L^2 or EI/L; one more for the control, which is more accurate."""
        kind, own, shown = kind_of(name, self._scene), natural_units(self._scene), self._system.unit(name)
        size = own.control if name == "control" else getattr(own, kind)
        ratio = float(size) / shown.size
        decimals = (6 if name == "control" else 5) - math.floor(math.log10(ratio))
        value /= shown.size
        if LEAST_DECIMALS <= decimals <= MOST_DECIMALS:
            return number(value, max(0, decimals))
        return f"{value:.5e}" if abs(value) > NOISE * ratio else "0"


def event_table(result: Result, units: str = "auto") -> str:
    """Table of events: one row per event and whisker; for a snap, one row before it and one after it.

    A last line says how many events did not fit into the result.

    Args:
        result: the Result of a single scan.
        units: "auto", "SI" or "dimensionless".

    Raises:
        ValueError: if `units` is none of these.
    """
    printed = _Printed(result.scene, units)
    names = ("base_x", *REACTIONS)
    rows = [[printed.heading("control"), "event", "whisker", "", *map(printed.heading, names)]]
    for event in result.events:
        # A snap of the whole network names no whisker because all of them move.
        whiskers = event.whiskers or tuple(range(1, np.asarray(event.before.fx).shape[0] + 1))
        snap = event.kind.name.startswith("snap")
        for when in ("before", "after") if snap else ("before",):
            state = getattr(event, when)
            for whisker in whiskers:
                values = [printed.cell(name, float(np.asarray(getattr(state, name))[whisker - 1])) for name in names]
                control = printed.cell("control", event.control)
                rows.append([control, event.kind.name, str(whisker), when if snap else "", *values])
    count, shown = int(result.events.count), len(result.events)
    missing = f"\nOnly the first {shown:,} of {count:,} events fit into the result." if count > shown else ""
    return (table(rows[0], rows[1:]) if len(rows) > 1 else "No events.") + missing


def peak_table(result: Result, units: str = "auto") -> str:
    """Table of extremes: one row per whisker and reaction, with the drive positions at which the extremes occur.

    Args:
        result: the Result of a single scan.
        units: "auto", "SI" or "dimensionless".

    Raises:
        ValueError: if `units` is none of these.
    """
    printed = _Printed(result.scene, units)
    control, place = np.asarray(result.control), f"at {printed.heading('control')}"
    rows = [["whisker", "reaction", "minimum", place, "maximum", place]]
    for whisker in range(np.asarray(result.fx).shape[1]):
        for name in REACTIONS:
            column = np.asarray(getattr(result, name))[:, whisker]
            row = [str(whisker + 1), printed.heading(name)]
            for pick in (np.nanargmin, np.nanargmax):
                if not np.isfinite(column).any():
                    row += ["-", "-"]
                    continue
                step = pick(column)
                # Every free whisker has the value zero, so the position of a zero has no meaning.
                is_zero = abs(column[step]) <= NOISE * np.nanmax(np.abs(column))
                at = "-" if is_zero else printed.cell("control", float(control[step]))
                row += [printed.cell(name, float(column[step])), at]
            rows.append(row)
    return table(rows[0], rows[1:])


def touches_object(result: Result) -> bool:
    """Whether any whisker touches the object at any step."""
    return bool(np.any(np.asarray(result.phase) != Phase.free))


def status_line(result: Result) -> tuple[int, str]:
    """Number of failed steps, and a line that counts the steps by status."""
    status = np.asarray(result.status)
    kinds, counts = np.unique(status, return_counts=True)
    failed = int(np.sum(status != Status.ok))
    parts = [f"{count} {Status(int(kind)).name}" for kind, count in zip(kinds, counts, strict=True)]
    return failed, f"{status.size} steps: {', '.join(parts)}"


def write_columns(columns: dict[str, np.ndarray], path: Path, comment: str) -> None:
    """Write columns of equal length as CSV below a comment line."""
    kinds = ["%d" if np.asarray(c).dtype.kind in "iu" else "%.9g" for c in columns.values()]
    header = f"# {comment}\n{','.join(columns)}"
    values = np.column_stack(list(columns.values())) + 0.0  # no minus sign before a zero
    np.savetxt(path, values, kinds, delimiter=",", header=header, comments="")


def write_rows(rows: Sequence[Sequence[str]], path: Path) -> None:
    """Write a table of words as CSV; cells without a value are empty."""
    lines = [",".join("" if cell == "-" else cell for cell in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
