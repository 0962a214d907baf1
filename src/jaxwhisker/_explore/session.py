"""A session: sliders for the parameters of a scene, and a picture for any of their values.

Every picture is a whole scan or motion with all shapes, so moving the drive, or the time, needs no further request.
"""

import math
import reprlib
import types
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import PlainFunction
from jaxwhisker._base.program import compilations
from jaxwhisker._dynamics.simulation import Simulation
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._explore.code import code_of, code_of_call
from jaxwhisker._explore.picture import packed_error, packed_picture, picture_of, picture_of_motion
from jaxwhisker._model.scene import AbstractScene, Scene
from jaxwhisker._path.path import Status
from jaxwhisker._scan.quantities import Unit, UnitSystem
from jaxwhisker._study.layout import kind_of_axis

LOGARITHMIC = 20.0  # a range from a positive number to more than this many times that number is logarithmic
DIGITS = 4  # of the value in the middle of a range, like those of values to which a slider is dragged

RECOMPILED = (
    "A function of the scene depends on the sliders, so every picture is compiled (about 10 seconds). "
    "An equinox.Module with numeric fields instead of the function avoids this."
)
RECOMPILED_MOTION = (
    "A function or the number of time steps depends on the sliders, so every picture is compiled (10 to 20 seconds). "
    "A fixed number of `steps`, and samples of the drive or jw.Whisking, avoid this."
)


class Slider(NamedTuple):
    """A parameter and its range."""

    name: str
    low: float
    high: float
    start: float
    logarithmic: bool
    unit: Unit = Unit("", 1.0)  # in which the page shows its values


class Session:
    """Pictures of what `build` makes from the values of the sliders. It answers one caller at a time.

    Args:
        build: makes a Scene or a Simulation from numbers given by name.
        ranges: a range for each slider; see `jw.explore`.
        kinds: kinds of quantities, as in `quantities.KINDS`, of parameters whose names do not suggest them.

    Raises:
        ValueError: as for `jw.explore`.
    """

    sliders: tuple[Slider, ...]

    def __init__(
        self,
        build: Callable[..., AbstractScene | Simulation],
        ranges: Mapping[str, Any],
        kinds: Mapping[str, str] | None = None,
    ):
        checks.float64_mode()
        sliders = [slider_of(name, given) for name, given in ranges.items()]
        self._build, self._functions = build, _Functions()
        first = self._built({slider.name: slider.start for slider in sliders})
        kind_of = {name: kind_of_axis(name) for name in ranges} | dict(kinds or {})
        self.sliders = tuple(s._replace(unit=_unit(first, kind_of[s.name])) for s in sliders)
        self._kind, self._picture_of, self._views = type(first), picture_of, {}
        if not isinstance(first, Scene | Simulation):
            from jaxwhisker._explore.space_picture import VIEWS, picture_in_space

            self._picture_of, self._views = picture_in_space, VIEWS

    @property
    def description(self) -> dict[str, Any]:
        """What a page needs before the first picture."""
        return {
            "sliders": [slider._asdict() | {"unit": slider.unit._asdict()} for slider in self.sliders],
            "position": "time" if issubclass(self._kind, Simulation) else "drive",
            "views": self._views,
            "phases": [phase.name for phase in Phase],
            "statuses": [status.name for status in Status],
        }

    def answer(self, values: Any) -> bytes:
        """The picture for the values of the sliders, or the error that prevents it."""
        try:
            numbers = self._checked(values)
            before = compilations()
            built = self._built(numbers)
            if not isinstance(built, self._kind):
                checks.fail("build", f"a function that always returns a {self._kind.__name__}", repr(built))
            if isinstance(built, Simulation):
                return self._of_motion(built, numbers, RECOMPILED_MOTION if compilations() > before else "")
            return self._of_scan(built, numbers)
        except Exception as error:  # the sliders must stay usable, whatever `build` raises
            return packed_error(error)

    def _of_scan(self, scene: AbstractScene, numbers: Mapping[str, float]) -> bytes:
        comment = ", ".join(f"{name} = {value!r}" for name, value in numbers.items())
        reused, new = self._functions.reused(scene)
        picture = jax.tree.map(np.asarray, self._picture_of(jax.tree.map(checks.as_float, reused)))
        return packed_picture(picture, scene, code_of(scene, comment), RECOMPILED if new else "")

    def _of_motion(self, motion: Simulation, numbers: Mapping[str, float], note: str) -> bytes:
        picture = jax.tree.map(np.asarray, picture_of_motion(motion))
        return packed_picture(picture, motion.scene, code_of_call(self._build, numbers), note)

    def _built(self, values: Mapping[str, float]) -> AbstractScene | Simulation:
        """What `build` makes of values."""
        checks.arguments("ranges", self._build, list(values))
        built = self._build(**values)
        checks.instance("build", built, (AbstractScene, Simulation), "a Scene or a Simulation", verb="return")
        return built

    def _checked(self, values: Any) -> dict[str, float]:
        names = [slider.name for slider in self.sliders]
        if not isinstance(values, dict) or set(values) != set(names):
            raise ValueError(f"A request must hold {', '.join(names) or 'no values'}, got {reprlib.repr(values)}.")
        for name, low, high, *_ in self.sliders:
            value = values[name]
            if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise ValueError(f"`{name}` must be a number from {low:g} to {high:g}, got {reprlib.repr(value)}.")
        return {name: float(values[name]) for name in names}


