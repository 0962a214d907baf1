"""Pictures of scans and deflections: result first, `ax=None`, the Axes come back; everything dimensionless.

Nothing here sets a global style or shows a window. Lengths are drawn in L, forces in EI/L^2, moments in EI/L of the
first whisker, whatever the scene's own units are.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes

from jaxwhisker.contact import Phase
from jaxwhisker.motion import Rotation, Translation
from jaxwhisker.profile import AbstractProfile, Graph, Parabola
from jaxwhisker.scene import units
from jaxwhisker.shape import shapes
from jaxwhisker.tilted import Tilted

# Okabe and Ito's colours, told apart with every kind of colour blindness; black stands last.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
LEAST_HEIGHT = 1e-3  # of an axis: what is constant but for rounding looks constant
FAR = 3.0  # lengths from the vertex to where an endless object is cut off
_OBJECT, _SUPPORT = "#DDDDDD", "#555555"

_AXIS = {
    "base_x": (r"$x_0/L$", "length"),
    "base_y": (r"$y_0/L$", "length"),
    "base_angle": (r"$\varphi_0$", None),
    "fx": (r"$f_x\,L^2/EI$", "force"),
    "fy": (r"$f_y\,L^2/EI$", "force"),
    "mz": (r"$m_z\,L/EI$", "moment"),
    "contact_force": (r"$f\,L^2/EI$", "force"),
    "contact_slope": (r"$\alpha$", None),
    "contact_arc": (r"$s_1/L$", "length"),
    "contact_x": (r"$\xi/L$", "length"),
    "contact_y": (r"$\eta/L$", "length"),
    "spring_length": (r"$\ell/L$", "length"),
}
QUANTITIES = tuple(_AXIS)
CONTROL_AXIS = r"$u/L$"
_ANGLE = "angle of the drive (rad)"


def _new_axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    from matplotlib import pyplot

    return pyplot.subplots()[1]


def _in_units(result, quantity: str) -> np.ndarray:
    unit = _AXIS[quantity][1]
    size = 1.0 if unit is None else float(getattr(units(result.scene), unit))
    return np.asarray(getattr(result, quantity)) / size


def axis_label(quantity: str) -> str:
    """Symbol and unit of a quantity."""
    return _AXIS[quantity][0]


def _control(result) -> np.ndarray:
    along_x = isinstance(result.scene.motion, Translation)
    return np.asarray(result.control) / (float(units(result.scene).length) if along_x else 1.0)


def control_axis(result) -> str:
    """What the control of a scan is."""
    motion = result.scene.motion
    return CONTROL_AXIS if isinstance(motion, Translation) else _ANGLE if isinstance(motion, Rotation) else "control"


def compare(
    results: Mapping[str, Any],
    quantity: str,
    *,
    index: int = 1,
    ax: Axes | None = None,
    colours: Sequence[str] = COLOURS,
) -> Axes:
    """Draw one quantity of several scans over the position of the drive.

    Args:
        results: label -> result.
        quantity: one of `QUANTITIES`: "fx", "fy", "mz", "spring_length", "base_x", ...
        index: number of the whisker, or of the spring, from 1.
        ax: where to draw; a new figure by default.
        colours: one per result, repeated if need be.

    Raises:
        ValueError: if there is no such quantity, whisker or spring.
    """
    if quantity not in _AXIS:
        raise ValueError(f"`quantity` must be one of {', '.join(QUANTITIES)}, but is {quantity!r}.")
    curves = []
    for k, (label, result) in enumerate(results.items()):
        columns = _in_units(result, quantity)
        if not 1 <= index <= columns.shape[1]:
            raise ValueError(f"`index` must lie between 1 and {columns.shape[1]}, but is {index}.")
        # Later curves lie on earlier ones wherever they coincide: thinner, they let those be seen.
        width = 1.8 - 0.9 * k / max(len(results) - 1, 1)
        curves.append((result, columns[:, index - 1], label, colours[k % len(colours)], width))
    return _over_control(curves, quantity, ax)


def signal(result, quantity: str, *, ax: Axes | None = None) -> Axes:
    """Draw one quantity of all whiskers (or springs) of a scan over the position of the drive.

    Args:
        result: of `scan`.
        quantity: one of `QUANTITIES`.
        ax: where to draw; a new figure by default.
    """
    name = "spring" if quantity == "spring_length" else "whisker"
    columns = enumerate(_in_units(result, quantity).T)
    curves = [(result, column, f"{name} {k + 1}", COLOURS[k % len(COLOURS)], 1.3) for k, column in columns]
    return _over_control(curves, quantity, ax)


def _over_control(curves, quantity: str, ax: Axes | None) -> Axes:
    ax = _new_axes(ax)
    for result, values, label, colour, width in curves:
        ax.plot(_control(result), values, color=colour, linewidth=width, label=label)
        ax.set_xlabel(control_axis(result))
    ax.set_ylabel(_AXIS[quantity][0])
    ax.grid(alpha=0.3)
    low, high = ax.get_ylim()
    if high - low < LEAST_HEIGHT:
        ax.set_ylim((low + high) / 2 - LEAST_HEIGHT, (low + high) / 2 + LEAST_HEIGHT)
    return ax


def contact_range(results: Sequence[Any], margin: float = 0.04) -> tuple[float, float]:
    """Range of the control, in L, in which any whisker of any of the scans is in contact, with a margin."""
    touching = [_control(r)[np.any(np.asarray(r.contact_force) > 0, axis=1)] for r in results]
    known = np.concatenate(touching)
    known = known if known.size else np.concatenate([_control(r) for r in results])
    low, high = float(known.min()), float(known.max())
    room = margin * max(high - low, 1e-3)
    return low - room, high + room


def profile(object: AbstractProfile, *, length: float = 1.0, whole: bool = True, ax: Axes | None = None) -> Axes:
    """Draw the object.

    Args:
        object: its profile.
        length: what is drawn as one.
        whole: draw the upper half of a circle or ellipse too, which no whisker touches.
        ax: where to draw; a new figure by default.
    """
    ax = _new_axes(ax)
    upright = object.profile if isinstance(object, Tilted) else object
    if isinstance(upright, Parabola):
        parameter = np.linspace(-1, 1, 481) * np.arctan(2 * float(upright.a) * FAR * length)
    elif isinstance(upright, Graph):
        parameter = np.linspace(-1, 1, 481) * FAR * length / float(upright.unit)
    else:
        parameter = np.linspace(-1, 1, 241) * (np.pi if whole else np.pi / 2)
    at = jax.vmap(object.point)(jnp.asarray(parameter))
    known = np.isfinite(np.asarray(at.y))  # a graph may end
    x, y = np.asarray(at.x)[known] / length, np.asarray(at.y)[known] / length
    ax.fill(x, y, color=_OBJECT, linewidth=0, zorder=0)
    ax.plot(x, y, color=_SUPPORT, linewidth=1, zorder=0.5)
    return ax


def _zigzag(start: float, end: float, height: float, amplitude: float = 0.018) -> tuple[np.ndarray, np.ndarray]:
    # Straight ends and six turns between: the number stays, so a stretched spring looks stretched.
    turns = np.r_[0.0, 0.2, 0.2 + 0.6 * (np.arange(12) + 0.5) / 12, 0.8, 1.0]
    swing = np.r_[0.0, 0.0, np.tile([1.0, -1.0], 6), 0.0, 0.0]
    return start + turns * (end - start), height + amplitude * swing


def _springs(support, nodes: np.ndarray, ax: Axes) -> None:
    """Springs along x; the others have no picture."""
    below = 0
    for spring in support.along("x"):
        first, second = spring.between
        height = 0.0
        if abs(second - first) > 1:  # a feedback spring passes other bases: it hangs below them
            below += 1
            height = -0.08 * below
            for node in (first, second):
                ax.plot([nodes[node]] * 2, [0, height], color=_SUPPORT, linewidth=0.8, zorder=1)
        if spring.softness == 0:
            ax.plot(nodes[[first, second]], [height] * 2, color=_SUPPORT, linewidth=2.5, zorder=1)
        else:
            ax.plot(
                *_zigzag(float(nodes[first]), float(nodes[second]), height), color=_SUPPORT, linewidth=0.9, zorder=1
            )


def _nearest(result, at: float) -> int:
    return int(np.argmin(np.abs(np.asarray(result.control) - at)))


def _lines(result, at: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Drive and centre lines, x and y (whiskers, points), at the nearest step, in L."""
    lines, size = shapes(result, at=[at]), float(units(result.scene).length)
    return float(_control(result)[_nearest(result, at)]), np.asarray(lines.x)[0] / size, np.asarray(lines.y)[0] / size


