"""A claim of the thesis, and the words that all of them use."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.report import number
from jaxwhisker._scan.result import Result
from jaxwhisker.thesis import page
from jaxwhisker.thesis.scans import WHISKERS, Case, Scans, vary

MAXIMA = ("min_fx", "max_fy", "max_mz")
MAXIMA_NAMES = tuple(name.replace("_", " ") for name in MAXIMA)
CLAMPED = Case(stiffness=math.inf)
MODELS = ("FB", "FBFB", "FBFBR")
SAME = 1e-6  # relative: maxima closer than this are called unchanged; they are read from steps of the drive


@dataclass(frozen=True)
class Claim:
    """What the thesis says, what was found, why, and the numbers."""

    says: str
    verdict: str
    why: str
    rows: Sequence[Sequence[str]]

    def page(self, at: int) -> list[page.Block]:
        """The claim as part of a page."""
        return [
            page.Heading(3, f"{at}. {self.says}"),
            page.Paragraph(" ".join(self.verdict.split()), strong="Found:"),
            page.Paragraph(" ".join(self.why.split())),
            page.Table(self.rows),
        ]


def shown(value: float) -> str:
    """The value of what is varied."""
    return "inf" if value == math.inf else f"{value:g}"


def cell(value: float, digits: int = 4) -> str:
    """A number as a cell of a table."""
    return "-" if math.isnan(value) else number(value, digits)


def varied(field: str, values: Sequence[float]) -> dict[str, list[Case]]:
    """Cases of every model with one field varied."""
    return {model: list(vary(field, values, Case(model)).values()) for model in MODELS}


def whiskers(model: str) -> range:
    """Numbers of the whiskers of a model."""
    return range(1, WHISKERS[model] + 1)


def maxima(scans: Scans, case: Case, whisker: int) -> list[float]:
    """Smallest fx, largest fy and mz."""
    return [scans.summary(case, name, whisker) for name in MAXIMA]


def from_clamped(scans: Scans, values: Sequence[float]) -> float:
    """Largest relative deviation of such maxima from those of the clamped whisker."""
    return max(abs(v / wanted - 1) for v, wanted in zip(values, maxima(scans, CLAMPED, 1), strict=True))


def monotone(values: Sequence[float] | np.ndarray, sign: float) -> bool:
    """Whether values grow (sign = 1) or fall (-1) throughout."""
    return bool(np.all(sign * np.diff(values) > 0))


def measured(
    families: Mapping[str, Sequence[Case]], field: str, measure: Callable[[Case, int], Sequence[float]]
) -> tuple[list[list[str]], list[tuple[str, np.ndarray]]]:
    """What `measure` finds in cases that differ in a field, by whisker: rows of a table; names and (cases, numbers)."""
    rows, found = [], []
    for name, family in families.items():
        for whisker in whiskers(family[0].model):
            numbers = np.array([measure(case, whisker) for case in family])
            rows += [
                [name, shown(getattr(c, field)), str(whisker), *map(cell, n)]
                for c, n in zip(family, numbers, strict=True)
            ]
            found.append((name, numbers))
    return rows, found


def jump(result: Result, whisker: int, other: int) -> tuple[float, float]:
    """fy of another whisker before and after one loses contact for good; NaN if there is none, or no such event."""
    gone = [e for kind in (EventKind.snap_off, EventKind.release) for e in result.events.of(kind, whisker)]
    if not gone or other > result.scene.support.whiskers:
        return math.nan, math.nan
    last = min(gone, key=lambda e: e.control)
    return float(last.before.fy[other - 1]), float(last.after.fy[other - 1])
