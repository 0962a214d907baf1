"""Several objects in one scene in space."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._model.objects import numbered, of_one_kind
from jaxwhisker._model.surface import AbstractSurface, Point


class Surfaces(AbstractSurface):
    """Several objects as one surface: a scene in space makes it of a tuple of surfaces.

    The objects are apart from each other. A point on the surface of one of them is farther away from all others, and
    therefore belongs to the object that is nearest to first order: a contact needs no number. There is no plane before
    all of them.
    """

    each: tuple[AbstractSurface, ...]

    @property
    def is_convex(self):
        return False

    @property
    def objects(self):
        return self.each

    def object_of(self, x):
        return jnp.argmin(self.of_each(lambda one: one.off(x)))

    def of_each(self, function):
        kinds = of_one_kind(self.each)
        values = [jax.vmap(function)(some) for _, some in kinds]
        order = np.argsort(np.concatenate([numbers for numbers, _ in kinds]))
        return jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[order], *values)

    def _of_nearest(self, x: Point, function: Callable[[Any], Any]) -> Any:
        """A function of the object that a point belongs to."""
        number, values, kind = jax.lax.stop_gradient(self.object_of(x)), [], jnp.asarray(0)
        for k, (numbers, some) in enumerate(of_one_kind(self.each)):
            own = jnp.asarray(numbers) == number
            place, kind = jnp.argmax(own), jnp.where(jnp.any(own), k, kind)
            values.append(function(jax.tree.map(lambda leaf, place=place: leaf[place], some)))
        return numbered(kind, values)

    def level(self, x):
        return self._of_nearest(x, lambda one: one.level(x))

    def gradient(self, x):
        return self._of_nearest(x, lambda one: one.gradient(x))

    def hessian(self, x):
        return self._of_nearest(x, lambda one: one.hessian(x))

    @property
    def has_planes(self):
        return all(one.has_planes for one in self.each)

    def plane_before(self, x):
        raise NotImplementedError

    def ball_before(self, x):
        radii, ways = self.of_each(lambda one: one.ball_before(x))
        nearest = jnp.argmin(radii)
        return radii[nearest], ways[nearest]

    def steps_to_joint(self, x, way):
        return self._of_nearest(x, lambda one: one.steps_to_joint(x, way))

    def thickness(self):
        return jnp.min(jnp.stack([one.thickness() for one in self.each]))

    def in_unit(self, length):
        return Surfaces(tuple(one.in_unit(length) for one in self.each))

    def interior_point(self):
        return jnp.mean(jnp.stack([one.interior_point() for one in self.each]), axis=0)

    def valid(self):
        return jnp.all(jnp.stack([one.valid() for one in self.each]))

    def _positive(self):
        return [value for one in self.each for value in one._positive()]

    def __str__(self):
        return "; ".join(map(str, self.each))


def as_one_surface(value: Any) -> Any:
    """A tuple of surfaces as one surface; anything else stays as it is."""
    if not isinstance(value, tuple) or not value or not all(isinstance(one, AbstractSurface) for one in value):
        return value
    first, *others = (one for some in value for one in some.objects)
    return Surfaces((first, *others)) if others else first
