"""Contact state: how each whisker touches the object, or that it is free. It selects one system of equations."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.friction import Friction, newly_slipping, slipping_from
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import PerObject, PerWhisker, of_object

Places = tuple[Float[Array, "*batch whiskers"], Float[Array, "*batch whiskers"]]  # parameter, beyond: see Friction


class ContactState(NamedTuple):
    """Phase and side of every whisker; slips with friction, and pieces and sides of objects that have several."""

    phase: Int[Array, "*batch whiskers"]
    side: Float[Array, "*batch whiskers"]  # +1: the whisker approached from the right of the object; -1: from the left
    friction: Friction | None = None  # None without friction
    piece: Int[Array, "*batch whiskers"] | None = None  # of the profile at each contact, 0 if free; None without edges
    # The side of each of several objects on which a whisker stands or, while it touches another one, has stood last.
    sides: Float[Array, "*batch objects whiskers"] | None = None

    @property
    def free(self) -> Bool[Array, "*batch whiskers"]:
        """Whether whiskers touch nothing."""
        return self.phase == Phase.free

    @property
    def touches(self) -> Bool[Array, "*batch whiskers"]:
        """Whether whiskers touch an object."""
        return self.phase != Phase.free

    @property
    def sticks(self) -> Bool[Array, "*batch whiskers"]:
        """Whether contacts stick to the object; only with friction."""
        return self.touches & (self.slip == 0)

    @property
    def slip(self) -> Int[Array, "*batch whiskers"]:
        """Directions in which contacts slip along the object, 0 if they stick; only with friction."""
        assert self.friction is not None
        return self.friction.slip

    @property
    def places(self) -> Any:  # Places | None, or only their shapes
        """Where contacts began to stick; None without friction."""
        return None if self.friction is None else self.friction[1:]

    def stuck_at(self, places: Places | None) -> "ContactState":
        """The state of contacts that began to stick at these places; None without friction."""
        if self.friction is None or places is None:
            return self
        return self._replace(friction=Friction(self.friction.slip, *places))

    @property
    def standing(self) -> PerObject:
        """The sides on which free whiskers stand: of the object, or of each of several."""
        return self.side if self.sides is None else self.sides

    def side_of(self, number: Int[Array, " whiskers"] | None) -> PerWhisker:
        """The side on which a free whisker stands of one of several objects; None if there is only one."""
        return self.side if self.sides is None or number is None else of_object(self.sides, number)

    def now_standing(self, standing: PerObject) -> "ContactState":
        """The state with these sides."""
        return self._replace(side=standing) if self.sides is None else self._replace(sides=standing)

    def ended(self, which: Bool[Array, "*batch whiskers"], standing: PerObject | None = None) -> "ContactState":
        """The state after the contacts of these whiskers have ended; from now on, they stand on these sides."""
        now = self if standing is None else self.now_standing(jnp.where(which, standing, self.standing))
        return now._replace(
            phase=jnp.where(which, Phase.free, self.phase),
            friction=newly_slipping(self.friction, which, now.side),
            piece=None if self.piece is None else jnp.where(which, 0, self.piece),
        )

    def begun(
        self,
        which: Bool[Array, " whiskers"],
        phase: Int[Array, " whiskers"],
        side: PerWhisker,
        piece: Int[Array, " whiskers"] | None,
    ) -> "ContactState":
        """The state after contacts of these whiskers have begun, in these phases, on these sides and pieces."""
        return self._replace(
            phase=jnp.where(which, phase, self.phase),
            side=jnp.where(which, side, self.side),
            friction=newly_slipping(self.friction, which, side),
            piece=self.piece if self.piece is None or piece is None else jnp.where(which, piece, self.piece),
        )


def all_free(problem: Problem, side: PerObject) -> ContactState:
    """The state of free whiskers that stand on these sides: of the object, or of each of several."""
    own = side if side.ndim == 1 else side[0]
    return ContactState(
        jnp.zeros(own.size, int),
        own,
        None if problem.friction_angle is None else slipping_from(own),
        jnp.zeros(own.size, int) if problem.profile.has_pieces else None,
        None if side.ndim == 1 else side,
    )
