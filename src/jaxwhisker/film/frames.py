"""Frames of a film: steps of a scan, with additional frames for every snap, or samples of a simulation."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from matplotlib.path import Path

from jaxwhisker._dynamics.simulation import Simulation
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.scene import Scene, objects_of
from jaxwhisker._model.silhouette import behind, silhouette_of
from jaxwhisker._path.path import SNAPS, Status
from jaxwhisker._scan.contacts import has_several
from jaxwhisker._scan.quantities import is_of_contacts
from jaxwhisker._scan.result import Event, Result
from jaxwhisker._scan.shapes import Shapes, shapes_of
from jaxwhisker._scan.state import State
from jaxwhisker.film.flow import flows
from jaxwhisker.plot.runs import (
    PlaneRun,
    Run,
    abscissa,
    events_of,
    lines_of_motion,
    places,
    places_of_events,
    progress,
    states_at,
)

SNAP_FRAMES = 13  # frames of a snap, including the states before and after it
FILMED_POINTS = 64  # per centre line
EVENT_ROUNDING = 1e-9  # of the travel or duration: a step exactly at an event shows the state after it
SWINGS = 0.1  # of the whisker's length: only a whisker that swings moves farther than this in one step of the flow
DEEPEST = 3e-3  # of the whisker's length: contacts and outlines are drawn with about this accuracy
CURLS = np.concatenate([[0.0], *([curl, -curl] for curl in np.linspace(0.1, 6.0, 60))])

Polyline = Complex[np.ndarray, " points"]  # x + iy


class Frames(NamedTuple):
    """Content of a film; arrays have one row per frame, in the scene's units."""

    step: Int[np.ndarray, " frames"]  # of the run; during a snap, the last step before it, or -1 if there is none
    control: Float[np.ndarray, " frames"]
    place: Float[np.ndarray, " frames"]  # on the horizontal axis of signals: the control of a scan, else the time
    status: Int[np.ndarray, " frames"]
    state: State  # (frames, whiskers)
    lines: Shapes  # (frames, whiskers, points)
    snap: Bool[np.ndarray, " frames"]


class Mark(NamedTuple):
    """An event in a film."""

    first: int  # frame at which it happens
    event: Event
    place: float  # on the horizontal axis of signals


class Silhouette(NamedTuple):
    """Contour of an object from left to right, or all around it in the same direction."""

    x: Float[np.ndarray, " points"]
    y: Float[np.ndarray, " points"]
    convex: bool = True  # or closed

    def depth(self, x: Float[np.ndarray, " line"], y: Float[np.ndarray, " line"]) -> float:
        """Largest depth of a line inside the object; if the line is outside, negative, or 0 unless it is convex."""
        if not self.convex:
            return self._depth(x, y)
        across = np.stack([np.diff(self.y), -np.diff(self.x)])
        across /= np.maximum(np.hypot(*across), 1e-300)
        out = across[0, :, None] * (x - self.x[:-1, None]) + across[1, :, None] * (y - self.y[:-1, None])
        return float(-np.min(np.max(out, axis=0)))

    def _depth(self, x: Float[np.ndarray, " line"], y: Float[np.ndarray, " line"]) -> float:
        """Largest distance from the contour of those points of a line that are inside."""
        points, contour = np.stack([x, y], axis=1), np.stack([self.x, self.y], axis=1)
        inside = Path(np.concatenate([contour, behind(self.x, self.y)])).contains_points(points)
        starts, ways = contour[:-1], np.diff(contour, axis=0)
        beside = points[inside, None] - starts
        share = np.sum(beside * ways, axis=2) / np.maximum(np.sum(ways**2, axis=1), 1e-300)
        apart = beside - np.clip(share, 0.0, 1.0)[..., None] * ways
        return float(np.hypot(*np.moveaxis(apart, 2, 0)).min(axis=1).max(initial=0.0))


