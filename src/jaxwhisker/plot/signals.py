"""Pictures of signals over the drive: reactions, spring lengths, any quantity of one scan or several."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker._scan.result import Result, check_one_scan
from jaxwhisker.plot.axes import (
    AXIS,
    COLOURS,
    DASHES,
    QUANTITIES,
    axis_label,
    colour,
    column,
    control_axis,
    control_of,
    in_units,
    legend_above,
    mark_events,
    one_axes,
)

_ANGLES = r"$\varphi$ (rad)"
LEAST_HEIGHT = 1e-3  # of an axis: what is constant but for rounding looks constant


def reactions(result: Result, *, axs: Iterable[Axes] | None = None) -> np.ndarray:
    """Draw fx, fy and mz of all whiskers over the drive, with thin lines at events; return the three Axes.

    Args:
        result: of `scan`.
        axs: where to draw, three of them; a new figure by default.

    Raises:
        ValueError: if `result` is none of one scan, or there are not three Axes.
    """
    check_one_scan(result)
    axes = column(axs, len(REACTIONS))
    for ax, quantity in zip(axes, REACTIONS, strict=True):
        signal(result, quantity, ax=ax)
        mark_events(ax, control_of(result, [event.control for event in result.events]))
    for ax in axes[:-1]:
        ax.set_xlabel("")
    legend_above(axes[0], axes[0].get_legend_handles_labels()[0])
    return axes


def spring_lengths(result: Result, *, ax: Axes | None = None) -> Axes:
    """Draw the lengths of all springs (of torsion springs the angles) over the drive, with thin lines at events.

    A spring has the colour of the whisker whose base is its second end; others to the same base are dashed.

    Args:
        result: of `scan`.
        ax: where to draw; a new figure by default.

    Raises:
        ValueError: if `result` is none of one scan, or its bases are clamped.
    """
    if not check_one_scan(result).scene.support.springs:
        raise ValueError(f"`result` must be of whiskers on springs, but is of {result.scene}.")
    ax = signal(result, "spring_length", ax=ax)
    mark_events(ax, control_of(result, [event.control for event in result.events]))
    legend_above(ax, ax.get_legend_handles_labels()[0])
    return ax


def signal(result: Result, quantity: str, *, ax: Axes | None = None) -> Axes:
    """Draw one quantity of all whiskers (or springs) of a scan over the position of the drive.

    Args:
        result: of `scan`.
        quantity: one of `QUANTITIES`.
        ax: where to draw; a new figure by default.

    Raises:
        ValueError: if `result` is none of one scan, or there is no such quantity.
    """
    values = _values(result, quantity)
    styles: list[dict[str, Any]]
    if quantity == "spring_length":
        styles = _springs(result)
    else:
        styles = [{"color": colour(k), "label": f"whisker {k + 1}"} for k in range(values.shape[1])]
    ax = one_axes(ax)
    for own, style in zip(values.T, styles, strict=True):
        ax.plot(control_of(result), own, linewidth=1.3, **style)
    return _finish(ax, [result], quantity)


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
    curves = []
    for result in results.values():
        values = _values(result, quantity)
        if not 1 <= index <= values.shape[1]:
            raise ValueError(f"`index` must lie between 1 and {values.shape[1]}, but is {index}.")
        curves.append((control_of(result), values[:, index - 1]))
    ax = one_axes(ax)
    for k, (label, curve) in enumerate(zip(results, curves, strict=True)):
        # Later curves lie on earlier ones wherever they coincide: thinner, they let those be seen.
        width = 1.8 - 0.9 * k / max(len(results) - 1, 1)
        ax.plot(*curve, color=colours[k % len(colours)], linewidth=width, label=label)
    return _finish(ax, list(results.values()), quantity)


def contact_range(results: Sequence[Any], margin: float = 0.04) -> tuple[float, float]:
    """Range of the control, in L, in which any whisker of any of the scans is in contact, with a margin."""
    touching = [control_of(r)[np.any(np.asarray(r.contact_force) > 0, axis=1)] for r in results]
    known = np.concatenate(touching)
    known = known if known.size else np.concatenate([control_of(r) for r in results])
    low, high = float(known.min()), float(known.max())
    room = margin * max(high - low, 1e-3)
    return low - room, high + room


def _values(result: Result, quantity: str) -> np.ndarray:
    if quantity not in AXIS:
        raise ValueError(f"`quantity` must be one of {', '.join(QUANTITIES)}, but is {quantity!r}.")
    return in_units(check_one_scan(result), quantity)


def _springs(result: Result) -> list[dict[str, Any]]:
    """How the springs are drawn: in the colour of their second base, the first one to it solid."""
    styles, held = [], []
    for k, spring in enumerate(result.scene.support.springs):
        base = max(spring.between[1], 1)
        dashes = DASHES[held.count(base) % len(DASHES)]
        held.append(base)
        along = {"x": "", "y": ", $y$", "phi": r", $\varphi$"}[spring.axis]
        styles.append({"color": colour(base - 1), "linestyle": dashes, "label": f"spring {k + 1}{along}"})
    return styles


def _finish(ax: Axes, results: Sequence[Result], quantity: str) -> Axes:
    for result in results:
        ax.set_xlabel(control_axis(result.scene))
    ax.set_ylabel(_label(results, quantity))
    ax.grid(alpha=0.3)
    low, high = ax.get_ylim()
    if high - low < LEAST_HEIGHT:
        ax.set_ylim((low + high) / 2 - LEAST_HEIGHT, (low + high) / 2 + LEAST_HEIGHT)
    return ax


def _label(results: Sequence[Result], quantity: str) -> str:
    """Of springs what there is: lengths, angles, or both."""
    axes = {spring.axis for result in results for spring in result.scene.support.springs}
    if quantity != "spring_length" or "phi" not in axes:
        return axis_label(quantity)
    return _ANGLES if axes == {"phi"} else f"{axis_label(quantity)}, {_ANGLES}"
