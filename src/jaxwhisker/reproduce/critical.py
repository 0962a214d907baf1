"""The critical stiffness of coupled whiskers, bracketed by scans: it depends on where the other whiskers stand."""

import dataclasses

import numpy as np

from jaxwhisker.critical import softest
from jaxwhisker.path import Status
from jaxwhisker.reproduce.scans import WHISKERS, Case, snap_through
from jaxwhisker.scan import scan
from jaxwhisker.support import Support

RELATIVE = 5e-3  # width of the bracket around a critical stiffness, relative to it
GROWTH = 1.1  # from one trial of a bracket's ends to the next


def critical(model: str, distance: float, slope: float) -> tuple[float, float]:
    """A bracket of the stiffness of all springs below which a whisker of `model` snaps through the vertex.

    `slope` is the steepest one of the clamped whisker; were the other whiskers' forces constant, its product with
    `softest` would be the answer.
    """

    def snaps(stiffness: float) -> bool:
        case = dataclasses.replace(Case(model, distance=distance), stiffness=stiffness)
        result = scan(case.scene(), case.control())
        # A scan that gets lost among snaps is no scan past the vertex either.
        return snap_through(result) is not None or bool(np.any(np.asarray(result.status) != Status.ok))

    guess = slope * softest(Support.named(model, 1.0))
    if WHISKERS[model] == 1:
        low, high = guess * (1 - RELATIVE / 2), guess * (1 + RELATIVE / 2)
    else:
        low = high = guess
    while not snaps(low):
        low, high = low / GROWTH, low
    while snaps(high):
        low, high = high, high * GROWTH
    while high - low > RELATIVE * high:
        middle = (low + high) / 2
        low, high = (middle, high) if snaps(middle) else (low, middle)
    return low, high
