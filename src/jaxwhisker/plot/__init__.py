"""Pictures: result first, `ax=None`, the Axes come back; no global style, no window.

Lengths are drawn in L, forces in EI/L^2, moments in EI/L of the first whisker, whatever the scene's own units are; the
drive's position grows to the right, as x does in pictures of states. A whisker has one colour everywhere.
"""

from jaxwhisker.plot.axes import COLOURS, CONTROL_AXIS, QUANTITIES, axis_label, control_axis, save
from jaxwhisker.plot.deflections import deflection
from jaxwhisker.plot.inverse import contour, fit, information
from jaxwhisker.plot.overview import overview
from jaxwhisker.plot.signals import compare, contact_range, reactions, signal, spring_lengths
from jaxwhisker.plot.states import in_words, profile, same_window, scene, shapes
from jaxwhisker.plot.strips import phases
from jaxwhisker.plot.studies import study

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
    "overview",
    "phases",
    "profile",
    "reactions",
    "same_window",
    "save",
    "scene",
    "shapes",
    "signal",
    "spring_lengths",
    "study",
]
