"""Figures: each function takes the result first, draws into `ax` (or a new figure) and returns the Axes.

No function sets a global style or opens a window. Scenes with L = EI = 1 are drawn dimensionless, in L and EI of the
first whisker; other scenes in SI units with prefixes (mm, mN, mN mm). `units` overrides this choice. The control
increases to the right, as x does in figures of states. Signals of simulations are drawn over time. A whisker has the
same colour in all figures.
"""

from jaxwhisker._base.suggest import no_attribute
from jaxwhisker._scan.quantities import DRAWN as QUANTITIES
from jaxwhisker.plot.axes import COLOURS, CONTROL_AXIS, axis_label, control_axis, save
from jaxwhisker.plot.bending_map import strain
from jaxwhisker.plot.inverse import contour, fit, information
from jaxwhisker.plot.phase_strips import phases
from jaxwhisker.plot.signals import (
    compare,
    contact_range,
    lateral_losses,
    overview,
    reactions,
    signal,
    spring_extensions,
    spring_lengths,
)
from jaxwhisker.plot.states import deflection, in_words, profile, same_window, scene, shapes
from jaxwhisker.plot.studies import study, tactile_image

__all__ = [
    "COLOURS",
    "CONTROL_AXIS",
    "QUANTITIES",
    "axis_label",
    "compare",
    "contact_range",
    "contour",
    "control_axis",
    "deflection",
    "fit",
    "in_words",
    "information",
    "lateral_losses",
    "overview",
    "phases",
    "profile",
    "reactions",
    "same_window",
    "save",
    "scene",
    "shapes",
    "signal",
    "spring_extensions",
    "spring_lengths",
    "strain",
    "study",
    "tactile_image",
]


def __dir__():
    return [*__all__, *(name for name in globals() if name.startswith("__"))]


def __getattr__(name: str):
    raise no_attribute(f"module {__name__!r}", name, __all__)
