"""The object: a rigid, strictly convex body above its profile, the curve that whiskers touch."""

import abc
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.functions import as_field, name_of
from jaxwhisker._base.types import Scalar


class ContactPoint(NamedTuple):
    """A point of the profile and the slope angle alpha of its tangent there."""

    x: Float[Array, "*batch"]
    y: Float[Array, "*batch"]
    cos: Float[Array, "*batch"]
    sin: Float[Array, "*batch"]


class FirstTouch(NamedTuple):
    """Where an unloaded vertical whisker that comes from one side first meets the object."""

    parameter: Float[Array, "*batch"]
    x: Float[Array, "*batch"]
    y: Float[Array, "*batch"]


STEEPEST = 1.5707963267948966 - 1e-6  # nearly upright


class AbstractProfile(eqx.Module):
    """A profile is a smooth curve `point(parameter)`, run through from left to right.

    The parameter is each profile's own (slope angle, eccentric angle, abscissa): what keeps the curve smooth and its
    derivative bounded. The outward normal, on which the contact force acts on the whisker, is (sin alpha, -cos alpha).
    """

    @abc.abstractmethod
    def point(self, parameter: Scalar) -> ContactPoint:
        """Point and slope at a parameter."""

    @abc.abstractmethod
    def first_touch(self, height: Scalar, side: Scalar) -> FirstTouch:
        """First contact of a vertical whisker of that height, coming from the right (side = +1) or left (-1).

        Meaningless if the object's lowest point is not below `height`.
        """

    @abc.abstractmethod
    def vertex(self) -> tuple[Scalar, Scalar]:
        """The object's lowest point (x, y)."""

    @abc.abstractmethod
    def in_unit(self, length: Scalar) -> "AbstractProfile":
        """The same object with lengths measured in `length`."""

    def ends(self) -> tuple[Scalar, Scalar]:
        """Parameters between which the profile lies: those of a slope, almost up to the upright, unless it says so."""
        return -STEEPEST, STEEPEST

    def around(self) -> tuple[Scalar, Scalar] | None:
        """Parameters between which `point` runs once around the object, for pictures; None unless it is closed."""
        return None

    def lowest(self) -> Scalar:
        """The parameter of the object's lowest point."""
        return self.at_slope(0.0)

    def at_slope(self, slope: Scalar) -> Scalar:
        """The parameter, between the ends, at which the profile has that slope angle, rad; without a derivative."""

        def angle(p):
            at = self.point(p)
            return jnp.where(jnp.isfinite(at.y), jnp.arctan2(at.sin, at.cos), jnp.nan)

        return _steepened_to(slope, angle, *self.ends())

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters lie where the constructor would have let them."""
        leaves = [jnp.asarray(x) for x in jax.tree.leaves(self) if checks.is_numeric(x)]
        finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in leaves]))
        return finite & jnp.all(jnp.stack([jnp.asarray(x) > 0 for x in self._positive()]))

    def convex(self, parameter: Scalar) -> Bool[Array, ""]:
        """Whether the profile curves away from the whisker at that parameter."""
        del parameter
        return jnp.asarray(True)

    @abc.abstractmethod
    def _positive(self) -> list[Scalar]:
        """The fields that have to be positive."""

    @abc.abstractmethod
    def __str__(self) -> str: ...


def _mirror(touch: FirstTouch, side: Scalar, position: Scalar) -> FirstTouch:
    # Symmetric profiles: the left-hand touch is the right-hand one mirrored at the vertex.
    return FirstTouch(side * touch.parameter, position + side * touch.x, touch.y)


class Parabola(AbstractProfile):
    """y = distance + a (x - position)^2, by slope angle: x = tan(alpha) / (2 a).

    Args:
        distance: q, height of the vertex above the bases; positive.
        a: half the curvature at the vertex, 1/length; positive.
        position: x of the vertex.
    """

    distance: Scalar
    a: Scalar = 1.0
    position: Scalar = 0.0

    def __check_init__(self):
        checks.number("distance", self.distance, positive=True)
        checks.number("a", self.a, positive=True)
        checks.number("position", self.position)

    def point(self, parameter):
        cos, sin = jnp.cos(parameter), jnp.sin(parameter)
        x = sin / (2 * self.a * cos)
        return ContactPoint(self.position + x, self.distance + self.a * x**2, cos, sin)

    def first_touch(self, height, side):
        rise = jnp.asarray((height - self.distance) / self.a, dtype=float)
        x = jnp.sqrt(jnp.where(rise > 0, rise, 1.0))  # out of reach the touch means nothing, but must not be NaN
        return _mirror(FirstTouch(jnp.arctan(2 * self.a * x), x, jnp.asarray(height, dtype=float)), side, self.position)

    def vertex(self):
        return self.position, self.distance

    def in_unit(self, length):
        return Parabola(self.distance / length, self.a * length, self.position / length)

    def _positive(self):
        return [self.distance, self.a]

    def __str__(self):
        return f"parabola q = {show(self.distance)}{differs(', a = ', self.a, 1.0)}{differs(', x = ', self.position)}"


class Ellipse(AbstractProfile):
    """Ellipse with half axes a along x and b along y: x = a sin t, y = -b cos t.

    The parameter lies half-way between eccentric angle t and slope angle alpha, tan(alpha) = sqrt(b/a) tan(parameter) =
    (b/a) tan(t): nothing happens all at once, however flat or steep the ellipse.

    Args:
        distance: q, height of the lowest point above the bases; positive.
        a: horizontal half axis, a length; positive.
        b: vertical half axis, a length; positive.
        position: x of the centre.
    """

    distance: Scalar
    a: Scalar
    b: Scalar
    position: Scalar = 0.0

    def __check_init__(self):
        checks.number("distance", self.distance, positive=True)
        checks.number("a", self.a, positive=True)
        checks.number("b", self.b, positive=True)
        checks.number("position", self.position)

    def point(self, parameter):
        return _elliptic_point(self, self.a, self.b, parameter)

    def around(self):
        return -jnp.pi, jnp.pi

    def first_touch(self, height, side):
        return _elliptic_touch(self, self.a, self.b, height, side)

    def vertex(self):
        return self.position, self.distance

    def in_unit(self, length):
        return Ellipse(self.distance / length, self.a / length, self.b / length, self.position / length)

    def _positive(self):
        return [self.distance, self.a, self.b]

    def __str__(self):
        axes = f"a = {show(self.a)}, b = {show(self.b)}"
        return f"ellipse q = {show(self.distance)}, {axes}{differs(', x = ', self.position)}"


class Circle(AbstractProfile):
    """Circle above its lowest point (position, distance), by slope angle: x = r sin(alpha), y = r (1 - cos(alpha)).

    Args:
        distance: q, height of the lowest point above the bases; positive.
        radius: r, a length; positive.
        position: x of the centre.
    """

    distance: Scalar
    radius: Scalar
    position: Scalar = 0.0

    def __check_init__(self):
        checks.number("distance", self.distance, positive=True)
        checks.number("radius", self.radius, positive=True)
        checks.number("position", self.position)

    def point(self, parameter):
        return _elliptic_point(self, self.radius, self.radius, parameter)

    def around(self):
        return -jnp.pi, jnp.pi

    def first_touch(self, height, side):
        return _elliptic_touch(self, self.radius, self.radius, height, side)

    def vertex(self):
        return self.position, self.distance

    def in_unit(self, length):
        return Circle(self.distance / length, self.radius / length, self.position / length)

    def _positive(self):
        return [self.distance, self.radius]

    def __str__(self):
        return f"circle q = {show(self.distance)}, r = {show(self.radius)}{differs(', x = ', self.position)}"


def _elliptic_point(profile: "Circle | Ellipse", a: Scalar, b: Scalar, parameter: Scalar) -> ContactPoint:
    cos, sin = jnp.cos(parameter), jnp.sin(parameter)
    size, norm = jnp.sqrt(a * sin**2 + b * cos**2), jnp.sqrt(b * sin**2 + a * cos**2)
    cos_t, sin_t = jnp.sqrt(b) * cos / size, jnp.sqrt(a) * sin / size
    # 1 - cos t loses its digits near the vertex; sin^2 t / (1 + cos t) does not.
    y = profile.distance + b * sin_t**2 / (1 + cos_t)
    return ContactPoint(profile.position + a * sin_t, y, jnp.sqrt(a) * cos / norm, jnp.sqrt(b) * sin / norm)


def _elliptic_touch(profile: "Circle | Ellipse", a: Scalar, b: Scalar, height: Scalar, side: Scalar) -> FirstTouch:
    # A whisker that stands higher than the widest point meets that with its shaft, otherwise its tip meets the flank.
    rise = jnp.asarray((height - profile.distance) / b, dtype=float)
    rise = jnp.minimum(jnp.where(rise > 0, rise, 1.0), 1.0)  # out of reach the touch means nothing, but must not be NaN
    cos_t, sin_t = 1 - rise, jnp.sqrt(rise * (2 - rise))
    parameter = jnp.arctan2(jnp.sqrt(b) * sin_t, jnp.sqrt(a) * cos_t)
    return _mirror(FirstTouch(parameter, a * sin_t, profile.distance + b * rise), side, profile.position)


class Graph(AbstractProfile):
    """y = g(x - position) for any strictly convex, twice differentiable g, by abscissa.

    Args:
        g: height of the profile above the bases, g(x) > 0; traceable by jax. An `equinox.Module` keeps its parameters
            differentiable; a plain function is taken as it is. Where g is NaN or infinite, the object ends: above the
            tips, or vertically as a semicircle does; at an edge that the whisker meets first a scan is `lost`.
        position: shift along x.
        extent: half the width, a length, in which the vertex and the first touch are searched.

    Raises:
        ValueError: if an argument is not of that kind.

    Where the scan touches it and g is not strictly convex, the scan ends with status `not_convex`.
    """

    g: Callable
    position: Scalar
    extent: Scalar
    unit: Scalar

    def __init__(self, g: Callable, position: Scalar = 0.0, *, extent: Scalar = 100.0, unit: Scalar = 1.0):
        if not callable(g):
            raise ValueError(f"`g` must be a function y = g(x), but is {g!r}.")
        self.g = as_field(g)
        self.position = position
        self.extent = extent
        self.unit = unit

    def __check_init__(self):
        checks.number("position", self.position)
        checks.number("extent", self.extent, positive=True)

    def _height(self, x):
        return self.g(x * self.unit) / self.unit

    def point(self, parameter):
        x = jnp.asarray(parameter, dtype=float)
        y, slope = jax.value_and_grad(self._height)(x)
        norm = jnp.sqrt(1 + slope**2)
        return ContactPoint(self.position + x, y, 1 / norm, slope / norm)

    def convex(self, parameter):
        bend = jax.grad(jax.grad(self._height))(jnp.asarray(parameter, dtype=float))
        return bend > 0

    def ends(self):
        return -self.extent / self.unit, self.extent / self.unit

    def at_slope(self, slope):
        def angle(x):
            # Not by the unit tangent: far out the square of g' may be too large for it.
            y, rise = jax.value_and_grad(self._height)(x)
            return jnp.where(jnp.isfinite(y) & jnp.isfinite(rise), jnp.arctan(rise), jnp.nan)

        return _steepened_to(slope, angle, *self.ends())

    def first_touch(self, height, side):
        vertex = self.lowest()

        def below(x):
            return self._height(x) < height  # False outside the domain

        reach = self.extent / self.unit
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
        return Graph(self.g, self.position / length, extent=self.extent, unit=self.unit * length)

    def _positive(self):
        return [self.vertex()[1], self.extent]

    def __str__(self):
        return f"graph y = {name_of(self.g)}(x){differs(', x = ', self.position)}"


def _steepened_to(slope: Scalar, angle: Callable, low: Scalar, high: Scalar) -> Float[Array, ""]:
    """Where a slope angle, which grows, has grown to that."""

    def flatter(parameter):
        here = angle(parameter)
        # Outside of its domain (NaN) the object ends, as a wall would.
        return jnp.where(jnp.isfinite(here), here < slope, parameter < (low + high) / 2)

    return bisect(flatter, low, high)


def bisect(inside: Callable, low: Scalar, high: Scalar) -> Float[Array, ""]:
    """The last point from `low` on at which `inside` still holds, to rounding; derivatives are attached elsewhere."""

    def halve(_, bracket):
        low, high = bracket
        middle = (low + high) / 2
        yes = inside(middle)
        return jnp.where(yes, middle, low), jnp.where(yes, high, middle)

    low = jnp.asarray(low, dtype=float)
    return jax.lax.fori_loop(0, 80, halve, (low, jnp.asarray(high, dtype=float)))[0]


def show(value) -> str:
    """A field as a person would write it; `?` while traced."""
    return "?" if isinstance(value, Tracer) else f"{float(value):.6g}" if jnp.ndim(value) == 0 else "..."


def differs(prefix: str, value, usual=0.0) -> str:
    """`prefix` and value, or nothing where the value is the usual one."""
    shown = show(value)
    return "" if shown == show(usual) else prefix + shown
