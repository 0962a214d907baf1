"""Figures of quantities over the control: reactions, spring lengths, comparisons, and a whole scan on one page."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxwhisker._base import checks
from jaxwhisker._scan.quantities import REACTIONS, UnitSystem, check_units, kind_of
from jaxwhisker._scan.result import Result, check_one_scan
from jaxwhisker.plot.axes import (
    COLOURS,
    DASHES,
    check_quantity,
    colour,
    grid_of_axes,
    legend_above,
    mark_events,
    one_axes,
    unit_systems,
)
from jaxwhisker.plot.states import shapes

_ANGLES = r"$\varphi$ (rad)"
LEAST_HEIGHT = 1e-3  # of an axis, dimensionless: rounding errors of a constant quantity stay invisible


def overview(result: Result, *, units: str = "auto") -> Figure:
    """Draw a scan on one page: a state, the reactions and the lengths of the springs.

    Args:
        result: of `scan`.
        units: "auto", "SI" (with prefixes: mm, mN) or "dimensionless" (in L and EI of the first whisker). "auto" is
            "dimensionless" for a first whisker with L = EI = 1, else "SI".

    Returns:
        A new Figure.

    Raises:
        ValueError: if `result` is not the Result of one scan or `units` is invalid.
    """
    springs = bool(check_one_scan(result).scene.support.springs)
    low, high = contact_range([result], units=units)
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    figure.suptitle(str(result.scene), fontsize=11)
    grid = figure.add_gridspec(len(REACTIONS) + springs, 2, width_ratios=(1, 1.2))
    middle = (low + high) / 2 * UnitSystem(result.scene, units).unit("control").size
    shapes(result, middle, units=units, ax=figure.add_subplot(grid[:, 0]))
    axes = [figure.add_subplot(grid[row, 1]) for row in range(grid.nrows)]
    reactions(result, units=units, axs=axes[:3])
    if springs:
        spring_lengths(result, units=units, ax=axes[3])
    for ax in axes:
        ax.set_xlim(low, high)
    for ax in axes[:-1]:
        ax.tick_params(labelbottom=False)
        ax.set_xlabel("")
    return figure


def reactions(result: Result, *, units: str = "auto", axs: Iterable[Axes] | None = None) -> np.ndarray:
    """Draw fx, fy and mz of all whiskers over the control, with thin lines at events.

    Args:
        result: of `scan`.
        units: "auto", "SI" or "dimensionless", see `overview`.
        axs: where to draw, three Axes; a new figure by default.

    Returns:
        The three Axes.

    Raises:
        ValueError: if `result` is not the Result of one scan, there are not three Axes, or `units` is invalid.
    """
    check_one_scan(result)
    check_units(units)
    axes = grid_of_axes(axs, rows=len(REACTIONS), sharex=True)
    for ax, quantity in zip(axes, REACTIONS, strict=True):
        _with_events(result, quantity, units, ax)
    for ax in axes[:-1]:
        ax.set_xlabel("")
    legend_above(axes[0])
    return axes


def spring_lengths(result: Result, *, units: str = "auto", ax: Axes | None = None) -> Axes:
    """Draw the lengths of all springs (the angles of torsion springs) over the control, with thin lines at events.

    A spring has the colour of the whisker at its second end. If several springs end at one base, the first one is solid
    and the others are dashed.

    Args:
        result: of `scan`.
        units: "auto", "SI" or "dimensionless", see `overview`.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not the Result of one scan, its bases are clamped, or `units` is invalid.
    """
    if not check_one_scan(result).scene.support.springs:
        raise ValueError(f"`result` must have whiskers on springs, got a scan of {result.scene}.")
    ax = _with_events(result, "spring_length", units, ax)
    legend_above(ax)
    return ax


def _with_events(result: Result, quantity: str, units: str, ax: Axes | None) -> Axes:
    ax = signal(result, quantity, units=units, ax=ax)
    controls = [event.control for event in result.events]
    mark_events(ax, UnitSystem(result.scene, units).shown("control", controls).tolist())
    return ax


def signal(result: Result, quantity: str, *, units: str = "auto", ax: Axes | None = None) -> Axes:
    """Draw one quantity of all whiskers (or springs) of a scan over the control.

    Args:
        result: of `scan`.
        quantity: one of `QUANTITIES`.
        units: "auto", "SI" or "dimensionless", see `overview`.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not the Result of one scan, or `quantity` or `units` is invalid.
    """
    system = UnitSystem(check_one_scan(result).scene, units)
    check_quantity(quantity)
    control, values = _over_control(result, quantity, system)
    ax = one_axes(ax)
    for own, style in zip(values.T, _styles(result, quantity, values.shape[1]), strict=True):
        ax.plot(control, own, linewidth=1.3, **style)
    return _finish(ax, [system], quantity)


def compare(
    results: Mapping[str, Result],
    quantity: str,
    *,
    index: int = 1,
    units: str = "auto",
    ax: Axes | None = None,
    colours: Sequence[str] = COLOURS,
) -> Axes:
    """Draw one quantity of several scans over the control.

    Args:
        results: results of `scan` by label.
        quantity: one of `QUANTITIES`: "fx", "fy", "mz", "spring_length", "base_x", ...
        index: number of the whisker, or of the spring, from 1.
        units: "auto", "SI" or "dimensionless", see `overview`. SI units are those of the first scan; if any scan is
            dimensionless, "auto" is "dimensionless" for all.
        ax: where to draw; a new figure by default.
        colours: one per result, repeated if there are more results.

    Returns:
        The Axes.

    Raises:
        ValueError: if `results` is not a mapping to Results of one scan each, or `quantity`, `index` or `units` is
            invalid.
    """
    checks.instance("results", results, Mapping, "a mapping from labels to Results")
    check_quantity(quantity)
    systems = unit_systems(_all_scans(list(results.values())), units)
    curves = []
    for result, system in zip(results.values(), systems, strict=True):
        control, values = _over_control(result, quantity, system)
        if not isinstance(index, int | np.integer) or not 1 <= index <= values.shape[1]:
            raise ValueError(f"`index` must lie between 1 and {values.shape[1]}, got {index!r}.")
        curves.append((control, values[:, index - 1]))
    ax = one_axes(ax)
    for k, (label, curve) in enumerate(zip(results, curves, strict=True)):
        # Later curves are drawn over earlier ones. Thinner lines leave those visible where both coincide.
        width = 1.8 - 0.9 * k / max(len(results) - 1, 1)
        ax.plot(*curve, color=colours[k % len(colours)], linewidth=width, label=label)
    return _finish(ax, systems, quantity)


def contact_range(results: Sequence[Result], margin: float = 0.04, *, units: str = "auto") -> tuple[float, float]:
    """Range of the control in which any whisker of any scan is in contact, with a margin.

    Args:
        results: results of `scan`.
        margin: fraction of the range that is added at both ends.
        units: "auto", "SI" or "dimensionless", see `compare`.

    Returns:
        Smallest and largest control, in the units of figures.

    Raises:
        ValueError: if `results` are not Results of one scan each or `units` is invalid.
    """
    systems = unit_systems(_all_scans(results), units)
    controls = [system.shown("control", result.control) for system, result in zip(systems, results, strict=True)]
    touching = [np.any(np.asarray(result.contact_force) > 0, axis=1) for result in results]
    known = np.concatenate([control[own] for control, own in zip(controls, touching, strict=True)])
    known = known if known.size else np.concatenate(controls)
    low, high = float(known.min()), float(known.max())
    room = margin * max(high - low, 1e-3 * systems[0].scale(kind_of("control", systems[0].scene)))
    return low - room, high + room


def _all_scans(results: Any) -> Sequence[Result]:
    """The results, if there is at least one and each is of one scan."""
    if not isinstance(results, Sequence) or not results:
        raise ValueError(f"`results` must hold at least one Result, got {results!r}.")
    return [check_one_scan(result) for result in results]


def _over_control(result: Result, quantity: str, system: UnitSystem) -> tuple[np.ndarray, np.ndarray]:
    """Controls (steps,) and values (steps, whiskers or springs) in the units shown."""
    return system.shown("control", result.control), system.shown(quantity, getattr(result, quantity))


def _styles(result: Result, quantity: str, count: int) -> list[dict[str, Any]]:
    """Styles of the curves of whiskers or springs; a spring has the colour of its second base, the first is solid."""
    if quantity != "spring_length":
        return [{"color": colour(k), "label": f"whisker {k + 1}"} for k in range(count)]
    styles, bases = [], []
    for k, spring in enumerate(result.scene.support.springs):
        base = max(spring.between[1], 1)
        dashes = DASHES[bases.count(base) % len(DASHES)]
        bases.append(base)
        along = {"x": "", "y": ", $y$", "phi": r", $\varphi$"}[spring.axis]
        styles.append({"color": colour(base - 1), "linestyle": dashes, "label": f"spring {k + 1}{along}"})
    return styles


def _finish(ax: Axes, systems: Sequence[UnitSystem], quantity: str) -> Axes:
    ax.set_xlabel(systems[-1].label("control"))
    # Torsion springs have angles.
    axes = {s.axis for system in systems for s in system.scene.support.springs} if quantity == "spring_length" else ""
    label = systems[0].label(quantity)
    ax.set_ylabel(label if "phi" not in axes else _ANGLES if axes == {"phi"} else f"{label}, {_ANGLES}")
    ax.grid(alpha=0.3)
    low, high = ax.get_ylim()
    least = LEAST_HEIGHT * systems[0].scale(kind_of(quantity, systems[0].scene))
    if high - low < least:
        ax.set_ylim((low + high) / 2 - least, (low + high) / 2 + least)
    return ax
