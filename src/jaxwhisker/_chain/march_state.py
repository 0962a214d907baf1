"""What a march of whiskers with several contacts knows, and what it asks about a step."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState, unused
from jaxwhisker._chain.gaps import Candidate
from jaxwhisker._chain.newton import ChainSolution
from jaxwhisker._chain.rows import RowsOfContacts, with_row, without_row
from jaxwhisker._equilibrium.friction import slipping_from
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.march_state import MarchState
from jaxwhisker._path.path import Node

TOUCH, RELEASE, PHASE, LOW, HIGH, LEAN, AT_STOP, SNAP = range(8)  # kinds of margins, and the arrival after a snap
PerRow = Float[Array, " rows"]


class NewContact(NamedTuple):
    """A contact that begins: its row among all contacts, and what it is like."""

    row: Int[Array, ""]
    numbers: Float[Array, "3"]
    phase: Int[Array, ""]
    side: Float[Array, ""]
    piece: Int[Array, ""]


class ChainStance(NamedTuple):
    """What the march asks about a point of the path, besides its equations."""

    gap: Float[Array, "whiskers candidates"]  # of contacts that may begin
    distance: Float[Array, " whiskers"]  # from the nearest object
    outside: Bool[Array, ""]  # whether no base is inside an object
    opens: Bool[Array, ""]  # whether object and shaft part on both sides of every contact
    speed: Scalar  # largest speed of any point of a whisker whose base does not yield, per control
    parameter: PerRow  # of the object, at each contact; 0 for places that are not used


class ChainFlow(NamedTuple):
    """What follows from a loss of stability."""

    attempt: Int[Array, ""]  # number of the distance behind the loss at which whiskers come to rest
    start: RowsOfContacts  # from where they begin to move
    u: Scalar  # the control of the loss
    travel: Scalar  # of the drive, there
    snaps: Int[Array, ""]  # so many have happened there before
    tries: Int[Array, ""]
    landed: Scalar  # the control nearest to the loss at which their contacts have been solved for
    push: Float[Array, " whiskers"]  # forces of all contacts of a whisker where rods have come to rest


class MarchOfChain(MarchState):
    """State of a march of whiskers with several contacts."""

    slips: Bool[Array, ""]  # whether a contact has come to an end of its piece behind which it cannot go on
    turns: Float[Array, " rates"]  # rates of what must not turn back, here; halved by the Illinois rule
    unstable_turns: Float[Array, " rates"]  # the same at a known unstable equilibrium
    touched: Bool[Array, ""]
    slips_tried: Int[Array, ""]  # so many times at the last event, with friction
    rests: Bool[Array, " rows"]  # contacts whose slip has come to rest here
    lead: Point  # derivatives of what must grow where slips have been changed

    def node(self, point: Point, tangent: Point, **remembered: Any) -> Node:
        if self.state.friction is not None:
            remembered = {"stop": self.goal, "corner": jnp.asarray(False)} | remembered
        return super().node(point, tangent, **remembered)


class TrialOfChain(NamedTuple):
    """The solved end of a step, and what it is like there."""

    solution: ChainSolution
    tangent: Point  # of unit length in the scale of the point
    stance: ChainStance
    candidates: Candidate  # contacts that may begin; fields (whiskers, candidates)
    guess: Point
    state: ChainState  # in which it is solved for
    stop: Scalar  # the control that the drive moves to
    last: Int[Array, ""]  # index of the last stop
    stable: Bool[Array, ""]
    turns: Float[Array, " rates"]  # rates of what must not turn back: of the drive, and of contacts that slip

    @property
    def point(self) -> Point:
        """The end of the step."""
        return self.solution.point

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether it is solved for."""
        return self.solution.converged


def inserted(z: RowsOfContacts, state: ChainState, new: NewContact, contacts: int) -> tuple[RowsOfContacts, ChainState]:
    """The contacts with a new one; those of its whisker that follow it move on by one place."""
    begun = None if state.friction is None else slipping_from(new.side)
    own = new.numbers, ChainState(new.phase, new.side, new.piece, begun)
    return with_row((z, state), new.row, own, contacts)


def removed(
    z: RowsOfContacts, state: ChainState, rows: Bool[Array, " rows"], contacts: int
) -> tuple[RowsOfContacts, ChainState]:
    """The contacts without one of these rows; those of its whisker that follow it move back by one place."""
    nothing = jnp.zeros_like(z), unused(z.shape[0], friction=state.friction is not None)
    return without_row((z, state), rows, nothing, contacts)
