"""The scans behind figures and claims: one study per kind of scene, with all cases that a figure or a claim needs."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._model.conic import Circle, Parabola
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import SNAPS, EventKind
from jaxwhisker._scan.result import Event, Events, Result
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
CORES = 2  # studies computed at the same time
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
    def structure(self) -> tuple[str, bool]:
        """What the cases of a study have in common."""
        return self.model, self.semicircle

    @property
    def whiskers(self) -> range:
        """Numbers of the whiskers."""
        return range(1, WHISKERS[self.model] + 1)

    def control(self) -> np.ndarray:
        """Drive positions that cover every scan of this model, for all parameters."""
        trailing = WHISKERS[self.model] * max(VALUES["rest_length"])
        return 0.001 * np.arange(1000, -round(1000 * (1.4 + trailing)) - 1, -1)


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

    At the end of a `with` block, studies that have not started are cancelled.
    """

    def __init__(self, cases: Iterable[Case]):
        self._pool = ThreadPoolExecutor(CORES)
        self._chosen = cases  # a generator does not choose them before the start, because that compiles programs
        self._begun: Future | None = None
        self._cases: dict[tuple, list[Case]] = {}
        self._studies: dict[tuple, Future] = {}

    def start(self) -> None:
        """Begin the studies, unless they have begun."""
        if self._begun is None:
            self._begun = self._pool.submit(self._begin)

    def _begin(self) -> None:
        for case in dict.fromkeys(self._chosen):
            self._cases.setdefault(case.structure, []).append(case)
        for structure, cases in self._cases.items():
            self._studies[structure] = self._pool.submit(_study, cases)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._pool.shutdown(cancel_futures=True)

    def _data(self, case: Case) -> "xr.Dataset":
        """The point of a study that belongs to a case, with its summary."""
        self.start()
        self._begun.result()  # pyright: ignore[reportOptionalMemberAccess]
        return self._studies[case.structure].result().isel(point=self._cases[case.structure].index(case))

    def __call__(self, case: Case) -> Result:
        """The scan of a case."""
        data = self._data(case)

        def arrays(names: Iterable[str], prefix: str = "") -> dict:
            return {name: jax.device_put(data[prefix + name].values) for name in names}

        state = [name for name in State.__dataclass_fields__ if name not in OPTIONAL]
        before, after = (State(**arrays(state, side)) for side in ("before_", "after_"))
        fields = arrays(("kind", "control", "count"), "event_") | {
            "whiskers": jax.device_put(data.event_whisker.values)
        }
        signals = arrays([*state, "control", "spring_length", "status"])
        travel = jnp.abs(fields["control"] - signals["control"][0])
        events = Events(**fields, travel=travel, before=before, after=after)
        return Result(**signals, deferred_events=events, scene=build(**dataclasses.asdict(case)))

    def summary(self, case: Case, whisker: int, *names: str) -> list[float]:
        """Variables of the summary of a case, such as `max_mz`, `control_of_max_mz` or `last_contact`."""
        data = self._data(case).sel(whisker=whisker)
        return [float(data[name]) for name in names]


def _study(cases: list[Case]) -> "xr.Dataset":
    of_structure = partial(build, *cases[0].structure)
    points = {name: [getattr(case, name) for case in cases] for name in VALUES}
    data = study(of_structure, points=points, control=cases[0].control(), outputs="all", progress=False)
    return data.merge(summary(data))


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


class SteepestSlope(NamedTuple):
    """The steepest slope dF_x/dx0 of the clamped whisker, and the position x0 of its base there."""

    slope: float
    base_x: float


@lru_cache
def steepest_slope(distance: float) -> SteepestSlope:
    """The steepest slope of the clamped whisker's force, which is the critical stiffness of FB."""
    slope, base_x = steepest(Whisker(), Parabola(distance))
    return SteepestSlope(float(slope), float(base_x))


def critical_cases(model: str, distance: float) -> list[Case]:
    """Cases of rising stiffness on both sides of the critical stiffness.

    If the forces on the other whiskers were constant, the critical stiffness would be the steepest slope times
    `softest` of the support with unit stiffness.
    """
    guess = steepest_slope(distance).slope * float(softest(Support.named(model, 1.0)))
    low, high = (1 - BRACKET / 2, 1 + BRACKET / 2) if WHISKERS[model] == 1 else SEARCHED
    stiffness = guess * np.geomspace(low, high, round(math.log(high / low) / BRACKET) + 1)
    return list(vary("stiffness", Case(model, distance=distance), stiffness.tolist()).values())


def critical_bracket(scans: Scans, cases: list[Case]) -> tuple[float, float]:
    """The largest stiffness at which a whisker snaps through the vertex, and the next stiffness of the cases.

    The first one is NaN if no case snaps through, and the second one if the stiffest case does.
    """
    snaps = [snap_through(scans(case)) is not None for case in cases]
    last = max((k for k, snap in enumerate(snaps) if snap), default=-1)
    ends = [cases[k].stiffness if 0 <= k < len(cases) else math.nan for k in (last, last + 1)]
    return ends[0], ends[1]