def state(result, at: float, *, whole: bool = True, ax: Axes | None = None) -> Axes:
    """Draw one state of a scan: object, drive, springs, whiskers and the contact forces on them.

    Args:
        result: of `scan`.
        at: position of the drive, in the scene's unit of length; the nearest step is drawn.
        whole: draw the upper half of a circle or ellipse too.
        ax: where to draw; a new figure by default.

    Arrows point the way the object pushes the whisker; they grow with the share of the scan's largest contact force.
    """
    ax = _new_axes(ax)
    size, step = float(units(result.scene).length), _nearest(result, at)
    _, x, y = _lines(result, at)
    profile(result.scene.profile, length=size, whole=whole, ax=ax)
    ax.axhline(0, color=_SUPPORT, linewidth=0.5, alpha=0.5, zorder=0)
    drive_x, drive_y, turned = (float(v) for v in result.scene.motion.pose(result.control[step]))
    drive_x, drive_y = drive_x / size, drive_y / size
    nodes, heights = (
        np.concatenate([[own], np.asarray(bases[step]) / size])
        for own, bases in ((drive_x, result.base_x), (drive_y, result.base_y))
    )
    if turned == 0 and np.all(heights == 0):
        _springs(result.scene.support, nodes, ax)
    ax.plot(drive_x, drive_y, marker="s", markersize=8, color=_SUPPORT, zorder=2, linestyle="none", label="drive")
    forces = np.nan_to_num(np.asarray(result.contact_force))
    share = forces[step] / max(forces.max(), 1e-300)
    for k in range(x.shape[0]):
        colour = COLOURS[k % len(COLOURS)]
        ax.plot(x[k], y[k], color=colour, linewidth=2, zorder=3, label=f"whisker {k + 1}")
        ax.plot(nodes[k + 1], heights[k + 1], marker="o", markersize=5, color=colour, zorder=4)
        if share[k] > 0:
            point = np.array([float(result.contact_x[step, k]), float(result.contact_y[step, k])]) / size
            slope = float(result.contact_slope[step, k])
            tail = point - (0.1 + 0.25 * share[k]) * np.array([np.sin(slope), -np.cos(slope)])
            arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
            ax.annotate("", xy=tuple(point), xytext=tuple(tail), arrowprops=arrow, zorder=5)
    _frame(ax)
    frame_states([ax], [result], [at])
    return ax


