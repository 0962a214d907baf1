"""The state of a march: where it is, what it is doing, and the step that it tries."""

from enum import IntEnum
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import PARAMETER
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.point import Contacts, Point
from jaxwhisker._equilibrium.solver import Solution
from jaxwhisker._equilibrium.stance import PerObject, PerWhisker, Poses, Stance
from jaxwhisker._path import snap_flow
from jaxwhisker._path.events import Ends, Lead, Margins
from jaxwhisker._path.path import Node, Status


class Task(IntEnum):
    """Task of an iteration of the march (see march.py)."""

    advance = 0
    event = 1
    arrive = 2
    done = 3
    kick = 4
    flow = 5


class Target(NamedTuple):
    """An event to be solved for: the margin that vanishes, the whisker concerned, and the expected distance."""

    number: Int[Array, ""]  # of the kind of event (see events.py)
    whisker: Bool[Array, " whiskers"]  # one-hot; all False for a stop
    distance: Scalar  # along the tangent
    contact: Contacts  # first contacts of whiskers that may touch
    phase: Int[Array, " whiskers"]
    side: PerWhisker
    limit: PerWhisker | None = None  # lean or parameter at which it happens; None without friction and edges
    piece: Int[Array, " whiskers"] | None = None  # of first contacts, and onto which contacts pass; None without edges
    object: Int[Array, " whiskers"] | None = None  # that is touched; None if there is only one


class MarchState(NamedTuple):
    """State of the march between two iterations."""

    task: Int[Array, ""]
    state: ContactState
    point: Point
    pose: Poses
    tangent: Point
    tangent_pose: Poses
    bend: Point  # change of the tangent per arc length
    step: Scalar  # length of the next step
    unstable_at: Scalar  # distance ahead of a known unstable equilibrium, or infinity
    unstable_turns: Float[Array, " rates"]  # of what must not turn back (law.py), there
    target: Target
    lead: Lead
    before_vertex: PerWhisker  # sign of sin(alpha) until the whisker passes the vertex
    goal: Int[Array, ""]  # index of the stop that the drive moves to
    direction: Scalar  # +1 while the drive moves towards larger u, else -1
    travel: Scalar  # distance that the drive has travelled since the first stop; negative on the approach to it
    pending: Node  # node to be written on arrival
    flow: snap_flow.Flow
    count: Int[Array, ""]
    status: Int[Array, ""]
    tries: Int[Array, ""] | None = None  # of the slips with which the path leaves an event; None without friction
    # Whiskers whose slip has come to rest here. The lean at which they stick does not change at first: rounding alone
    # decides about the sign of its rate.
    rests: Bool[Array, " whiskers"] | None = None
    stance: Stance | None = None  # at this point; None where it is known without computing anything
    # The profile's parameters where contacts stick, which are integrated along it; None without friction.
    stuck_at: PerWhisker | None = None

    @property
    def parameters(self) -> PerWhisker:
        """The profile's parameters at all contacts."""
        known = self.point.z[:, PARAMETER]
        return known if self.stuck_at is None else jnp.where(self.state.sticks, self.stuck_at, known)

    def drive_rate(self, tangent: Point) -> Scalar:
        """du/ds along a tangent, positive while the drive moves towards its stop."""
        return self.direction * tangent.u

    def stopped(self, status: Status | Int[Array, ""]) -> "MarchState":
        """The state after the march has ended with this status."""
        return self._replace(
            task=jnp.asarray(int(Task.done)), status=jnp.asarray(int(status) if isinstance(status, Status) else status)
        )


class Trial(NamedTuple):
    """The solved end of a step, and its checks."""

    solution: Solution
    tangent: Point
    tangent_pose: Poses
    stable: Bool[Array, ""]
    sound: Bool[Array, ""]  # whether all contacts are as the equations assume
    here: Margins  # at the start of the step
    there: Margins  # at its end
    stance: Stance  # at its end
    standing: PerObject  # sides on which free whiskers stand at its end
    turns: Float[Array, " rates"]  # of what must not turn back (law.py), for contacts with hardly any force infinite
    reason: Status | Int[Array, ""] = Status.not_convex  # the status if contacts are not sound
    ends: Ends | None = None  # of the pieces on which contacts are; None without edges
    parameters: PerWhisker | None = None  # of the profile at contacts; None without friction
