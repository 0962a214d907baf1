"""The scans behind figures and claims: one study for each structure, of all cases that are asked for."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
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


@dataclass(frozen=True)
class Case:
    """One scan of the thesis; the defaults are the values that stay while others are varied."""

    model: str = "FB"
    stiffness: float = 70.0
    distance: float = 0.2
    rest_length: float = 0.2
    semicircle: bool = False

    @property
    def numbers(self) -> dict[str, float]:
        """What differs between the cases of a study."""
        return {"stiffness": self.stiffness, "distance": self.distance, "rest_length": self.rest_length}

    def control(self) -> np.ndarray:
        """Positions of the drive that hold every scan of this model, whatever is varied."""
        trailing = WHISKERS[self.model] * max(REST_LENGTHS)
        return STEP * np.arange(round(1.0 / STEP), -round((1.4 + trailing) / STEP) - 1, -1)


def build(*, model: str, semicircle: bool, stiffness, distance, rest_length) -> Scene:
    """The scene of a case: infinite stiffness makes FB the clamped whisker."""
    profile = Circle(distance, RADIUS) if semicircle else Parabola(distance)
    return Scene(Whisker(), profile, Support.named(model, stiffness, rest_length))


def vary(field: str, values: Sequence, base: Case = Case()) -> dict[str, Case]:
    """Label -> case, one field of `base` replaced by each value."""
    return {label(field, value): dataclasses.replace(base, **{field: value}) for value in values}


def label(field: str, value) -> str:
    """How a varied value is named in a legend."""
    symbol = {"stiffness": r"$c$ = ", "distance": r"$q$ = ", "rest_length": r"$\lambda$ = ", "model": ""}[field]
    return symbol + (r"$\infty$" if value == math.inf else value if field == "model" else f"{value:g}")


class Scans:
    """Scans by case, from studies that run in the background; a context, which gives up those not begun when left."""

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
        """What the study holds of a case, with its summary."""
        key = _structure(case)
        return self._studies[key].result().isel(point=self._cases[key].index(case))

    def __call__(self, case: Case) -> Result:
        """The scan of a case."""
        return _result(self.data(case), build(model=case.model, semicircle=case.semicircle, **case.numbers))

    def summary(self, case: Case, name: str, whisker: int) -> float:
        """A variable of the summary of a case: `max_mz`, `control_of_max_mz`, `last_contact`, ..."""
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
    """The result of `scan` from one point of a study that holds all outputs."""

    def of(names: Iterable[str], prefix: str = "") -> dict:
        return {name: jnp.asarray(data[prefix + name].values) for name in names}

    before, after = (State(**of(State.__dataclass_fields__, side)) for side in ("before_", "after_"))
    whiskers = jnp.asarray(data.event_whisker.values)
    told = of(("kind", "control", "count"), "event_")
    travel = jnp.abs(told["control"] - jnp.asarray(data.control.values)[0])
    events = Events(**told, travel=travel, whiskers=whiskers, before=before, after=after)
    signals = of([*State.__dataclass_fields__, "control", "spring_length", "status"])
    return Result(**signals, events=events, scene=scene)


def event(result: Result, kind: str, whisker: int) -> Event | None:
    """The first event of that kind of that whisker."""
    return next(iter(result.events.of(EventKind[kind], whisker)), None)


def snap_through(result: Result) -> Event | None:
    """The first snap, through or off, of a whisker before it has passed the vertex: what lies on its way is skipped."""
    for found in result.events:
        if found.kind in SNAPS:
            moved = np.abs(np.asarray(found.after.base_x) - np.asarray(found.before.base_x))
            if np.asarray(found.before.contact_slope)[np.argmax(moved)] > 0:
                return found
    return None
