"""Panels: stretches of a path on which forces are smooth, and integrals along them.

The march places its nodes as densely as the path requires, and at all of its corners. The panels lie between these
nodes. Within a panel, the control is the cubic of t in [0, 1] that has the direction of the path at both ends. Forces
change with the square root of the distance to a fold. On the way to a fold, this root is linear in t, and forces are
smooth functions of t. Gauss-Legendre points in t integrate them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.program import Program
from jaxwhisker._base.quadrature import gauss, legendre, legendre_integrals
from jaxwhisker._equilibrium.point import Point, dot, scale_of
from jaxwhisker._path.path import NO_EVENT, STOP, Path, Stops, entry_of, is_snap
from jaxwhisker._scan.mechanics import AnyProblem
from jaxwhisker._scan.result import Events
from jaxwhisker._scan.steps import TRAVEL_NOISE

POINTS = 16  # in each panel
SHORT = 3e-3  # nodes nearer to a corner, in the scale of the path, begin no panel: they crowd there
SHORT_TO_FOLD = 0.02  # the same before a fold, where states of closely spaced points are less accurate
FLAT = 1e-3  # du/ds at a located fold is smaller


def _legendre_slopes(values: list) -> list:
    """Derivatives by 2 t of Legendre polynomials with these values."""
    slopes = [0.0 * values[0], values[0]]
    for n in range(1, len(values) - 1):
        slopes.append(slopes[n - 1] + (2 * n + 1) * values[n])
    return slopes


_AT, _WEIGHTS = gauss(POINTS)
_VALUES = np.stack(legendre(_AT, POINTS))
_COEFFICIENTS = _VALUES * _WEIGHTS * (2 * np.arange(POINTS)[:, None] + 1)  # times values at the points
# Times values at the points: derivatives by t there.
_SLOPES = 2 * np.stack(_legendre_slopes(list(_VALUES)), axis=1) @ _COEFFICIENTS


class PanelEnds(NamedTuple):
    """Ends of the panels in order; the last one is repeated as padding. Panel k lies between ends k and k + 1."""

    control: Float[Array, " ends"]  # in the scene's units, like travel
    travel: Float[Array, " ends"]
    slopes: Float[Array, "ends 2"]  # of the share of the panel's control by t, at the panel's start and end
    node: Int[Array, " ends"]  # of the path, whose control this is
    event: Int[Array, " ends"]  # number of the event here; -1 if there is none
    stop: Int[Array, " ends"]  # number of the stop here; -1 if there is none
    last: Int[Array, ""]  # index of the last end
    noise: Float[Array, ""]  # travels that differ by less are taken as equal


def ends_of(problem: AnyProblem, path: Path) -> PanelEnds:
    """The ends of the panels of a path, from where the drive is at its first stop."""
    nodes, unit = path.nodes, jax.lax.stop_gradient(problem.unit.control)
    room = nodes.kind.shape[0]
    control = jnp.asarray(nodes.point.u)
    index, last = jnp.arange(room), jnp.maximum(path.count - 1, 0)
    reached = (jnp.cumsum((nodes.travel >= 0) & (index < path.count)) > 0) & (index < path.count)
    follows = jnp.minimum(index + 1, last)
    # A snap, and a change of slips, is the second node at its place.
    second = is_snap(nodes.kind) if nodes.corner is None else is_snap(nodes.kind) | nodes.corner
    first = second[follows] & (follows > index)
    corner = reached & ((nodes.kind != NO_EVENT) | second | first | (index == last))
    public = reached & (nodes.kind >= 0)
    number = jnp.where(public, jnp.cumsum(public) - 1, -1)
    number = jnp.where((number < 0) & first, number[follows], number)
    is_stop = reached & (nodes.kind == STOP)
    stop = jnp.where(is_stop, jnp.cumsum(is_stop) - 1, -1)

    steps = jax.vmap(_distance)(nodes.point, Point(nodes.z_before[follows], control[follows]))
    passed = jnp.cumsum(steps) - steps
    upcoming = jax.lax.cummin(jnp.where(corner, passed, jnp.inf), reverse=True)
    behind = jax.lax.cummax(jnp.where(corner, passed, -jnp.inf))
    ahead = jax.lax.cummin(jnp.where(corner, index, last), reverse=True)[follows]  # the next corner after each node
    folds = first & (jnp.abs(nodes.arriving.u) < FLAT) & (nodes.kind == NO_EVENT)
    apart = jnp.where(folds[ahead], SHORT_TO_FOLD, SHORT)
    kept = corner | (reached & (upcoming - passed > apart) & (passed - behind > SHORT))
    at = jnp.nonzero(kept, size=room, fill_value=last)[0]
    fold = jnp.where(folds[ahead], nodes.travel[ahead], jnp.inf)
    slopes = jax.vmap(lambda a, b: _slopes(path, fold[a], a, b))(at, jnp.append(at[1:], last))
    place = jnp.where(first, follows, index)[at]
    travel = nodes.travel[at] * unit
    noise = TRAVEL_NOISE * (unit + jnp.maximum(travel[-1], 0.0))
    return PanelEnds(control[at] * unit, travel, slopes, place, number[at], stop[at], jnp.sum(kept) - 1, noise)


def _distance(a: Point, b: Point) -> Float[Array, ""]:
    chord = Point(b.z - a.z, b.u - a.u)
    return jnp.sqrt(dot(chord, chord, scale_of(a.z)))


def _slopes(path: Path, fold: Float[Array, ""], start: Int[Array, ""], stop: Int[Array, ""]) -> Float[Array, "2"]:
    """Slopes of the share of the control between two nodes; within [0, 3], where the cubic is monotone.

    Args:
        path: the path.
        fold: travel at the next corner after the first node if that is a fold; otherwise infinite.
        start: the first node.
        stop: the second node.
    """
    here, there = (jax.tree.map(lambda leaf, k=k: leaf[k], path.nodes) for k in (start, stop))
    chord = Point(there.z_before - here.point.z, there.point.u - here.point.u)
    scale = scale_of(here.point.z)
    directions = here.leaving, there.arriving
    forwards = jnp.stack([dot(direction, chord, scale) for direction in directions])
    rates = jnp.stack([direction.u for direction in directions])
    # A direction that is passed while t grows from 0 to 1, at the speed of the chord.
    good = (forwards > 0) & (chord.u != 0)
    slopes = rates * dot(chord, chord, scale) / jnp.where(good, forwards * chord.u, 1.0)
    slopes = jnp.where(good, jnp.clip(slopes, 0.0, 3.0), 1.0)
    # Towards a fold, the square root of the distance to it is linear in t.
    left = jnp.stack([fold - here.travel, fold - there.travel])
    folds = jnp.isfinite(fold) & (left[0] > left[1])
    roots = jnp.sqrt(jnp.where(folds, jnp.maximum(left, 0.0), 1.0))
    return jnp.where(folds, 2 * roots / jnp.sum(roots), slopes)


ends_now = Program(ends_of, frozen=True)


def with_slopes(
    ends: PanelEnds, problem: AnyProblem, path: Path, events: Events, stops: Stops
) -> Float[Array, " ends"]:
    """Controls of the ends, with their derivatives: events and stops move, other nodes stay where they are."""
    control = jnp.asarray(path.nodes.point.u)[ends.node] * problem.unit.control
    entry = entry_of(ends.event, events.count, events.control.shape[0])
    event = events.control[jnp.maximum(entry, 0)]
    known = (ends.event >= 0) & (entry >= 0) & jnp.isfinite(event)
    control = jnp.where(known, event, control)
    stop = jnp.asarray(stops)[jnp.maximum(ends.stop, 0)]
    control = jnp.where(ends.stop >= 0, stop, control)
    # The values are those of the path.
    return ends.control + (control - jax.lax.stop_gradient(control))


with_slopes_now = Program(with_slopes)


class Panel(NamedTuple):
    """One panel, or all panels along the first axis."""

    start: Float[Array, "*panels"]  # control
    stop: Float[Array, "*panels"]
    travel: Float[Array, "*panels 2"]  # at the start and at the end
    slopes: Float[Array, "*panels 2"]
    noise: Float[Array, "*panels"]  # of travels

    @property
    def used(self) -> Bool[Array, "*panels"]:
        """Whether the drive moves; corners of the path are panels in which it stands still."""
        return self.travel[..., 1] - self.travel[..., 0] > 8 * self.noise


def panels_of(ends: PanelEnds) -> Panel:
    """All panels between the ends."""
    both = jnp.stack([ends.travel[:-1], ends.travel[1:]], axis=-1)
    noise = jnp.full_like(both[:, 0], ends.noise)
    return Panel(ends.control[:-1], ends.control[1:], both, ends.slopes[:-1], noise)


panels_now = Program(panels_of)


def share(t: Float[Array, "*#at"], slopes: Float[Array, "*#at 2"]) -> tuple[Float[Array, "*_"], Float[Array, "*_"]]:
    """Share of the panel's control at t, and its derivative."""
    cubic = Cubic(jnp.zeros(()), jnp.ones(()), slopes[..., 0], slopes[..., 1])
    return cubic.value(t), cubic.rate(t)


