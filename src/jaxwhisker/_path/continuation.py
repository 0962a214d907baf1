"""What the march asks of whiskers, in the plane and in space.

The march (march.py) and what follows from its steps (transitions.py) are written once, in terms of these methods. They
know neither how many unknowns a contact has, nor whether there is a plane or friction.
"""

import abc
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.march_state import Cases, MarchState, Outcome, Target, Trial
from jaxwhisker._path.path import Node, Path


class Limits(NamedTuple):
    """Controls at which a scan right across the object begins, ends if nothing happens, and stops searching."""

    start: Scalar
    end: Scalar
    far: Scalar
    known: Any = True  # whether whiskers are known to be free at the start, and on the way to it


class Loss(NamedTuple):
    """Whether stability is lost, at a turning point of the path, within a step or at its end."""

    holds: Bool[Array, ""]  # nothing turns back within the step
    located: Bool[Array, ""]  # what turns back does so at the end
    reached: Bool[Array, ""] | None = None  # what is known to turn back ahead rests at the end; in the plane
    rests: Bool[Array, " rates"] | None = None  # the contacts among this


class TargetPoint(NamedTuple):
    """The point where the margin of a target vanishes."""

    good: Bool[Array, ""]  # whether it is solved for, within the last step
    distance: Scalar  # along the path
    step: Scalar  # length of the step that is tried if it is not
    violated: Bool[Array, ""]  # whether another margin vanishes before
    earlier: Target  # the event there
    holds: Bool[Array, ""]  # whether the path is still stable there


class Arrival(NamedTuple):
    """The point of an event in the state that holds from here on."""

    node: Node
    good: Bool[Array, ""]  # whether the path goes on from here, and not one of these cases:
    others: Cases


class WaysOn(NamedTuple):
    """How the path may go on from an event in other ways than along its direction, or in a snap."""

    others: Cases
    onwards: Any  # the state if none of these cases holds
    first: Bool[Array, ""]  # whether the node is to be written now; otherwise only if the march ends here


M = TypeVar("M", bound=MarchState)
T = TypeVar("T", bound=Trial)


