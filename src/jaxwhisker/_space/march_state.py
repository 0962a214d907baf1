"""The state of a march in space: where it is, what it is doing, and the nodes that it writes."""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.path import NO_EVENT, Status
from jaxwhisker._space.free import Nearest
from jaxwhisker._space.newton import Phases, SpaceSolution
from jaxwhisker._space.problem import Contacts
from jaxwhisker._space.slip import SlipState
from jaxwhisker._space.stance import SpaceStance


class SpaceTask(IntEnum):
    """Task of an iteration of the march (see march.py)."""

    advance = 0
    event = 1
    arrive = 2
    done = 3
    flow = 4


TOUCH, RELEASE, PHASE, AT_STOP, GRIP, LOSS, SNAP = range(7)  # kinds of margins, and what follows from a loss
SETTLED = -3  # kind of a node at which contacts have settled, besides NO_EVENT and STOP


class SpaceNode(NamedTuple):
    """An equilibrium on the path, and the path's directions before and after it."""

    point: Point
    z_before: Contacts  # on arrival, which differs for a whisker that begins to touch
    arriving: Point
    leaving: Point
    phase: Phases  # from here on
    phase_before: Phases
    travel: Float[Array, "*nodes"]  # distance that the drive has travelled since the first stop; negative before it
    kind: Int[Array, ""]  # EventKind, NO_EVENT, STOP or SETTLED
    whiskers: Bool[Array, " whiskers"]
    # Of the step that ends here; None without friction:
    mode: Int[Array, " whiskers"] | None
    inner: Point | None  # its other stages, fields (stages - 1, ...)


class SpacePath(NamedTuple):
    """Nodes 0 to count - 1, in padded arrays. The status says why the path ends where it does."""

    nodes: SpaceNode
    count: Int[Array, ""]
    status: Int[Array, ""]


class SpaceTarget(NamedTuple):
    """An event to be solved for."""

    margin: Int[Array, ""]
    whiskers: Bool[Array, " whiskers"]
    distance: Scalar  # along the path, expected
    first: Nearest  # contacts that may begin, fields (whiskers, ...)


class SpaceFlow(NamedTuple):
    """Contacts that slide after a loss of stability."""

    time: Scalar  # length of the next time step
    steps: Int[Array, ""]
    start: Contacts  # at the loss
    clings: Bool[Array, " whiskers"]  # not to come free: the unloaded shape is inside the object
    opens: Bool[Array, ""]  # whether no contact has split on the way


class March(NamedTuple):
    """State of the march between two iterations."""

    task: Int[Array, ""]
    phase: Phases
    point: Point
    tangent: Point
    bend: Point  # change of the tangent per arc length
    step: Scalar
    stance: SpaceStance  # of free whiskers
    size: Scalar  # determinant of the sliding stiffness here; halved by the Illinois rule
    unstable_at: Scalar  # distance ahead of a known unstable state, or infinity
    unstable_size: Scalar  # the determinant there
    target: SpaceTarget
    pending: SpaceNode
    goal: Int[Array, ""]
    direction: Scalar  # +1 while the drive moves towards larger u
    travel: Scalar
    touched: Bool[Array, ""]
    flow: SpaceFlow
    slip: SlipState | None
    sunk: Bool[Array, " whiskers"] | None  # freed although still a little inside the object; None without friction
    count: Int[Array, ""]
    status: Int[Array, ""]

    def stopped(self, status: Status | Array) -> "March":
        """The state after the march has ended with this status."""
        return self._replace(task=jnp.asarray(int(SpaceTask.done)), status=jnp.asarray(status, dtype=int))


class SpaceTrial(NamedTuple):
    """The solved point of an iteration, and what it is like there."""

    solution: SpaceSolution
    tangent: Point  # of unit length in the scale of the point
    stance: SpaceStance
    guess: Point  # of the end of the step
    phase: Phases  # in which it is solved for
    stop: Scalar  # the control that the drive moves to
    stops: Float[Array, " stops"]
    last: Int[Array, ""]  # index of the last stop

    @property
    def point(self) -> Point:
        """The solved point: the end of the step."""
        return self.solution.end


Outcome = tuple[March, Bool[Array, ""] | Array, SpaceNode]  # the next state, whether to write a node, and that node


def node_at(march: March, point: Point, tangent: Point, points: Point | None = None) -> SpaceNode:
    """A plain node: the path goes on as it arrives. `points` are the stages of a step with friction."""
    travel = march.travel + jnp.abs(point.u - march.point.u)
    nobody = jnp.zeros_like(march.phase, bool)
    mode, inner = None, None
    if march.slip is not None:
        points = march.pending.inner if points is None else jax.tree.map(lambda leaf: leaf[:-1], points)
        mode, inner = march.slip.mode, points
    kind = jnp.asarray(NO_EVENT)
    return SpaceNode(point, point.z, tangent, tangent, march.phase, march.phase, travel, kind, nobody, mode, inner)
