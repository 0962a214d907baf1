"""What all pictures share: colours, labels with symbols and units, axes, and saving."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties

from jaxwhisker._model.motion import Rotation, Translation
from jaxwhisker._model.scene import Scene, units
from jaxwhisker._scan.result import Result

# Okabe and Ito's colours, told apart with every kind of colour blindness; black stands last.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
DASHES = ("-", "--", ":", "-.")
GREY = "#777777"
OBJECT, SUPPORT = "#DDDDDD", "#555555"

AXIS = {
    "base_x": (r"$x_0/L$", "length"),
    "base_y": (r"$y_0/L$", "length"),
    "base_angle": (r"$\varphi_0$ (rad)", None),
    "fx": (r"$f_x\,L^2/EI$", "force"),
    "fy": (r"$f_y\,L^2/EI$", "force"),
    "mz": (r"$m_z\,L/EI$", "moment"),
    "contact_force": (r"$f\,L^2/EI$", "force"),
    "contact_slope": (r"$\alpha$ (rad)", None),
    "contact_arc": (r"$s_1/L$", "length"),
    "contact_x": (r"$\xi/L$", "length"),
    "contact_y": (r"$\eta/L$", "length"),
    "spring_length": (r"$\ell/L$", "length"),
}
QUANTITIES = tuple(AXIS)
CONTROL_AXIS = r"$u/L$"
_ANGLE = "angle of the drive (rad)"


def colour(index: int) -> str:
    """The colour of a whisker, counted from 0, in all pictures."""
    return COLOURS[index % len(COLOURS)]


def axis_label(quantity: str) -> str:
    """Symbol and unit of a quantity."""
    return AXIS[quantity][0]


def control_axis(scene: Scene) -> str:
    """Symbol and unit of the control of a scene's scan."""
    motion = scene.motion
    return CONTROL_AXIS if isinstance(motion, Translation) else _ANGLE if isinstance(motion, Rotation) else "control"


def control_of(result: Result, control: Any = None) -> np.ndarray:
    """Controls, by default those of the steps, as pictures have them: lengths of the drive in L."""
    return np.asarray(result.control if control is None else control, dtype=float) / control_size(result.scene)


def control_size(scene: Scene) -> float:
    """What pictures draw as a control of one."""
    return float(units(scene).length) if isinstance(scene.motion, Translation) else 1.0


def in_units(result: Result, quantity: str) -> np.ndarray:
    """A quantity without dimensions, (steps, whiskers) or (steps, springs)."""
    unit, sizes = AXIS[quantity][1], units(result.scene)
    size = 1.0 if unit is None else float(getattr(sizes, unit))
    values = np.asarray(getattr(result, quantity)) / size
    if quantity == "spring_length":  # of torsion springs an angle
        values = values * [size if spring.axis == "phi" else 1.0 for spring in result.scene.support.springs]
    return values


def one_axes(ax: Axes | None) -> Axes:
    """Where to draw: in a new figure by default."""
    if ax is not None:
        return ax
    from matplotlib import pyplot

    return pyplot.subplots(layout="constrained")[1]


def column(axs: Iterable[Axes] | None, count: int) -> np.ndarray:
    """Axes below each other that share what runs to the right: in a new figure by default."""
    if axs is not None:
        return given(axs, count)
    from matplotlib import pyplot

    return pyplot.subplots(count, 1, sharex=True, squeeze=False, layout="constrained")[1][:, 0]


def given(axs: Iterable[Axes], count: int) -> np.ndarray:
    """Axes in a row.

    Raises:
        ValueError: if there are more or fewer.
    """
    found = np.ravel(np.asarray(axs, dtype=object))
    if found.size != count:
        raise ValueError(f"`axs` must be {count} Axes, but are {found.size}.")
    return found


def mark_events(ax: Axes, controls: Iterable[float]) -> None:
    """Thin vertical lines where events are."""
    for control in dict.fromkeys(controls):
        ax.axvline(control, color=GREY, linewidth=0.5, zorder=0)


def legend_above(ax: Axes, handles: Sequence[Any], *, least: int = 2, columns: int = 3) -> None:
    """A legend on top of the Axes, where it hides nothing, if there are so many things to tell apart."""
    if len(handles) >= least:
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "frameon": False, "borderaxespad": 0.2}
        style = {"fontsize": "small", "handlelength": 1.5, "columnspacing": 1.0}
        ax.legend(handles=handles, ncols=min(len(handles), columns), **style, **place)


def title(ax: Axes, words: str) -> None:
    """A title, above the legend if there is one."""
    legend = ax.get_legend()
    if legend is None:
        ax.set_title(words, fontsize="small")
    else:
        legend.set_title(words, FontProperties(size="small"))


def save(drawn: Figure | Axes | Iterable[Axes], path: str | Path, **options: Any) -> None:
    """Save a picture; the text of PDF and SVG files stays text, which can be searched and edited.

    Args:
        drawn: a Figure, or any of its Axes.
        path: its ending tells the format.
        options: of matplotlib's `savefig`, such as `dpi`.
    """
    import matplotlib

    figure = drawn if isinstance(drawn, Figure) else np.ravel(np.asarray(drawn, dtype=object))[0].figure
    with matplotlib.rc_context({"svg.fonttype": "none", "pdf.fonttype": 42, "ps.fonttype": 42}):
        figure.savefig(path, **options)
