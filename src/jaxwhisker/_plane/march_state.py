"""What a march in the plane knows besides what all marches know, and what it asks about a step."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._equilibrium.contact import PARAMETER
from jaxwhisker._equilibrium.point import Contacts, Point
from jaxwhisker._equilibrium.solver import Solution
from jaxwhisker._equilibrium.stance import PerObject, PerWhisker, Poses, Stance
from jaxwhisker._path.march_state import MarchState
from jaxwhisker._path.margins import Margins
from jaxwhisker._path.path import Status
from jaxwhisker._plane.events import Ends, Facts, Lead
from jaxwhisker._plane.snap_flow import Flow


class FirstContact(NamedTuple):
    """Contacts of whiskers that may touch."""

    contact: Contacts
    phase: Int[Array, " whiskers"]
    side: PerWhisker
    piece: Int[Array, " whiskers"] | None = None  # of first contacts, and onto which contacts pass; None without edges
    object: Int[Array, " whiskers"] | None = None  # that is touched; None if there is only one


class MarchInPlane(MarchState):
    """State of a march in the plane."""

    pose: Poses
    tangent_pose: Poses
    unstable_turns: Float[Array, " rates"]  # of what must not turn back (law.py), at a known unstable equilibrium
    lead: Lead
    before_vertex: PerWhisker  # sign of sin(alpha) until the whisker passes the vertex
    slips_tried: Int[Array, ""] | None = None  # so many times at the last event; None without friction
    # Whiskers whose slip has come to rest here. The lean at which they stick does not change at first: rounding alone
    # decides about the sign of its rate.
    rests: Bool[Array, " whiskers"] | None = None
    # The profile's parameters where contacts stick, which are integrated along it; None without friction.
    stuck_at: PerWhisker | None = None

    @property
    def parameters(self) -> PerWhisker:
        """The profile's parameters at all contacts."""
        known = self.point.z[:, PARAMETER]
        return known if self.stuck_at is None else jnp.where(self.state.sticks, self.stuck_at, known)


class Proposed(NamedTuple):
    """What is known of a step before it is solved for."""

    guess: Point  # of its end
    facts: Facts  # of the event that is sought
    flow: Flow


class TrialInPlane(NamedTuple):
    """The solved end of a step, and its checks."""

    proposed: Proposed
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

    @property
    def point(self) -> Point:
        """The end of the step."""
        return self.solution.point

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether it is solved for."""
        return self.solution.converged

    @property
    def guess(self) -> Point:
        """Where it was predicted."""
        return self.proposed.guess
