"""A session: what is computed for the values of the sliders.

Scenes are built anew from the sliders' values, in Python. The reply is a whole scan with all shapes, so that moving the
drive asks for nothing.
"""

import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._explore.code import code_of
from jaxwhisker._explore.lifted import Lifting
from jaxwhisker._explore.picture import picture
from jaxwhisker._explore.reply import failure, success
from jaxwhisker._explore.sliders import Slider, sliders_of
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import Status

Coded = Callable[[Scene, Mapping[str, float]], str]  # the code that makes the scene of these values


class Session:
    """Answers what a scene looks like. Several threads may ask at once.

    Args:
        build: makes a Scene from numbers given by name.
        ranges: a range for each slider; see `jw.explore`.
        code: tells the Python code that makes a scene; that of `build` by default.

    Raises:
        ValueError: as `jw.explore`.
    """

    sliders: tuple[Slider, ...]

    def __init__(self, build: Callable[..., Scene], ranges: Mapping[str, Any], code: Coded | None = None):
        checks.float64_mode()
        self.sliders = sliders_of(build, ranges)
        self._build, self._code = build, code or partial(code_of, build)
        self._lifted, self._one, self._closed = Lifting(), threading.Lock(), False
        self._scene({slider.name: slider.start for slider in self.sliders})

    @property
    def description(self) -> dict[str, Any]:
        """What a page has to know before the first reply."""
        return {
            "sliders": [slider._asdict() for slider in self.sliders],
            "phases": [phase.name for phase in Phase],
            "statuses": [status.name for status in Status],
        }

    def answer(self, values: Any) -> bytes:
        """The reply for the sliders' values; where the scene is refused it tells why.

        Raises:
            ValueError: if the values are not one finite number for each slider, within its range.
        """
        numbers = self._checked(values)
        with self._one:
            if self._closed:
                raise ValueError("The sliders are closed.")
            try:
                scene = self._scene(numbers)
                shown = jax.tree.map(np.asarray, picture(self._lifted(jax.tree.map(checks.as_float, scene))))
                result = eqx.tree_at(lambda r: r.scene, shown.result, scene)
                return success(shown._replace(result=result), self._code(scene, numbers))
            except Exception as error:  # whatever `build` may raise, the page goes on
                return failure(error)

    @property
    def busy(self) -> bool:
        """Whether a scene is being computed, or compiled."""
        return self._one.locked()

    def close(self) -> None:
        """Answer no more; waits for what is being computed."""
        with self._one:
            self._closed = True

    def _scene(self, values: Mapping[str, float]) -> Scene:
        scene = self._build(**values)
        if not isinstance(scene, Scene):
            raise ValueError(f"`build` must return a Scene, but returned {scene!r}.")
        return scene

    def _checked(self, values: Any) -> dict[str, float]:
        names = [slider.name for slider in self.sliders]
        if not isinstance(values, dict) or sorted(values) != sorted(names):
            raise ValueError(f"The values must be those of {', '.join(names) or 'no slider'}, but are {values!r}.")
        for name, low, high, *_ in self.sliders:
            value = values[name]
            if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise ValueError(f"`{name}` must be a number from {low:g} to {high:g}, but is {value!r}.")
        return {name: float(values[name]) for name in names}