def points_of(panel: Panel) -> tuple[Float[Array, "panels points"], Float[Array, "panels points"]]:
    """Control and travel at the points of each panel."""
    shares, _ = share(jnp.asarray(_AT), panel.slopes[:, None])
    control = panel.start[:, None] + (panel.stop - panel.start)[:, None] * shares
    start, stop = panel.travel[:, :1], panel.travel[:, 1:]
    # Points next to the end belong to this side of it, which the travel must show.
    return control, jnp.minimum(start + (stop - start) * shares, stop - 2 * panel.noise[:, None])


def rates_of(panel: Panel) -> Float[Array, "panels points"]:
    """Derivatives of the control by t at the points."""
    _, rates = share(jnp.asarray(_AT), panel.slopes[:, None])
    return (panel.stop - panel.start)[:, None] * rates


def slopes_at_points(values: Float[Array, "panels points *more"]) -> Float[Array, "panels points *more"]:
    """Derivatives by t at the points, of polynomials through values there."""
    return _times(_SLOPES, values)


def coefficients(values: Float[Array, "panels points *more"]) -> Float[Array, "panels points *more"]:
    """Coefficients of Legendre polynomials through values at the points; the first one is the integral."""
    return _times(_COEFFICIENTS, values)


def _times(matrix: np.ndarray, values: Array) -> Array:
    # Elementwise, because jax 0.10.2 computes large batches of small matrix products incorrectly.
    wide = np.reshape(matrix, (1, *matrix.shape, *[1] * (values.ndim - 2)))
    return jnp.sum(wide * values[:, None], axis=2)


