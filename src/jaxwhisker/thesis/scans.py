"""The scans behind figures and claims: one study per kind of scene, with all cases that a figure or a claim needs."""

import dataclasses
import math
import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from jaxwhisker._base.aside import Compilers, interruptible
from jaxwhisker._model.conic import Circle, Parabola
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import SNAPS, EventKind
from jaxwhisker._scan.result import Event, Events, Result
from jaxwhisker._scan.scan import prepare_scan
from jaxwhisker._scan.state import OPTIONAL, State
from jaxwhisker._study.critical import softest, steepest
from jaxwhisker._study.study import study
from jaxwhisker._study.summary import summary

if TYPE_CHECKING:
    import xarray as xr

# Values of the parameters that are varied, and their symbols.
VALUES = {
    "stiffness": (30.0, 50.0, 70.0, 100.0, 200.0, math.inf),
    "distance": (0.1, 0.2, 0.3, 0.4),
    "rest_length": (0.1, 0.2, 0.3, 0.4),
}
SYMBOLS = {"stiffness": r"$c$ = ", "distance": r"$q$ = ", "rest_length": r"$\lambda$ = "}
STUDIES = 8  # at the same time; most of them wait for their programs
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
    brief: bool = False  # scanned at the two ends only, because nothing but the events is needed

    @property
    def structure(self) -> tuple[str, bool, bool]:
        """What the cases of a study have in common."""
        return self.model, self.semicircle, self.brief

    @property
    def scene(self) -> Scene:
        """The scene that is scanned."""
        return build(self.model, self.semicircle, **{name: getattr(self, name) for name in VALUES})

    @property
    def whiskers(self) -> range:
        """Numbers of the whiskers."""
        return range(1, WHISKERS[self.model] + 1)

    def control(self) -> np.ndarray:
        """Drive positions that cover every scan of this model, for all parameters."""
        trailing = WHISKERS[self.model] * max(VALUES["rest_length"])
        control = 0.001 * np.arange(1000, -round(1000 * (1.4 + trailing)) - 1, -1)
        return control[[0, -1]] if self.brief else control


def build(model: str, semicircle: bool, stiffness, distance, rest_length) -> Scene:
    """Build the scene of a case; infinite stiffness turns FB into the clamped whisker."""
    profile = Circle(distance, radius=1.0) if semicircle else Parabola(distance)
    return Scene(Whisker(), profile, Support.named(model, stiffness, rest_length))


def vary(field: str, base: Case = Case(), values: Sequence[float] | None = None) -> dict[str, Case]:
    """Cases with one field of `base` replaced by each value, by label; by default by those of `VALUES`."""
    values = VALUES[field] if values is None else values
    labels = [SYMBOLS[field] + (r"$\infty$" if value == math.inf else f"{value:g}") for value in values]
    return {name: dataclasses.replace(base, **{field: v}) for name, v in zip(labels, values, strict=True)}


class Scans:
    """Scans by case, from studies that run in the background as soon as they are started or needed.

    All programs are traced one after the other, and compiled in one thread per processor while others are traced and
    the first studies run. At the end of a `with` block, studies that have not started are cancelled.

    Args:
        *groups: cases; those of a group are chosen, in the background, after the studies of the previous ones have
            begun. No study has cases of two groups.
    """

    def __init__(self, *groups: Iterable[Case]):
        self._groups = groups
        self._pool, self._compilers = ThreadPoolExecutor(STUDIES), Compilers()
        self._tracing = threading.Lock()
        self._begun: list[Future] = []
        self._cases: dict[tuple, list[Case]] = {}
        self._studies: dict[tuple, Future] = {}

    def start(self) -> None:
        """Begin the studies, unless they have begun."""
        if not self._begun and self._groups:
            self._begun.append(self._pool.submit(self._begin, *self._groups))

    def _begin(self, group: Iterable[Case], *later: Iterable[Case]) -> None:
        cases: dict[tuple, list[Case]] = {}
        for case in dict.fromkeys(group):
            cases.setdefault(case.structure, []).append(case)
        self._cases |= cases
        for structure, some in cases.items():
            self._studies[structure] = self._pool.submit(self._study, some)
        if later:
            self._begun.append(self._pool.submit(self._begin, *later))

    def _study(self, cases: list[Case]) -> "xr.Dataset":
        with self._tracing:
            prepare_scan(self._compilers, cases[0].scene, cases[0].control())
        of_structure = partial(build, *cases[0].structure[:2])
        points = {name: [getattr(case, name) for case in cases] for name in VALUES}
        data = study(of_structure, points=points, control=cases[0].control(), outputs="all", progress=False)
        return data if cases[0].brief else data.merge(summary(data))

    def __enter__(self):
        return self

    def __exit__(self, kind, *rest):
        self._pool.shutdown(wait=kind is None, cancel_futures=True)
        self._compilers.__exit__(kind, *rest)

    def _data(self, case: Case) -> "xr.Dataset":
        """The point of a study that belongs to a case, with its summary."""
        self.start()
        with interruptible():
            for begun in self._begun:
                begun.result()
                if case.structure in self._studies:
                    break
            data = self._studies[case.structure].result()
        return data.isel(point=self._cases[case.structure].index(case))

    def __call__(self, case: Case) -> Result:
        """The scan of a case."""
        data = self._data(case)
        signals = _arrays(data, [*STATE, "control", "spring_length", "status"])
        return Result(**signals, deferred_events=_events(data), scene=case.scene)

    def events(self, case: Case) -> Events:
        """The events of the scan of a case."""
        return _events(self._data(case))

    def summary(self, case: Case, whisker: int, *names: str) -> list[float]:
        """Variables of the summary of a case, such as `max_mz`, `control_of_max_mz` or `last_contact`."""
        data = self._data(case).sel(whisker=whisker)
        return [float(data[name]) for name in names]


