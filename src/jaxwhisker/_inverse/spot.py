"""A contact with something unknown, as one with a spot: an object without size, whose parameter is its slope."""

import jax.numpy as jnp

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.objects import Objects
from jaxwhisker._model.profile import AbstractProfile, ContactPoint


class Spot(AbstractProfile):
    """A point that whiskers may touch from all sides."""

    x: Scalar
    y: Scalar

    def point(self, parameter):
        return ContactPoint(jnp.asarray(self.x), jnp.asarray(self.y), jnp.cos(parameter), jnp.sin(parameter))

    def first_touch(self, height, side):
        raise NotImplementedError

    def vertex(self):
        return self.x, self.y

    def in_unit(self, length):
        return Spot(self.x / length, self.y / length)

    def _positive(self):
        return []

    def __str__(self):
        return "something unknown"


def with_spot(known: Objects, x: Scalar, y: Scalar) -> Objects:
    """Smooth objects, and after them a spot, on the last piece."""
    assert known.placeholder_parameter is not None
    return Objects((*known.each, Spot(x, y)), (*known.placeholder_parameter, 0.0))
