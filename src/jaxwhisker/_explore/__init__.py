"""Sliders: the parameters of a scene in Jupyter, or on a local page."""

import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from jaxwhisker._model.scene import Scene

__all__ = ["explore"]


def explore(build: Callable[..., Scene], /, **ranges: Any) -> Any:
    """Change the parameters of a scene and move its drive with sliders; shapes, signals and events follow.

        def build(stiffness, distance):
            return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fbfbr(stiffness), rod=jw.ClosedForm())

        jw.explore(build, stiffness=(10, 500), distance=(0.1, 0.9, 0.2))

    In Jupyter the sliders are a widget, which appears if the call is the last line of a cell. Elsewhere they are a
    local page, which opens in the browser and stays until Ctrl-C. The first picture waits for the compiler unless
    the cache has its programs; further scenes with the same structure take some milliseconds. A button shows Python
    code for the scene.

    Args:
        build: makes a Scene from numbers given by name. It is called again for every picture and may branch on their
            values. A change of the scene's structure needs another compilation: another kind of object, more springs,
            or a plain function that depends on a slider (an `equinox.Module` with numeric fields does not).
        ranges: (low, high) or (low, high, start) for each parameter by name, in the unit of the parameter. By default a
            slider starts in the middle. It is logarithmic if high/low > 20 and low > 0. Parameters of `build` without
            a range keep their defaults.

    Returns:
        The widget in Jupyter, else None.

    Raises:
        ValueError: if a range is not valid or is not that of a parameter of `build`; if a parameter without a default
            has no range; if `build` does not return a Scene at the start values; if JAX is in float32 mode.
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
