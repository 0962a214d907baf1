"""What a march of whiskers in space with several contacts asks about a step, and the contacts that begin."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.rows import RowsOfContacts, with_row, without_row
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._space_chain.newton import ChainSolutionInSpace, PhasesOfRows
from jaxwhisker._space_chain.stance import ChainStanceInSpace


class NewContactInSpace(NamedTuple):
    """A contact that begins: its row among all contacts, and what it is like."""

    row: Int[Array, ""]
    contact: Float[Array, "11"]
    phase: Int[Array, ""]


class FlowOfChainInSpace(NamedTuple):
    """Contacts that slide after a loss of stability."""

    time: Scalar  # length of the next time step
    steps: Int[Array, ""]
    start: RowsOfContacts  # at the loss
    way: Float[Array, "rows 3"]  # of the contacts in the last time step; zero where they have changed since
    opens: Bool[Array, ""]  # whether no contact has split on the way
    clings: Bool[Array, " rows"]  # not to come free: the unloaded shape is inside an object
    last: RowsOfContacts  # of a whisker that has come free, just before
    last_phase: PhasesOfRows


class TrialOfChainInSpace(NamedTuple):
    """The solved end of a step, and what it is like there."""

    solution: ChainSolutionInSpace
    tangent: Point  # of unit length in the scale of the point
    stance: ChainStanceInSpace
    guess: Point
    phase: PhasesOfRows  # in which it is solved for
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


def inserted(
    z: RowsOfContacts, phase: PhasesOfRows, new: NewContactInSpace, contacts: int
) -> tuple[RowsOfContacts, PhasesOfRows]:
    """The contacts with a new one; those of its whisker that follow it move on by one place."""
    return with_row((z, phase), new.row, (new.contact, new.phase), contacts)


def removed(
    z: RowsOfContacts, phase: PhasesOfRows, rows: Bool[Array, " rows"], contacts: int
) -> tuple[RowsOfContacts, PhasesOfRows]:
    """The contacts without one of these rows; those of its whisker that follow it move back by one place."""
    nothing = jnp.zeros_like(z), jnp.full_like(phase, int(Phase.free))
    return without_row((z, phase), rows, nothing, contacts)
