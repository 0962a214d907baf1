"""What a march in space knows besides what all marches know, and what it asks about a step."""

from typing import NamedTuple, Protocol, runtime_checkable

from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.march_state import MarchState, Trial
from jaxwhisker._space.newton import Phases, SpaceSolution
from jaxwhisker._space.problem import Contacts
from jaxwhisker._space.slip import SlipState
from jaxwhisker._space.stance import SpaceStance

TOUCH, RELEASE, PHASE, AT_STOP, GRIP, LOSS, SNAP = range(7)  # kinds of margins, and what follows from a loss
SETTLED = -3  # kind of a node at which contacts have settled, besides NO_EVENT and STOP


class SpaceFlow(NamedTuple):
    """Contacts that slide after a loss of stability."""

    time: Scalar  # length of the next time step
    steps: Int[Array, ""]
    start: Contacts  # at the loss
    clings: Bool[Array, " whiskers"]  # not to come free: the unloaded shape is inside the object
    opens: Bool[Array, ""]  # whether no contact has split on the way


class MarchInSpace(MarchState):
    """State of a march in space."""

    size: Scalar  # determinant of the sliding stiffness here; halved by the Illinois rule
    unstable_size: Scalar  # the determinant at a known unstable equilibrium
    touched: Bool[Array, ""]
    slip: SlipState | None  # None without friction
    sunk: Bool[Array, " whiskers"] | None  # freed although still a little inside the object; None without friction

    @property
    def phase(self) -> Phases:
        """The phases of all whiskers."""
        return self.state.phase


@runtime_checkable
class AnyTrialInSpace(Trial, Protocol):
    """The solved end of a step, with one contact or with several."""

    @property
    def stop(self) -> Scalar:
        """The control that the drive moves to."""
        ...


class TrialInSpace(NamedTuple):
    """The solved end of a step, and what it is like there."""

    solution: SpaceSolution
    tangent: Point  # of unit length in the scale of the point
    stance: SpaceStance
    guess: Point
    phase: Phases  # in which it is solved for
    stop: Scalar  # the control that the drive moves to
    stops: Float[Array, " stops"]
    last: Int[Array, ""]  # index of the last stop

    @property
    def point(self) -> Point:
        """The end of the step."""
        return self.solution.end

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether it is solved for."""
        return self.solution.converged

    @property
    def stable(self) -> Bool[Array, ""]:
        """Whether the equilibrium is stable."""
        return self.stance.stable
