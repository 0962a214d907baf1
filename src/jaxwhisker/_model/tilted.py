"""A tilted object: any profile, turned."""

import jax
import jax.numpy as jnp

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, ContactPoint, FirstTouch, bisect, show
from jaxwhisker._model.support import RIGHT_ANGLE


class Tilted(AbstractProfile):
    """A profile turned counter-clockwise about a point.

    Args:
        profile: the object before it is turned.
        angle: rad; less than a right angle.
        about: (x, y) that stays where it is.

    Raises:
        ValueError: if an argument is not of that kind.
    """

    profile: AbstractProfile
    angle: Scalar
    about: tuple[Scalar, Scalar] = (0.0, 0.0)

    def __check_init__(self):
        if not isinstance(self.profile, AbstractProfile):
            raise ValueError(f"`profile` must be a profile, but is {self.profile!r}.")
        checks.number("angle", self.angle)
        if not checks.is_traced(self.angle) and not abs(float(self.angle)) < RIGHT_ANGLE:
            raise ValueError(f"`angle` must be less than a right angle, but is {float(self.angle):g} rad.")
        if not (isinstance(self.about, tuple) and len(self.about) == 2):
            raise ValueError(f"`about` must be a pair of numbers, but is {self.about!r}.")
        for value in self.about:
            checks.number("about", value)

    def point(self, parameter):
        at, (x, y) = self.profile.point(parameter), self.about
        cos, sin = jnp.cos(self.angle), jnp.sin(self.angle)
        right, up = at.x - x, at.y - y
        return ContactPoint(
            x + right * cos - up * sin,
            y + right * sin + up * cos,
            at.cos * cos - at.sin * sin,
            at.sin * cos + at.cos * sin,
        )

    def convex(self, parameter):
        return self.profile.convex(parameter)

    def ends(self):
        return self.profile.ends()

    def around(self):
        return self.profile.around()

    def first_touch(self, height, side):
        lowest, (low, high) = self.lowest(), self.ends()
        end = jnp.where(side > 0, high, low)

        def below(p):
            # Up to where the object is widest; False outside of its domain.
            at = self.point(p)
            return (at.cos > 0) & (at.y < height)

        p = lowest + side * bisect(lambda way: below(lowest + side * way), 0.0, side * (end - lowest))
        p = jax.lax.stop_gradient(p)
        at = self.point(p)
        return FirstTouch(p, at.x, at.y)

    def vertex(self):
        at = self.point(self.lowest())
        return at.x, at.y

    def in_unit(self, length):
        x, y = self.about
        return Tilted(self.profile.in_unit(length), self.angle, (x / length, y / length))

    def _positive(self):
        return [*self.profile._positive(), RIGHT_ANGLE - jnp.abs(self.angle)]

    def __str__(self):
        return f"{self.profile}, tilted by {show(self.angle)}"
