"""Capsules and boxes with rounded edges.

Both are the points at one distance, the radius, from a core: a segment, or a box that is smaller by the radius. With
the coordinates u of a point along the axes of the core, and its half edges h, the exact surface is

    sum of G(|u| - h) = r^2 / 2,    G(v) = v^2 / 2 for v > 0, else 0.

Its curvature jumps where round parts begin. There, paths of scans have corners, and stability may be lost without a
fold. So G'' rises from 0 to 1 for -w < v < w, by a cubic: the curvature is continuous, and nowhere larger than before.
Beyond, G exceeds v^2 / 2 by w^2 / 10, and round parts are a little smaller.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text
from jaxwhisker._base.types import Scalar, Triple
from jaxwhisker._model.surface import AbstractDescribed, AbstractSurface, Point, as_point, triple_text

BLEND = 0.1  # w over the radius
EXCESS = 0.1  # of G, over w^2
STILL = 1e-12  # speeds that are rounding errors


class _Beyond(NamedTuple):
    """G along each axis of the core, and its derivatives by |u|."""

    value: Float[Array, "3"]
    rate: Float[Array, "3"]
    bend: Float[Array, "3"]
    distance: Float[Array, "3"]  # |u| - h
    side: Float[Array, "3"]  # sign of u


class Rounded(AbstractSurface):
    """The surface at a distance from a box, which may be as thin as a segment: sum of G = size^2 / 2."""

    middle: Point
    axes: Float[Array, "3 3"]  # of the core; rows
    half: Float[Array, "3"]  # its half edges, not negative
    width: Float[Array, "3"]  # w, at most the half edge
    size: Float[Array, ""]

    def _beyond(self, x: Point) -> _Beyond:
        u = jnp.sum(self.axes * (x - self.middle), axis=1)
        side = jnp.where(u < 0, -1.0, 1.0)
        v = side * u - self.half
        whole = 2 * jnp.where(self.width > 0, self.width, 1.0)
        s, rounds = jnp.clip(v / whole + 0.5, 0.0, 1.0), v >= self.width
        value = jnp.where(rounds, v**2 / 2 + EXCESS * self.width**2, whole**2 * s**4 * (5 - 2 * s) / 20)
        rate = jnp.where(rounds, v, whole * s**3 * (2 - s) / 2)
        bend = jnp.where(rounds, 1.0, s**2 * (3 - 2 * s))
        return _Beyond(value, rate, bend, v, side)

    def level(self, x):
        return jnp.sum(self._beyond(x).value) / self.size - self.size / 2

    def gradient(self, x):
        at = self._beyond(x)
        return jnp.sum((at.side * at.rate / self.size)[:, None] * self.axes, axis=0)

    def hessian(self, x):
        bend = self._beyond(x).bend / self.size
        return jnp.sum(bend[:, None, None] * self.axes[:, :, None] * self.axes[:, None, :], axis=0)

    def plane_before(self, x):
        distance, normal = super().plane_before(x)
        # The level is constant in the core. The plane of its nearest face will do there.
        at = self._beyond(x)
        beyond = at.distance - jnp.sqrt(self.size**2 - 2 * EXCESS * self.width**2)
        face = jnp.argmax(beyond)
        deep = jnp.sum(at.value) < (self.size / 2) ** 2 / 2
        return (
            jnp.where(deep, beyond[face], distance),
            jnp.where(deep, at.side[face] * self.axes[face], normal),
        )

    def steps_to_joint(self, x, way):
        at, speed = self._beyond(x), jnp.sum(self.axes * way, axis=1)
        v, outwards = at.distance, at.side * speed > 0
        other = 2 * self.half + jnp.minimum(v, 0.0)  # to the joint on the other side of the core
        joint = jnp.where(v < 0, jnp.where(outwards, -v, other), jnp.where(outwards, jnp.inf, v))
        inside = jnp.abs(v) < self.width
        room = jnp.where(inside, self.width, jnp.maximum(joint - self.width, self.width))
        return jnp.min(jnp.where(self.width > 0, room / jnp.maximum(jnp.abs(speed), STILL), jnp.inf))

    def in_unit(self, length):
        return Rounded(self.middle / length, self.axes, self.half / length, self.width / length, self.size / length)

    def absorbed(self, turn, before, after):
        middle = after + jnp.sum(turn * (self.middle - before), axis=1)
        axes = jnp.sum(self.axes[:, None, :] * turn, axis=-1)
        return Rounded(middle, axes, self.half, self.width, self.size)

    def interior_point(self):
        return self.middle

    def thickness(self):
        return self.size + jnp.min(self.half)

    def _positive(self):
        return [self.size]

    def __str__(self):
        return "rounded body"


class Capsule(AbstractDescribed):
    """Circular cylinder with two hemispherical ends: all points within one radius of a segment.

    A peg with a free end is a long capsule. Its curvature is continuous: from 0.1 radii before the end of the segment
    to 0.1 radii after it, or less if the capsule is short, the curvature along it rises from 0 to 1/r. For that, the
    hemispheres have a radius of 0.999 r.

    Args:
        radius: r, a length; positive.
        start: (x, y, z) of one end of the segment, the centre of a hemisphere, lengths.
        end: (x, y, z) of the other one.

    Raises:
        ValueError: if a value is not a finite number, the radius is not positive, or both ends are the same.

    Examples:
        >>> peg = jw.Capsule(0.1, start=(0.0, 0.9, 0.0), end=(0.0, 0.9, 3.0))
        >>> print(peg)
        capsule r = 0.1, from (0, 0.9, 0) to (0, 0.9, 3)
        >>> print(peg.off(jnp.array([0.0, 0.9, -0.3])).round(3))
        0.133
    """

    radius: Scalar
    start: Triple = eqx.field(converter=checks.as_tuple)
    end: Triple = eqx.field(converter=checks.as_tuple)

    def __check_init__(self):
        checks.number("radius", self.radius, positive=True)
        checks.triple("start", self.start)
        checks.triple("end", self.end)
        if not checks.is_traced((self.start, self.end)) and all(
            float(a) == float(b) for a, b in zip(self.start, self.end, strict=True)
        ):
            checks.fail("end", "a point other than `start`", self.end)

    def form(self):
        radius = jnp.asarray(self.radius, dtype=float)
        start, end = as_point(self.start), as_point(self.end)
        length = jnp.sqrt(jnp.sum((end - start) ** 2))
        along = (end - start) / length
        across = jnp.cross(along, jnp.eye(3)[jnp.argmin(jnp.abs(along))])
        across = across / jnp.sqrt(jnp.sum(across**2))
        axes = jnp.stack([along, across, jnp.cross(along, across)])
        only = jnp.array([1.0, 0.0, 0.0])
        return Rounded((start + end) / 2, axes, length / 2 * only, _width(radius, length / 2) * only, radius)

    def _positive(self):
        return [self.radius, jnp.sum((as_point(self.end) - as_point(self.start)) ** 2)]

    def __str__(self):
        return f"capsule r = {as_text(self.radius)}, from {triple_text(self.start)} to {triple_text(self.end)}"


class RoundedBox(AbstractDescribed):
    """Cuboid with rounded edges and corners; `rotated` turns it about its centre.

    Its faces are flat, its edges are parts of cylinders and its corners parts of spheres. The curvature is continuous:
    beside an edge, it rises from 0 to 1/r over 0.2 radii, or less if a face is narrow. For that, edges have a radius of
    0.999 r, and corners one of 0.998 r.

    Args:
        size: (x, y, z), the lengths of its edges with the rounded parts; positive.
        radius: r of the edges and corners, a length; positive, and less than half of the shortest edge.
        centre: (x, y, z) of the centre, lengths.

    Raises:
        ValueError: if a value is not a finite number, or the radius or size is out of its range.

    Examples:
        >>> box = jw.RoundedBox((0.8, 0.5, 0.6), radius=0.05, centre=(0.0, 1.0, 0.0))
        >>> print(box)
        rounded box (0.8, 0.5, 0.6), r = 0.05, centre (0, 1, 0)
        >>> print(box.normal(jnp.array([0.2, 0.7, 0.1])))
        [ 0. -1.  0.]
    """

    size: Triple = eqx.field(converter=checks.as_tuple)
    radius: Scalar
    centre: Triple = eqx.field(converter=checks.as_tuple)

    def __check_init__(self):
        checks.triple("size", self.size, positive=True)
        checks.number("radius", self.radius, positive=True)
        checks.triple("centre", self.centre)
        if not checks.is_traced((self.size, self.radius)):
            least = min(map(float, self.size)) / 2
            if not float(self.radius) < least:
                checks.fail("radius", f"less than half of the shortest edge ({least:g})", self.radius)

    def form(self):
        radius = jnp.asarray(self.radius, dtype=float)
        half = as_point(self.size) / 2 - radius
        width = _width(radius, jnp.min(half))
        size = jnp.sqrt(radius**2 + 2 * EXCESS * width**2)  # faces are where they should be
        return Rounded(as_point(self.centre), jnp.eye(3), half, jnp.full(3, width), size)

    def _positive(self):
        return [self.radius, jnp.min(as_point(self.size)) / 2 - self.radius]

    def __str__(self):
        return f"rounded box {triple_text(self.size)}, r = {as_text(self.radius)}, centre {triple_text(self.centre)}"


def _width(radius: Float[Array, ""], half: Float[Array, ""]) -> Float[Array, ""]:
    """w for this radius and the least half edge."""
    return jnp.minimum(BLEND * radius, half)
