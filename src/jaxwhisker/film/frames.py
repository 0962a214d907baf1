"""Frames of a film: steps of a scan, with additional frames for every snap."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.silhouette import silhouette_of
from jaxwhisker._path.path import SNAPS
from jaxwhisker._scan.result import Event, Result
from jaxwhisker._scan.shapes import Shapes, shapes_of
from jaxwhisker._scan.state import State, state_of
from jaxwhisker.film.flow import flows

SNAP_FRAMES = 13  # frames of a snap, including the states before and after it
FILMED_POINTS = 64  # per centre line
EVENT_ROUNDING = 1e-9  # of the travel: a step exactly at an event shows the state after it
SWINGS = 0.1  # of the whisker's length: only a whisker that swings moves farther than this in one step of the flow
PADDING = 64  # states are padded to a multiple of this, because films of similar length then share a compiled program
DEEPEST = 3e-3  # of the whisker's length: contacts and outlines are drawn with about this accuracy
CURLS = np.concatenate([[0.0], *([curl, -curl] for curl in np.linspace(0.1, 6.0, 60))])

Polyline = Complex[np.ndarray, " points"]  # x + iy


class Frames(NamedTuple):
    """Content of a film; arrays have one row per frame, in the scene's units."""

    step: Int[np.ndarray, " frames"]  # of the scan; during a snap, the last step before it, or -1 if there is none
    control: Float[np.ndarray, " frames"]
    state: State  # (frames, whiskers)
    lines: Shapes  # (frames, whiskers, points)
    snap: Bool[np.ndarray, " frames"]


class Silhouette(NamedTuple):
    """Contour of a convex object from left to right, or all around it in the same direction."""

    x: Float[np.ndarray, " points"]
    y: Float[np.ndarray, " points"]

    def depth(self, x: Float[np.ndarray, " line"], y: Float[np.ndarray, " line"]) -> float:
        """Largest depth of a line inside the object; negative if the line is outside."""
        across = np.stack([np.diff(self.y), -np.diff(self.x)])
        across /= np.maximum(np.hypot(*across), 1e-300)
        out = across[0, :, None] * (x - self.x[:-1, None]) + across[1, :, None] * (y - self.y[:-1, None])
        return float(-np.min(np.max(out, axis=0)))


def frames(result: Result, count: int) -> tuple[Frames, list[tuple[int, Event]]]:
    """Frames for evenly spaced steps of a scan and for its snaps; events, each with the frame at which it happens.

    A snap takes no time in a scan. Its frames show the overdamped flow of the bases from the state before to the state
    after it. Between successive frames, the base or tip that moves farthest always moves by the same distance. Where a
    whisker swings free or to the far side, there is no equilibrium in between, so its centre line is turned from one
    state to the other.

    Args:
        result: result of `scan`.
        count: number of frames for the steps; every snap adds `SNAP_FRAMES`.
    """
    events, control = list(result.events), np.asarray(result.control)
    shown = np.round(np.linspace(0, control.size - 1, count)).astype(int)
    of_scan = jax.tree.map(lambda leaf: np.asarray(leaf)[shown], state_of(result))
    snaps = [k for k, event in enumerate(events) if event.kind in SNAPS]
    groups = [of_scan, *map(_with_ends, [events[k] for k in snaps], flows(result, snaps))]
    at_snaps = [np.full(group.phase.shape[0], events[k].control) for k, group in zip(snaps, groups[1:], strict=True)]
    lines = lines_of(result.scene, groups, [control[shown], *at_snaps])
    scan = Frames(shown, control[shown], of_scan, lines[0], np.zeros(count, bool))
    begin = _first_steps(result)
    of_snap = {
        k: _snap_frames(result, int(begin[k]) - 1, events[k], states, own)
        for k, states, own in zip(snaps, groups[1:], lines[1:], strict=True)
    }
    parts, marks, start = [], [], 0
    for k, event in enumerate(events):
        end = int(np.searchsorted(shown, begin[k]))
        parts.append(_at(scan, slice(start, end)))
        marks.append((sum(part.step.size for part in parts), event))
        if k in of_snap:
            parts.append(of_snap[k])
        start = end
    return _merged(np.concatenate, [*parts, _at(scan, slice(start, None))]), marks


def _snap_frames(result: Result, step: int, event: Event, states: State, lines: Shapes) -> Frames:
    lengths = np.array([float(whisker.length) for whisker in result.scene.whiskers])
    even = _even(states, lines, lengths, silhouettes_of_scan(result))
    return Frames(np.full(SNAP_FRAMES, step), np.full(SNAP_FRAMES, event.control), *even, np.ones(SNAP_FRAMES, bool))


def silhouettes_of_scan(result: Result) -> list[Silhouette]:
    """Contours of the objects of a scan, in the scene's units."""
    length = float(result.scene.whiskers[0].length)
    return [Silhouette(*silhouette_of(one, length)) for one in result.scene.profile.objects]


def _first_steps(result: Result) -> Int[np.ndarray, " events"]:
    """First step at or after each event."""
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(np.asarray(result.control))))])
    happens = np.asarray(result.events.travel)[: len(result.events)]
    return np.searchsorted(travel, happens - EVENT_ROUNDING * travel[-1])


def _with_ends(event: Event, flow: State) -> State:
    """States of a flow with those before and after the snap."""
    before, after = (jax.tree.map(lambda leaf: np.asarray(leaf)[None], end) for end in (event.before, event.after))
    return _merged(np.concatenate, [before, flow, after])


