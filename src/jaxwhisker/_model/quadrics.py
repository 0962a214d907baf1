"""Spheres, ellipsoids, cylinders, paraboloids and planes."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text, text_unless
from jaxwhisker._base.types import Scalar, Triple
from jaxwhisker._model.surface import AbstractDescribed, Quadric, as_point, triple_text

# Depth of the inner point of a plane, a length: a plane has no length of its own, and any small number will do.
BELOW = 1e-30


class Sphere(AbstractDescribed):
    """Sphere.

    Args:
        radius: r, a length; positive.
        centre: (x, y, z) of the centre, lengths.

    Raises:
        ValueError: if a value is not a finite number, or the radius is not positive.

    Examples:
        >>> sphere = jw.Sphere(1.0, centre=(0.0, 1.3, 0.0))
        >>> print(sphere)
        sphere r = 1, centre (0, 1.3, 0)
        >>> print(sphere.normal(jnp.array([0.0, 0.3, 0.0])))
        [ 0. -1.  0.]
    """

    radius: Scalar
    centre: Triple = eqx.field(converter=checks.as_tuple)

    def __check_init__(self):
        checks.number("radius", self.radius, positive=True)
        checks.triple("centre", self.centre)

    def form(self):
        radius = jnp.asarray(self.radius, dtype=float)
        return Quadric(as_point(self.centre), jnp.eye(3) / radius, jnp.zeros(3), radius / 2)

    def _positive(self):
        return [self.radius]

    def __str__(self):
        return f"sphere r = {as_text(self.radius)}, centre {triple_text(self.centre)}"


class Ellipsoid(AbstractDescribed):
    """Ellipsoid with half axes a along x, b along y and c along z; `rotated` turns it about its centre.

    Args:
        half_axes: (a, b, c), lengths; positive.
        centre: (x, y, z) of the centre, lengths.

    Raises:
        ValueError: if a value is not a finite number, or a half axis is not positive.

    Examples:
        >>> print(jw.Ellipsoid((1.2, 0.7, 0.5), centre=(0.0, 1.1, 0.0)).rotated((0.0, 0.0, 0.3)))
        ellipsoid a = 1.2, b = 0.7, c = 0.5, centre (0, 1.1, 0), turned by (0, 0, 0.3)
    """

    half_axes: Triple = eqx.field(converter=checks.as_tuple)
    centre: Triple = eqx.field(converter=checks.as_tuple)

    def __check_init__(self):
        checks.triple("half_axes", self.half_axes, positive=True)
        checks.triple("centre", self.centre)

    def form(self):
        axes = as_point(self.half_axes)
        size = axes[1]  # the gradient of the level is 1 at the lowest point
        return Quadric(as_point(self.centre), jnp.diag(size / axes**2), jnp.zeros(3), size / 2)

    def _positive(self):
        return list(self.half_axes)

    def __str__(self):
        axes = ", ".join(f"{name} = {as_text(value)}" for name, value in zip("abc", self.half_axes, strict=True))
        return f"ellipsoid {axes}, centre {triple_text(self.centre)}"


class Cylinder(AbstractDescribed):
    """Infinitely long circular cylinder.

    Args:
        radius: r, a length; positive.
        point: (x, y, z) of a point on its axis, lengths.
        axis: direction of its axis; any vector other than zero.

    Raises:
        ValueError: if a value is not a finite number, the radius is not positive, or the axis is zero.

    Examples:
        >>> print(jw.Cylinder(0.9, point=(0.0, 1.2, 0.0), axis=(0.5, 0.0, 0.8)))
        cylinder r = 0.9, through (0, 1.2, 0) along (0.5, 0, 0.8)
    """

    radius: Scalar
    point: Triple = eqx.field(converter=checks.as_tuple)
    axis: Triple = eqx.field(default=(0.0, 0.0, 1.0), converter=checks.as_tuple)

    def __check_init__(self):
        checks.number("radius", self.radius, positive=True)
        checks.triple("point", self.point)
        checks.triple("axis", self.axis)
        if not checks.is_traced(self.axis) and not any(float(part) for part in self.axis):
            checks.fail("axis", "a vector other than zero", self.axis)

    def form(self):
        radius, axis = jnp.asarray(self.radius, dtype=float), as_point(self.axis)
        across = jnp.eye(3) - axis[:, None] * axis / jnp.sum(axis**2)
        return Quadric(as_point(self.point), across / radius, jnp.zeros(3), radius / 2)

    def _positive(self):
        return [self.radius, jnp.sum(as_point(self.axis) ** 2)]

    def __str__(self):
        place = f"through {triple_text(self.point)} along {triple_text(self.axis)}"
        return f"cylinder r = {as_text(self.radius)}, {place}"


class Paraboloid(AbstractDescribed):
    """Paraboloid y = distance + a x^2 + b z^2.

    Args:
        distance: q, height of the vertex (0, q, 0), a length.
        a: half the curvature along x at the vertex, 1/length; positive.
        b: half the curvature along z at the vertex, 1/length; positive; by default a.

    Raises:
        ValueError: if a value is not a finite number, or not positive where it must be.

    Examples:
        >>> paraboloid = jw.Paraboloid(0.2, a=2.0, b=0.5)
        >>> print(paraboloid.curvature(jnp.array([0.0, 0.2, 0.0])).diagonal())
        [4. 0. 1.]
    """

    distance: Scalar
    a: Scalar = 1.0
    b: Scalar | None = None

    def __check_init__(self):
        checks.number("distance", self.distance)
        checks.number("a", self.a, positive=True)
        if self.b is not None:
            checks.number("b", self.b, positive=True)

    def form(self):
        a, b = self._halves()
        depth = 1 / (2 * jnp.maximum(a, b))  # the smaller radius of curvature at the vertex
        inside = jnp.zeros(3).at[1].set(self.distance + depth)
        return Quadric(inside, jnp.diag(jnp.stack([2 * a, jnp.zeros(()), 2 * b])), jnp.array([0.0, -1.0, 0.0]), depth)

    def _halves(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """a and b."""
        return jnp.asarray(self.a, dtype=float), jnp.asarray(self.a if self.b is None else self.b, dtype=float)

    def _positive(self):
        return list(self._halves())

    def __str__(self):
        b = "" if self.b is None else f", b = {as_text(self.b)}"
        return f"paraboloid q = {as_text(self.distance)}{text_unless(1.0, ', a = ', self.a)}{b}"


class Plane(AbstractDescribed):
    """Plane, such as a wall: the object is all that lies behind it.

    Args:
        point: (x, y, z) of a point of the plane, lengths; near the whiskers, where a default scan looks for it.
        outward: direction of its normal out of the object, towards the whiskers; any vector other than zero.

    Raises:
        ValueError: if a value is not a finite number, or the direction is zero.

    Examples:
        >>> wall = jw.Plane(point=(-0.5, 0.0, 0.0), outward=(1.0, -1.0, 0.0))
        >>> print(wall)
        plane through (-0.5, 0, 0), facing (1, -1, 0)
        >>> print(wall.off(jnp.zeros(3)).round(6))
        0.353553
    """

    point: Triple = eqx.field(converter=checks.as_tuple)
    outward: Triple = eqx.field(converter=checks.as_tuple)

    def __check_init__(self):
        checks.triple("point", self.point)
        checks.triple("outward", self.outward)
        if not checks.is_traced(self.outward) and not any(float(part) for part in self.outward):
            checks.fail("outward", "a vector other than zero", self.outward)

    def form(self):
        outward = as_point(self.outward)
        return Quadric(
            as_point(self.point), jnp.zeros((3, 3)), outward / jnp.sqrt(jnp.sum(outward**2)), jnp.asarray(BELOW)
        )

    def _positive(self):
        return [jnp.sum(as_point(self.outward) ** 2)]

    def __str__(self):
        return f"plane through {triple_text(self.point)}, facing {triple_text(self.outward)}"