STATE = [name for name in State.__dataclass_fields__ if name not in OPTIONAL]


def _arrays(data: "xr.Dataset", names: Iterable[str], prefix: str = "") -> dict[str, Any]:
    return jax.device_put({name: data.variables[prefix + name].values for name in names})


def _events(data: "xr.Dataset") -> Events:
    before, after = (State(**_arrays(data, STATE, side)) for side in ("before_", "after_"))
    fields = _arrays(data, ("kind", "control", "count"), "event_")
    travel = jax.device_put(np.abs(data.variables["event_control"].values - data.variables["control"].values[0]))
    whiskers = jax.device_put(data.variables["event_whisker"].values)
    return Events(**fields, whiskers=whiskers, travel=travel, before=before, after=after)


def first_event(result: Result, kind: str, whisker: int) -> Event | None:
    """The first event of this kind and whisker; None if there is none."""
    return next(iter(result.events.of(EventKind[kind], whisker)), None)


def snap_through(events: Events) -> Event | None:
    """The first snap in which a whisker has not passed the vertex yet, which skips part of the signal; else None."""
    for event in events:
        if event.kind in SNAPS:
            moved = np.abs(np.asarray(event.after.base_x) - np.asarray(event.before.base_x))
            if np.asarray(event.before.contact_slope)[np.argmax(moved)] > 0:
                return event
    return None


class SteepestSlope(NamedTuple):
    """The steepest slope dF_x/dx0 of the clamped whisker, and the position x0 of its base there."""

    slope: float
    base_x: float


@lru_cache
def steepest_slope(distance: float) -> SteepestSlope:
    """The steepest slope of the clamped whisker's force, which is the critical stiffness of FB."""
    slope, base_x = steepest(Whisker(), Parabola(distance))
    return SteepestSlope(float(slope), float(base_x))


@lru_cache
def softness(model: str) -> float:
    """`softest` of the support of a model with unit stiffness."""
    return float(jax.jit(lambda: softest(Support.named(model, 1.0)))())


def critical_cases(model: str, distance: float) -> list[Case]:
    """Cases of rising stiffness on both sides of the critical stiffness.

    If the forces on the other whiskers were constant, the critical stiffness would be the steepest slope times
    `softness`.
    """
    guess = steepest_slope(distance).slope * softness(model)
    low, high = (1 - BRACKET / 2, 1 + BRACKET / 2) if WHISKERS[model] == 1 else SEARCHED
    stiffness = guess * np.geomspace(low, high, round(math.log(high / low) / BRACKET) + 1)
    return list(vary("stiffness", Case(model, distance=distance, brief=True), stiffness.tolist()).values())


def critical_bracket(scans: Scans, cases: list[Case]) -> tuple[float, float]:
    """The largest stiffness at which a whisker snaps through the vertex, and the next stiffness of the cases.

    The first one is NaN if no case snaps through, and the second one if the stiffest case does.
    """
    snaps = [snap_through(scans.events(case)) is not None for case in cases]
    last = max((k for k, snap in enumerate(snaps) if snap), default=-1)
    ends = [cases[k].stiffness if 0 <= k < len(cases) else math.nan for k in (last, last + 1)]
    return ends[0], ends[1]
