"""What a march of whiskers with several contacts knows, and what it asks about a step."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.gaps import Candidate
from jaxwhisker._chain.newton import ChainSolution
from jaxwhisker._equilibrium.point import Contacts, Point
from jaxwhisker._path.march_state import MarchState

TOUCH, RELEASE, PHASE, LOW, HIGH, AT_STOP, SNAP = range(7)  # kinds of margins, and the arrival after a snap
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


class ChainFlow(NamedTuple):
    """What follows from a loss of stability."""

    beyond: Scalar  # distance of the control behind the loss at which whiskers come to rest
    start: Contacts  # from where they begin to move
    u: Scalar  # the control of the loss
    travel: Scalar  # of the drive, there
    snaps: Int[Array, ""]  # so many have happened there before
    tries: Int[Array, ""]


class MarchOfChain(MarchState):
    """State of a march of whiskers with several contacts."""

    slips: Bool[Array, ""]  # whether a contact has come to an end of its piece behind which it cannot go on
    rate: Scalar  # of the drive along the path, here; halved by the Illinois rule
    unstable_rate: Scalar  # the rate at a known unstable equilibrium
    touched: Bool[Array, ""]


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

    @property
    def point(self) -> Point:
        """The end of the step."""
        return self.solution.point

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether it is solved for."""
        return self.solution.converged


def inserted(z: Contacts, state: ChainState, new: NewContact, contacts: int) -> tuple[Contacts, ChainState]:
    """The contacts with a new one; those of its whisker that follow it move on by one place."""
    index = jnp.arange(z.shape[0])
    moves = (index > new.row) & (index // contacts == new.row // contacts)
    source, here = jnp.where(moves, index - 1, index), index == new.row

    def put(leaf, own):
        moved = leaf[source]
        return jnp.where(here[:, None] if leaf.ndim > 1 else here, own, moved)

    numbers = put(z, new.numbers)
    return numbers, ChainState(*map(put, state, (new.phase, new.side, new.piece)))


def removed(z: Contacts, state: ChainState, rows: Bool[Array, " rows"], contacts: int) -> tuple[Contacts, ChainState]:
    """The contacts without one of these rows; those of its whisker that follow it move back by one place."""
    index, gone = jnp.arange(z.shape[0]), jnp.any(rows)
    row = jnp.argmax(rows)
    moves = gone & (index >= row) & (index // contacts == row // contacts)
    at_end = index % contacts == contacts - 1
    source, empty = jnp.where(moves & ~at_end, index + 1, index), moves & at_end

    def taken(leaf, nothing):
        moved = leaf[source]
        return jnp.where(empty[:, None] if leaf.ndim > 1 else empty, nothing, moved)

    return taken(z, 0.0), ChainState(*(taken(own, nothing) for own, nothing in zip(state, (0, 1.0, 0), strict=True)))