def _frame(ax: Axes) -> None:
    ax.set_aspect("equal")
    ax.set_xlabel(r"$x/L$")
    ax.set_ylabel(r"$y/L$")


def phases(result, at: float) -> str:
    """What each whisker does at a position of the drive, in words: "1: tip, 2: free"."""
    phase = np.asarray(result.phase[_nearest(result, at)])
    return ", ".join(f"{k + 1}: {Phase(int(p)).name}" for k, p in enumerate(phase))


def deflection(results: Mapping[str, Any], *, length: float = 1.0, ax: Axes | None = None) -> Axes:
    """Draw whiskers bent by given loads.

    Args:
        results: label -> result of `deflect`.
        length: what is drawn as one.
        ax: where to draw; a new figure by default.
    """
    ax = _new_axes(ax)
    for k, (label, result) in enumerate(results.items()):
        x, y = np.asarray(result.x) / length, np.asarray(result.y) / length
        ax.plot(x, y, color=COLOURS[k % len(COLOURS)], linewidth=2, label=label)
    ax.plot(0, 0, marker="s", markersize=8, color=_SUPPORT, zorder=4)
    ax.grid(alpha=0.3)
    _frame(ax)
    return ax


def overview(result):
    """Draw a scan on one page: some states, the reactions and the lengths of the springs; return the Figure."""
    from matplotlib.figure import Figure

    springs = bool(result.scene.support.springs)
    quantities = ["fx", "fy", "mz", *["spring_length"] * springs]
    figure = Figure(figsize=(11, 6.5))
    grid = figure.add_gridspec(
        len(quantities), 2, width_ratios=(1, 1.2), left=0.06, right=0.98, top=0.9, bottom=0.08, wspace=0.18, hspace=0.12
    )
    figure.suptitle(str(result.scene), fontsize=11)
    low, high = contact_range([result])
    at = (low + high) / 2 * float(units(result.scene).length)
    scene_axes = state(result, at, ax=figure.add_subplot(grid[:, 0]))
    scene_axes.set_title(f"state at $u/L$ = {(low + high) / 2:.3f}", fontsize=10)
    scene_axes.legend(loc="upper left", fontsize=8)
    for row, quantity in enumerate(quantities):
        ax = signal(result, quantity, ax=figure.add_subplot(grid[row, 1]))
        ax.set_xlim(low, high)
        if row < len(quantities) - 1:
            ax.tick_params(labelbottom=False)
            ax.set_xlabel("")
        if quantity in ("fx", "spring_length"):
            ax.legend(fontsize=8, loc="lower left" if quantity == "fx" else "upper left", ncols=5)
        if quantity == "spring_length":
            bottom, top = ax.get_ylim()
            ax.set_ylim(bottom, top + 0.3 * (top - bottom))  # lengths peak where the legend stands
    return figure


def frame_states(axes: Sequence[Axes], results: Sequence[Any], ats: Sequence[float]) -> None:
    """Give pictures of states one common window that holds drives, whiskers and the object's lower part."""
    left, right, bottom, top = np.inf, -np.inf, -0.1, 1.1
    for result, at in zip(results, ats, strict=True):
        u, x, y = _lines(result, at)
        left, right = np.nanmin([left, u, *x.flat]), np.nanmax([right, u, *x.flat])
        vertex = float(result.scene.profile.vertex()[1]) / float(units(result.scene).length)
        top = max(top, vertex + 0.1, float(np.nanmax(y)) + 0.1)
        loops = sum(abs(b - a) > 1 for a, b in (s.between for s in result.scene.support.springs))
        bottom = min(bottom, -0.1 - 0.08 * loops)
    for ax in axes:
        ax.set_xlim(left - 0.12, right + 0.12)
        ax.set_ylim(bottom, top)
