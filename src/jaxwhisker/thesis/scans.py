"""The scans behind figures and claims: one study per kind of scene, with all cases that a figure or a claim needs."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from jaxwhisker._model.profiles import Circle, Parabola
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.result import Event, Events, Result
from jaxwhisker._scan.state import State
from jaxwhisker._study.critical import Steepest, softest, steepest
from jaxwhisker._study.study import study
from jaxwhisker._study.summary import summary

if TYPE_CHECKING:
    import xarray as xr

STIFFNESSES = (30.0, 50.0, 70.0, 100.0, 200.0, math.inf)
DISTANCES = (0.1, 0.2, 0.3, 0.4)
REST_LENGTHS = (0.1, 0.2, 0.3, 0.4)
RADIUS = 1.0  # of the semicircle
STEP = 0.001
CORES = 2  # studies computed at the same time
SNAPS = (EventKind.snap_through, EventKind.snap_off)
WHISKERS = {"FB": 1, "FBFB": 2, "FBFBR": 2, "FBFBFBR": 3}
BRACKET = 5e-3  # relative width of the bracket around a critical stiffness
# Range of the critical stiffness of coupled whiskers, relative to its value if the other forces were constant.
SEARCHED = 1.0, 1.25


@dataclass(frozen=True)
class Case:
    """One scan of the thesis. The defaults are the base values, which are kept while another parameter is varied."""

    model: str = "FB"
    stiffness: float = 70.0
    distance: float = 0.2
    rest_length: float = 0.2
    semicircle: bool = False

    @property
    def numbers(self) -> dict[str, float]:
        """Parameters that may differ between the cases of a study."""
        return {"stiffness": self.stiffness, "distance": self.distance, "rest_length": self.rest_length}

    def control(self) -> np.ndarray:
        """Drive positions that cover every scan of this model, for all parameters."""
        trailing = WHISKERS[self.model] * max(REST_LENGTHS)
        return STEP * np.arange(round(1.0 / STEP), -round((1.4 + trailing) / STEP) - 1, -1)


def build(*, model: str, semicircle: bool, stiffness, distance, rest_length) -> Scene:
    """Build the scene of a case; infinite stiffness turns FB into the clamped whisker."""
    profile = Circle(distance, RADIUS) if semicircle else Parabola(distance)
    return Scene(Whisker(), profile, Support.named(model, stiffness, rest_length))


def vary(field: str, values: Sequence, base: Case = Case()) -> dict[str, Case]:
    """Cases with one field of `base` replaced by each value, by label."""
    return {label(field, value): dataclasses.replace(base, **{field: value}) for value in values}


def label(field: str, value) -> str:
    """Label of a varied value in a legend."""
    symbol = {"stiffness": r"$c$ = ", "distance": r"$q$ = ", "rest_length": r"$\lambda$ = ", "model": ""}[field]
    return symbol + (r"$\infty$" if value == math.inf else value if field == "model" else f"{value:g}")


class Scans:
    """Scans by case, from studies that run in the background.

    At the end of a `with` block, studies that have not started are cancelled.
    """

    def __init__(self, cases: Iterable[Case]):
        self._pool = ThreadPoolExecutor(CORES)
        self._cases: dict[tuple, list[Case]] = {}
        for case in dict.fromkeys(cases):
            self._cases.setdefault(_structure(case), []).append(case)
        self._studies = {key: self._pool.submit(_study, cases) for key, cases in self._cases.items()}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._pool.shutdown(cancel_futures=True)

    def data(self, case: Case) -> "xr.Dataset":
        """The point of a study that belongs to a case, with its summary."""
        key = _structure(case)
        return self._studies[key].result().isel(point=self._cases[key].index(case))

    def __call__(self, case: Case) -> Result:
        """The scan of a case."""
        return _result(self.data(case), build(model=case.model, semicircle=case.semicircle, **case.numbers))

    def summary(self, case: Case, name: str, whisker: int) -> float:
        """A variable of the summary of a case, such as `max_mz`, `control_of_max_mz` or `last_contact`."""
        return float(self.data(case)[name].sel(whisker=whisker))


def _structure(case: Case) -> tuple[str, bool]:
    return case.model, case.semicircle


def _study(cases: list[Case]) -> "xr.Dataset":
    first = cases[0]
    points = {name: [case.numbers[name] for case in cases] for name in first.numbers}
    of_structure = partial(build, model=first.model, semicircle=first.semicircle)
    data = study(of_structure, points=points, control=first.control(), outputs="all", progress=False)
    return data.merge(summary(data))


def _result(data: "xr.Dataset", scene: Scene) -> Result:
    """Convert one point of a study with all outputs into the result of `scan`."""

    def arrays(names: Iterable[str], prefix: str = "") -> dict:
        return {name: jnp.asarray(data[prefix + name].values) for name in names}

    before, after = (State(**arrays(State.__dataclass_fields__, side)) for side in ("before_", "after_"))
    whiskers = jnp.asarray(data.event_whisker.values)
    fields = arrays(("kind", "control", "count"), "event_")
    travel = jnp.abs(fields["control"] - jnp.asarray(data.control.values)[0])
    events = Events(**fields, travel=travel, whiskers=whiskers, before=before, after=after)
    signals = arrays([*State.__dataclass_fields__, "control", "spring_length", "status"])
    return Result(**signals, events=events, scene=scene)


def first_event(result: Result, kind: str, whisker: int) -> Event | None:
    """The first event of this kind and whisker; None if there is none."""
    return next(iter(result.events.of(EventKind[kind], whisker)), None)


def snap_through(result: Result) -> Event | None:
    """The first snap in which a whisker has not passed the vertex yet, which skips part of the signal; else None."""
    for event in result.events:
        if event.kind in SNAPS:
            moved = np.abs(np.asarray(event.after.base_x) - np.asarray(event.before.base_x))
            if np.asarray(event.before.contact_slope)[np.argmax(moved)] > 0:
                return event
    return None


@lru_cache
def steepest_slope(distance: float) -> Steepest:
    """The steepest slope of the clamped whisker's force, which is the critical stiffness of FB."""
    return steepest(Whisker(), Parabola(distance))


def critical_cases(model: str, distance: float) -> list[Case]:
    """Cases of rising stiffness on both sides of the critical stiffness.

    If the forces on the other whiskers were constant, the critical stiffness would be the steepest slope times
    `softest` of the support with unit stiffness.
    """
    guess = steepest_slope(distance).slope * softest(Support.named(model, 1.0))
    low, high = (1 - BRACKET / 2, 1 + BRACKET / 2) if WHISKERS[model] == 1 else SEARCHED
    stiffness = guess * np.geomspace(low, high, round(math.log(high / low) / BRACKET) + 1)
    return list(vary("stiffness", stiffness.tolist(), Case(model, distance=distance)).values())


def critical_bracket(scans: Scans, cases: list[Case]) -> tuple[float, float]:
    """The largest stiffness at which a whisker snaps through the vertex, and the next stiffness of the cases.

    The first one is NaN if no case snaps through, and the second one if the stiffest case does.
    """
    snaps = [snap_through(scans(case)) is not None for case in cases]
    last = max((k for k, snap in enumerate(snaps) if snap), default=-1)
    ends = [cases[k].stiffness if 0 <= k < len(cases) else math.nan for k in (last, last + 1)]
    return ends[0], ends[1]
