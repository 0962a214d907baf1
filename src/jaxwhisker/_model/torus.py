"""A torus: a ring with a round tube, the points at one distance from a circle. It is not convex."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text
from jaxwhisker._base.types import Scalar, Triple
from jaxwhisker._model.surface import AbstractDescribed, AbstractSurface, Point, as_point, triple_text

# Over the radius: points nearer to the axis, or to the centre of the tube, have no nearest point of the surface.
CORE = 1e-9


class _FromCircle(NamedTuple):
    """A point as seen from the ring."""

    rise: Float[Array, ""]  # height above the plane of the ring
    off_circle: Float[Array, ""]  # distance from the axis, less that of the circle
    out: Point  # unit vector away from the axis
    distance: Float[Array, ""]  # from the circle
    along: Float[Array, "2"]  # unit vector away from the circle: its parts along `out` and along the axis


class Ring(AbstractSurface):
    """The points at a distance from a circle. The level is the exact distance."""

    middle: Point
    axis: Point  # unit vector
    radius: Float[Array, ""]  # of the circle
    tube: Float[Array, ""]  # distance from it, less than its radius

    @property
    def is_convex(self):
        return False

    def _seen(self, x: Point) -> _FromCircle:
        d = x - self.middle
        rise = jnp.sum(d * self.axis)
        across = d - rise * self.axis
        square, core = jnp.sum(across**2), CORE * self.radius
        # On the axis, any direction will do.
        on_axis = square <= core**2
        away = jnp.sqrt(jnp.where(on_axis, core**2, square))
        beside = jnp.cross(self.axis, jnp.eye(3)[jnp.argmin(jnp.abs(self.axis))])
        out = jnp.where(on_axis, beside / jnp.sqrt(jnp.sum(beside**2)), across / away)
        off_circle = away - self.radius
        square = off_circle**2 + rise**2
        central = square <= core**2
        distance = jnp.sqrt(jnp.where(central, core**2, square))
        along = jnp.where(central, jnp.array([1.0, 0.0]), jnp.stack([off_circle, rise]) / distance)
        return _FromCircle(rise, off_circle, out, distance, along)

    def level(self, x):
        return self._seen(x).distance - self.tube

    def gradient(self, x):
        seen = self._seen(x)
        return seen.along[0] * seen.out + seen.along[1] * self.axis

    def hessian(self, x):
        seen = self._seen(x)
        meridian = seen.along[0] * self.axis - seen.along[1] * seen.out
        around = jnp.cross(self.axis, seen.out)
        along_circle = seen.along[0] / (self.radius + seen.off_circle)
        return meridian[:, None] * meridian / seen.distance + along_circle * around[:, None] * around

    def ball_before(self, x):
        return self.level(x), self.gradient(x)

    def plane_before(self, x):
        # The convex hull of the ring consists of all points at one distance from a disc.
        seen = self._seen(x)
        beyond = jnp.maximum(seen.off_circle, 0.0)
        size = jnp.sqrt(beyond**2 + seen.rise**2)
        normal = (beyond * seen.out + seen.rise * self.axis) / jnp.where(size > 0, size, 1.0)
        return size - self.tube, jnp.where(size > 0, normal, self.axis)

    def in_unit(self, length):
        return Ring(self.middle / length, self.axis, self.radius / length, self.tube / length)

    def absorbed(self, turn, before, after):
        middle = after + jnp.sum(turn * (self.middle - before), axis=1)
        return Ring(middle, jnp.sum(turn * self.axis, axis=1), self.radius, self.tube)

    def interior_point(self):
        return self.middle

    def thickness(self):
        return self.tube

    def _positive(self):
        return [self.tube, self.radius - self.tube]

    def __str__(self):
        return "ring"


class Torus(AbstractDescribed):
    """Ring with a circular cross-section: all points within one tube radius of a circle.

    A ring is not convex. A whisker may touch it in several places, for which the scene needs `contacts=2` or more. With
    one contact, a scan ends with the status `second_contact` there.

    Args:
        radius: R of the circle in the middle of the tube, a length.
        tube_radius: r of the tube, a length; positive, and less than `radius`.
        centre: (x, y, z) of the centre of the circle, lengths; it lies in the hole.
        axis: direction of the axis, normal to the circle; any vector other than zero.

    Raises:
        ValueError: if a value is not a finite number, a radius is out of its range, or the axis is zero.

    Examples:
        >>> ring = jw.Torus(0.4, 0.1, centre=(0.0, 1.0, 0.0), axis=(0.0, 1.0, 0.2))
        >>> print(ring)
        torus R = 0.4, r = 0.1, centre (0, 1, 0), axis (0, 1, 0.2)
        >>> print(ring.off(jnp.array([0.0, 1.0, 0.0])).round(6))
        0.3
    """

    radius: Scalar
    tube_radius: Scalar
    centre: Triple = eqx.field(converter=checks.as_tuple)
    axis: Triple = eqx.field(default=(0.0, 0.0, 1.0), converter=checks.as_tuple)

    @property
    def is_convex(self):
        return False

    def __check_init__(self):
        checks.number("radius", self.radius, positive=True)
        checks.number("tube_radius", self.tube_radius, positive=True)
        checks.triple("centre", self.centre)
        checks.triple("axis", self.axis)
        if not checks.is_traced((self.radius, self.tube_radius)) and not float(self.tube_radius) < float(self.radius):
            checks.fail("tube_radius", f"less than `radius` ({as_text(self.radius)})", self.tube_radius)
        if not checks.is_traced(self.axis) and not any(float(part) for part in self.axis):
            checks.fail("axis", "a vector other than zero", self.axis)

    def form(self):
        axis = as_point(self.axis)
        radius, tube = (jnp.asarray(value, dtype=float) for value in (self.radius, self.tube_radius))
        return Ring(as_point(self.centre), axis / jnp.sqrt(jnp.sum(axis**2)), radius, tube)

    def _positive(self):
        return [self.tube_radius, self.radius - self.tube_radius, jnp.sum(as_point(self.axis) ** 2)]

    def __str__(self):
        radii = f"R = {as_text(self.radius)}, r = {as_text(self.tube_radius)}"
        return f"torus {radii}, centre {triple_text(self.centre)}, axis {triple_text(self.axis)}"
