"""Pictures of whiskers, springs, drive and object: of a scene before its scan, and at positions of the drive."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

from jaxwhisker._base import checks
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, moves_along_x, units
from jaxwhisker._model.silhouette import silhouette_of
from jaxwhisker._scan.result import Result, check_one_scan
from jaxwhisker.plot.axes import OBJECT, SUPPORT, colour, control_axis, control_of, legend_above, one_axes, title
from jaxwhisker.plot.drawing import Drawing, drawing, drawing_at, rest_state, start_of

STATES = 5  # drawn if nobody says which
MOST_TOLD = 6  # positions that a title has room for
PALEST = 0.25  # opacity of the earliest of several states
NARROWEST = 1.3  # lengths that a picture is wide at least
WIDE = 3.0  # lengths up to which there is a tick at every half
ROOM = 0.1  # lengths around what is drawn
BEYOND = 0.5  # lengths beside the vertex that the picture of a scene holds


def scene(scene: Scene, *, ax: Axes | None = None) -> Axes:
    """Draw a scene before its scan: object, drive, springs and unloaded whiskers. Nothing is solved.

    Args:
        scene: with the drive where the first whisker is about to touch, or where a motion of one's own begins.
        ax: where to draw; a new figure by default.

    Raises:
        ValueError: if it is no Scene.
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"`scene` must be a Scene, but is {scene!r}.")
    ax = one_axes(ax)
    control = start_of(scene)
    drawn = drawing(scene, control, rest_state(scene, control))
    _draw(scene, [drawn], True, ax)
    # The object from beyond its vertex on, and not only where it is touched first.
    vertex = float(scene.profile.vertex()[0]) / float(units(scene).length)
    left, right = ax.get_xlim()
    ax.set_xlim(min(left, vertex - BEYOND), max(right, vertex + BEYOND))
    return ax


def shapes(result: Result, at: Any = None, *, whole: bool = True, ax: Axes | None = None) -> Axes:
    """Draw whiskers, springs, drive, object and contact forces at one or several positions of the drive.

    Of several, earlier whiskers are paler; springs, drive and forces are those of the last. Arrows point the way the
    object pushes the whisker and grow with the share of the scan's largest contact force. Failed steps are left out.

    Args:
        result: of `scan`.
        at: drive positions in the scene's unit, the nearest steps are drawn; by default five across the contact.
        whole: draw the upper half of a circle or ellipse too, which no whisker touches.
        ax: where to draw; a new figure by default.

    Raises:
        ValueError: if `result` is none of one scan, or `at` not finite numbers.
    """
    check_one_scan(result)
    steps = _steps_across(result) if at is None else _steps_at(result, at)
    ax = one_axes(ax)
    _draw(result.scene, [drawing_at(result, step) for step in steps], whole, ax)
    digits = 3 if len(steps) == 1 else 2
    told = ", ".join(f"{control_of(result)[step]:.{digits}f}" for step in steps).replace("-", "\N{MINUS SIGN}")
    if len(steps) <= MOST_TOLD:
        title(ax, f"{control_axis(result.scene)}: {told}")
    return ax


def profile(object: AbstractProfile, *, length: float = 1.0, whole: bool = True, ax: Axes | None = None) -> Axes:
    """Draw the object.

    Args:
        object: its profile.
        length: what is drawn as one.
        whole: draw the upper half of a circle or ellipse too, which no whisker touches.
        ax: where to draw; a new figure by default.

    Raises:
        ValueError: if `object` is no profile, or `length` not positive.
    """
    if not isinstance(object, AbstractProfile):
        raise ValueError(f"`object` must be a profile, but is {object!r}.")
    checks.number("length", length, positive=True)
    ax = one_axes(ax)
    x, y = (coordinate / length for coordinate in silhouette_of(object, length, whole=whole))
    ax.fill(x, y, color=OBJECT, linewidth=0, zorder=0)
    ax.plot(x, y, color=SUPPORT, linewidth=1, zorder=0.5)
    return ax


def same_window(axs: Iterable[Axes]) -> None:
    """Give pictures of states one common window, that of all of them together."""
    axes = list(axs)
    (left, right), (bottom, top) = (np.array([get(ax) for ax in axes]).T for get in (Axes.get_xlim, Axes.get_ylim))
    for ax in axes:
        ax.set_xlim(left.min(), right.max())
        ax.set_ylim(bottom.min(), top.max())


