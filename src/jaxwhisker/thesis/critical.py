"""The critical stiffness of coupled whiskers, bracketed by scans: it depends on where the other whiskers stand."""

import math
from functools import lru_cache

import numpy as np

from jaxwhisker._model.profiles import Parabola
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._study.critical import Steepest, softest, steepest
from jaxwhisker.thesis.scans import WHISKERS, Case, Scans, snap_through, vary

RELATIVE = 5e-3  # width of the bracket around a critical stiffness, relative to it
RANGE = 1.0, 1.25  # of a critical stiffness to what it were if the other whiskers' forces were constant


@lru_cache
def slope(distance: float) -> Steepest:
    """The steepest slope of the clamped whisker: the critical stiffness of FB."""
    return steepest(Whisker(), Parabola(distance))


def trials(model: str, distance: float) -> list[Case]:
    """Cases of rising stiffness, among which is the critical one.

    Were the other whiskers' forces constant, it would be the steepest slope times `softest`.
    """
    guess = slope(distance).slope * softest(Support.named(model, 1.0))
    low, high = (1 - RELATIVE / 2, 1 + RELATIVE / 2) if WHISKERS[model] == 1 else RANGE
    stiffness = guess * np.geomspace(low, high, round(math.log(high / low) / RELATIVE) + 1)
    return list(vary("stiffness", stiffness.tolist(), Case(model, distance=distance)).values())


def bracket(scans: Scans, cases: list[Case]) -> tuple[float, float]:
    """The stiffness of the stiffest springs with which a whisker snaps through the vertex, and the next one.

    NaN if all of them do, or none.
    """
    snaps = [snap_through(scans(case)) is not None for case in cases]
    last = max((k for k, snap in enumerate(snaps) if snap), default=-1)
    ends = [cases[k].stiffness if 0 <= k < len(cases) else math.nan for k in (last, last + 1)]
    return ends[0], ends[1]
