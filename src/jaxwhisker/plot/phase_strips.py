"""Strips over the control or time: where whiskers are free, in tip contact or in tangential contact, and events."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.path import EventKind, Status
from jaxwhisker._scan.quantities import UnitSystem
from jaxwhisker._scan.result import Event
from jaxwhisker._scan.route import turns_of
from jaxwhisker.plot.axes import GREY, colour, event_entries, event_marker, legend_above, one_axes
from jaxwhisker.plot.runs import Run, abscissa, check_one_run, events_of, places, places_of_events, progress

_HEIGHT = 0.6  # of the strips of a whisker; rows are 1 apart
_IN_STRIPS = (EventKind.tip_to_tangential, EventKind.tangential_to_tip)  # events that the strips show without a marker


def phases(result: Run, *, units: str = "auto", ax: Axes | None = None) -> Axes:
    """Draw where each whisker is free, in tip contact (hatched) or in tangential contact (solid), and its events.

    If whiskers may have several contacts, each contact has its own row, from the outermost one on.

    The horizontal axis is the control, or the time of a simulation. If the drive of a scan reverses, each part of its
    path has its own strip, from top to bottom. Failed steps leave gaps.

    Args:
        result: of `scan` or `simulate`.
        units: "auto", "SI" or "dimensionless", see `overview`.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not that of one scan or simulation, or `units` is invalid.
    """
    system = UnitSystem(check_one_run(result).scene, units)
    ax = one_axes(ax)
    over = abscissa(result)
    control, phase = system.shown(over, places(result, over)), np.asarray(result.phase)
    known = np.asarray(result.status) == Status.ok
    # The travel of the drive grows even where the control reverses.
    events, (travel, happens) = events_of(result), (system.shown(over, place) for place in progress(result))
    at = system.shown(over, places_of_events(result, over))
    turns = _turns(control)
    height, whiskers = _HEIGHT / (len(turns) - 1), phase.shape[1]
    tall = height if len(turns) == 2 else 0.85 * height
    phase = phase.reshape(phase.shape[0], -1)
    contacts = phase.shape[1] // whiskers
    for row in range(phase.shape[1]):
        k, contact = row // contacts, row % contacts + 1
        # A snap of the whole network names no whisker, because all of them move.
        own = [n for n, event in enumerate(events) if k + 1 in (event.whiskers or range(1, whiskers + 1))]
        marked = [n for n in own if _is_marked(events[n], k, contact)]
        for strip, (first, last) in enumerate(pairwise(turns)):
            top = row + 1 - _HEIGHT / 2 + strip * height
            part = slice(first, last + 1)
            for kind, *ends in _runs(travel[part], phase[part, row], known[part], happens[own]):
                left, right = sorted(np.interp(ends, travel[part], control[part]))
                ax.broken_barh([(left, right - left)], (top, tall), **_bar(kind, colour(k)))
            for n in marked:
                if travel[first] <= happens[n] <= travel[last] and events[n].kind not in _IN_STRIPS:
                    ax.plot(at[n], top + tall / 2, linestyle="none", zorder=4, **event_marker(events[n].kind))
    ax.set_xlabel(system.label(over))
    names = [f"whisker {k + 1}" for k in range(whiskers)]
    if contacts > 1:
        names = [f"{name}, contact {number + 1}" for name in names for number in range(contacts)]
    ax.set_yticks(range(1, len(names) + 1), names)
    ax.set_ylim(len(names) + 0.5, 0.5)
    ax.tick_params(left=False)
    handles: list[Any] = [Patch(label=kind.name, **_bar(kind, GREY)) for kind in Phase]
    legend_above(ax, handles + event_entries(event.kind for event in events if event.kind not in _IN_STRIPS))
    return ax


def _is_marked(event: Event, whisker: int, contact: int) -> bool:
    """Whether an event of a whisker, counted from 0, is marked on one of its contacts, counted from 1."""
    if event.contact is not None or contact == 1:
        return event.contact in (contact, None)
    return any(side.phase[whisker, contact - 1] != Phase.free for side in (event.before, event.after))


def _turns(control: np.ndarray) -> list[int]:
    """The first step, the steps where the drive reverses, and the last step."""
    return [0, *turns_of(control).tolist(), control.size - 1]


def _runs(
    travel: np.ndarray, phase: np.ndarray, known: np.ndarray, changes: np.ndarray
) -> Iterator[tuple[Phase, float, float]]:
    """Phases with the travel at which they begin and end: at an event, or else midway between two steps."""
    starts = np.flatnonzero(np.r_[True, (phase[1:] != phase[:-1]) | (known[1:] != known[:-1])])
    ends = np.r_[starts[1:], phase.size] - 1
    for first, last in zip(starts.tolist(), ends.tolist(), strict=True):
        if known[first]:
            begin = _change(travel, first - 1, known, changes) if first > 0 else travel[0]
            end = _change(travel, last, known, changes) if last + 1 < phase.size else travel[-1]
            yield Phase(int(phase[first])), float(begin), float(end)


def _change(travel: np.ndarray, step: int, known: np.ndarray, changes: np.ndarray) -> float:
    """Travel at which a phase ends, between a step and the next one."""
    here, there = travel[step], travel[step + 1]
    within = changes[(changes >= here) & (changes <= there)]
    if within.size:
        return within[0]
    return (here + there) / 2 if known[step] and known[step + 1] else here if known[step] else there


def _bar(kind: Phase, own: str) -> dict[str, Any]:
    """Look of the bar of a phase, in the colour of its whisker."""
    if kind == Phase.free:
        return {"facecolor": "white", "edgecolor": GREY, "linewidth": 0.5, "zorder": 1}
    if kind == Phase.tip:
        return {"facecolor": "white", "edgecolor": own, "hatch": "/////", "linewidth": 0.8, "zorder": 2}
    return {"facecolor": own, "edgecolor": own, "linewidth": 0.8, "zorder": 2}
