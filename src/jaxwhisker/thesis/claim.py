"""A claim of the thesis, and the quantities that claims compare."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.report import fixed
from jaxwhisker._scan.result import Result
from jaxwhisker.thesis.scans import WHISKERS, Case, Scans, vary

MAXIMA = ("min_fx", "max_fy", "max_mz")
MAXIMA_NAMES = tuple(name.replace("_", " ") for name in MAXIMA)
CLAMPED = Case(stiffness=math.inf)
MODELS = ("FB", "FBFB", "FBFBR")
SAME = 1e-6  # relative difference below which maxima count as unchanged


@dataclass(frozen=True)
class Claim:
    """A statement of the thesis and what the scans show."""

    statement: str
    figures: str  # figures that show it; empty if the thesis does not make the statement
    holds: str  # "yes", "in part", "no", or "new" for what the thesis does not state
    result: str
    explanation: str
    rows: Sequence[Sequence[str]]

    def in_short(self) -> str:
        """The first sentence of the result, for a table whose other column says whether the claim holds."""
        first = " ".join(self.result.split()).split(". ")[0].rstrip(".")
        return first.removeprefix("The claim holds").lstrip(": ")


def verdict(holds: bool) -> str:
    """The beginning of a result."""
    return "The claim holds" if holds else "The claim does not hold"


def varied_value(value: float) -> str:
    """The value of a varied parameter in a table."""
    return "inf" if value == math.inf else f"{value:g}"


def cell(value: float, digits: int = 4) -> str:
    """A number in a table."""
    return "-" if math.isnan(value) else fixed(value, digits)


def varied(field: str, values: Sequence[float]) -> dict[str, list[Case]]:
    """Cases of every model with one field varied."""
    return {model: list(vary(field, values, Case(model)).values()) for model in MODELS}


def whiskers(model: str) -> range:
    """Numbers of the whiskers of a model."""
    return range(1, WHISKERS[model] + 1)


def maxima(scans: Scans, case: Case, whisker: int) -> list[float]:
    """Smallest fx, largest fy and largest mz."""
    return [scans.summary(case, name, whisker) for name in MAXIMA]


def deviation_from_clamped(scans: Scans, values: Sequence[float]) -> float:
    """Largest relative deviation of `values`, in the order of MAXIMA, from the maxima of the clamped whisker."""
    expected = maxima(scans, CLAMPED, 1)
    return max(abs(value / reference - 1) for value, reference in zip(values, expected, strict=True))


def monotone(values: Sequence[float] | np.ndarray, sign: float) -> bool:
    """Whether all differences between neighbours are positive (sign = 1) or negative (-1)."""
    return bool(np.all(sign * np.diff(values) > 0))


def measure_all(
    families: Mapping[str, Sequence[Case]], field: str, measure: Callable[[Case, int], Sequence[float]]
) -> tuple[list[list[str]], list[tuple[str, np.ndarray]]]:
    """Apply `measure` to every whisker of cases that differ in one field.

    Returns:
        The rows of a table; and for every whisker the name of its family and an array (cases, numbers).
    """
    rows, measured = [], []
    for name, family in families.items():
        for whisker in whiskers(family[0].model):
            numbers = np.array([measure(case, whisker) for case in family])
            rows += [
                [name, varied_value(getattr(case, field)), str(whisker), *map(cell, values)]
                for case, values in zip(family, numbers, strict=True)
            ]
            measured.append((name, numbers))
    return rows, measured


def jump(result: Result, whisker: int, other: int) -> tuple[float, float]:
    """fy of whisker `other` before and after the last detachment of `whisker`; NaN if either is missing."""
    detached = [e for kind in (EventKind.snap_off, EventKind.release) for e in result.events.of(kind, whisker)]
    if not detached or other > result.scene.support.whiskers:
        return math.nan, math.nan
    last = min(detached, key=lambda e: e.control)
    return float(last.before.fy[other - 1]), float(last.after.fy[other - 1])