def integral_to(t: Float[Array, ""], coefficients: Float[Array, "points *more"]) -> Float[Array, "*more"]:
    """Integral from 0 to t of the polynomial with these coefficients."""
    return jnp.tensordot(jnp.stack(legendre_integrals(t, POINTS)), coefficients, axes=1)


def place_in(panel: Panel, control: Float[Array, ""]) -> Float[Array, ""]:
    """The t at which a panel has a control."""
    used = panel.used
    way = jnp.where(used, panel.stop - panel.start, 1.0)
    wanted = jnp.where(used, (control - panel.start) / way, 0.0)
    still, slopes = jax.lax.stop_gradient(wanted), jax.lax.stop_gradient(panel.slopes)

    def halved(_, bounds):
        low, high = bounds
        middle = (low + high) / 2
        below = share(middle, slopes)[0] < still
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    low, high = jax.lax.fori_loop(0, 24, halved, (jnp.zeros_like(still), jnp.ones_like(still)))
    t = (low + high) / 2
    # The last steps of Newton's method have the first and second derivatives of the solution.
    for _ in range(3):
        value, rate = share(t, slopes)
        safe = rate > 1e-12
        t = jnp.clip(t - jnp.where(safe, (value - wanted) / jnp.where(safe, rate, 1.0), 0.0), 0.0, 1.0)
    return t
