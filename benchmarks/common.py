"""Helpers that all benchmarks share: environment, interleaved timing, stored results and Markdown tables.

A results file is a JSON table with one row per line: `{"environment": {...}, "columns": [...], "rows": [[...], ...]}`.
"""

import argparse
import datetime
import json
import os
import platform
import statistics
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

TESTS = Path(__file__).parents[1] / "tests"
sys.path.extend([str(TESTS), str(TESTS / "oracles")])  # benchmarks compare with the oracles of the tests

RESULTS = Path(__file__).parent / "results"
PACKAGES = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "numpy")
DIGITS = 8  # significant digits of stored numbers


def environment(*packages: str) -> dict[str, str]:
    """Machine, cores, load, versions (also those of further packages) and date."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {
        "date": datetime.date.today().isoformat(),
        "processor": model,
        "cores": str(os.cpu_count()),
        "load": f"{os.getloadavg()[0]:.1f}",
        "python": platform.python_version(),
        **{name: version(name) for name in (*PACKAGES, *packages)},
    }


def interleaved(calls: dict, repeats: int) -> dict[Any, dict[str, float]]:
    """Median and quartiles of each call's run time in seconds.

    Calls take turns, which spreads any drift of the machine over all of them.
    """
    times: dict[Any, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(repeats):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - start)
    return {name: summary(values) for name, values in times.items()}


def summary(values: list[float]) -> dict[str, float]:
    """Median and quartiles."""
    low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
    return {"median": middle, "lower": low, "upper": high}


def quick(description: str | None) -> bool:
    """Parse the command line of a benchmark whose only option is `--quick`."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer cases and repetitions")
    return parser.parse_args().quick


def read(name: str) -> dict:
    """Read a results file: its environment, and its rows as dicts with None for empty cells."""
    stored = json.loads((RESULTS / f"{name}.json").read_text())
    rows = [dict(zip(stored["columns"], row, strict=True)) for row in stored["rows"]]
    return {"environment": stored["environment"], "rows": rows}


def write(name: str, rows: list[dict], *packages: str) -> None:
    """Print the rows as a table and store them with the environment, in which further packages may be named."""
    print(table(rows))
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.json").write_text(serialised(environment(*packages), rows))


def serialised(surroundings: dict[str, str], rows: list[dict]) -> str:
    """Text of a results file."""
    columns = _columns(rows)
    lines = [json.dumps([_rounded(row.get(column)) for column in columns]) for row in rows]
    head = f'{{"environment": {json.dumps(surroundings)},\n"columns": {json.dumps(columns)},\n"rows": [\n'
    return head + ",\n".join(lines) + "\n]}\n"


def _rounded(value):
    """Round floats, also in nested lists."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    return [_rounded(item) for item in value] if isinstance(value, list) else value


def _columns(rows: list[dict]) -> list[str]:
    """Columns of any row, in order of appearance."""
    return list(dict.fromkeys(column for row in rows for column in row))


def cell(value) -> str:
    """Format a table cell: three digits, powers of ten below 1e-3, empty for None."""
    if isinstance(value, float):
        return f"{value:.0e}" if 0 < abs(value) < 1e-3 else f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return "" if value is None else f"{value:,}" if isinstance(value, int) else str(value)


def table(rows: list[dict]) -> str:
    """Format rows as a Markdown table, without columns that are empty in every row."""
    columns = [column for column in _columns(rows) if any(row.get(column) is not None for row in rows)]
    lines = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
    lines += ["| " + " | ".join(cell(row.get(column)) for column in columns) + " |" for row in rows]
    return "\n".join(lines)


def without(row: dict, *columns: str) -> dict:
    """Copy of a row without some columns."""
    return {name: value for name, value in row.items() if name not in columns}
