"""Text output of scans and simulations: aligned tables of events and peaks, and CSV files."""

import math
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._scan.contacts import has_several
from jaxwhisker._scan.dataset import counted
from jaxwhisker._scan.quantities import UnitSystem, kind_of, reactions_of, unit_in_words

ROUNDED = 1e-9  # relative to the unit; smaller numbers are printed as zero
LEAST_DECIMALS, MOST_DECIMALS = -1, 9  # decimals of six significant digits; outside, numbers get powers of ten


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Text in aligned columns: words are aligned on the left, numbers on the right."""
    columns = list(zip(header, *rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    numeric = [all(map(_reads_as_number, column[1:])) for column in columns]

    def line(cells):
        aligned = [c.rjust(w) if n else c.ljust(w) for c, w, n in zip(cells, widths, numeric, strict=True)]
        return "  ".join(aligned).rstrip()

    return "\n".join([line(header), line(["-" * w for w in widths]), *map(line, rows)])


def _reads_as_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return cell in ("", "-")
    return True


def fixed(value: float, digits: int = 5) -> str:
    """Format a number with this many decimals and without a minus sign before zero."""
    rounds_to_zero = abs(value) < 0.5 * 10.0**-digits
    return f"{0.0 if rounds_to_zero else value:.{digits}f}"


class _Printed(UnitSystem):
    """Units and numbers of a scene's quantities in printed tables."""

    def heading(self, name: str) -> str:
        """Name and unit of a quantity."""
        unit = self.unit(name).name
        if self.dimensionless and not unit:
            unit = unit_in_words(kind_of(name, self.scene), dimensionless=True)
        return f"{name} ({unit})" if unit not in ("", "1") else name

    def cell(self, name: str, value: float) -> str:
        """Six significant digits relative to L, EI/L^2, EI/L or T; one more for the control, which is more accurate."""
        size = self.unit(name).size
        ratio = float(self.natural.control) / size if name == "control" else self.scale(kind_of(name, self.scene))
        decimals = (6 if name == "control" else 5) - math.floor(math.log10(ratio))
        value /= size
        if LEAST_DECIMALS <= decimals <= MOST_DECIMALS:
            return fixed(value, max(0, decimals))
        return f"{value:.5e}" if abs(value) > ROUNDED * ratio else "0"


def event_table(result: Any, units: str = "auto") -> str:
    """Table of events: one row per event and whisker; for a snap, one row before it and one after it.

    If whiskers may have several contacts, there are columns for the contact and its object, as in `Event`. A last line
    says how many events did not fit into the result.

    Args:
        result: the Result or SpaceResult of a single scan.
        units: "auto", "SI" or "dimensionless".

    Raises:
        ValueError: if `units` is none of these.
    """
    printed = _Printed(result.scene, units)
    names = ("base_x", *reactions_of(result.scene))
    places = ("contact", "object") if has_several(result) else ()
    header, rows = [printed.heading("control"), "event", "whisker", *places, "", *map(printed.heading, names)], []
    for event in result.events:
        # A snap of the whole network names no whisker because all of them move.
        whiskers = event.whiskers or range(1, event.before.fx.size + 1)
        control, kind = printed.cell("control", event.control), event.kind.name
        sides = {"before": event.before, "after": event.after} if kind.startswith("snap") else {"": event.before}
        for (when, state), whisker in product(sides.items(), whiskers):
            values = [printed.cell(name, float(getattr(state, name)[whisker - 1])) for name in names]
            place = [str(getattr(event, name) or "-") for name in places]
            rows.append([control, kind, str(whisker), *place, when, *values])
    return _with_omitted(result, header, rows)


def timed_event_table(motion: Any, units: str = "auto") -> str:
    """Table of the events of a single simulation, with the time and the drive position of each.

    A last line says how many events did not fit into the result.

    Args:
        motion: a Simulation.
        units: "auto", "SI" or "dimensionless".

    Raises:
        ValueError: if `units` is none of these.
    """
    printed, names = _Printed(motion.scene, units), ("time", "control")
    rows = [
        [*(printed.cell(name, getattr(event, name)) for name in names), event.kind.name, str(event.whisker)]
        for event in motion.events
    ]
    return _with_omitted(motion, [*map(printed.heading, names), "event", "whisker"], rows)


def _with_omitted(result: Any, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of events, and a line that says how many are missing in it."""
    count, shown = int(result.events.count), len(result.events)
    missing = (
        f"\nOnly {shown:,} of {count:,} events fit into the result, the first and the last." if count > shown else ""
    )
    return (table(header, rows) if rows else "No events.") + missing


def peak_table(result: Any, units: str = "auto") -> str:
    """Table of extremes: one row per whisker and reaction, with the drive positions at which the extremes occur.

    Args:
        result: the result of a single scan or simulation.
        units: "auto", "SI" or "dimensionless".

    Raises:
        ValueError: if `units` is none of these.
    """
    printed = _Printed(result.scene, units)
    place, rows = f"at {printed.heading('control')}", []
    for whisker, name in product(range(result.fx.shape[1]), reactions_of(result.scene)):
        column = np.asarray(getattr(result, name))[:, whisker]
        rows.append([str(whisker + 1), printed.heading(name)])
        for pick in (np.nanargmin, np.nanargmax):
            if not np.isfinite(column).any():
                rows[-1] += ["-", "-"]
                continue
            step = pick(column)
            # Every free whisker has the value zero, so the position of a zero has no meaning.
            is_zero = abs(column[step]) <= ROUNDED * np.nanmax(np.abs(column))
            at = "-" if is_zero else printed.cell("control", float(result.control[step]))
            rows[-1] += [printed.cell(name, float(column[step])), at]
    return table(["whisker", "reaction", "minimum", place, "maximum", place], rows)


def is_timed(result: Any) -> bool:
    """Whether it is a motion in time rather than a scan."""
    return hasattr(result, "time")


def touches_object(result: Any) -> bool:
    """Whether any whisker touches the object at any step."""
    return bool(np.any(np.asarray(result.phase) != Phase.free))


def status_line(result: Any) -> tuple[int, str]:
    """Number of failed steps or samples, and a line that counts them by status."""
    counts, steps = counted(result.status), np.size(result.status)
    words = ", ".join(f"{count} {name}" for name, count in counts.items())
    return steps - counts.get("ok", 0), f"{steps} {'samples' if is_timed(result) else 'steps'}: {words}"


def write_columns(columns: dict[str, np.ndarray], path: Path, comment: str) -> None:
    """Write columns of equal length as CSV below a comment line, in full precision."""
    # The fewest digits that identify each float; adding 0 removes the sign of -0.0.
    rows = zip(*((column + 0).tolist() for column in columns.values()), strict=True)
    write_rows([list(columns), *(list(map(repr, row)) for row in rows)], path, comment)


def write_rows(rows: Sequence[Sequence[str]], path: Path, comment: str | None = None) -> None:
    """Write a table of words as CSV, below a comment line if there is one; cells without a value are empty."""
    lines = [] if comment is None else [f"# {comment}"]
    lines += [",".join("" if cell == "-" else cell for cell in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
