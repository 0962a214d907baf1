"""Stances: where bases stand before the object, and where their unloaded whiskers would first touch it."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxwhisker._equilibrium.touch import TouchAlongX

PerWhisker = Float[Array, " whiskers"]
Contacts = Float[Array, "*batch whiskers numbers"]  # three numbers, and loads (see contact.py and couplings.py)
PerObject = Float[Array, "*objects whiskers"]  # of each object, if there are several, and each whisker
Poses = Float[Array, "whiskers axes"]


class ScenePose(NamedTuple):
    """Poses of bases in the scene, dimensionless; angles to the upright, rad, positive counter-clockwise."""

    x: PerWhisker
    y: PerWhisker
    angle: PerWhisker


def of_object(values: Shaped[Array, "objects whiskers"], number: Int[Array, " whiskers"]) -> Shaped[Array, " whiskers"]:
    """Each whisker's value for one of the objects."""
    return jnp.take_along_axis(values, number[None], axis=0)[0]


class Stance(NamedTuple):
    """Positions of bases in the scene, and the first touches of their unloaded whiskers if the bases moved along x.

    With several objects, touches and what follows from them have the leading axis of the objects.
    """

    x: PerWhisker
    right: TouchAlongX  # in an approach from the right
    left: TouchAlongX
    free: Contacts | None = None  # their contacts if they are free (contact.py); None if unbent
    loads: Float[Array, "whiskers loads"] | None = None  # the last part of their contacts; None without couplings

    def of(self, number: Int[Array, " whiskers"] | None) -> "Stance":
        """The stance of each whisker before one of several objects; None if there is only one."""
        if number is None:
            return self
        pick = partial(of_object, number=number)
        right, left = (jax.tree.map(pick, touch) for touch in (self.right, self.left))
        return self._replace(right=right, left=left)

    def first(self, side: PerObject) -> TouchAlongX:
        """First touches of whiskers that approach from these sides (+1 right, -1 left)."""
        return jax.tree.map(lambda right, left: jnp.where(side > 0, right, left), self.right, self.left)

    @property
    def contact_if_free(self) -> Contacts | float:
        """Contacts (see contact.py) of the whiskers if they are free."""
        return 0.0 if self.free is None else self.free

    @property
    def clear(self) -> Bool[Array, "*objects whiskers"]:
        """Whether unloaded whiskers stand clear of the object."""
        return ~self.right.reaches | (self.x > self.right.x) | (self.x < self.left.x)

    @property
    def side(self) -> PerObject:
        """The side of the object on which a whisker stands, or the nearer side: +1 right, -1 left."""
        return jnp.where(self.x - self.right.x >= self.left.x - self.x, 1.0, -1.0)
