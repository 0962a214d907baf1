"""Figures of quantities over the control or time: reactions, spring lengths, comparisons, and an overview."""

from collections.abc import Iterable, Mapping, Sequence
from textwrap import fill
from typing import Any

import numpy as np
from jax import Array
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxwhisker._base import checks
from jaxwhisker._scan.quantities import OF_SPRINGS, UnitSystem, check_units, kind_of
from jaxwhisker._scan.result import SpaceResult, check_one_scan
from jaxwhisker.plot.axes import (
    COLOURS,
    DASHES,
    GREY,
    colour,
    grid_of_axes,
    legend_above,
    mark_events,
    one_axes,
    unit_systems,
)
from jaxwhisker.plot.runs import (
    Run,
    abscissa,
    check_one_run,
    check_quantity,
    contacts_of,
    events_of,
    places,
    places_of_events,
    reactions_of,
    values_of,
)
from jaxwhisker.plot.states import shapes

_ANGLES = r"$\varphi$ (rad)", r"$\Delta\varphi$ (rad)"  # of torsion springs: lengths and extensions
ROWS, WIDE = 3, (9.0, 5.6)  # rows of reactions; inches, of a figure with two columns
NAMES_OF_AXES = {"y": ", $y$", "z": ", $z$"}
NAMES_OF_AXES |= {axis: rf", $\varphi{axis[3:]}$" for axis in ("phi", "phi_x", "phi_y")}
FRICTION_FORCES = "normal_force", "friction_x", "friction_y", "friction_z"
LEAST_HEIGHT = 1e-3  # of an axis, dimensionless: rounding errors of a constant quantity stay invisible
LEAST_EXTENSION = 1e-9  # the same for extensions, which are small if springs are stiff
LETTERS = 12  # per inch in the title of an overview


