"""Sliders: a scene whose parameters are dragged, in Jupyter or on a local page."""

import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from jaxwhisker._model.scene import Scene

__all__ = ["explore"]


def explore(build: Callable[..., Scene], /, **ranges: Any) -> Any:
    """Drag the parameters of a scene, and its drive, and see shapes, signals and events follow.

        def build(stiffness, distance):
            return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fbfbr(stiffness), rod=jw.ClosedForm())

        jw.explore(build, stiffness=(10, 500), distance=(0.1, 0.9, 0.2))

    In Jupyter a widget comes back, which shows itself as the last line of a cell. Elsewhere a local page opens in the
    browser, and the call ends with Ctrl-C. The first picture waits for the compiler (10 to 30 s); after that every
    scene of the same structure takes some milliseconds. A button shows the Python code of the current scene.

    Args:
        build: makes a Scene from numbers given by name. It is called anew for every picture and may decide by their
            values; what changes the structure of the scene (a kind of object, a number of springs) is compiled anew.
        ranges: by name of a parameter (low, high) or (low, high, start), in the unit of the parameter; a slider starts
            in the middle if not told. It is logarithmic where high/low > 20 and low > 0. Parameters of `build` without
            a range keep their defaults.

    Returns:
        The widget; None outside of Jupyter.

    Raises:
        ValueError: if a range is none, names no parameter of `build`, or a parameter that needs one has none; if
            `build` returns no Scene where the sliders start; if JAX is in float32 mode.
        ImportError: in Jupyter, if anywidget is missing: `pip install jaxwhisker[explore]`.
    """
    from jaxwhisker._explore.session import Session

    session = Session(build, ranges)
    if _in_jupyter():
        from jaxwhisker._explore.widget import Explorer

        return Explorer(session)
    from jaxwhisker._explore.page import serve

    with suppress(KeyboardInterrupt):
        serve(session)
    return None


def _in_jupyter() -> bool:
    """Whether a kernel runs this, to which widgets can talk."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    return getattr(shell, "kernel", None) is not None