class Continuation(abc.ABC, Generic[M, T]):
    """The parts of a march that depend on the mechanics."""

    margin_noise: ClassVar[float]  # accuracy of margins; with it, two events at one place do not violate each other
    touch: ClassVar[int]  # number of the event in which a contact begins
    at_stop: ClassVar[int]  # number of the event of a stop

    problem: Any

    # How a march begins and ends, and how large it may become.

    @abc.abstractmethod
    def limits(self, first_stop: Scalar) -> Limits:
        """The limits of a scan to a first stop, or right across the object if that is NaN."""

    @abc.abstractmethod
    def crop(self, path: Path, whole: Bool[Array, ""], limits: Limits) -> tuple[Path, Scalar, Scalar]:
        """The path, and the first and last control at which whiskers touch on it, with a margin."""

    @abc.abstractmethod
    def checked(self, path: Path) -> Path:
        """The path up to where what follows is not modelled."""

    @abc.abstractmethod
    def capacity(self, stops: int) -> int:
        """Largest number of nodes on a path to this many stops."""

    @abc.abstractmethod
    def room(self, capacity: int, last: Int[Array, ""]) -> Any:
        """Number of nodes that a march to this stop may use of a capacity."""

    @abc.abstractmethod
    def iterations(self, room: Any) -> Any:
        """Number of iterations of a march that may write so many nodes."""

    # A step.

    @abc.abstractmethod
    def start(self, stops: Float[Array, " stops"], limits: Limits) -> M:
        """The state in which the first iteration looks where free whiskers are before the first stop."""

    @abc.abstractmethod
    def trial(self, march: M, stops: Float[Array, " stops"], last: Int[Array, ""]) -> T:
        """Predict and solve for the end of a step."""

    @abc.abstractmethod
    def after_flow(self, march: M, trial: T) -> Outcome:
        """Handle a step of what follows from a loss of stability."""

    def felt(self, at: Point, change: Point) -> Point:
        """A change of a point as whiskers feel it."""
        del at
        return change

    def measured(self, direction: Point) -> Point:
        """What counts of a direction for lengths along the path."""
        return direction

    @abc.abstractmethod
    def node(self, march: M, trial: T) -> Node:
        """A plain node at the end of a step: the path continues as it arrives."""

    @abc.abstractmethod
    def moved(self, march: M, trial: T, moved: M) -> M:
        """The state at the end of a step, with what the mechanics alone knows."""

    @abc.abstractmethod
    def first_violated(self, march: M, trial: T, distance: Scalar) -> tuple[Bool[Array, ""], Target]:
        """Whether an event lies within a step of this length, and the first such event."""

    @abc.abstractmethod
    def before_loss(self, march: M, trial: T, distance: Scalar) -> M:
        """The state before a step at whose end, at this distance, stability is lost; with a shorter step to try."""

    # The end of a step along the path.

    @abc.abstractmethod
    def accepts(self, march: M, trial: T) -> tuple[Any, Any]:
        """Whether a solved step has not ended on another path, and by what factor the next may be longer at most."""

    @abc.abstractmethod
    def dip(self, march: M, trial: T, violated: Bool[Array, ""]) -> tuple[Bool[Array, ""], Scalar]:
        """Whether something may happen and be undone within a step, and the share of the step where to look for it."""

    def revised(
        self, march: M, trial: T, good: Bool[Array, ""], shorter: M
    ) -> tuple[Bool[Array, ""], M, Bool[Array, ""]]:
        """Whether a step is good, the state in which a shorter one is tried, and whether no step leads on."""
        del march, trial
        return good, shorter, jnp.asarray(False)

    def astray(self, march: M) -> M:
        """The state from which no step leads on along the path."""
        return march

    @abc.abstractmethod
    def loss(self, march: M, trial: T) -> Loss:
        """Compare the end of a step with what is known of a loss of stability ahead."""

    @abc.abstractmethod
    def after_loss(self, march: M, moved: M, trial: T, node: Node, loss: Loss) -> M:
        """The state where stability is lost."""

    @abc.abstractmethod
    def ends(self, march: M, trial: T, loss: Loss, turned: M) -> Cases:
        """Why a march may end, or its path turn, at the end of a good step; `turned` is the state after a loss."""

    @abc.abstractmethod
    def written(self, march: M, trial: T, node: Node, loss: Loss) -> tuple[Bool[Array, ""], Node]:
        """Whether the end of a good step is a node to be written, and this node."""

    def last_node(self, march: M) -> tuple[Bool[Array, ""], Node] | None:
        """Whether a march ends with a node that is not yet written, and the node; None if it never does."""
        del march

    @abc.abstractmethod
    def onwards(self, march: M, moved: M, trial: T, factor: Scalar) -> M:
        """The state after an accepted step, with the length of the next one; `factor` is that by its error."""

    # The point of an event.

    @abc.abstractmethod
    def found(self, march: M, trial: T) -> TargetPoint:
        """Compare the solution with the event that was sought."""

    def may_touch_otherwise(self) -> bool:
        """Whether whiskers may touch with the tip where their shaft was expected to, or the reverse."""
        return True

    def at_event(self, march: M, trial: T, found: TargetPoint) -> tuple[Cases, Cases]:
        """What else may follow from the point of an event: if it is not found, and if it is."""
        del march, trial, found
        return [], []

    @abc.abstractmethod
    def event_node(self, march: M, trial: T, found: TargetPoint) -> tuple[Bool[Array, ""], Node]:
        """Whether a node is to be written at once, and the node of an event, in the state that holds from here on."""

    @abc.abstractmethod
    def arriving(self, march: M, trial: T, arriving: M) -> M:
        """The state at an event, before the path leaves it, with what the mechanics alone knows."""

    # The point of an event in its new state.

    @abc.abstractmethod
    def leaves(self, march: M, trial: T, direction: Scalar) -> Scalar:
        """The sign of the tangent with which the path leaves an event, while the drive moves in this direction."""

    @abc.abstractmethod
    def leaving(self, march: M, trial: T, onwards: M, sign: Scalar) -> M:
        """The state in which the path leaves an event, with what the mechanics alone knows."""

    @abc.abstractmethod
    def arrived(self, march: M, trial: T, node: Node, falls: Bool[Array, ""]) -> Arrival:
        """Whether the point belongs to the path; `falls` tells whether the path cannot go on without a snap."""

    def is_over(self, march: M, trial: T, last: Int[Array, ""]) -> Bool[Array, ""]:
        """Whether nothing can happen any more on the way to the last stop."""
        del march, trial, last
        return jnp.asarray(False)

    @abc.abstractmethod
    def ways_on(self, march: M, onwards: M, node: Node, trial: T, falls: Bool[Array, ""]) -> WaysOn:
        """How the path may go on from an event."""

    @abc.abstractmethod
    def to_snap(self, march: M) -> M:
        """The state that is about to leave an equilibrium that has lost its stability."""
