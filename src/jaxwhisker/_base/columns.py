"""Columns of numbers by name, from text files as spreadsheets, NumPy and laboratory programs write them.

np.genfromtxt and pandas.read_csv must be told about decimal commas and lines of units, and rename columns that occur
twice. Of a column of text, genfromtxt makes NaN; pandas drops names behind a #, as NumPy writes them.
"""

import csv
import gzip
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np

from jaxwhisker._base import checks

MISSING = "", "-", "NA", "N/A", "#N/A", "null", "None"  # cells without a value; NaN is a number
GZIP, UTF_16 = b"\x1f\x8b", (b"\xff\xfe", b"\xfe\xff")  # first bytes of such files
COMMENT = "#"


def read_columns(path: str | Path, *, columns: Mapping[str, str] | None = None, skip: int = 0) -> dict[str, np.ndarray]:
    """Columns of numbers of a text file, by name: for `identify`, `reconstruct` and others, and to look at.

    Columns are separated by commas, semicolons, tabs or spaces, and have decimal points or commas. Their names are in
    the line above the numbers, which may begin with #, and a line of units may follow. Files may be compressed (gzip).
    Empty cells are NaN.

    Args:
        path: of the file.
        columns: names here, such as "control" and "fx", and the names of these columns in the file. Default: all
            columns of numbers, with their names in the file.
        skip: number of lines above the names that are skipped, such as a preamble.

    Returns:
        Arrays of shape (rows,), by name.

    Raises:
        ValueError: if the file does not exist or does not hold columns of equal length below their names, `columns`
            names one that is not there, occurs twice or does not hold numbers, or `skip` is not a number of lines.

    Examples:
        >>> import pathlib, tempfile
        >>> path = pathlib.Path(tempfile.mkdtemp(), "sweep.txt")
        >>> _ = path.write_text("drive; Fx in N; Mz\\nmm; N; N mm\\n0,1; 0,25; 1\\n0,2; 0,5; 2\\n")
        >>> jw.read_columns(path, columns={"control": "drive", "fx": "Fx in N"})
        {'control': array([0.1, 0.2]), 'fx': array([0.25, 0.5 ])}
    """
    checks.count("skip", skip, least=0)
    if columns is None:
        table = cells_of("path", path, skip=skip)
        found = {name: _floats_or_none(cells) for name, cells in table.items()}
        return {name: values for name, values in found.items() if values is not None}
    checks.instance("columns", columns, Mapping, "a mapping from names to names of columns of the file")
    table = cells_of("path", path, set(columns.values()).__contains__, skip=skip)
    lacking = [name for name in columns.values() if name not in table]
    if lacking:
        checks.fail("columns", f"among the columns of the file, {', '.join(table)}", ", ".join(map(str, lacking)))
    return {name: floats("path", path, own, table[own]) for name, own in columns.items()}


def cells_of(
    argument: str, path: str | Path, wanted: Callable[[str], bool] = bool, *, skip: int = 0
) -> dict[str, tuple[str, ...]]:
    """The columns of a file as text; one that is wanted must not occur twice.

    Raises:
        ValueError: if the file cannot be read like this; it names the argument.
    """
    path = Path(path)
    if not path.is_file():
        why = "is a directory" if path.is_dir() else "does not exist"
        raise ValueError(f"`{argument}` must be the path of a CSV file, got {path}, which {why}.")
    lines = [line for line in re.split(r"\r\n?|\n", _text_of(path))[skip:] if line.strip()]
    body = [line for line in lines if line[0] != COMMENT]
    above = lines.index(body[0]) if body else 0
    separator = max(",;\t", key=body[0].count) if body else ","
    if body and separator not in body[0]:
        body, separator = [re.sub(r"\s+", "\t", line.strip()) for line in body], "\t"

    def split(some: Iterable[str]) -> list[list[str]]:
        return [[cell.strip() for cell in row] for row in csv.reader(some, delimiter=separator, skipinitialspace=True)]

    names, *rows = split(body) or [[]]
    if all(map(_is_number, names)) and above and lines[above - 1][0] == COMMENT:  # as np.savetxt writes names
        header = lines[above - 1].lstrip(COMMENT).strip()
        header = header if separator in header else re.sub(r"\s+", "\t", header).replace("\t", separator)
        names, rows = split([header])[0], [names, *rows]
    units = bool(rows) and any(cell not in MISSING for cell in rows[0]) and not any(map(_is_number, rows[0]))
    if len(rows) > 1 and units:
        rows = rows[1:]
    # A last column of comments may be missing in some rows.
    rows = [row + [""] * (0 if any(map(wanted, names[len(row) :])) else len(names) - len(row)) for row in rows]
    if not rows or any(len(row) != len(names) for row in rows):
        raise ValueError(f"`{argument}` must be columns of equal length below a line of names, got {path}.")
    twice = sorted({name for name in names if names.count(name) > 1 and wanted(name)})
    if twice:
        raise ValueError(f"`{argument}` must hold each column once, got several of {', '.join(twice)} in {path}.")
    return dict(zip(names, zip(*rows, strict=True), strict=True))


def floats(argument: str, path: str | Path, name: str, cells: Iterable[str]) -> np.ndarray:
    """The numbers in a column; NaN where there is none."""
    try:
        return np.array([_number_in(cell) for cell in cells])
    except ValueError as error:
        raise ValueError(
            f"`{argument}` must be columns of numbers below a line of names, got {path}: {error} ({name})."
        ) from None


def _floats_or_none(cells: Iterable[str]) -> np.ndarray | None:
    try:
        return np.array([_number_in(cell) for cell in cells])
    except ValueError:
        return None


def _is_number(cell: str) -> bool:
    return cell not in MISSING and _floats_or_none([cell]) is not None


def _number_in(cell: str) -> float:
    """The number in a cell, with a decimal point or comma; NaN if there is none."""
    cell = cell.strip()
    return np.nan if cell in MISSING else float(cell.replace(",", "."))


def _text_of(path: Path) -> str:
    content = path.read_bytes()
    content = gzip.decompress(content) if content.startswith(GZIP) else content
    try:
        return content.decode("utf-16" if content[:2] in UTF_16 else "utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")  # every byte is a character
