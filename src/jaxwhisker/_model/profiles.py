"""Profiles made of others: the graph of a function, and a tilted profile."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_field, as_text, name_of, text_unless
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, ContactPoint, FirstTouch, bisect, bisect_angle


class Graph(AbstractProfile):
    """Graph y = g(x - position) of a twice differentiable function.

    It must be strictly convex, unless the scene has room for several contacts: with `Scene(contacts=2)`, it may be any
    smooth function. Its parameter is the abscissa x - position. If a whisker with one contact touches where g is not
    strictly convex, the scan ends with status `not_convex`.

    Args:
        g: height of the profile above the bases, a length, as a function of the abscissa, a length; positive. JAX must
            be able to trace it. The parameters of an `equinox.Module` are differentiable; a plain function is constant.
            Where g is NaN or infinite, the object ends. It must end above the tips, or vertically like a semicircle: if
            a whisker meets an edge first, the status of the scan is `lost`.
        position: shift along x, a length.
        extent: half the width of the range that is searched for the vertex and the first touch, a length; positive.

    Raises:
        ValueError: if `g` is not a function of one number that JAX can trace, or another value is not allowed.

    Examples:
        >>> profile = jw.Graph(lambda x: jnp.cosh(2 * x - 1) / 5)
        >>> x, y = profile.vertex()
        >>> print(f"x = {x:.3f}, y = {y:.3f}")
        x = 0.500, y = 0.200
    """

    g: Callable
    position: Scalar
    extent: Scalar
    _unit: Scalar  # of `position` and of points; `g` and `extent` stay in the user's unit

    def __init__(self, g: Callable, position: Scalar = 0.0, *, extent: Scalar = 100.0):
        checks.function("g", g)
        checks.number("position", position)
        checks.number("extent", extent, positive=True)
        self.g, self.position, self.extent, self._unit = as_field(g), position, extent, 1.0

    def _height(self, x):
        return self.g(x * self._unit) / self._unit

    def point(self, parameter):
        x = jnp.asarray(parameter, dtype=float)
        y, slope = jax.value_and_grad(self._height)(x)
        norm = jnp.sqrt(1 + slope**2)
        return ContactPoint(self.position + x, y, 1 / norm, slope / norm)

    def convex(self, parameter):
        return jax.grad(jax.grad(self._height))(jnp.asarray(parameter, dtype=float)) > 0

    def ends(self):
        return -self.extent / self._unit, self.extent / self._unit

    def around(self, x, y, reach):
        del y
        low, high = self.ends()
        return jnp.clip(x - self.position - reach, low, high), jnp.clip(x - self.position + reach, low, high)

    def facing(self, x, y):
        del y
        low, high = self.ends()
        return jnp.clip(x - self.position, low, high)

    def at_slope(self, slope):
        def angle(x):
            # The unit tangent would not do: far out, the square of g' may overflow.
            y, rise = jax.value_and_grad(self._height)(x)
            return jnp.where(jnp.isfinite(y) & jnp.isfinite(rise), jnp.arctan(rise), jnp.nan)

        return bisect_angle(angle, slope, *self.ends())

    def first_touch(self, height, side):
        vertex = self.lowest()

        def below(x):
            return self._height(x) < height  # False outside the domain

        reach = self.extent / self._unit
        x = jax.lax.stop_gradient(vertex + side * bisect(lambda d: below(vertex + side * d), 0.0, reach))
        # A last Newton step carries the derivative, unless the object ends there.
        y, slope = jax.value_and_grad(self._height)(x)
        crosses = jnp.isfinite(slope) & (slope != 0) & (jnp.abs(y - height) < 1e-9)
        x = x - jnp.where(crosses, (y - height) / jnp.where(crosses, slope, 1.0), 0.0)
        return FirstTouch(x, self.position + x, self._height(x))

    def vertex(self):
        x = self.lowest()
        return self.position + x, self._height(x)

    def in_unit(self, length):
        return eqx.tree_at(lambda p: (p.position, p._unit), self, (self.position / length, self._unit * length))

    def _positive(self):
        return [self.vertex()[1], self.extent]

    def __str__(self):
        return f"graph y = {name_of(self.g)}(x){text_unless(0.0, ', x = ', self.position)}"


class Tilted(AbstractProfile):
    """A profile turned counter-clockwise about a point.

    Its parameter is that of the profile before it is turned.

    Args:
        profile: the object before it is turned.
        angle: angle of the turn, rad, positive counter-clockwise; less than a right angle.
        about: (x, y) of the fixed point, lengths.

    Raises:
        ValueError: if an argument has the wrong type, is not finite, or the angle is too large.

    Examples:
        >>> profile = jw.Tilted(jw.Parabola(0.2), angle=0.3)
        >>> x, y = profile.vertex()
        >>> print(f"{profile}: lowest point at ({x:.3f}, {y:.3f})")
        parabola q = 0.2, tilted by 0.3: lowest point at (-0.214, 0.168)
    """

    profile: AbstractProfile
    angle: Scalar
    about: tuple[Scalar, Scalar] = (0.0, 0.0)

    def __check_init__(self):
        checks.instance("profile", self.profile, AbstractProfile, "a profile such as Parabola or Graph")
        if len(self.profile.objects) > 1:
            checks.fail("profile", "a single object", str(self.profile))
        checks.acute_angle("angle", self.angle)
        checks.pair("about", self.about)

    def canonical(self):
        return eqx.tree_at(lambda own: own.profile, self, self.profile.canonical())

    def point(self, parameter):
        return self._turned(self.profile.point(parameter))

    def _turned(self, at: ContactPoint) -> ContactPoint:
        x, y = self.about
        cos, sin = jnp.cos(self.angle), jnp.sin(self.angle)
        right, up = at.x - x, at.y - y
        turned_x, turned_y = x + right * cos - up * sin, y + right * sin + up * cos
        return ContactPoint(turned_x, turned_y, at.cos * cos - at.sin * sin, at.sin * cos + at.cos * sin)

    @property
    def has_edges(self):
        return self.profile.has_edges

    def speed(self, parameter):
        return self.profile.speed(parameter)

    def breaks(self):
        return self.profile.breaks()

    def point_on(self, piece, parameter):
        return self._turned(self.profile.point_on(piece, parameter))

    def faces(self):
        faces = self.profile.faces()
        return faces if faces is None else self._turned(faces)

    def convex(self, parameter):
        return self.profile.convex(parameter)

    def ends(self):
        return self.profile.ends()

    @property
    def closed(self):
        return self.profile.closed

    def span(self):
        return self.profile.span()

    def around(self, x, y, reach):
        return self.profile.around(*self._turned_back(x, y), reach)

    def facing(self, x, y):
        return self.profile.facing(*self._turned_back(x, y))

    def _turned_back(self, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
        about_x, about_y = self.about
        cos, sin, right, up = jnp.cos(self.angle), jnp.sin(self.angle), x - about_x, y - about_y
        return about_x + right * cos + up * sin, about_y - right * sin + up * cos

    def first_touch(self, height, side):
        return self._climbed(height, side, self.ends(), lambda at: at.cos > 0)  # up to where the object is widest

    def above_widest(self, height, side):
        return self._climbed(height, side, self.span(), lambda at: side * at.sin > 0)

    def _climbed(
        self, height: Scalar, side: Scalar, ends: tuple[Scalar, Scalar], goes_on: Callable[[ContactPoint], Any]
    ) -> FirstTouch:
        """The point at this height that is reached from the lowest one, as far as the profile goes on."""
        lowest, end = self.lowest(), jnp.where(side > 0, ends[1], ends[0])

        def below(p):
            at = self.point(p)
            return goes_on(at) & (at.y < height)  # False outside its domain

        p = lowest + side * bisect(lambda way: below(lowest + side * way), 0.0, side * (end - lowest))
        p = jax.lax.stop_gradient(p)
        at = self.point(p)
        return FirstTouch(p, at.x, at.y, self.piece_at(p))

    def vertex(self):
        at = self.point(self.lowest())
        return at.x, at.y

    def in_unit(self, length):
        x, y = self.about
        return Tilted(self.profile.in_unit(length), self.angle, (x / length, y / length))

    def _positive(self):
        return [*self.profile._positive(), checks.RIGHT_ANGLE - jnp.abs(self.angle)]

    def __str__(self):
        return f"{self.profile}, tilted by {as_text(self.angle)}"
