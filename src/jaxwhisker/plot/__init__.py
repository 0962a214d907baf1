"""Pictures: result first, `ax=None`, the Axes come back; no global style, no window."""

from jaxwhisker.plot.inverse import contour, fit, information
from jaxwhisker.plot.scans import (
    COLOURS,
    CONTROL_AXIS,
    QUANTITIES,
    axis_label,
    compare,
    contact_range,
    control_axis,
    deflection,
    frame_states,
    overview,
    phases,
    profile,
    signal,
    state,
)

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
    "frame_states",
    "information",
    "overview",
    "phases",
    "profile",
    "signal",
    "state",
]
