"""The path of equilibria: its nodes, and the events on it.

A path is a sequence of nodes: exact equilibria in the order in which the drive passes them, with the tangents of the
path before and after each. Every corner of the path (an event, a turning point of the drive) is a node.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.types import NamedInt, Scalar
from jaxwhisker._equilibrium.point import Contacts, Point

# Where the drive starts, turns and ends, in the scene's units; padded.
Stops = Float[Array, " stops"] | Float[np.ndarray, " stops"]
Last = Int[Array, ""] | Int[np.ndarray, ""] | int  # index of the last stop


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
    undetermined = 8  # contacts may move on in no way (with friction), or in more than one
    second_contact = 9  # a whisker has met the object in a second place; see `Scene.detects`
    crossing = 10  # two whiskers have crossed; see `Scene.detects`
    at_spring = 11  # a contact has reached a spring or a foundation on its shaft
    too_many_contacts = 12  # a whisker has more contacts than the scene has room for; see `Scene(contacts=)`


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
    bifurcation = 10  # in space: a symmetric branch loses its stability, and whiskers may go either way


SNAPS = (EventKind.snap_through, EventKind.snap_off)
NO_EVENT = -1
STOP = -2  # the drive reverses, or the scan ends


class Node(NamedTuple):
    """An equilibrium on the path, and the path's directions before and after it."""

    point: Point
    z_before: Contacts  # contacts on arrival, which differ if they begin or end here
    arriving: Point  # tangents, of unit length in the scale of the point
    leaving: Point
    state: Any  # of the contacts, from here on; `phase` is one of its fields
    before: Any  # on arrival
    travel: Float[Array, ""]  # distance that the drive has travelled since the first step; negative on the approach
    kind: Int[Array, ""]  # EventKind, NO_EVENT or STOP
    whiskers: Bool[Array, " whiskers"]  # those that the event concerns
    # What contacts with friction remember; None without.
    stop: Int[Array, ""] | None = None  # in the plane: index of the next stop
    corner: Bool[Array, ""] | None = None  # in the plane: whether contacts stick or slip at the node before
    inner: Point | None = None  # in space: the other stages of the step that ends here, fields (stages - 1, ...)


def is_snap(kind: Int[Array, "*nodes"]) -> Bool[Array, "*nodes"]:
    """Whether an event is a snap."""
    return (kind == EventKind.snap_through) | (kind == EventKind.snap_off)


class Path(NamedTuple):
    """Nodes 0 to count - 1, in padded arrays. The status says why the path ends where it does."""

    nodes: Node
    count: Int[Array, ""]
    status: Int[Array, ""]


class ScanPath(NamedTuple):
    """A path, and the range of the control in which whiskers touch the object."""

    path: Path
    start: Float[Array, ""]
    stop: Float[Array, ""]


def select(condition, yes, no):
    """Select one of two trees of the same structure by a condition."""

    def one(a: Any, b: Any) -> Any:
        # Leaves that both trees share need no selection: most decisions of a march change few leaves.
        if a is b:
            return a
        alike = jnp.shape(condition) == () and jnp.shape(a) == jnp.shape(b) and jnp.result_type(a) == jnp.result_type(b)
        # For a single condition, this is one operation where jnp.where needs three.
        return jax.lax.select(condition, *map(jnp.asarray, (a, b))) if alike else jnp.where(condition, a, b)

    return jax.tree.map(one, yes, no)


def first_case(*cases, otherwise):
    """Select the tree of the first case (condition, tree) whose condition holds."""
    conditions, trees = [condition for condition, _ in cases], [*(tree for _, tree in cases), otherwise]
    first = jnp.argmax(jnp.stack([*conditions, jnp.asarray(True)]))
    leaves, structure = zip(*map(jax.tree.flatten, trees), strict=True)
    # Leaves that all trees share need no selection.
    chosen = [k for k, same in enumerate(zip(*leaves, strict=True)) if any(leaf is not same[0] for leaf in same)]
    kinds = {k: jnp.result_type(*(own[k] for own in leaves)) for k in chosen}

    def case(own):
        return lambda: [jnp.asarray(own[k], dtype=kinds[k]) for k in chosen]

    # A switch: XLA would compute all conditions again for every leaf that is selected by them.
    selected = dict(zip(chosen, jax.lax.switch(first, [case(own) for own in leaves]), strict=True))
    return jax.tree.unflatten(structure[-1], [selected.get(k, leaf) for k, leaf in enumerate(leaves[-1])])


def event_room(whiskers: int) -> int:
    """Number of events that a scan has room for, unless it is known to have more; a path has more nodes."""
    return 32 + 16 * whiskers


def room_for(nodes: Any, count: Array, usual: int) -> tuple[int, ...]:
    """More room for events than usual, in powers of two, if a path that is known needs it; else nothing."""
    if checks.is_traced((nodes, count)):
        return ()
    most = int(np.sum(np.asarray(nodes.kind)[: int(count)] != NO_EVENT))  # stops among them
    return () if most <= usual else (usual * 2 ** math.ceil(math.log2(most / usual)),)


def first_and_last(public: Bool[Array, " nodes"], size: int) -> Int[Array, " events"]:
    """Indices of the events among nodes, in the order of the path: of too many, the first half and the last."""
    number, count = jnp.cumsum(public) - 1, jnp.sum(public)
    kept = public & (entry_of(number, count, size) >= 0)
    return jnp.nonzero(kept, size=size, fill_value=0)[0]


def entry_of(number: Int[Array, " nodes"], count: Int[Array, ""], size: int) -> Int[Array, " nodes"]:
    """Entries of events in arrays with room for so many, from their numbers among all; -1 for those left out."""
    late = number - jnp.maximum(count - size, 0)
    return jnp.where(number < size // 2, number, jnp.where(late >= size // 2, late, -1))


def cut(path: Path, place: Scalar, status: Int[Array, ""]) -> Path:
    """The path up to a place, with this status; the whole path if it is ok."""
    nodes, bad = path.nodes, status != Status.ok
    index = jnp.clip(jnp.floor(place).astype(int), 0, path.count - 1)
    after = jnp.minimum(index + 1, path.count - 1)
    here, there = nodes.travel[index], nodes.travel[after]
    travel = here + (place - index) * (there - here)
    # The node after the place stays, because states before it are interpolated, but nothing happens there.
    stays = bad & (travel > here)
    kind = nodes.kind.at[after].set(jnp.where(stays, NO_EVENT, nodes.kind[after]))
    nodes = nodes._replace(kind=kind, travel=nodes.travel.at[after].set(jnp.where(stays, travel, there)))
    if nodes.corner is not None:
        nodes = nodes._replace(corner=nodes.corner.at[after].set(jnp.where(stays, False, nodes.corner[after])))
    count = jnp.where(place < 0, 0, index + 1 + stays)
    return Path(nodes, jnp.where(bad, count, path.count), jnp.where(bad, status, path.status))