def _unit(built: AbstractScene | Simulation, kind: str) -> Unit:
    """The unit in which a slider shows quantities of a kind."""
    if isinstance(built, Simulation) and np.ndim(built.control) != 1:
        return Unit("", 1.0)  # the answer says that a batch is not allowed
    units = UnitSystem(built.scene if isinstance(built, Simulation) else built)
    return Unit("", 1.0) if units.dimensionless else units.of_kind(kind)


class _Functions:
    """Plain functions of the scenes. `build` often makes new ones; each is replaced by the first equal one.

    Otherwise JAX would compile every scene that has a new function.
    """

    def __init__(self):
        self._known: dict[Any, PlainFunction] = {}  # by code and by the values that it uses

    def reused(self, scene: AbstractScene) -> tuple[Any, bool]:
        """The scene with known functions in place of equal new ones, and whether it adds another function to them."""
        known = len(self._known)
        scene = jax.tree.map(self._first, scene, is_leaf=lambda leaf: isinstance(leaf, PlainFunction))
        return scene, 0 < known < len(self._known)

    def _first(self, leaf: Any) -> Any:
        if not isinstance(leaf, PlainFunction) or not isinstance(leaf.function, types.FunctionType):
            return leaf
        function = leaf.function
        values = tuple(cell.cell_contents for cell in function.__closure__ or ())
        keywords = frozenset((function.__kwdefaults__ or {}).items())
        try:
            return self._known.setdefault((id(function.__code__), values, function.__defaults__, keywords), leaf)
        except TypeError:  # values that cannot be compared, such as arrays
            return self._known.setdefault(id(function), leaf)


def slider_of(name: str, given: Any) -> Slider:
    """The slider of a parameter for (low, high) or (low, high, start).

    Raises:
        ValueError: if the range is not valid.
    """
    try:
        low, high, *rest = numbers = [float(value) for value in given]
    except (TypeError, ValueError):
        low, high, *rest = numbers = [math.nan, math.nan]
    if len(rest) > 1 or not all(map(math.isfinite, numbers)):
        raise ValueError(f"`{name}` must be (low, high) or (low, high, start) with finite numbers, got {given!r}.")
    if not low < high:
        raise ValueError(f"`{name}` must be a range with low < high, got {given!r}.")
    logarithmic = low > 0 and high / low > LOGARITHMIC
    middle = math.sqrt(low * high) if logarithmic else (low + high) / 2
    start = rest[0] if rest else min(max(float(f"{middle:.{DIGITS}g}"), low), high)
    if not low <= start <= high:
        raise ValueError(f"`{name}` must start from {low:g} to {high:g}, got {start:g}.")
    return Slider(name, low, high, start, logarithmic)
