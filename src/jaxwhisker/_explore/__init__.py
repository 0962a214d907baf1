"""Sliders: the parameters of a scene or of a motion in Jupyter, or on a local page."""

import sys
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from jaxwhisker._model.scene import Scene

if TYPE_CHECKING:
    from jaxwhisker._dynamics.simulation import Simulation
    from jaxwhisker._model.space_scene import SpaceScene

__all__ = ["explore"]


def explore(build: "Callable[..., Scene | SpaceScene | Simulation]", /, **ranges: Any) -> Any:
    """Change the parameters of a scene, in the plane or in space, and move its drive with sliders.

    Shapes, signals and events follow:

        def build(stiffness, distance):
            return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fbfbr(stiffness), rod=jw.ClosedForm())

        jw.explore(build, stiffness=(10, 500), distance=(0.1, 0.9, 0.2))

    If `build` returns a Simulation, signals are drawn over time, one slider moves through time, and a button plays the
    motion:

        def build(stiffness, speed):
            scene = jw.Scene(jw.Whisker(mass_per_length=1.0), jw.Parabola(0.2), jw.Support.fb(stiffness))
            settings = {"steps": 800, "every": 2, "stiffness_damping": 0.02, "shapes": 8}
            return jw.simulate(scene, np.array([0.75, -1.6]), 2.35 / speed, **settings)

        jw.explore(build, stiffness=(30, 500), speed=(0.15, 1.5, 0.3))

    Scenes in space are seen by a camera: drag the picture to turn it, or choose a projection with a button. Sliders
    keep the view:

        def build(radius, offset):
            return jw.Scene(jw.Whisker(), jw.Sphere(radius, (0.0, 1.3, offset)))

        jw.explore(build, radius=(0.5, 1.5), offset=(0.05, 0.5))

    In Jupyter the sliders are a widget, which appears if the call is the last line of a cell. Elsewhere they are a
    local page, which opens in the browser and stays until Ctrl-C. The first picture waits for the compiler unless
    the cache has its programs; further scenes with the same structure take some milliseconds, and motions as long as
    `simulate`. A button shows Python code for the scene or the motion.

    Args:
        build: makes a Scene, in the plane or in space, or a Simulation from numbers given by name. It is called again
            for every picture and may branch on their values. A change of the scene's structure needs another
            compilation: another kind of object, more springs, or a plain function that depends on a slider (an
            `equinox.Module` with numeric fields does not). So does a number of time steps that depends on a slider.
            Every sample of a simulation is drawn: a few hundred are enough (`every`).
        ranges: (low, high) or (low, high, start) for each parameter by name, in the unit of the parameter. Sliders show
            scenes in SI units with prefixes, as figures do, if their names end with `length`, `distance`, `radius`,
            `position` or `stiffness`. By default a slider starts in the middle. It is logarithmic if high/low > 20 and
            low > 0. Parameters of `build` without a range keep their defaults.

    Returns:
        The widget in Jupyter, else None.

    Raises:
        ValueError: if a range is not valid or is not that of a parameter of `build`; if a parameter without a default
            has no range; if `build` does not return a Scene or a Simulation at the start values; if JAX is in float32
            mode.
        ImportError: if tornado or anywidget is missing: `pip install 'jaxwhisker[explore]'`.
    """
    from jaxwhisker._explore.hosts import Explorer, serve
    from jaxwhisker._explore.session import Session

    session = Session(build, ranges)
    if _in_jupyter():
        return Explorer(session)
    with suppress(KeyboardInterrupt):
        serve(session)
    return None


def _in_jupyter() -> bool:
    """Whether this process is a Jupyter kernel."""
    shell = sys.modules.get("IPython")
    return shell is not None and hasattr(shell.get_ipython(), "kernel")