def frames(result: PlaneRun, count: int) -> tuple[Frames, list[Mark]]:
    """Frames for evenly spaced steps of a scan and for its snaps, or for samples of a simulation; and the events.

    A snap takes no time in a scan. Its frames show the overdamped flow of the bases from the state before to the state
    after it. Between successive frames, the base or tip that moves farthest always moves by the same distance. Where a
    whisker swings free or to the far side, there is no equilibrium in between, so its centre line is turned from one
    state to the other.

    Samples of a simulation are evenly spaced in time. If it fails, the last frame shows the last state before.

    Args:
        result: result of `scan` or `simulate`.
        count: number of frames for the steps; every snap adds `SNAP_FRAMES`, and a simulation that fails has fewer.
    """
    events, control, over = events_of(result), np.asarray(result.control), abscissa(result)
    shown = np.round(np.linspace(0, control.size - 1, count)).astype(int)
    status = np.asarray(result.status)[shown]
    if isinstance(result, Simulation):
        shown, status = _until_failure(shown, status)
    states = states_at(result, shown)
    snaps = [k for k, event in enumerate(events) if event.kind in SNAPS]
    groups = [states, *map(_with_ends, [events[k] for k in snaps], _flows(result, snaps))]
    at_snaps = [np.full(group.phase.shape[0], events[k].control) for k, group in zip(snaps, groups[1:], strict=True)]
    if isinstance(result, Simulation):
        lines = [lines_of_motion(result, shown, points=FILMED_POINTS)]
    else:
        lines = lines_of(result.scene, groups, [control[shown], *at_snaps])
    no_snap = np.zeros(shown.size, bool)
    steps = Frames(shown, control[shown], places(result, over)[shown], status, states, lines[0], no_snap)
    begin = first_steps(result)
    of_snap = {
        k: _snap_frames(result, int(begin[k]) - 1, events[k], states, own)
        for k, states, own in zip(snaps, groups[1:], lines[1:], strict=True)
    }
    where = places_of_events(result, over)
    parts, marks, start = [], [], 0
    for k, event in enumerate(events):
        end = int(np.searchsorted(shown, begin[k]))
        parts.append(_at(steps, slice(start, end)))
        marks.append(Mark(sum(part.step.size for part in parts), event, float(where[k])))
        if k in of_snap:
            parts.append(of_snap[k])
        start = end
    return _merged(np.concatenate, [*parts, _at(steps, slice(start, None))]), marks


def _until_failure(shown: Int[np.ndarray, " all"], status: Int[np.ndarray, " all"]) -> tuple[np.ndarray, np.ndarray]:
    """The samples of a simulation before it fails, at least one; the last one has the status of the failure."""
    failed = np.flatnonzero(status != Status.ok)
    if not failed.size:
        return shown, status
    last = failed[0]
    return shown[:last], np.append(status[: last - 1], status[last])


def _flows(result: PlaneRun, snaps: Sequence[int]) -> list[State]:
    """The flows of the snaps of a scan; a simulation has no snaps, because everything in it takes time.

    Those of whiskers that may have several contacts are not computed: they turn from one state to the other.
    """
    if not isinstance(result, Result):
        return []
    if has_several(result):
        return [states_at(result, np.arange(0)) for _ in snaps]
    return flows(result, snaps)


def _snap_frames(result: PlaneRun, before: int, event: Event, states: State, lines: Shapes) -> Frames:
    lengths = np.array([float(whisker.length) for whisker in result.scene.whiskers])
    even = _even(states, lines, lengths, silhouettes_of_scan(result))
    step, control = np.full(SNAP_FRAMES, before), np.full(SNAP_FRAMES, event.control)
    status = np.asarray(result.status)[np.maximum(step, 0)]
    return Frames(step, control, control, status, *even, np.ones(SNAP_FRAMES, bool))


def silhouettes_of_scan(result: PlaneRun) -> list[Silhouette]:
    """Contours of the objects of a scan, in the scene's units."""
    length = float(result.scene.whiskers[0].length)
    found = []
    for one in objects_of(result.scene):
        x, y = silhouette_of(one, length)
        found.append(Silhouette(x, y, bool(one.closed) or not behind(x, y).size))
    return found


def first_steps(result: Run) -> Int[np.ndarray, " events"]:
    """First step at or after each event."""
    passed, happens = progress(result)
    return np.searchsorted(passed, happens - EVENT_ROUNDING * passed[-1])


def _with_ends(event: Event, flow: State) -> State:
    """States of a flow with those before and after the snap."""
    before, after = (jax.tree.map(lambda leaf: np.asarray(leaf)[None], end) for end in (event.before, event.after))
    return _merged(np.concatenate, [before, flow, after])


def lines_of(scene: Scene, groups: Sequence[State], controls: Sequence[np.ndarray]) -> list[Shapes]:
    """Centre lines of each group of states, at these controls."""
    sizes = np.array([group.phase.shape[0] for group in groups])
    lines = shapes_of(scene, _merged(np.concatenate, groups), np.concatenate(controls), points=FILMED_POINTS)
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
    contacts = (first.phase != Phase.free) & (second.phase != Phase.free)
    touching = contacts = contacts & ~(swings[:, None] if has_several(first) else swings)
    if has_several(first):
        if second.contact_object is not None:
            contacts &= first.contact_object == second.contact_object
        touching = contacts.any(axis=1)
    fields: dict[str, Any] = {"phase": np.where(contacts, second.phase, Phase.free)}
    if second.slip is not None:
        fields["slip"] = np.where(touching, second.slip, 0)
    if second.contact_object is not None:
        fields["contact_object"] = np.where(contacts, second.contact_object, 0)

    def mixed(before: Any, after: Any) -> Any:
        return jax.tree.map(lambda a, b: (1 - share) * a + share * b, before, after)

    for name in State.__dataclass_fields__:
        if name not in ("phase", "slip", "contact_object") and getattr(first, name) is not None:
            value = mixed(getattr(first, name), getattr(second, name))
            kept = name == "shaft_loads" or name.startswith("base")
            fields[name] = value if kept else np.where(contacts if is_of_contacts(name) else touching, value, 0.0)
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
