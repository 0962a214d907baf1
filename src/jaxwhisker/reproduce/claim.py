"""A claim of the thesis, and the words that all of them use."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxwhisker.report import number
from jaxwhisker.reproduce import page
from jaxwhisker.reproduce.scans import WHISKERS, Case, Scans

MAXIMA = (("fx", -1.0, "min fx"), ("fy", 1.0, "max fy"), ("mz", 1.0, "max mz"))
MAXIMA_NAMES = tuple(name for _, _, name in MAXIMA)
CLAMPED = Case(stiffness=math.inf)
MODELS = ("FB", "FBFB", "FBFBR")
SAME = 1e-5  # relative: maxima closer than this are called unchanged; they are read from steps of the drive


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


def shown(case: Case, field: str) -> str:
    """The value of a field of a case."""
    value = getattr(case, field)
    return value if isinstance(value, str) else "inf" if value == math.inf else f"{value:g}"


def cell(value: float, digits: int = 4) -> str:
    """A number as a cell of a table."""
    return "-" if math.isnan(value) else number(value, digits)


def control_of(event) -> float:
    """Where an event is; NaN for none."""
    return math.nan if event is None else event.control


def cases(model: str, field: str, values: Sequence[float]) -> list[Case]:
    """Cases of a model with one field varied."""
    return [Case(**{"model": model, field: value}) for value in values]


def whiskers(model: str) -> range:
    """Numbers of the whiskers of a model."""
    return range(1, WHISKERS[model] + 1)


def maxima(scans: Scans, case: Case, whisker: int) -> list[float]:
    """Smallest fx, largest fy and mz."""
    return [scans.peak(case, quantity, whisker, sign)[0] for quantity, sign, _ in MAXIMA]


def from_clamped(scans: Scans, values: Sequence[float]) -> float:
    """Largest relative deviation of such maxima from those of the clamped whisker."""
    return max(abs(v / wanted - 1) for v, wanted in zip(values, maxima(scans, CLAMPED, 1), strict=True))


def monotone(values: Sequence[float], sign: float) -> bool:
    """Whether values grow (sign = 1) or fall (-1) throughout."""
    return bool(np.all(sign * np.diff(values) > 0))


def jump(event, whisker: int) -> tuple[float, float]:
    """fy of a whisker before and after an event; NaN for none."""
    if event is None:
        return math.nan, math.nan
    before, after = (float(np.asarray(state.fy)[whisker - 1]) for state in (event.before, event.after))
    return before, after