def overview(result: Run, *, view: Any = None, units: str = "auto") -> Figure:
    """Draw a scan or a simulation on one page: a state, the reactions and the extensions of the springs.

    A scan is drawn where any whisker is in contact; a simulation from start to end, because whiskers ring down. In
    space, there are six reactions and, with friction, the parts of the contact force.

    Args:
        result: of `scan` or `simulate`.
        view: of a scan in space: (elevation, azimuth), "xy", "xz" or "yz", see `scene`.
        units: "auto", "SI" (with prefixes: mm, mN) or "dimensionless" (in L and EI of the first whisker). "auto" is
            "dimensionless" for a first whisker with L = EI = 1, else "SI".

    Returns:
        A new Figure.

    Raises:
        ValueError: if `result` is not that of one scan or simulation or `units` is invalid.
    """
    springs = bool(check_one_run(result).scene.support.springs)
    low, high = contact_range([result], units=units)
    over, system = abscissa(result), UnitSystem(result.scene, units)
    names, columns = reactions_of(result), len(reactions_of(result)) // ROWS
    friction = FRICTION_FORCES if isinstance(result, SpaceResult) and result.scene.friction is not None else ()
    rows = ROWS + len(friction) // 2 + springs
    figure = Figure(figsize=(11, 6.5) if columns == 1 else (14, 1.9 * rows + 0.8), layout="constrained")
    figure.suptitle(fill(str(result.scene), int(LETTERS * figure.get_figwidth())), fontsize=11)
    grid = figure.add_gridspec(rows, 1 + columns, width_ratios=(1, 1.2) if columns == 1 else (1.3, 1, 1))
    camera = isinstance(result, SpaceResult) and not isinstance(view, str)
    left = figure.add_subplot(grid[:, 0], projection="3d" if camera else None)
    middle = (low + high) / 2 * system.unit(over).size
    shapes(result, middle, view=view, units=units, ax=left)
    axes = [figure.add_subplot(grid[k % ROWS, 1 + k // ROWS]) for k in range(len(names))]
    reactions(result, units=units, axs=axes)
    for k, quantity in enumerate(friction):
        axes.append(figure.add_subplot(grid[ROWS + k // 2, 1 + k % 2]))
        _with_events(result, quantity, units, axes[-1])
    if springs:
        axes.append(figure.add_subplot(grid[rows - 1, 1:]))
        _with_events(result, "spring_extension", units, axes[-1])
        legend_above(axes[-1])
    times = system.shown("time", places(result, "time")) if over == "time" else np.empty(0)
    if np.isfinite(times).any():
        low, high = np.nanmin(times), np.nanmax(times)
    for ax in axes:
        ax.set_xlim(low, high)
        place: Any = ax.get_subplotspec()
        if place.rowspan.stop < rows:
            ax.tick_params(labelbottom=False)
            ax.set_xlabel("")
    return figure


def reactions(result: Run, *, units: str = "auto", axs: Iterable[Axes] | None = None) -> np.ndarray:
    """Draw the reactions of all whiskers over the control or time, with thin lines and markers at events.

    They are fx, fy and mz in the plane, and fx, fy, fz, mx, my and mz in space.

    Args:
        result: of `scan` or `simulate`.
        units: "auto", "SI" or "dimensionless", see `overview`.
        axs: where to draw, three Axes, in space six; a new figure by default.

    Returns:
        The Axes, in the order of the reactions.

    Raises:
        ValueError: if `result` is not that of one scan or simulation, there are not three (six) Axes, or `units` is
            invalid.
    """
    names = reactions_of(check_one_run(result))
    check_units(units)
    columns = len(names) // ROWS
    axes = grid_of_axes(axs, rows=ROWS, columns=columns, sharex=True, **({"figsize": WIDE} if columns > 1 else {}))
    if axs is None:  # forces on the left, moments on the right
        axes = axes.reshape(ROWS, columns).T.ravel()
    entries, *_ = [_with_events(result, quantity, units, ax) for ax, quantity in zip(axes, names, strict=True)]
    for k, ax in enumerate(axes):
        if (k + 1) % ROWS:
            ax.set_xlabel("")
    _name_curves_and_events(axes[0], entries)
    return axes


def spring_lengths(result: Run, *, units: str = "auto", ax: Axes | None = None) -> Axes:
    """Draw the lengths of all springs (the angles of torsion springs) over the control or time, with lines at events.

    A spring has the colour of the whisker at its second end. If several springs end at one base, the first one is solid
    and the others are dashed.

    Args:
        result: of `scan` or `simulate`.
        units: "auto", "SI" or "dimensionless", see `overview`.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not that of one scan or simulation, its bases are clamped, or `units` is invalid.
    """
    return _of_springs(result, "spring_length", units, ax)


def spring_extensions(result: Run, *, units: str = "auto", ax: Axes | None = None) -> Axes:
    """Draw the extensions of all springs, length - rest_length, as `spring_lengths` draws their lengths.

    Args:
        result: of `scan` or `simulate`.
        units: "auto", "SI" or "dimensionless", see `overview`.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not that of one scan or simulation, its bases are clamped, or `units` is invalid.
    """
    return _of_springs(result, "spring_extension", units, ax)


def _of_springs(result: Run, quantity: str, units: str, ax: Axes | None) -> Axes:
    if not check_one_run(result).scene.support.springs:
        raise ValueError(f"`result` must have whiskers on springs, got a scan of {result.scene}.")
    check_units(units)
    ax = one_axes(ax)
    _name_curves_and_events(ax, _with_events(result, quantity, units, ax))
    return ax


def _with_events(result: Run, quantity: str, units: str, ax: Axes) -> list[Line2D]:
    """Draw a quantity and the events, and return the entries of a legend for the events."""
    system, over = UnitSystem(result.scene, units), abscissa(result)
    _draw(result, quantity, system, ax)
    return mark_events(ax, system.shown(over, places_of_events(result, over)).tolist(), events_of(result))


def _name_curves_and_events(ax: Axes, entries: list[Line2D]) -> None:
    curves = ax.get_legend_handles_labels()[0]
    legend_above(ax, (curves if len(curves) > 1 else []) + entries, least=1)


def signal(result: Run, quantity: str, *, units: str = "auto", ax: Axes | None = None) -> Axes:
    """Draw one quantity of all whiskers (or springs): of a scan over the control, of a simulation over time.

    If whiskers may have several contacts, quantities of contacts have a curve for each: solid for the outermost one,
    dashed for the next. Except for the force, curves end where there is no contact.

    Args:
        result: of `scan` or `simulate`.
        quantity: one of `QUANTITIES`; of a simulation also "gap", "tip_x" or "tip_y"; of a scan in space also "fz",
            "mx", "my", "base_z", "contact_z", "friction_x", "friction_y" or "friction_z".
        units: "auto", "SI" or "dimensionless", see `overview`.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not that of one scan or simulation, or `quantity` or `units` is invalid.
    """
    system = UnitSystem(check_one_run(result).scene, units)
    check_quantity(quantity, result)
    ax = one_axes(ax)
    _draw(result, quantity, system, ax)
    legend_above(ax)
    return ax


def _draw(result: Run, quantity: str, system: UnitSystem, ax: Axes) -> None:
    over = abscissa(result)
    x, values = _curve(result, over, quantity, system)
    for own, style in zip(values.T, _styles(result, quantity, values.shape[1]), strict=True):
        ax.plot(x, own, linewidth=1.3, **style)
    _finish(ax, [system], over, quantity)


def compare(
    results: Mapping[str, Run],
    quantity: str,
    *,
    index: int = 1,
    units: str = "auto",
    ax: Axes | None = None,
    colours: Sequence[str] = COLOURS,
) -> Axes:
    """Draw one quantity of several scans or simulations, with a legend of their labels.

    Curves of several contacts are solid for the outermost one, and dashed for the next.

    Simulations are drawn over time. If there is a scan among them, all are drawn over the control.

    Args:
        results: results of `scan` or `simulate` by label.
        quantity: one of `QUANTITIES`: "fx", "fy", "mz", "spring_extension", "base_x", ...; of simulations also "gap",
            "tip_x" or "tip_y".
        index: number of the whisker, or of the spring, from 1.
        units: "auto", "SI" or "dimensionless", see `overview`. SI units are those of the first result; if any is
            dimensionless, "auto" is "dimensionless" for all.
        ax: where to draw; a new figure by default.
        colours: one per result, repeated if there are more results.

    Returns:
        The Axes.

    Raises:
        ValueError: if `results` is not a mapping to results of one scan or simulation each, or `quantity`, `index` or
            `units` is invalid.
    """
    checks.instance("results", results, Mapping, "a mapping from labels to Results")
    runs = _all_runs(list(results.values()))
    check_quantity(quantity, *runs)
    over, systems = abscissa(*runs), unit_systems(runs, units)
    curves = []
    for run, system in zip(runs, systems, strict=True):
        x, values = _curve(run, over, quantity, system)
        values = values.reshape(values.shape[0], -1, contacts_of(run, quantity))
        if not isinstance(index, int | np.integer) or not 1 <= index <= values.shape[1]:
            raise ValueError(f"`index` must lie between 1 and {values.shape[1]}, got {index!r}.")
        curves.append((x, values[:, index - 1].T))
    ax = one_axes(ax)
    for k, (label, (x, each)) in enumerate(zip(results, curves, strict=True)):
        # Later curves are drawn over earlier ones. Thinner lines leave those visible where both coincide.
        width = 1.8 - 0.9 * k / max(len(results) - 1, 1)
        for contact, values in enumerate(each):  # one curve, unless whiskers may have several contacts
            style: dict[str, Any] = {"color": colours[k % len(colours)], "linestyle": DASHES[contact % len(DASHES)]}
            ax.plot(x, values, **style, linewidth=width, label=None if contact else label)
    _finish(ax, systems, over, quantity)
    legend_above(ax, least=1)
    return ax


def lateral_losses(
    result: Run, losses: Float[Array | np.ndarray, " whiskers"], *, axs: Iterable[Axes], units: str = "auto"
) -> np.ndarray:
    """Mark in drawn signals where whiskers leave the plane of the scan, unless something guides them.

    A dotted line marks the loss of each whisker, in its colour if there are several, and the range beyond the first one
    is shaded.

    Args:
        result: of `scan`.
        losses: of `lateral_loss`; NaN for whiskers that stay in the plane.
        axs: where the signals of this result are drawn over the control, such as the Axes of `reactions`.
        units: of these signals, see `overview`.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not that of one scan, or `units` is invalid.
    """
    system, control = UnitSystem(check_one_scan(result).scene, units), np.asarray(result.control)
    places, (first, last) = (system.shown("control", values) for values in (np.asarray(losses), control[[0, -1]]))
    axes = np.array(list(axs))
    for ax in axes:
        limits = ax.get_xlim()
        for k in np.flatnonzero(np.isfinite(places)):
            # With one whisker, colours may distinguish scans.
            own = colour(int(k)) if places.size > 1 else "0.35"
            ax.axvline(places[k], color=own, linestyle=":", linewidth=1.2)
        if np.isfinite(places).any():
            end, beyond = (limits[0], np.nanmax(places)) if last < first else (limits[1], np.nanmin(places))
            ax.axvspan(beyond, end, color=GREY, alpha=0.15, linewidth=0, zorder=0)
            place = {"xy": (beyond, 0.02), "xycoords": ax.get_xaxis_transform(), "textcoords": "offset points"}
            side = {"xytext": (-4, 0), "ha": "right"} if last < first else {"xytext": (4, 0), "ha": "left"}
            ax.annotate("needs lateral guidance", **place, **side, va="bottom", fontsize="x-small", color="0.35")
        ax.set_xlim(limits)
    return axes


def contact_range(results: Sequence[Run], margin: float = 0.04, *, units: str = "auto") -> tuple[float, float]:
    """Range of the control (of simulations: of time) in which any whisker is in contact, with a margin.

    Args:
        results: results of `scan` or `simulate`.
        margin: fraction of the range that is added at both ends.
        units: "auto", "SI" or "dimensionless", see `compare`.

    Returns:
        Smallest and largest control or time, in the units of figures; those of the whole motion without contact.

    Raises:
        ValueError: if `results` are not those of one scan or simulation each, or `units` is invalid.
    """
    runs = _all_runs(results)
    over, systems = abscissa(*runs), unit_systems(runs, units)
    shown = [system.shown(over, places(run, over)) for system, run in zip(systems, runs, strict=True)]
    touching = [np.any(np.asarray(run.contact_force) > 0, axis=tuple(range(1, run.phase.ndim))) for run in runs]
    known = np.concatenate([place[own] for place, own in zip(shown, touching, strict=True)])
    known = known if known.size else np.concatenate(shown)
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    room = margin * max(high - low, 1e-3 * systems[0].scale(kind_of(over, systems[0].scene)))
    return low - room, high + room


def _all_runs(results: Any) -> Sequence[Run]:
    """The results, if there is at least one and each is of one scan or simulation."""
    if not isinstance(results, Sequence) or not results:
        raise ValueError(f"`results` must hold at least one Result, got {results!r}.")
    return [check_one_run(result) for result in results]


def _curve(run: Run, over: str, quantity: str, system: UnitSystem) -> tuple[np.ndarray, np.ndarray]:
    """Controls or times (steps,) and values (steps, whiskers or springs) in the units shown."""
    return system.shown(over, places(run, over)), system.shown(quantity, values_of(run, quantity))


def _styles(result: Run, quantity: str, count: int) -> list[dict[str, Any]]:
    """Styles of the curves of whiskers or springs; a spring has the colour of its second base, the first is solid."""
    if (contacts := contacts_of(result, quantity)) > 1:
        return [
            {
                "color": colour(k // contacts),
                "linestyle": DASHES[k % contacts % len(DASHES)],
                "label": f"whisker {k // contacts + 1}, contact {k % contacts + 1}",
            }
            for k in range(count)
        ]
    if quantity not in OF_SPRINGS:
        return [{"color": colour(k), "label": f"whisker {k + 1}"} for k in range(count)]
    styles, bases = [], []
    for k, spring in enumerate(result.scene.support.springs):
        base = max(spring.between[1], 1)
        dashes = DASHES[bases.count(base) % len(DASHES)]
        bases.append(base)
        along = NAMES_OF_AXES.get(spring.axis, "")
        styles.append({"color": colour(base - 1), "linestyle": dashes, "label": f"spring {k + 1}{along}"})
    return styles


def _finish(ax: Axes, systems: Sequence[UnitSystem], over: str, quantity: str) -> None:
    ax.set_xlabel(systems[-1].label(over))
    # Torsion springs have angles.
    turning = {s.turns for system in systems for s in system.scene.support.springs} if quantity in OF_SPRINGS else set()
    label, angles = systems[0].label(quantity), _ANGLES[quantity == "spring_extension"]
    ax.set_ylabel(label if True not in turning else angles if turning == {True} else f"{label}, {angles}")
    ax.grid(alpha=0.3)
    low, high = ax.get_ylim()
    least = LEAST_EXTENSION if quantity == "spring_extension" else LEAST_HEIGHT
    least = least * systems[0].scale(kind_of(quantity, systems[0].scene))
    if high - low < least:
        ax.set_ylim((low + high) / 2 - least, (low + high) / 2 + least)
