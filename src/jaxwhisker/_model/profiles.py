"""Profiles given by formulas: parabola, circle, ellipse, the graph of a function, and any of them tilted."""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_field, as_text, name_of, text_unless
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, ContactPoint, FirstTouch, bisect, bisect_angle


class _AbstractFormula(AbstractProfile):
    """A profile that is given by the position of its vertex and by positive numbers."""

    # Its subclasses declare `distance` and `position`, because the order of the fields is that of their arguments.

    def __check_init__(self):
        for name in self.__dataclass_fields__:
            checks.number(name, getattr(self, name), positive=name != "position")

    def vertex(self: Any):
        return self.position, self.distance

    def _positive(self):
        return [getattr(self, name) for name in self.__dataclass_fields__ if name != "position"]


class Parabola(_AbstractFormula):
    """Parabola y = distance + a (x - position)^2.

    Its parameter is the slope angle alpha: x - position = tan(alpha) / (2 a).

    Args:
        distance: q, height of the vertex above the bases, a length; positive.
        a: half the curvature at the vertex, 1/length; positive.
        position: x of the vertex, a length.

    Raises:
        ValueError: if a value is not a finite number, or not positive where it must be.

    Examples:
        >>> profile = jw.Parabola(distance=0.2, a=2.0)
        >>> point = profile.point(jnp.pi / 4)  # where the slope is 45 degrees
        >>> print(f"x = {point.x:.3f}, y = {point.y:.3f}")
        x = 0.250, y = 0.325
    """

    distance: Scalar
    a: Scalar = 1.0
    position: Scalar = 0.0

    def point(self, parameter):
        cos, sin = jnp.cos(parameter), jnp.sin(parameter)
        x = sin / (2 * self.a * cos)
        return ContactPoint(self.position + x, self.distance + self.a * x**2, cos, sin)

    def speed(self, parameter):
        return 1 / (2 * self.a * jnp.cos(parameter) ** 3)

    def first_touch(self, height, side):
        x = jnp.sqrt(_rise((height - self.distance) / self.a))
        return _mirror(FirstTouch(jnp.arctan(2 * self.a * x), x, jnp.asarray(height, dtype=float)), side, self.position)

    def in_unit(self, length):
        return Parabola(self.distance / length, self.a * length, self.position / length)

    def __str__(self):
        a, position = text_unless(1.0, ", a = ", self.a), text_unless(0.0, ", x = ", self.position)
        return f"parabola q = {as_text(self.distance)}{a}{position}"


class _AbstractEllipse(_AbstractFormula):
    @abc.abstractmethod
    def _axes(self) -> tuple[Scalar, Scalar]:
        """Half axes along x and y."""

    def point(self, parameter):
        (a, b), (position, distance) = self._axes(), self.vertex()
        cos, sin = jnp.cos(parameter), jnp.sin(parameter)
        size, norm = jnp.sqrt(a * sin**2 + b * cos**2), jnp.sqrt(b * sin**2 + a * cos**2)
        cos_t, sin_t = jnp.sqrt(b) * cos / size, jnp.sqrt(a) * sin / size
        # 1 - cos t loses its digits near the vertex; sin^2 t / (1 + cos t) does not.
        y = distance + b * sin_t**2 / (1 + cos_t)
        return ContactPoint(position + a * sin_t, y, jnp.sqrt(a) * cos / norm, jnp.sqrt(b) * sin / norm)

    def speed(self, parameter):
        a, b = self._axes()
        cos, sin = jnp.cos(parameter) ** 2, jnp.sin(parameter) ** 2
        return a * b * jnp.sqrt(b * sin + a * cos) / jnp.sqrt(a * sin + b * cos) ** 3

    def around(self):
        return -jnp.pi, jnp.pi

    def first_touch(self, height, side):
        # The shaft of a whisker that ends above the widest point meets that point; otherwise the tip meets the flank.
        return self._at(height, side, highest=1.0)

    def beside(self, height, side):
        return self._at(height, side, highest=2.0)

    def _at(self, height: Scalar, side: Scalar, highest: float) -> FirstTouch:
        """The outermost point at this height, but at most so many half axes above the lowest point."""
        (a, b), (position, distance) = self._axes(), self.vertex()
        rise = jnp.minimum(_rise((height - distance) / b), highest)
        cos_t, sin_t = 1 - rise, jnp.sqrt(rise * (2 - rise))
        parameter = jnp.arctan2(jnp.sqrt(b) * sin_t, jnp.sqrt(a) * cos_t)
        return _mirror(FirstTouch(parameter, a * sin_t, distance + b * rise), side, position)


