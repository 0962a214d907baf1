"""The frames of a film: steps of a scan, and between them every snap as a flow of its own."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.result import Event, Result
from jaxwhisker._scan.shapes import Shapes, shapes_of
from jaxwhisker._scan.state import State
from jaxwhisker.film.flow import flows
from jaxwhisker.film.swing import Outline, between

SNAP_FRAMES = 13  # of a snap, its states before and after included
POINTS = 64  # of a centre line
ROUNDING = 1e-9  # of the drive's way: a step exactly at an event belongs to what begins there
SWINGS = 0.1  # of its length: farther than this no base or tip moves in one step of the flow
BLOCK = 64  # states are padded to a multiple of this: films of about the same length share what is compiled


class Frames(NamedTuple):
    """What a film shows; arrays have a row per frame, in the scene's units."""

    step: Int[np.ndarray, " frames"]  # of the scan; during a snap the last one before it, -1 for none
    control: Float[np.ndarray, " frames"]
    state: State  # (frames, whiskers)
    lines: Shapes  # (frames, whiskers, points)
    snap: Bool[np.ndarray, " frames"]


def frames(result: Result, count: int, outline: Outline) -> tuple[Frames, list[tuple[int, Event]]]:
    """Frames of `count` steps of a scan, evenly, and `SNAP_FRAMES` for every snap; and in which frame what happens.

    A snap takes no time in a scan. Its frames show the flow of the overdamped bases from the state before to the state
    after it, at equal distances, too: the farthest that any base or tip moves. Where a whisker swings free or
    over to the far side, which no equilibrium is part of, its centre line is turned from the one state to the other.

    Args:
        result: of `scan`.
        count: frames for the steps.
        outline: of the object, in the scene's units.
    """
    events, control = list(result.events), np.asarray(result.control)
    shown = np.round(np.linspace(0, control.size - 1, count)).astype(int)
    begin = _steps_of(result)
    snaps = [k for k, event in enumerate(events) if event.kind >= EventKind.snap_through]
    of_scan = State(**{name: jnp.asarray(getattr(result, name))[shown] for name in State.__dataclass_fields__})
    of_scan = jax.tree.map(np.asarray, of_scan)
    groups = [of_scan, *map(_whole, [events[k] for k in snaps], flows(result, snaps))]
    lines = lines_of(groups, result)
    scan = Frames(shown, control[shown], of_scan, lines[0], np.zeros(count, bool))
    lengths = np.array([float(whisker.length) for whisker in result.scene.whiskers])
    parts, marks, start = [], [], 0
    for k, event in enumerate(events):
        end = int(np.searchsorted(shown, begin[k]))
        parts.append(_rows(scan, slice(start, end)))
        marks.append((sum(part.step.size for part in parts), event))
        start = end
        if k in snaps:
            number = 1 + snaps.index(k)
            states, own = _flowing(groups[number], lines[number], lengths, outline)
            at = np.full(SNAP_FRAMES, begin[k] - 1), np.full(SNAP_FRAMES, event.control)
            parts.append(Frames(*at, states, own, np.ones(SNAP_FRAMES, bool)))
    return _joined([*parts, _rows(scan, slice(start, None))]), marks


def _steps_of(result: Result) -> Int[np.ndarray, " events"]:
    """The first step at or behind each event."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(np.asarray(result.control))))])
    travel = np.asarray(result.events.travel)[: len(result.events)]
    return np.searchsorted(way, travel - ROUNDING * way[-1])


def _whole(event: Event, flow: State) -> State:
    """The states of a snap from the one before to the one after it."""
    before, after = (jax.tree.map(lambda leaf: np.asarray(leaf)[None], end) for end in (event.before, event.after))
    return _joined([before, flow, after])


def lines_of(groups: Sequence[State], result: Result) -> list[Shapes]:
    """Centre lines of the states of each group."""
    sizes = np.array([group.phase.shape[0] for group in groups])
    states = _joined(groups)
    padded = jax.tree.map(lambda leaf: jnp.asarray(np.pad(leaf, [(0, -sizes.sum() % BLOCK), (0, 0)])), states)
    lines = shapes_of(padded, jax.tree.map(checks.as_float, result.scene.whiskers), points=POINTS)
    ends = np.cumsum(sizes)
    rows = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
    return [jax.tree.map(lambda leaf, own=own: np.asarray(leaf)[own], lines) for own in rows]


def _flowing(
    states: State, lines: Shapes, lengths: Float[np.ndarray, " whiskers"], outline: Outline
) -> tuple[State, Shapes]:
    """`SNAP_FRAMES` states and centre lines at equal distances, the first and the last one exactly."""
    x, y = (np.diff(coordinate[..., [0, -1]], axis=0) for coordinate in (lines.x, lines.y))
    moved = np.hypot(x, y).max(axis=2)
    way = np.concatenate([[0.0], np.cumsum(np.nan_to_num(moved.max(axis=1)))])
    last = way.size - 1
    places = np.interp(np.linspace(0.0, way[-1], SNAP_FRAMES), way, np.arange(last + 1.0))
    places[0], places[-1] = 0.0, last  # also where nothing moves
    found_states, found_lines = [], []
    for place in places:
        row, share = int(place), place - int(place)
        (state, line), ahead = (_row((states, lines), k) for k in (row, min(row + 1, last)))
        if share > 0:
            line = between(line, ahead[1], lengths, share, outline)
            state = _mixed(state, ahead[0], share, moved[row] > SWINGS * lengths)
        found_states.append(state)
        found_lines.append(line)
    return _stacked(found_states), _stacked(found_lines)


def _mixed(first: State, second: State, share: float, swings: Bool[np.ndarray, " whiskers"]) -> State:
    """A state between two; of a whisker that swings, lets go or touches meanwhile there is no contact to tell of."""
    touching = (first.phase != Phase.free) & (second.phase != Phase.free) & ~swings
    fields: dict[str, Any] = {"phase": np.where(touching, second.phase, Phase.free)}
    for name in State.__dataclass_fields__:
        if name != "phase":
            value = (1 - share) * getattr(first, name) + share * getattr(second, name)
            fields[name] = value if name.startswith("base") else np.where(touching, value, 0.0)
    return State(**{name: jnp.asarray(value) for name, value in fields.items()})


def _rows(tree: Any, rows: slice) -> Any:
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def _row(tree: Any, row: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[row], tree)


def _joined(trees: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *trees)


def _stacked(trees: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)
