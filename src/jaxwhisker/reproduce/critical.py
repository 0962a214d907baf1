"""The critical stiffness: below it a scan snaps through the vertex and skips the maximum.

A base on a spring is stable while the spring is stiffer than the object's force is steep, c > dF_x/dx0 of the clamped
whisker, F_x being the force on the whisker. The steepest slope near the vertex is therefore the critical stiffness of
one whisker. (Towards the snap-off the slope grows without bound: there every spring gives way, and none skips a
maximum.) The critical stiffness of coupled whiskers depends on where the others stand; scans bracket it.
"""

import dataclasses
import math

import numpy as np

from jaxwhisker.contact import Phase
from jaxwhisker.path import Status
from jaxwhisker.reproduce.scans import WHISKERS, Case, Scans, snap_through
from jaxwhisker.scan import scan
from jaxwhisker.support import Support

RELATIVE = 5e-3  # width of the bracket around a critical stiffness, relative to it
GROWTH = 1.1  # from one trial of a bracket's ends to the next
WINDOW = 0.02  # on both sides of the steepest point, scanned again with FINE steps
FINE = 2e-5


def steepest(scans: Scans, distance: float) -> tuple[float, float]:
    """Largest dF_x/dx0 of the clamped whisker in tangential contact, and the x0 where it is."""
    case = Case(stiffness=math.inf, distance=distance)
    x, slope = _slope(scans(case))
    at = x[np.nanargmax(slope)] - case.rest_length
    # As many steps as all scans of the model have: the compiled one serves again.
    control = np.maximum(at + WINDOW - FINE * np.arange(case.control().size), at - WINDOW)
    x, slope = _slope(scan(case.scene(), control))
    k = int(np.nanargmax(slope))
    return float(slope[k]), float(x[k])


def _slope(result) -> tuple[np.ndarray, np.ndarray]:
    moving = np.flatnonzero(np.diff(np.asarray(result.control), prepend=np.inf))
    x, force = np.asarray(result.base_x)[moving, 0], -np.asarray(result.fx)[moving, 0]
    tangential = np.asarray(result.phase)[moving, 0] == Phase.tangential
    inside = tangential & np.roll(tangential, 1) & np.roll(tangential, -1)
    return x, np.where(inside, np.gradient(force, x), np.nan)


def softest(model: str) -> float:
    """How far the softest base of a model yields to a force there, relative to a single spring: max C_ii c."""
    flexibility = Support.named(model, 1.0).flexibility()
    return 1.0 if flexibility is None else float(np.max(np.diag(np.asarray(flexibility.matrix))))


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

    guess = slope * softest(model)
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
