"""What all figures share: colours, units and labels, argument checks, axes, legends and saving."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties

from jaxwhisker._model.scene import Scene
from jaxwhisker._scan.quantities import DRAWN, UnitSystem, dimensionless_label
from jaxwhisker._scan.quantities import QUANTITIES as TABLE
from jaxwhisker._scan.result import Result

# The palette of Okabe and Ito, whose colours remain distinct for colour-blind readers; black comes last.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
DASHES = ("-", "--", ":", "-.")
GREY = "#777777"
OBJECT, SUPPORT = "#DDDDDD", "#555555"

QUANTITIES = DRAWN
CONTROL_AXIS = dimensionless_label(TABLE["control"].symbol, "length")


def colour(index: int) -> str:
    """Colour of a whisker, counted from 0, in all figures."""
    return COLOURS[index % len(COLOURS)]


def axis_label(quantity: str, scene: Scene | None = None, *, units: str = "auto") -> str:
    """Symbol and unit of a quantity, for an axis.

    Args:
        quantity: one of `QUANTITIES`.
        scene: scene whose units are shown; by default the label is dimensionless.
        units: "auto", "SI" or "dimensionless".

    Raises:
        ValueError: if there is no such quantity, `scene` is not a Scene or `units` is invalid.
    """
    check_quantity(quantity)
    if scene is None:
        return dimensionless_label(TABLE[quantity].symbol, TABLE[quantity].kind)
    return UnitSystem(check_scene(scene), units).label(quantity)


def control_axis(scene: Scene, *, units: str = "auto") -> str:
    """Symbol and unit of the control of a scene, for an axis.

    Args:
        scene: scene whose control is drawn.
        units: "auto", "SI" or "dimensionless".

    Raises:
        ValueError: if `scene` is not a Scene or `units` is invalid.
    """
    return UnitSystem(check_scene(scene), units).label("control")


def unit_systems(results: Sequence[Result], units: str) -> list[UnitSystem]:
    """Units for results that share axes: the SI units of the first one, or L and EI of each one."""
    own = [UnitSystem(result.scene, units) for result in results]
    if any(one.dimensionless for one in own):
        return [UnitSystem(one.scene, "dimensionless") for one in own]
    return [UnitSystem(one.scene, "SI", prefixes_of=own[0].scene) for one in own]


def check_type(name: str, value: Any, allowed: type | tuple[type, ...], words: str) -> None:
    """Check the type of an argument.

    Raises:
        ValueError: if it has another type.
    """
    if not isinstance(value, allowed):
        raise ValueError(f"`{name}` must be {words}, got {value!r}.")


def check_scene(scene: Any) -> Scene:
    """Return a scene after checking its type."""
    check_type("scene", scene, Scene, "a Scene")
    return scene


def check_quantity(quantity: Any) -> None:
    """Check that `quantity` is one of `QUANTITIES`."""
    if quantity not in QUANTITIES:
        raise ValueError(f"`quantity` must be one of {', '.join(QUANTITIES)}, got {quantity!r}.")


def one_axes(ax: Axes | None) -> Axes:
    """Axes to draw into: in a new figure by default."""
    if ax is not None:
        check_type("ax", ax, Axes, "matplotlib Axes")
        return ax
    from matplotlib import pyplot

    return pyplot.subplots(layout="constrained")[1]


def column(axs: Iterable[Axes] | None, count: int) -> np.ndarray:
    """Axes below each other with one horizontal axis: in a new figure by default."""
    if axs is not None:
        return several_axes(axs, count)
    from matplotlib import pyplot

    return pyplot.subplots(count, 1, sharex=True, squeeze=False, layout="constrained")[1][:, 0]


def several_axes(axs: Any, count: int | None = None) -> np.ndarray:
    """Axes as a one-dimensional array.

    Raises:
        ValueError: if they are not Axes, or if their number is not `count`.
    """
    axes = np.ravel(np.asarray(list(axs) if isinstance(axs, Iterable) else axs, dtype=object))
    words = "Axes" if count is None else f"{count} Axes"
    if not axes.size or not all(isinstance(ax, Axes) for ax in axes):
        raise ValueError(f"`axs` must be {words}, got {axs!r}.")
    if count not in (None, axes.size):
        raise ValueError(f"`axs` must be {words}, got {axes.size}.")
    return axes


def mark_events(ax: Axes, controls: Iterable[float]) -> None:
    """Draw thin vertical lines at the controls of events."""
    for control in dict.fromkeys(controls):
        ax.axvline(control, color=GREY, linewidth=0.5, zorder=0)


def legend_above(ax: Axes, handles: Sequence[Any], *, least: int = 2, columns: int = 3) -> None:
    """Put a legend above the Axes, where it hides nothing, if there are at least that many entries."""
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
    check_type("drawn", first, (Figure, Axes), "a matplotlib Figure or Axes")
    figure = first if isinstance(first, Figure) else first.figure
    with matplotlib.rc_context({"svg.fonttype": "none", "pdf.fonttype": 42, "ps.fonttype": 42}):
        figure.savefig(path, **options)
