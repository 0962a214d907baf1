"""What all figures share: colours, units and labels, argument checks, axes, legends and saving."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D

from jaxwhisker._base import checks
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.quantities import (
    QUANTITIES,
    Unit,
    UnitSystem,
    check_units,
    dimensionless_label,
    with_prefix,
)
from jaxwhisker._scan.quantities import quantity as named
from jaxwhisker.plot.runs import Run, check_quantity

# The palette of Okabe and Ito, whose colours remain distinct for colour-blind readers; black comes last.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
DASHES = ("-", "--", ":", "-.")
GREY = "#777777"
OBJECT, SUPPORT = "#DDDDDD", "#555555"
# Shape and filling of the marker of each kind of event.
MARKERS = {
    EventKind.touch: ("o", "white"),
    EventKind.tip_to_tangential: ("^", "white"),
    EventKind.vertex: ("v", "white"),
    EventKind.tangential_to_tip: ("^", GREY),
    EventKind.stick: ("<", GREY),
    EventKind.slip: (">", GREY),
    EventKind.edge: ("|", "black"),
    EventKind.release: ("s", "white"),
    EventKind.snap_through: ("D", "black"),
    EventKind.snap_off: ("X", "black"),
    EventKind.bifurcation: ("*", "white"),
}
EVENT_HEIGHT = 0.95  # of markers of events, as a share of the Axes

CONTROL_AXIS = dimensionless_label(QUANTITIES["control"].symbol, "length")


def colour(index: int) -> str:
    """Colour of a whisker, counted from 0, in all figures."""
    return COLOURS[index % len(COLOURS)]


def axis_label(quantity: str, scene: AbstractScene | None = None, *, units: str = "auto") -> str:
    """Symbol and unit of a quantity, for an axis.

    Args:
        quantity: one of `QUANTITIES`; of a scene in space, one that `signal` draws.
        scene: scene whose units are shown; by default the label is dimensionless.
        units: "auto", "SI" or "dimensionless".

    Raises:
        ValueError: if there is no such quantity, `scene` is not a Scene or `units` is invalid.
    """
    if scene is None:
        check_quantity(quantity)
        return dimensionless_label(named(quantity).symbol, named(quantity).kind)
    checks.instance("scene", scene, AbstractScene, "a Scene")
    check_quantity(quantity, scene=scene)
    return UnitSystem(scene, units).label(quantity)


def control_axis(scene: AbstractScene, *, units: str = "auto") -> str:
    """Symbol and unit of the control of a scene, for an axis.

    Args:
        scene: scene whose control is drawn.
        units: "auto", "SI" or "dimensionless".

    Raises:
        ValueError: if `scene` is not a Scene or `units` is invalid.
    """
    checks.instance("scene", scene, AbstractScene, "a Scene")
    return UnitSystem(scene, units).label("control")


def length_unit(length: float, units: str) -> Unit:
    """Unit of coordinates near a whisker of this length, without a scene: "auto" is "SI" unless the length is 1."""
    check_units(units)
    length = 1.0 if np.isclose(length, 1.0) else length
    return with_prefix("m", length) if units == "SI" or (units == "auto" and length != 1) else Unit("", length)


def label_coordinates(ax: Axes, unit: Unit) -> None:
    """Label the axes of a drawing in the plane, which have the same scale."""
    ax.set_aspect("equal")
    x, y = (f"${s}$ ({unit.name})" if unit.name else dimensionless_label(s, "length") for s in "xy")
    ax.set(xlabel=x, ylabel=y)


def rounded(size: float) -> float:
    """Nearest of ..., 1, 2, 2.5, 5, 10, ..."""
    power = 10.0 ** np.floor(np.log10(size))
    return float(min((1.0, 2.0, 2.5, 5.0, 10.0), key=lambda one: abs(one * power - size)) * power)


def unit_systems(results: Sequence[Run], units: str) -> list[UnitSystem]:
    """Units for results that share axes: the SI units of the first one, or L and EI of each one."""
    own = [UnitSystem(result.scene, units) for result in results]
    if any(one.dimensionless for one in own):
        return [UnitSystem(one.scene, "dimensionless") for one in own]
    return [UnitSystem(one.scene, "SI", prefixes_of=own[0].scene) for one in own]


def one_axes(ax: Axes | None) -> Axes:
    """Axes to draw into: in a new figure by default."""
    if ax is None:
        return grid_of_axes(None)[0]
    checks.instance("ax", ax, Axes, "matplotlib Axes")
    return ax


def grid_of_axes(axs: Iterable[Axes] | None, rows: int = 1, columns: int = 1, **options: Any) -> np.ndarray:
    """Axes row by row, as a one-dimensional array: in a new figure by default."""
    if axs is not None:
        return several_axes(axs, rows * columns)
    from matplotlib import pyplot

    return pyplot.subplots(rows, columns, squeeze=False, layout="constrained", **options)[1].ravel()


def several_axes(axs: Any, count: int | None = None) -> np.ndarray:
    """Axes as a one-dimensional array.

    Raises:
        ValueError: if they are not Axes, or if their number is not `count`.
    """
    axes = np.ravel(np.asarray(list(axs) if isinstance(axs, Iterable) else axs, dtype=object))
    known = axes.size > 0 and all(isinstance(ax, Axes) for ax in axes)
    if not known or count not in (None, axes.size):
        checks.fail("axs", "Axes" if count is None else f"{count} Axes", axes.size if known else repr(axs))
    return axes


def mark_events(ax: Axes, at: Iterable[float], events: Sequence[Any]) -> list[Line2D]:
    """Draw a thin vertical line with a marker, in the colour of its whisker, at each event; return entries of a legend.

    Args:
        ax: where to draw.
        at: places of the events along the horizontal axis.
        events: the events, each with its `kind` and `whiskers`.
    """
    for place, event in zip(at, events, strict=True):
        line = {"color": GREY, "linewidth": 0.5, "zorder": 0, "markevery": [1], "transform": ax.get_xaxis_transform()}
        edge = colour(event.whiskers[0] - 1) if len(event.whiskers) == 1 else "black"
        ax.plot([place] * 3, [0.0, EVENT_HEIGHT, 1.0], **line | event_marker(event.kind, edge))
    return event_entries(event.kind for event in events)


def event_marker(kind: EventKind, edge: str = "black") -> dict[str, Any]:
    """Look of the marker of an event."""
    shape, filled = MARKERS[kind]
    look = {"marker": shape, "markerfacecolor": filled, "markeredgecolor": edge}
    return look | {"markersize": 5, "markeredgewidth": 0.8}


def event_entries(kinds: Iterable[EventKind]) -> list[Line2D]:
    """Entries of a legend for these kinds of events."""
    found = set(kinds)
    return [
        Line2D([], [], label=kind.name.replace("_", "-"), linestyle="none", **event_marker(kind))
        for kind in MARKERS
        if kind in found
    ]


def legend_above(ax: Axes, handles: Sequence[Any] | None = None, *, least: int = 2, columns: int = 3) -> None:
    """Put a legend above the Axes, where it hides nothing, if there are at least that many entries."""
    handles = ax.get_legend_handles_labels()[0] if handles is None else handles
    if len(handles) >= least:
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "frameon": False, "borderaxespad": 0.2}
        style = {"fontsize": "small", "handlelength": 1.5, "columnspacing": 1.0}
        ax.legend(handles=handles, ncols=min(len(handles), columns), **style, **place)


def title(ax: Axes, words: str) -> None:
    """Set a title, above the legend if there is one."""
    legend = ax.get_legend()
    if legend is None:
        ax.set_title(words, fontsize="small")
    else:
        legend.set_title(words, FontProperties(size="small"))


def save(drawn: Figure | Axes | Iterable[Axes], path: str | Path, **options: Any) -> None:
    """Save a figure; text in PDF and SVG files stays text, which can be searched and edited.

    Args:
        drawn: a Figure, or any of its Axes.
        path: path of the file; its suffix selects the format.
        options: options of matplotlib's `savefig`, such as `dpi`.

    Raises:
        ValueError: if `drawn` is neither a Figure nor Axes.
    """
    import matplotlib

    first: Any = drawn if isinstance(drawn, Figure) else next(iter(np.ravel(np.asarray(drawn, dtype=object))), drawn)
    checks.instance("drawn", first, (Figure, Axes), "a matplotlib Figure or Axes")
    figure = first if isinstance(first, Figure) else first.figure
    with matplotlib.rc_context({"svg.fonttype": "none", "pdf.fonttype": 42, "ps.fonttype": 42}):
        figure.savefig(path, **options)
