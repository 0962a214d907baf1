"""The path of equilibria: its nodes, the events on it, and the margins that measure the distance to events.

A path is a sequence of nodes: exact equilibria in the order in which the drive passes them, with the tangents of the
path before and after each. Every corner of the path (an event, a turning point of the drive) is a node.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import NamedInt, Scalar
from jaxwhisker._equilibrium.contact import FORCE, LEAN, PARAMETER, SLACK, Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.pieces import ends_of
from jaxwhisker._equilibrium.point import Contacts, Point
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import PerObject, PerWhisker, Poses, Stance
from jaxwhisker._model.profile import AbstractProfile


class Status(NamedInt):
    """Status of a step of the scan; a step that is not `ok` holds NaN."""

    ok = 0
    invalid = 1  # a parameter is outside its domain
    lost = 2  # the path could not be followed further: no equilibrium was found near the last one
    unsettled = 3  # after a loss of stability the bases did not come to rest, or only at a higher energy
    not_convex = 4  # the profile is not convex where a whisker touches it
    too_long = 5  # more nodes, iterations or (for a traced control) turning points than there is room for
    inexact = 6  # this step's equations are not satisfied to tolerance
    unstable = 7  # this step's equilibrium is not stable
    undetermined = 8  # friction lets the contacts move on in no way, or in more than one
    second_contact = 9  # a whisker has met the object in a second place; see `Scene.detects`
    crossing = 10  # two whiskers have crossed; see `Scene.detects`
    at_spring = 11  # a contact has reached a spring or a foundation on its shaft


class EventKind(NamedInt):
    """Kind of an event."""

    touch = 0  # contact begins, with zero force
    tip_to_tangential = 1
    vertex = 2  # the contact passes the lowest point of the object
    tangential_to_tip = 3
    release = 4  # contact ends smoothly, with zero force
    snap_through = 5  # stability is lost, and no whisker that slips comes free
    snap_off = 6  # stability is lost, and a whisker slips and comes free
    stick = 7  # a contact stops slipping along the object
    slip = 8  # a contact that stuck begins to slip
    edge = 9  # a contact passes an end of an edge: from the edge to a face or arc, or onto the edge


SNAPS = (EventKind.snap_through, EventKind.snap_off)
NO_EVENT = -1
STOP = -2  # the drive reverses, or the scan ends


class Node(NamedTuple):
    """An equilibrium on the path, and the path's directions before and after it."""

    point: Point
    z_before: Contacts  # contacts on arrival, which differ if they begin or end here
    arriving: Point  # tangents, of unit length in the scale of the point
    leaving: Point
    state: ContactState  # from here on
    before: ContactState  # on arrival
    travel: Float[Array, ""]  # distance that the drive has travelled since the first step; negative on the approach
    kind: Int[Array, ""]  # EventKind, NO_EVENT or STOP
    whiskers: Bool[Array, " whiskers"]  # those that the event concerns
    stop: Int[Array, ""] | None = None  # index of the next stop; None without friction, which remembers stops
    corner: Bool[Array, ""] | None = None  # whether contacts stick or slip at the node before; None without friction


def is_snap(kind: Int[Array, "*nodes"]) -> Bool[Array, "*nodes"]:
    """Whether an event is a snap."""
    return (kind == EventKind.snap_through) | (kind == EventKind.snap_off)


class Path(NamedTuple):
    """Nodes 0 to count - 1, in padded arrays. The status says why the path ends where it does."""

    nodes: Node
    count: Int[Array, ""]
    status: Int[Array, ""]


def select(condition, yes, no):
    """Select one of two trees of the same structure by a condition."""
    # Leaves that both trees share need no selection: most decisions of a march change few leaves.
    return jax.tree.map(lambda a, b: a if a is b else jnp.where(condition, a, b), yes, no)


def first_case(*cases, otherwise):
    """Select the tree of the first case (condition, tree) whose condition holds."""
    conditions = [condition for condition, _ in cases]
    first = jnp.argmax(jnp.stack([*conditions, jnp.asarray(True)]))
    for number, (_, tree) in reversed(list(enumerate(cases))):
        otherwise = select(first == number, tree, otherwise)
    return otherwise


NOTHING = np.zeros(0)


