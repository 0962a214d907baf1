"""The picture of phases: when each whisker is free, touches with its tip or along its shaft, and what happens."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.path import EventKind, Status
from jaxwhisker._scan.result import Result, check_one_scan
from jaxwhisker.plot.axes import GREY, colour, control_axis, control_of, legend_above, one_axes

_HEIGHT = 0.6  # of a row
_MARKERS = {
    EventKind.touch: ("o", "white"),
    EventKind.vertex: ("v", "white"),
    EventKind.release: ("s", "white"),
    EventKind.snap_through: ("D", "black"),
    EventKind.snap_off: ("X", "black"),
}


def phases(result: Result, *, ax: Axes | None = None) -> Axes:
    """Draw what each whisker does over the drive: free, tip contact (hatched), tangential contact (solid); and events.

    Where the drive turns round, every stretch of its way has a strip of its own, from the top down. Failed steps leave
    gaps.

    Args:
        result: of `scan`.
        ax: where to draw; a new figure by default.

    Raises:
        ValueError: if `result` is none of one scan.
    """
    check_one_scan(result)
    ax = one_axes(ax)
    control, phase, known = control_of(result), np.asarray(result.phase), np.asarray(result.status) == Status.ok
    # Along the way of the drive, which grows where the control may turn.
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(control)))])
    events = list(result.events)
    ways = control_of(result, np.asarray(result.events.travel)[: len(events)])
    turns = _turns(control)
    height, whiskers, seen = _HEIGHT / (len(turns) - 1), phase.shape[1], set()
    tall = height if len(turns) == 2 else 0.85 * height
    for k in range(whiskers):
        # A snap of the network as a whole names no whisker: all of them move.
        own = [n for n, event in enumerate(events) if k + 1 in (event.whiskers or range(1, whiskers + 1))]
        for strip, (first, last) in enumerate(pairwise(turns)):
            top = k + 1 - _HEIGHT / 2 + strip * height
            part = slice(first, last + 1)
            for kind, *ends in _runs(way[part], phase[part, k], known[part], ways[own]):
                left, right = sorted(np.interp(ends, way[part], control[part]))
                ax.broken_barh([(left, right - left)], (top, tall), **_bar(kind, colour(k)))
            for n in own:
                if way[first] <= ways[n] <= way[last] and events[n].kind in _MARKERS:
                    seen.add(events[n].kind)
                    ax.plot(*control_of(result, [events[n].control]), top + tall / 2, **_marker(events[n].kind))
    ax.set_xlabel(control_axis(result.scene))
    ax.set_yticks(range(1, whiskers + 1), [f"whisker {k + 1}" for k in range(whiskers)])
    ax.set_ylim(whiskers + 0.5, 0.5)
    ax.tick_params(left=False)
    _legend(ax, [kind for kind in _MARKERS if kind in seen])
    return ax


def _turns(control: np.ndarray) -> list[int]:
    """The first step, those where the drive turns round, and the last."""
    moves = np.flatnonzero(np.diff(control))
    signs = np.sign(np.diff(control)[moves])
    return [0, *moves[1:][signs[1:] != signs[:-1]].tolist(), control.size - 1]


def _runs(
    way: np.ndarray, phase: np.ndarray, known: np.ndarray, changes: np.ndarray
) -> Iterator[tuple[Phase, float, float]]:
    """Phases and the ways between which they last: from event to event, or midway between steps where there is none."""
    starts = np.flatnonzero(np.r_[True, (phase[1:] != phase[:-1]) | (known[1:] != known[:-1])])
    ends = np.r_[starts[1:], phase.size] - 1
    for first, last in zip(starts.tolist(), ends.tolist(), strict=True):
        if known[first]:
            begin = _between(way, first - 1, known, changes) if first > 0 else way[0]
            end = _between(way, last, known, changes) if last + 1 < phase.size else way[-1]
            yield Phase(int(phase[first])), float(begin), float(end)


def _between(way: np.ndarray, step: int, known: np.ndarray, changes: np.ndarray) -> float:
    """Where between a step and the next a phase ends."""
    here, there = way[step], way[step + 1]
    within = changes[(changes >= here) & (changes <= there)]
    if within.size:
        return within[0]
    return (here + there) / 2 if known[step] and known[step + 1] else here if known[step] else there


def _bar(kind: Phase, colour: str) -> dict[str, Any]:
    if kind == Phase.free:
        return {"facecolor": "white", "edgecolor": GREY, "linewidth": 0.5, "zorder": 1}
    if kind == Phase.tip:
        return {"facecolor": "white", "edgecolor": colour, "hatch": "/////", "linewidth": 0.8, "zorder": 2}
    return {"facecolor": colour, "edgecolor": colour, "linewidth": 0.8, "zorder": 2}


def _marker(kind: EventKind) -> dict[str, Any]:
    shape, filled = _MARKERS[kind]
    look = {"marker": shape, "markerfacecolor": filled, "markeredgecolor": "black", "linestyle": "none"}
    return look | {"markersize": 5, "markeredgewidth": 0.8, "zorder": 4}


def _legend(ax: Axes, events: list[EventKind]) -> None:
    handles: list[Any] = [Patch(label=kind.name, **_bar(kind, GREY)) for kind in Phase]
    handles += [Line2D([], [], label=kind.name.replace("_", "-"), **_marker(kind)) for kind in events]
    legend_above(ax, handles)