def lines_of(scene: Scene, groups: Sequence[State], controls: Sequence[np.ndarray]) -> list[Shapes]:
    """Centre lines of each group of states, at these controls."""
    sizes = np.array([group.phase.shape[0] for group in groups])
    states = _merged(np.concatenate, groups)
    room = (0, -sizes.sum() % PADDING)
    padded = jax.tree.map(lambda leaf: jnp.asarray(np.pad(leaf, [room, (0, 0)])), states)
    lines = shapes_of(scene, padded, np.pad(np.concatenate(controls), [room]), points=FILMED_POINTS)
    lines = jax.tree.map(np.asarray, lines)
    return [_at(lines, slice(end - size, end)) for end, size in zip(np.cumsum(sizes), sizes, strict=True)]


def _even(
    states: State, lines: Shapes, lengths: Float[np.ndarray, " whiskers"], silhouettes: Sequence[Silhouette]
) -> tuple[State, Shapes]:
    """`SNAP_FRAMES` states and centre lines at equal distances, including the first and the last ones."""
    x, y = (np.diff(coordinate[..., [0, -1]], axis=0) for coordinate in (lines.x, lines.y))
    moved = np.hypot(x, y).max(axis=2)
    path = np.concatenate([[0.0], np.cumsum(np.nan_to_num(moved.max(axis=1)))])
    last = path.size - 1
    places = np.interp(np.linspace(0.0, path[-1], SNAP_FRAMES), path, np.arange(last + 1.0))
    places[0], places[-1] = 0.0, last  # even if nothing moves
    even_states, even_lines = [], []
    for place in places:
        row, share = int(place), place - int(place)
        (state, line), ahead = (_at((states, lines), k) for k in (row, min(row + 1, last)))
        if share > 0:
            line = between(line, ahead[1], lengths, share, silhouettes)
            state = _mixed(state, ahead[0], share, moved[row] > SWINGS * lengths)
        even_states.append(state)
        even_lines.append(line)
    return _merged(np.stack, even_states), _merged(np.stack, even_lines)


def _mixed(first: State, second: State, share: float, swings: Bool[np.ndarray, " whiskers"]) -> State:
    """State between two others; whiskers that swing, release or touch in between have no contact."""
    touching = (first.phase != Phase.free) & (second.phase != Phase.free) & ~swings
    fields: dict[str, Any] = {"phase": np.where(touching, second.phase, Phase.free)}
    if second.slip is not None:
        fields["slip"] = np.where(touching, second.slip, 0)
    if second.contact_object is not None:
        fields["contact_object"] = np.where(touching, second.contact_object, 0)

    def mixed(before: Any, after: Any) -> Any:
        return jax.tree.map(lambda a, b: (1 - share) * a + share * b, before, after)

    for name in State.__dataclass_fields__:
        if name not in ("phase", "slip", "contact_object") and getattr(first, name) is not None:
            value = mixed(getattr(first, name), getattr(second, name))
            kept = name == "shaft_loads" or name.startswith("base")
            fields[name] = value if kept else np.where(touching, value, 0.0)
    return State(**jax.tree.map(jnp.asarray, fields))


def between(
    first: Shapes,
    second: Shapes,
    lengths: Float[np.ndarray, " whiskers"],
    share: float,
    silhouettes: Sequence[Silhouette],
) -> Shapes:
    """Centre lines (whiskers, points) at a share of the way from the first to the second ones.

    Bases move along straight lines, directions turn uniformly, and lengths are kept. A line that would enter an object
    is curled until it passes outside, or enters as little as possible.
    """
    ends = [np.asarray(line.x) + 1j * np.asarray(line.y) for line in (first, second)]
    lines = [_turned(a, b, float(length), share, silhouettes) for a, b, length in zip(*ends, lengths, strict=True)]
    return Shapes(jnp.asarray(np.real(lines)), jnp.asarray(np.imag(lines)))


def _turned(
    first: Polyline, second: Polyline, length: float, share: float, silhouettes: Sequence[Silhouette]
) -> Polyline:
    (base0, angle0), (base1, angle1) = _directions(first), _directions(second)
    angle1 = angle1 - 2 * np.pi * np.round((angle1[0] - angle0[0]) / (2 * np.pi))  # the root turns the shorter way
    turned = (1 - share) * angle0 + share * angle1
    # A curled line is ahead at its root and lags behind at its tip.
    curl = share * (1 - share) * np.linspace(-1.0, 1.0, turned.size) * (angle0 - angle1)
    tried = []
    for curled in CURLS:
        pieces = length / turned.size * np.exp(1j * (turned + curled * curl))
        line = np.cumsum([(1 - share) * base0 + share * base1, *pieces])
        tried.append((max(one.depth(np.real(line), np.imag(line)) for one in silhouettes), line))
        if tried[-1][0] < DEEPEST * length:
            break
    return min(tried, key=lambda one: one[0])[1]


def _directions(line: Polyline) -> tuple[complex, Float[np.ndarray, " pieces"]]:
    """Base of a line and directions of pieces of equal length."""
    arc = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(line)))])
    even = np.interp(np.linspace(0.0, arc[-1], line.size), arc, line)
    return complex(line[0]), np.unwrap(np.angle(np.diff(even)))


def _at(tree: Any, index: int | slice) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


def _merged(merge: Callable, trees: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: merge(leaves), *trees)