class Margins(NamedTuple):
    """Distance of each whisker from each kind of event; an event occurs where its margin becomes negative."""

    touch: PerObject
    release: PerWhisker
    phase: PerWhisker  # tip <-> tangential
    vertex: PerWhisker
    stop: Float[Array, " 1"]
    slip: Float[Array, " sticking"]  # of sticking contacts; empty without friction
    # Distances of the parameter from both ends of its piece; empty without edges.
    low: Float[Array, " touching"] | np.ndarray = NOTHING
    high: Float[Array, " touching"] | np.ndarray = NOTHING


def each_touch(margins: PerObject) -> list[PerWhisker]:
    """Margins of touches: of the whiskers, or of the whiskers for each of several objects."""
    return [margins] if margins.ndim == 1 else list(margins)


TOUCH, RELEASE, PHASE, VERTEX, AT_STOP, SLIP, LOW, HIGH = range(len(Margins._fields))  # indices into Margins
LEAN_NOISE = 1e-6  # largest error of the lean of a contact that sticks with hardly any force
CONE_NOISE = 1e-12  # ... and of the force across the normal of others, in EI/L^2
MARGIN_NOISE = 1e-12  # accuracy of margins; with it, two events at the same place do not violate each other


def margins(
    state: ContactState,
    point: Point,
    at: Stance,
    ahead: PerWhisker,
    remaining: Scalar,
    friction_angle: Scalar | None = None,
    profile: AbstractProfile | None = None,
) -> Margins:
    """Margins at a point.

    Args:
        state: phases and sides.
        point: the point.
        at: stance of the whiskers at the point.
        ahead: sin(alpha), with the sign that makes it positive before the vertex.
        remaining: distance of the drive to its next stop.
        friction_angle: largest lean of a contact force.
        profile: the object; not needed without edges.
    """
    free = state.free
    force, lean, slack = point.z[:, :3].T
    first = at.first(state.standing)
    far = jnp.inf
    low = high = NOTHING
    if state.piece is not None and profile is not None and profile.has_edges:
        start, end = ends_of(profile, state.piece)
        low, high = (jnp.where(free, far, margin) for margin in (lean - start, end - lean))
    return Margins(
        touch=jnp.where(free & first.reaches, state.standing * (at.x - first.x), far),
        release=jnp.where(free, far, force),
        phase=jnp.where(free, far, jnp.where(state.phase == Phase.tip, -slack, slack)),
        vertex=jnp.where(free, far, ahead),
        stop=jnp.reshape(remaining, 1),
        slip=_sticking(state, lambda limit: limit - jnp.abs(lean) + lean_noise(force), friction_angle, far),
        low=low,
        high=high,
    )


def margin_rates(problem: Problem, state: ContactState, point: Point, direction: Point, pose_rate: Poses) -> Margins:
    """Derivatives of the margins along the path; zero for vertex and stop, which are passed only once."""
    free, lean = state.free, point.z[:, LEAN]
    moves = jnp.where(free, 0.0, direction.z[:, PARAMETER]) if problem.profile.has_edges else NOTHING
    return Margins(
        touch=jnp.where(free, problem.touch_rate(state.standing, pose_rate), 0.0),
        release=jnp.where(free, 0.0, direction.z[:, FORCE]),
        phase=jnp.where(free, 0.0, jnp.where(state.phase == Phase.tip, -1.0, 1.0) * direction.z[:, SLACK]),
        vertex=jnp.zeros_like(state.side),
        stop=jnp.zeros(1),
        slip=_sticking(state, lambda _: -jnp.sign(lean) * direction.z[:, LEAN], problem.friction_angle, 0.0),
        low=moves,
        high=-moves,
    )


def lean_noise(force: PerWhisker) -> PerWhisker:
    """Angle by which rounding may make the leans of contacts that stick exceed their limit."""
    return jnp.minimum(LEAN_NOISE, CONE_NOISE / jnp.maximum(force, CONE_NOISE))


def _sticking(
    state: ContactState, values: Callable[[Scalar], PerWhisker], limit: Scalar | None, otherwise: float
) -> Float[Array, " sticking"]:
    if state.friction is None or limit is None:
        return jnp.zeros(0)
    return jnp.where(state.sticks, values(limit), otherwise)
