"""The scans behind figures and claims: each case is scanned once."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from jaxwhisker.path import EventKind
from jaxwhisker.profile import Circle, Parabola
from jaxwhisker.result import Event, Result
from jaxwhisker.scan import scan
from jaxwhisker.scene import Scene
from jaxwhisker.support import Support
from jaxwhisker.whisker import Whisker

STIFFNESSES = (30.0, 50.0, 70.0, 100.0, 200.0, math.inf)
DISTANCES = (0.1, 0.2, 0.3, 0.4)
REST_LENGTHS = (0.1, 0.2, 0.3, 0.4)
RADIUS = 1.0  # of the semicircle
STEP = 0.001
CORES = 2  # structures compiled at the same time
ROUGH = 1e-3  # relative change next to a maximum above which finer steps look for it
SNAPS = (EventKind.snap_through, EventKind.snap_off)
WHISKERS = {"FB": 1, "FBFB": 2, "FBFBR": 2, "FBFBFBR": 3}


@dataclass(frozen=True)
class Case:
    """One scan of the thesis; the defaults are the values that stay while others are varied."""

    model: str = "FB"
    stiffness: float = 70.0
    distance: float = 0.2
    rest_length: float = 0.2
    semicircle: bool = False

    def scene(self) -> Scene:
        """The scene: infinite stiffness makes FB the clamped whisker."""
        profile = Circle(self.distance, RADIUS) if self.semicircle else Parabola(self.distance)
        return Scene(Whisker(), profile, Support.named(self.model, self.stiffness, self.rest_length))

    def control(self) -> np.ndarray:
        """Positions of the drive that hold every scan of this model, whatever is varied.

        One grid per model lets all its scans share a compiled march, and all its curves an axis.
        """
        trailing = WHISKERS[self.model] * max(REST_LENGTHS)
        return STEP * np.arange(round(1.0 / STEP), -round((1.4 + trailing) / STEP) - 1, -1)


def vary(field: str, values: Sequence, base: Case = Case()) -> dict[str, Case]:
    """Label -> case, one field of `base` replaced by each value."""
    return {label(field, value): dataclasses.replace(base, **{field: value}) for value in values}


def label(field: str, value) -> str:
    """How a varied value is named in a legend."""
    symbol = {"stiffness": r"$c$ = ", "distance": r"$q$ = ", "rest_length": r"$\lambda$ = ", "model": ""}[field]
    return symbol + (r"$\infty$" if value == math.inf else value if field == "model" else f"{value:g}")


class Scans:
    """Scans by case, each done once; a context, which gives up what it has not begun when it is left."""

    def __init__(self):
        self._results: dict[Case, Result] = {}
        self._peaks: dict[tuple, tuple[float, float]] = {}
        self._compiling: dict[tuple, Future] = {}
        self._pool = ThreadPoolExecutor(CORES)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._pool.shutdown(cancel_futures=True)

    def compile(self, cases: Iterable[Case]) -> None:
        """Start to compile what these cases need, in their order; scans of the same structure share it."""
        for case in cases:
            if _structure(case) not in self._compiling:
                self._compiling[_structure(case)] = self._pool.submit(scan, case.scene(), case.control())

    def __call__(self, case: Case) -> Result:
        """The result of scanning `case`."""
        if case not in self._results:
            self.compile([case])
            self._compiling[_structure(case)].result()
            self._results[case] = scan(case.scene(), case.control())
        return self._results[case]

    def peak(self, case: Case, quantity: str, whisker: int, sign: float = 1.0) -> tuple[float, float]:
        """Extreme value of a quantity (sign = 1: largest, -1: smallest) and where: (value, control)."""
        key = (case, quantity, whisker, sign)
        if key not in self._peaks:
            self._peaks[key] = _peak(self(case), quantity, whisker, sign)
        return self._peaks[key]


def _structure(case: Case) -> tuple:
    return case.model, case.semicircle


def event(result: Result, kind: str, whisker: int) -> Event | None:
    """The first event of that kind of that whisker."""
    return next(iter(result.events.of(EventKind[kind], whisker)), None)


def lets_go(result: Result, whisker: int) -> Event | None:
    """The event at which a whisker loses contact for good."""
    found = [e for kind in (EventKind.snap_off, EventKind.release) for e in result.events.of(kind, whisker)]
    return min(found, key=lambda e: e.control, default=None)


def snap_through(result: Result) -> Event | None:
    """The first snap, through or off, of a whisker before it has passed the vertex: what lies on its way is skipped."""
    for found in result.events:
        if found.kind in SNAPS:
            moved = np.abs(np.asarray(found.after.base_x) - np.asarray(found.before.base_x))
            if np.asarray(found.before.contact_slope)[np.argmax(moved)] > 0:
                return found
    return None


def _peak(result: Result, quantity: str, whisker: int, sign: float) -> tuple[float, float]:
    """See `Scans.peak`. NaN where the scan failed before its end."""
    column = np.asarray(getattr(result, quantity))[:, whisker - 1]
    control = np.asarray(result.control)
    if not np.isfinite(column).all():
        return math.nan, math.nan
    k = int(np.argmax(sign * column))
    best = float(column[k]), float(control[k])
    # A snap may cut off a maximum between two steps: the states at its ends count too.
    snaps = [e for e in result.events if e.kind in SNAPS]
    for found in snaps:
        for state in (found.before, found.after):
            value = float(np.asarray(getattr(state, quantity))[whisker - 1])
            if sign * value > sign * best[0]:
                best = value, found.control
    if not 0 < k < column.size - 1 or any(control[k + 1] <= e.control <= control[k - 1] for e in snaps):
        return best
    near = control[k - 1 : k + 2], column[k - 1 : k + 2]
    if np.ptp(near[1]) > ROUGH * abs(column[k]):
        fine = np.linspace(control[k - 1], control[k + 1], control.size)  # as many steps: no second compilation
        column = np.asarray(getattr(scan(result.scene, fine), quantity))[:, whisker - 1]
        k = int(np.clip(np.argmax(sign * column), 1, fine.size - 2))
        near = fine[k - 1 : k + 2], column[k - 1 : k + 2]
    value, at = _vertex(*near)
    return (value, at) if sign * value > sign * best[0] else best


def _vertex(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Vertex (y, x) of the parabola through three equidistant points."""
    bend = y[0] - 2 * y[1] + y[2]
    shift = 0.5 * (y[0] - y[2]) / bend if bend else 0.0
    return float(y[1] - 0.25 * (y[0] - y[2]) * shift), float(x[1] + shift * (x[2] - x[1]))
