"""The path: what a scan's states and events are read from, and the words that describe it.

A path is a sequence of nodes, exact equilibria on the way that the drive takes, with the tangents of the path before
and behind each. Every corner of the path (an event, a turning point of the drive) is a node.
"""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.clearance import Stance
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.newton import Contacts, Mode, PerWhisker, Point, Poses


class Status(IntEnum):
    """What became of a step of the scan; everything but `ok` leaves NaN behind."""

    ok = 0
    invalid = 1  # a parameter lies outside its domain: the scene means nothing
    lost = 2  # the path could not be followed further: no equilibrium near the last one was found
    unsettled = 3  # after a loss of stability the bases did not come to rest
    not_convex = 4  # the profile is not convex where the scan touches it
    too_long = 5  # more nodes or events than the path has room for
    inexact = 6  # this step's equations are not fulfilled to tolerance
    unstable = 7  # this step's equilibrium is not stable


class EventKind(IntEnum):
    """What happens at an event."""

    touch = 0
    tip_to_tangential = 1
    vertex = 2
    tangential_to_tip = 3
    release = 4  # contact ends smoothly, its force going to zero
    snap_through = 5
    snap_off = 6


NO_EVENT = -1
STOP = -2  # the drive turns round or the scan ends


class Node(NamedTuple):
    """An equilibrium on the path, and how the path comes and goes."""

    point: Point
    z_before: Contacts  # contacts as the path comes: those that begin or end here differ
    arriving: Point  # tangents, of unit length in the scale of the point
    leaving: Point
    phase: Int[Array, " whiskers"]  # from here on
    side: PerWhisker
    travel: Float[Array, ""]  # way of the drive since the first step; negative on the approach to it
    kind: Int[Array, ""]
    whiskers: Bool[Array, " whiskers"]  # which the event concerns
    phase_before: Int[Array, " whiskers"]
    side_before: PerWhisker


class Path(NamedTuple):
    """Nodes 0 to count - 1; arrays are padded. Beyond the last node's travel the status tells why there is nothing."""

    nodes: Node
    count: Int[Array, ""]
    status: Int[Array, ""]


def select(condition, yes, no):
    """One of two trees of the same structure."""
    # What both share is not asked: most of a march's decisions change little.
    return jax.tree.map(lambda a, b: a if a is b else jnp.where(condition, a, b), yes, no)


def decided(*cases, otherwise):
    """The tree of the first case (condition, tree) whose condition holds."""
    conditions = [condition for condition, _ in cases]
    first = jnp.argmax(jnp.stack([*conditions, jnp.asarray(True)]))
    for number, (_, tree) in reversed(list(enumerate(cases))):
        otherwise = select(first == number, tree, otherwise)
    return otherwise


class Margins(NamedTuple):
    """How far each whisker is from each event; an event is where its margin turns negative."""

    touch: PerWhisker
    release: PerWhisker
    phase: PerWhisker  # tip <-> tangential
    vertex: PerWhisker
    stop: Float[Array, " 1"]


def margins(mode: Mode, point: Point, at: Stance, ahead: PerWhisker, way: Scalar) -> Margins:
    """Margins at a point. `ahead` is the sign of sin(alpha) before the vertex, `way` what the drive still has to go."""
    free = mode.phase == Phase.free
    force, _, slack = point.z.T
    first = at.first(mode.side)
    far = jnp.inf
    return Margins(
        touch=jnp.where(free & first.reaches, mode.side * (at.x - first.x), far),
        release=jnp.where(free, far, force),
        phase=jnp.where(free, far, jnp.where(mode.phase == Phase.tip, -slack, slack)),
        vertex=jnp.where(free, far, ahead),
        stop=jnp.reshape(way, 1),
    )


def rates(mode: Mode, direction: Point, pose: Poses) -> Margins:
    """How the margins change along a direction of the path, but for the vertex and the stop, which are passed once.

    Where a pose is more than x, the touch's is left out, too.
    """
    free = mode.phase == Phase.free
    none = jnp.zeros_like(pose[:, 0])
    return Margins(
        touch=jnp.where(free, mode.side * pose[:, 0], 0.0) if pose.shape[1] == 1 else none,
        release=jnp.where(free, 0.0, direction.z[:, 0]),
        phase=jnp.where(free, 0.0, jnp.where(mode.phase == Phase.tip, -1.0, 1.0) * direction.z[:, 2]),
        vertex=none,
        stop=jnp.zeros(1),
    )