class Ellipse(_AbstractEllipse):
    """Ellipse with half axes a along x and b along y: x = a sin t, y = -b cos t, relative to its centre.

    Its parameter p lies between the eccentric angle t and the slope angle alpha:
    tan(alpha) = sqrt(b/a) tan(p) = (b/a) tan(t). This keeps the curve smooth for flat and for steep ellipses.

    Args:
        distance: q, height of the lowest point above the bases, a length; positive.
        a: horizontal half axis, a length; positive.
        b: vertical half axis, a length; positive.
        position: x of the centre, a length.

    Raises:
        ValueError: if a value is not a finite number, or not positive where it must be.

    Examples:
        >>> print(jw.Ellipse(distance=0.2, a=0.5, b=0.3, position=0.1))
        ellipse q = 0.2, a = 0.5, b = 0.3, x = 0.1
    """

    distance: Scalar
    a: Scalar
    b: Scalar
    position: Scalar = 0.0

    def _axes(self):
        return self.a, self.b

    def in_unit(self, length):
        return Ellipse(self.distance / length, self.a / length, self.b / length, self.position / length)

    def __str__(self):
        axes = f"a = {as_text(self.a)}, b = {as_text(self.b)}"
        return f"ellipse q = {as_text(self.distance)}, {axes}{text_unless(0.0, ', x = ', self.position)}"


class Circle(_AbstractEllipse):
    """Circle of radius r above its lowest point (position, distance).

    Its parameter is the slope angle alpha: x - position = r sin(alpha), y - distance = r (1 - cos(alpha)).

    Args:
        distance: q, height of the lowest point above the bases, a length; positive.
        radius: r, a length; positive.
        position: x of the centre, a length.

    Raises:
        ValueError: if a value is not a finite number, or not positive where it must be.

    Examples:
        >>> jw.Circle(distance=0.2, radius=0.5).vertex()
        (0.0, 0.2)
    """

    distance: Scalar
    radius: Scalar
    position: Scalar = 0.0

    def _axes(self):
        return self.radius, self.radius

    def in_unit(self, length):
        return Circle(self.distance / length, self.radius / length, self.position / length)

    def __str__(self):
        position = text_unless(0.0, ", x = ", self.position)
        return f"circle q = {as_text(self.distance)}, r = {as_text(self.radius)}{position}"


def _rise(value: Scalar) -> Scalar:
    # Out of reach, any finite value will do.
    value = jnp.asarray(value, dtype=float)
    return jnp.where(value > 0, value, 1.0)


def _mirror(touch: FirstTouch, side: Scalar, position: Scalar) -> FirstTouch:
    # Symmetric profiles: the left-hand touch is the right-hand one mirrored at the vertex.
    return FirstTouch(side * touch.parameter, position + side * touch.x, touch.y)


class Graph(AbstractProfile):
    """Graph y = g(x - position) of a strictly convex, twice differentiable function.

    Its parameter is the abscissa x - position. If a whisker touches where g is not strictly convex, the scan ends with
    status `not_convex`.

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

    def around(self):
        return self.profile.around()

    def first_touch(self, height, side):
        return self._climbed(height, side, self.ends(), lambda at: at.cos > 0)  # up to where the object is widest

    def beside(self, height, side):
        return self._climbed(height, side, self.around() or self.ends(), lambda at: side * at.sin > 0)

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
