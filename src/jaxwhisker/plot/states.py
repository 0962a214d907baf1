"""Figures of whiskers, springs, drive and object: before a scan, during a run, and under given loads."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

from jaxwhisker._base import checks
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, moves_along_x, objects_of
from jaxwhisker._model.silhouette import behind, silhouette_of
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._model.surfaces import as_one_surface
from jaxwhisker._scan.array import Array as WhiskerArray
from jaxwhisker._scan.deflect import Deflection
from jaxwhisker._scan.quantities import Unit, UnitSystem, kind_of
from jaxwhisker._scan.result import SpaceResult
from jaxwhisker.plot.axes import (
    OBJECT,
    SUPPORT,
    colour,
    label_coordinates,
    legend_above,
    length_unit,
    one_axes,
    rounded,
    several_axes,
    title,
)
from jaxwhisker.plot.drawing import Drawing, drawing, drawing_at, rest_state, start_of
from jaxwhisker.plot.runs import Run, abscissa, check_one_run, places
from jaxwhisker.plot.view import check_no_view

MINUS = "\N{MINUS SIGN}"
STATES = 5  # drawn by default
MOST_LISTED = 6  # positions of the drive that fit into a title
PALEST = 0.25  # opacity of the earliest of several states
# Lengths are in L of the first whisker.
NARROWEST = 1.3  # least width of a window
WIDE = 3.0  # a narrower window has ticks about half an L apart
WINDOW_MARGIN = 0.1  # around what is drawn
BESIDE = 0.5  # distance from the vertex of an object to both sides up to which it is shown


def scene(
    setup: AbstractScene | WhiskerArray,
    *,
    surface: AbstractSurface | tuple[AbstractSurface, ...] | None = None,
    view: Any = None,
    units: str = "auto",
    ax: Axes | None = None,
) -> Axes:
    """Draw a scene before its scan: object, drive, springs and unloaded whiskers.

    The drive stands where the first whisker is about to touch, or at the start of a motion that has ends. Nothing is
    solved.

    In space, the picture also shows the directors d1, d2 and d3 at the bases. What the object hides is paler. An object
    that goes on far beyond the whiskers is cut off.

    An Array is drawn at the control 0, every whisker with its shape, base point and direction.

    Args:
        setup: a Scene or an Array.
        surface: the object beside an Array. Default: none.
        view: of a scene in space: a camera at (elevation, azimuth) in degrees, or the projection "xy", "xz" or "yz". At
            (0, 0) the camera looks along -z, with x to the right; the elevation raises it, and the azimuth moves it
            towards +x. "xy" looks along -z, "xz" from below, where the whiskers are, and "yz" along x, with z to the
            right. Default: (15, 35), or "xy" in plain Axes.
        units: "auto", "SI" (with prefixes: mm, mN) or "dimensionless" (in L and EI of the first whisker). "auto" is
            "dimensionless" for a first whisker with L = EI = 1, else "SI".
        ax: where to draw, for a camera 3D Axes; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `setup` is neither a Scene nor an Array, `surface` is not the object of an Array, `view` or
            `units` is invalid, or `ax` does not suit `view`.
    """
    if isinstance(setup, WhiskerArray):
        from jaxwhisker.plot.space import draw_array

        body = as_one_surface(surface)
        if body is not None:
            checks.instance("surface", body, AbstractSurface, "a surface, such as a Sphere, or a tuple of surfaces")
        return draw_array(setup, body, units, view, ax)
    checks.instance("setup", setup, AbstractScene, "a Scene or an Array")
    if surface is not None:
        checks.fail("surface", "None for a Scene, which has an object", repr(surface))
    system = UnitSystem(setup, units)
    if not isinstance(setup, Scene):
        from jaxwhisker.plot.space import draw_scene

        return draw_scene(system.scene, system, view, ax)
    check_no_view(view)
    ax = one_axes(ax)
    control = start_of(setup)
    _draw_states([drawing(setup, control, rest_state(setup, control))], system, True, ax)
    return ax


def shapes(
    result: Run,
    at: Any = None,
    *,
    whole: bool = True,
    view: Any = None,
    units: str = "auto",
    ax: Axes | None = None,
) -> Axes:
    """Draw whiskers, springs, drive, object and contact forces at one or several positions of the drive, or times.

    If there are several, earlier whiskers are paler; springs, drive and forces belong to the last one. Arrows point in
    the direction in which the object pushes the whisker; their length grows with the force, relative to the largest
    contact force (of a simulation, without short impacts). Failed steps are left out.

    In space, a dotted line is the way of the contact during the whole scan.

    Args:
        result: result of `scan` or `simulate`.
        at: drive position or positions of a scan, or time or times of a simulation, in the scene's unit; the nearest
            steps are drawn. Default: five across the contact.
        whole: draw the upper half of a circle or ellipse too, which no whisker touches.
        view: of a scan in space: (elevation, azimuth), "xy", "xz" or "yz", see `scene`.
        units: "auto", "SI" or "dimensionless", see `scene`.
        ax: where to draw, for a camera 3D Axes; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not that of one scan or simulation, `at` is not finite numbers within it, `view` or
            `units` is invalid, or `ax` does not suit `view`.
    """
    system = UnitSystem(check_one_run(result).scene, units)
    steps = _steps_across(result) if at is None else _steps_at(result, at)
    if isinstance(result, SpaceResult):
        from jaxwhisker.plot.space import draw_shapes

        ax = draw_shapes(result, steps, system, view, ax)
    else:
        check_no_view(view)
        ax = one_axes(ax)
        _draw_states([drawing_at(result, step) for step in steps], system, whole, ax)
    if len(steps) <= MOST_LISTED:
        # To a thousandth of L or T for one step, to a hundredth for several.
        over = abscissa(result)
        digits = max(decimals(system, over) - (len(steps) > 1), 0)
        listed = ", ".join(f"{place:.{digits}f}" for place in system.shown(over, places(result, over))[steps])
        title(ax, f"{system.label(over)}: {listed.replace('-', MINUS)}")
    return ax


def decimals(system: UnitSystem, over: str = "control") -> int:
    """Decimals that resolve about a thousandth of L along the control, or of T."""
    return max(3 - round(np.log10(system.scale(kind_of(over, system.scene)))), 0)


def profile(shape: AbstractProfile, *, length: float = 1.0, whole: bool = True, ax: Axes | None = None) -> Axes:
    """Draw an object.

    Args:
        shape: profile of the object, such as `jw.Parabola`.
        length: unit of length: this length is drawn as 1.
        whole: draw the upper half of a circle or ellipse too, which no whisker touches.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `shape` is not a profile or `length` is not positive.
    """
    checks.instance("shape", shape, AbstractProfile, "a profile such as jw.Parabola(0.2)")
    checks.number("length", length, positive=True)
    ax = one_axes(ax)
    _draw_object(shape, length, length, whole, ax)
    return ax


def deflection(
    results: Mapping[str, Deflection], *, length: float | None = None, units: str = "auto", ax: Axes | None = None
) -> Axes:
    """Draw whiskers bent by given loads.

    Args:
        results: results of `deflect` by label.
        length: the length L that is drawn as 1 if units are dimensionless; by default that of the longest whisker.
        units: "auto", "SI" or "dimensionless". "auto" is "SI" unless `length` is given or L = 1.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `results` is not a mapping to results of `deflect`, `length` is not positive or `units` is
            invalid.
    """
    words = "a non-empty mapping from labels to results of jw.deflect"
    checks.instance("results", results, Mapping, words)
    for one in list(results.values()) or [None]:
        checks.instance("results", one, Deflection, words)
    if length is not None:
        checks.number("length", length, positive=True)
    longest = max((s for one in results.values() if np.isfinite(s := float(one.s[-1]))), default=1.0)
    unit = length_unit(longest, "dimensionless" if units == "auto" and length is not None else units)
    if length is not None and not unit.name:
        unit = Unit("", length)
    ax = one_axes(ax)
    for k, (label, result) in enumerate(results.items()):
        x, y = np.asarray(result.x) / unit.size, np.asarray(result.y) / unit.size
        ax.plot(x, y, color=colour(k), linewidth=2, label=label)
    ax.plot(0, 0, marker="s", markersize=8, color=SUPPORT, zorder=4)
    ax.grid(alpha=0.3)
    label_coordinates(ax, unit)
    return ax


def same_window(axs: Iterable[Axes]) -> None:
    """Give several Axes the same limits, which hold everything that any of them shows.

    Raises:
        ValueError: if `axs` are not Axes.
    """
    axes = several_axes(axs)
    left, right, bottom, top = np.array([(*ax.get_xlim(), *ax.get_ylim()) for ax in axes]).T
    for ax in axes:
        ax.set(xlim=(left.min(), right.max()), ylim=(bottom.min(), top.max()))


def in_words(result: Run, at: float) -> str:
    """Phases of all whiskers at a position of the drive, or time, such as "1: tip, 2: free".

    Several contacts of a whisker are named from the tip to the base, such as "1: tip and tangential".

    Args:
        result: result of `scan` or `simulate`.
        at: drive position or time in the scene's unit; the nearest step is described.

    Raises:
        ValueError: if `result` is not that of one scan or simulation, or `at` is not a finite number within it.
    """
    (step,) = _steps_at(check_one_run(result), at)
    return ", ".join(f"{k + 1}: {_phases_in_words(phase)}" for k, phase in enumerate(np.asarray(result.phase)[step]))


def _phases_in_words(phase: np.ndarray | np.integer) -> str:
    """The phase of a whisker, or those of its contacts."""
    contacts = np.atleast_1d(phase)
    touching = contacts[contacts != Phase.free]
    return " and ".join(Phase(int(p)).name for p in touching) or Phase.free.name


def _steps_at(result: Run, at: Any) -> list[int]:
    (checks.vector if np.ndim(at) else checks.number)("at", at)
    over = abscissa(result)
    all_places = places(result, over)
    checks.within("at", at, all_places, "times of the simulation" if over == "time" else "drive positions of the scan")
    return [int(np.argmin(np.abs(all_places - one))) for one in np.atleast_1d(np.asarray(at, dtype=float))]


def _steps_across(result: Run) -> list[int]:
    """Evenly spaced steps with contact, or known ones if there is no contact, in the order of time."""
    forces = np.asarray(result.contact_force).reshape(np.size(result.control), -1)
    known = np.flatnonzero(np.isfinite(forces).all(axis=1))
    touching = np.flatnonzero((np.nan_to_num(forces) > 0).any(axis=1))
    steps = next((some for some in (touching, known) if some.size), np.arange(forces.shape[0]))
    return steps[((np.arange(STATES) + 0.5) / STATES * steps.size).astype(int)].tolist()


def draw_object(system: UnitSystem, ax: Axes, *, whole: bool = True) -> None:
    """Draw the objects of a scene and, if all bases move along x only, the line on which they move."""
    lengths = system.unit("base_x").size
    for one in objects_of(system.scene):
        _draw_object(one, lengths * system.scale("length"), lengths, whole, ax)
    if moves_along_x(system.scene):
        ax.axhline(0, color=SUPPORT, linewidth=0.5, alpha=0.5, zorder=0)
    ax.set(xlabel=system.label_of("x", "length"), ylabel=system.label_of("y", "length"))


def _draw_object(shape: AbstractProfile, whisker: float, unit: float, whole: bool, ax: Axes) -> None:
    for one in shape.objects:
        x, y = (coordinate / unit for coordinate in silhouette_of(one, whisker, whole=whole))
        rest = np.empty((0, 2)) if one.closed else behind(x, y)
        ax.fill(np.append(x, rest[:, 0]), np.append(y, rest[:, 1]), color=OBJECT, linewidth=0, zorder=0)
        ax.plot(x, y, color=SUPPORT, linewidth=1, zorder=0.5)


def _draw_states(drawn: Sequence[Drawing], system: UnitSystem, whole: bool, ax: Axes) -> None:
    """Draw the object, the last state, and, paler, the whiskers of the states before."""
    draw_object(system, ax, whole=whole)
    scaled = [one.scaled(system.scale("length")) for one in drawn]
    for age, one in enumerate(reversed(scaled)):
        opacity = 1.0 if age == 0 else PALEST + (0.7 - PALEST) * (1 - age / len(drawn))
        for k, line in enumerate(one.whiskers):
            label = f"whisker {k + 1}" if age == 0 else None
            style = {"color": colour(k), "alpha": opacity, "zorder": 3 - 0.01 * age}
            ax.plot(line.x, line.y, **style, linewidth=2 if age == 0 else 1.4, solid_capstyle="round", label=label)
            ax.plot(one.bases.x[k], one.bases.y[k], **style, marker="o", markersize=5 if age == 0 else 3)
    _draw_support(scaled[-1], ax)
    contacts = len(scaled[-1].arrows) // len(scaled[-1].whiskers)
    for k, arrow in enumerate(scaled[-1].arrows):
        if arrow is not None:
            draw_arrow(arrow.tail, arrow.head, colour(k // contacts), ax)
    ax.set_aspect("equal")
    _set_window(drawn, system, ax)
    legend_above(ax, [line for line in ax.get_lines() if str(line.get_label()).startswith("whisker")])


def draw_arrow(tail: tuple[float, float], head: tuple[float, float], own: str, ax: Axes) -> None:
    """Draw a force."""
    style = {"arrowstyle": "-|>", "color": own, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", xy=head, xytext=tail, arrowprops=style, zorder=5)


def _draw_support(state: Drawing, ax: Axes) -> None:
    for line in state.springs:
        ax.plot(line.x, line.y, color=SUPPORT, linewidth=line.width, zorder=2)
    if state.arm is not None:
        style = {"linewidth": 0.8, "linestyle": ":", "marker": "+", "markevery": [0], "zorder": 1}
        ax.plot(state.arm.x, state.arm.y, color=SUPPORT, **style)
    square = {"marker": (4, 0, 45 + np.degrees(state.drive.angle)), "linestyle": "none"}
    look = {"markersize": 10, "markerfacecolor": OBJECT, "markeredgecolor": SUPPORT, "zorder": 1.5}
    ax.plot(state.drive.x, state.drive.y, **square, **look, label="drive")


def _set_window(drawn: Sequence[Drawing], system: UnitSystem, ax: Axes) -> None:
    """Set limits that hold drive, whiskers, springs and forces, and every object on both sides of its vertex."""
    parts = [one.extent(springs=one is drawn[-1]) for one in drawn]
    x, y = (np.concatenate(coordinate) for coordinate in zip(*parts, strict=True))
    scale = system.scale("length")
    vertices = [system.shown("contact_x", np.asarray(one.vertex())) / scale for one in objects_of(system.scene)]
    vertex = max((float(height) for _, height in vertices), default=0.0)
    if x.size:
        middle, reach = (x.min() + x.max()) / 2, max(np.ptp(x) / 2 + WINDOW_MARGIN, NARROWEST / 2)
        left = min([middle - reach, *(float(at) - BESIDE for at, _ in vertices)])
        right = max([middle + reach, *(float(at) + BESIDE for at, _ in vertices)])
        ax.set_xlim(scale * left, scale * right)
    ax.set_ylim(scale * (y.min(initial=0.0) - WINDOW_MARGIN), scale * (max(y.max(initial=1.0), vertex) + WINDOW_MARGIN))
    if x.size and np.ptp(x) < WIDE:  # by default the ticks of a narrow window overlap
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(MultipleLocator(rounded(0.5 * scale)))
