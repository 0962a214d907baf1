"""Profiles that are conic sections: parabola, circle and ellipse.

All of them are one curve with further numbers, so that scenes with any of them share their programs.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text, text_unless
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import STEEPEST, AbstractProfile, ContactPoint, FirstTouch


class Conic(AbstractProfile):
    """Conic section with its vertex below: x^2 = 2 R y - k y^2, relative to the vertex.

    R is the radius of curvature at the vertex, and k = 0 for a parabola, 1 for a circle, (a/b)^2 for an ellipse with
    half axes a along x and b along y, and negative for a hyperbola. With the slope angle alpha,

        x = R sin(alpha) / D,    y = R sin(alpha)^2 / (D (D + cos(alpha))),    D = sqrt(cos(alpha)^2 + k sin(alpha)^2).

    The parameter p has tan(alpha) = c tan(p). For an ellipse, the power of two c near sqrt(b/a) places p between the
    slope angle and the eccentric angle, which keeps the curve smooth for flat and for steep ellipses; otherwise p is
    alpha. An integer, c has no derivative: it only labels points.
    """

    distance: Float[Array, ""]  # of the vertex above the bases
    radius: Float[Array, ""]  # R
    shape: Float[Array, ""]  # k
    position: Float[Array, ""]  # of the vertex along x
    stretch: Int[Array, ""]  # log2 c

    def point(self, parameter):
        return _point(self, parameter)

    def _sizes(self, parameter: Scalar) -> tuple[Array, Array, Array, Array]:
        """cos(p), c sin(p), the root of the sum of their squares, and D times this root."""
        cos, sin = jnp.cos(parameter), jnp.exp2(self.stretch) * jnp.sin(parameter)
        cos2, sin2 = cos * cos, sin * sin
        size, norm = jnp.sqrt(cos2 + self.shape * sin2), jnp.sqrt(cos2 + sin2)
        # An open curve goes on analytically beyond its vertical tangents, for steps of Newton's method.
        return cos, sin, norm, jnp.where((cos < 0) & ~self.closed, -size, size)

    def _point(self, parameter: Scalar) -> ContactPoint:
        cos, sin, norm, size = self._sizes(parameter)
        x = self.radius * sin / size
        # R (1 - cos t) loses its digits near the vertex; this form does not.
        return ContactPoint(self.position + x, self.distance + x * sin / (size + cos), cos / norm, sin / norm)

    def _rate(self, parameter: Scalar) -> ContactPoint:
        """Derivative of `point` by the parameter."""
        cos, sin, norm, size = self._sizes(parameter)
        c = jnp.exp2(self.stretch)
        speed, turn = self.radius * c / (size * size * size), c / (norm * norm * norm)
        return ContactPoint(speed * cos, speed * sin, -turn * sin, turn * cos)

    def speed(self, parameter):
        c = jnp.exp2(self.stretch)
        cos, factor = jnp.cos(parameter), c * c
        cos2 = cos * cos
        sin2 = factor * (1 - cos2)
        size2 = cos2 + self.shape * sin2
        return self.radius * c * jnp.sqrt((cos2 + sin2) / size2) / size2

    def first_touch(self, height, side):
        # The shaft of a whisker that ends above the widest point meets that point; otherwise the tip meets the flank.
        return self._at(height, side, highest=1.0)

    def above_widest(self, height, side):
        return self._at(height, side, highest=2.0)

    def _at(self, height: Scalar, side: Scalar, highest: float) -> FirstTouch:
        """The outermost point at this height; of a closed curve, at most so many half axes above the lowest point."""
        rise, closed = jnp.asarray(height - self.distance, dtype=float), self.closed
        # Out of reach, any finite value will do.
        y = jnp.where(rise > 0, rise, self.radius)
        y = jnp.minimum(y, jnp.where(closed, highest * self.radius / jnp.where(closed, self.shape, 1.0), jnp.inf))
        x, down = jnp.sqrt(y * (2 * self.radius - self.shape * y)), self.radius - self.shape * y
        parameter = jnp.arctan2(x, jnp.exp2(self.stretch) * down)
        return FirstTouch(side * parameter, self.position + side * x, self.distance + y)

    @property
    def closed(self):
        return self.shape > 0

    def span(self):
        end = jnp.where(self.closed, jnp.pi, STEEPEST)
        return -end, end

    def lowest(self):
        return jnp.zeros(())

    def at_slope(self, slope):
        low, high = self.ends()
        return jnp.clip(jnp.arctan2(jnp.sin(slope), jnp.exp2(self.stretch) * jnp.cos(slope)), low, high)

    def vertex(self):
        return self.position, self.distance

    def in_unit(self, length):
        return Conic(self.distance / length, self.radius / length, self.shape, self.position / length, self.stretch)

    def _positive(self):
        return [self.distance, self.radius]

    def __str__(self):
        return f"conic section q = {as_text(self.distance)}, R = {as_text(self.radius)}, k = {as_text(self.shape)}"


@eqx.filter_custom_jvp
def _point(conic: Conic, parameter: Scalar) -> ContactPoint:
    return conic._point(parameter)


@_point.def_jvp
def _(primals, tangents):
    # All Newton steps take the derivative by the parameter. In closed form, it compiles much faster.
    (conic, parameter), (conic_dot, parameter_dot) = primals, tangents
    here, parts = _point(conic, parameter), []
    if parameter_dot is not None:
        parts.append(jax.tree.map(lambda rate: rate * parameter_dot, conic._rate(parameter)))
    if jax.tree.leaves(conic_dot):
        parts.append(eqx.filter_jvp(lambda conic: conic._point(parameter), (conic,), (conic_dot,))[1])

    def total(leaf, *dots):
        return sum((dot for dot in dots if dot is not None), jnp.zeros_like(leaf))

    return here, jax.tree.map(total, here, *parts)


def conic(distance: Scalar, radius: Scalar, shape: Scalar, position: Scalar) -> Conic:
    """The conic section with these numbers, and with a parameter that suits its shape."""
    distance, radius, shape, position = (
        jnp.asarray(value, dtype=float) for value in (distance, radius, shape, position)
    )
    still = jax.lax.stop_gradient(shape)
    stretch = jnp.round(jnp.log2(jnp.where(still > 0, still, 1.0)) / -4).astype(int)
    return Conic(distance, radius, shape, position, stretch)


class _AbstractConic(AbstractProfile):
    """A conic section that is given by the position of its vertex and by further numbers."""

    # Its subclasses declare `distance` and `position`, because the order of the fields is that of their arguments.

    @abc.abstractmethod
    def conic(self) -> Conic:
        """The curve."""

    def point(self, parameter):
        return self.conic().point(parameter)

    def speed(self, parameter):
        return self.conic().speed(parameter)

    def first_touch(self, height, side):
        return self.conic().first_touch(height, side)

    def above_widest(self, height, side):
        return self.conic().above_widest(height, side)

    def lowest(self):
        return self.conic().lowest()

    def at_slope(self, slope):
        return self.conic().at_slope(slope)

    def vertex(self: Any):
        return self.position, self.distance

    def in_unit(self, length):
        return self.conic().in_unit(length)


class _ByAxes(_AbstractConic):
    """A parabola, circle or ellipse, told apart by a number."""

    distance: Scalar
    first: Scalar  # half the curvature of a parabola, the half axis of an ellipse along x
    second: Scalar  # its half axis along y
    position: Scalar
    is_open: Bool[Array, ""] | Bool[np.ndarray, ""]  # a parabola

    def conic(self):
        ratio = self.first / self.second
        radius = jnp.where(self.is_open, 1 / (2 * self.first), self.first * ratio)
        return conic(self.distance, radius, jnp.where(self.is_open, 0.0, ratio * ratio), self.position)

    def _positive(self):
        return [self.distance, self.first, self.second]

    def __str__(self):
        return str(self.conic())


class _AbstractKind(_AbstractConic):
    """A conic section of one kind, whose numbers are positive but for its position."""

    def __check_init__(self):
        for name in self.__dataclass_fields__:
            checks.number(name, getattr(self, name), positive=name != "position")

    def _positive(self):
        return [getattr(self, name) for name in self.__dataclass_fields__ if name != "position"]


class _AbstractClosedConic(_AbstractKind):
    @property
    def closed(self):
        return True

    def span(self):
        return -jnp.pi, jnp.pi


class Parabola(_AbstractKind):
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

    def conic(self):
        return conic(self.distance, 1 / (2 * self.a), 0.0, self.position)

    def canonical(self):
        return _ByAxes(self.distance, self.a, np.float64(1.0), self.position, np.asarray(True))

    def __str__(self):
        a, position = text_unless(1.0, ", a = ", self.a), text_unless(0.0, ", x = ", self.position)
        return f"parabola q = {as_text(self.distance)}{a}{position}"


class Circle(_AbstractClosedConic):
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

    def conic(self):
        return conic(self.distance, self.radius, 1.0, self.position)

    def canonical(self):
        return _ByAxes(self.distance, self.radius, self.radius, self.position, np.asarray(False))

    def __str__(self):
        position = text_unless(0.0, ", x = ", self.position)
        return f"circle q = {as_text(self.distance)}, r = {as_text(self.radius)}{position}"


class Ellipse(_AbstractClosedConic):
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

    def conic(self):
        return conic(self.distance, self.a**2 / self.b, (self.a / self.b) ** 2, self.position)

    def canonical(self):
        return _ByAxes(self.distance, self.a, self.b, self.position, np.asarray(False))

    def __str__(self):
        axes = f"a = {as_text(self.a)}, b = {as_text(self.b)}"
        return f"ellipse q = {as_text(self.distance)}, {axes}{text_unless(0.0, ', x = ', self.position)}"