def in_words(result: Result, at: float) -> str:
    """What each whisker does at a position of the drive, in words: "1: tip, 2: free"."""
    (step,) = _steps_at(result, at)
    return ", ".join(f"{k + 1}: {Phase(int(p)).name}" for k, p in enumerate(np.asarray(result.phase)[step]))


def _steps_at(result: Result, at: Any) -> list[int]:
    if np.ndim(at) == 0:
        checks.number("at", at)
    else:
        checks.vector("at", at)
    return [int(np.argmin(np.abs(np.asarray(result.control) - u))) for u in np.atleast_1d(np.asarray(at, dtype=float))]


def _steps_across(result: Result) -> list[int]:
    """Steps evenly over those in contact, or over those that are known, in the order of time."""
    forces = np.asarray(result.contact_force)
    known = np.flatnonzero(np.isfinite(forces).all(axis=1))
    touching = np.flatnonzero((np.nan_to_num(forces) > 0).any(axis=1))
    steps = next((found for found in (touching, known) if found.size), np.arange(forces.shape[0]))
    return steps[((np.arange(STATES) + 0.5) / STATES * steps.size).astype(int)].tolist()


def _draw(scene: Scene, drawn: Sequence[Drawing], whole: bool, ax: Axes) -> None:
    """The last drawing, and the whiskers of those before, paler."""
    profile(scene.profile, length=float(units(scene).length), whole=whole, ax=ax)
    if moves_along_x(scene):
        ax.axhline(0, color=SUPPORT, linewidth=0.5, alpha=0.5, zorder=0)
    for age, one in enumerate(reversed(drawn)):
        opacity = 1.0 if age == 0 else PALEST + (0.7 - PALEST) * (1 - age / len(drawn))
        for k, line in enumerate(one.whiskers):
            label = f"whisker {k + 1}" if age == 0 else None
            style = {"color": colour(k), "alpha": opacity, "zorder": 3 - 0.01 * age}
            ax.plot(line.x, line.y, **style, linewidth=2 if age == 0 else 1.4, solid_capstyle="round", label=label)
            ax.plot(one.bases.x[k], one.bases.y[k], **style, marker="o", markersize=5 if age == 0 else 3)
    last = drawn[-1]
    for line in last.springs:
        ax.plot(line.x, line.y, color=SUPPORT, linewidth=line.width, zorder=2)
    if last.arm is not None:
        ax.plot(
            last.arm.x, last.arm.y, color=SUPPORT, linewidth=0.8, linestyle=":", marker="+", markevery=[0], zorder=1
        )
    place = {"marker": (4, 0, 45 + np.degrees(last.drive.angle)), "linestyle": "none"}  # a square that turns
    look = {"markersize": 10, "markerfacecolor": OBJECT, "markeredgecolor": SUPPORT, "zorder": 1.5}
    ax.plot(last.drive.x, last.drive.y, **place, **look, label="drive")
    for k, arrow in enumerate(last.arrows):
        if arrow is not None:
            style = {"arrowstyle": "-|>", "color": colour(k), "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
            ax.annotate("", xy=arrow.head, xytext=arrow.tail, arrowprops=style, zorder=5)
    ax.set_aspect("equal")
    ax.set_xlabel(r"$x/L$")
    ax.set_ylabel(r"$y/L$")
    _frame(scene, drawn, ax)
    legend_above(ax, [line for line in ax.get_lines() if str(line.get_label()).startswith("whisker")])


def _frame(scene: Scene, drawn: Sequence[Drawing], ax: Axes) -> None:
    """A window that holds drive, whiskers, springs and forces, and the object down to its vertex."""
    parts = [one.extent(springs=one is drawn[-1]) for one in drawn]
    x, y = (np.concatenate(coordinate) for coordinate in zip(*parts, strict=True))
    vertex = float(scene.profile.vertex()[1]) / float(units(scene).length)
    if x.size:
        middle, reach = (x.min() + x.max()) / 2, max(np.ptp(x) / 2 + ROOM, NARROWEST / 2)
        ax.set_xlim(middle - reach, middle + reach)
    ax.set_ylim(y.min(initial=0.0) - ROOM, max(y.max(initial=1.0), vertex) + ROOM)
    if x.size and np.ptp(x) < WIDE:  # else ticks of narrow pictures would overlap
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(MultipleLocator(0.5))
