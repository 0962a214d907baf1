"""The object: a rigid body above its profile, the curve that whiskers touch; convex where they have one contact each.

A profile with edges consists of pieces, numbered from left to right: edges have even numbers, the smooth arcs between
them odd ones. Along an arc, the parameter of the profile moves the point. On an edge the point is fixed, and the
parameter turns the tangent from the slope of one neighbour to that of the other. Point and slope are thus continuous
functions of one increasing parameter, whose values between two pieces are the profile's breaks.
"""

import abc
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar

STEEPEST = checks.RIGHT_ANGLE - 1e-6  # rad, almost vertical


class ContactPoint(NamedTuple):
    """A point of the profile and the slope angle alpha of its tangent there."""

    x: Float[Array, "*batch"]
    y: Float[Array, "*batch"]
    cos: Float[Array, "*batch"]
    sin: Float[Array, "*batch"]

    @property
    def normal(self) -> Float[Array, "*batch 2"]:
        """The outward unit normal of the object."""
        return jnp.stack([self.sin, -self.cos], axis=-1)

    def off(self, x: Scalar | Array, y: Scalar | Array) -> Array:
        """Distances of points from the tangent, positive outside."""
        return (x - self.x) * self.sin - (y - self.y) * self.cos

    def along(self, x: Scalar | Array, y: Scalar | Array) -> Array:
        """Distances of points from this one along the tangent; zero for those to which it is nearest."""
        return (x - self.x) * self.cos + (y - self.y) * self.sin


class FirstTouch(NamedTuple):
    """Where an unloaded vertical whisker that approaches from one side first meets the object."""

    parameter: Float[Array, "*batch"]
    x: Float[Array, "*batch"]
    y: Float[Array, "*batch"]
    piece: Int[Array, "*batch"] | None = None  # None for a profile without edges


class AbstractProfile(eqx.Module):
    """A profile: a curve `point(parameter)`, traversed from left to right, smooth unless it has edges.

    Each profile chooses its parameter (slope angle, eccentric angle, abscissa) such that the curve is smooth and its
    derivative bounded. The contact force acts on the whisker along the outward normal (sin alpha, -cos alpha).
    """

    @abc.abstractmethod
    def point(self, parameter: Scalar) -> ContactPoint:
        """Point and slope at a parameter."""

    def speed(self, parameter: Scalar) -> Scalar:
        """Arc length per parameter."""

        def position(parameter):
            at = self.point(parameter)
            return (at.x, at.y), at

        (x, y), at = jax.jvp(position, (parameter,), (jnp.ones_like(parameter),), has_aux=True)[1:]
        return x * at.cos + y * at.sin

    @abc.abstractmethod
    def first_touch(self, height: Scalar, side: Scalar) -> FirstTouch:
        """First contact of a vertical whisker of this height, coming from the right (side = +1) or left (-1).

        The result is finite but meaningless if the object's lowest point is not below `height`.
        """

    def above_widest(self, height: Scalar, side: Scalar) -> FirstTouch:
        """The object's outermost point at this height, right (side = +1) or left (-1); y differs if it has none."""
        return self.first_touch(height, side)

    @abc.abstractmethod
    def vertex(self) -> tuple[Scalar, Scalar]:
        """The object's lowest point (x, y)."""

    @abc.abstractmethod
    def in_unit(self, length: Scalar) -> "AbstractProfile":
        """The same object with lengths measured in `length`."""

    def canonical(self) -> "AbstractProfile":
        """The same object, with numbers in place of the class that tells its kind, where they can do that."""
        return self

    @property
    def has_edges(self) -> bool:
        """Whether the profile consists of pieces."""
        return False

    @property
    def has_corners(self) -> bool:
        """Whether all edges are corners between straight faces."""
        return False

    @property
    def is_concave(self) -> bool:
        """Whether the profile is known to have inner corners or to be hollow."""
        return False

    @property
    def objects(self) -> tuple["AbstractProfile", ...]:
        """The separate objects."""
        return (self,)

    @property
    def has_pieces(self) -> bool:
        """Whether a contact needs to know its piece."""
        return self.has_edges

    def object_of(self, piece: Int[Array, "*batch"] | None) -> Int[Array, "*batch"] | None:
        """The object with this piece, an index into `objects`; None if there is only one."""
        del piece

    def on(self, piece: Int[Array, ""] | None) -> "AbstractProfile":
        """The curve `point(parameter)` of the object with this piece."""
        del piece
        return self

    def breaks(self) -> Float[Array, " breaks"]:
        """Parameters at which one piece ends and the next one begins; none without edges."""
        return jnp.zeros(0)

    def point_on(self, piece: Int[Array, ""] | None, parameter: Scalar) -> ContactPoint:
        """Point and slope at a parameter of a piece, which is continued smoothly beyond its ends."""
        assert piece is None
        return self.point(parameter)

    def ends_on(self, piece: Int[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Parameters at which pieces begin and end; infinite for the outer ends of an object's first and last piece."""
        far = jnp.full(1, jnp.inf)
        breaks = jnp.concatenate([-far, self.breaks(), far])
        return breaks[piece], breaks[piece + 1]

    def piece_at(self, parameter: Scalar) -> Int[Array, ""] | None:
        """The piece with this parameter; None without edges."""
        return jnp.sum(parameter >= self.breaks()) if self.has_edges else None

    def ends(self) -> tuple[Scalar, Scalar]:
        """Parameters of the profile's two ends; by default slope angles of almost a right angle."""
        return -STEEPEST, STEEPEST

    def faces(self) -> ContactPoint | None:
        """A point and the slope of each side of a polygon; None for a curved outline."""
        return None

    @property
    def closed(self) -> Bool[Array, ""] | bool:
        """Whether `point` runs all around the object, between the parameters of its `span`."""
        return False

    def span(self) -> tuple[Scalar, Scalar]:
        """Parameters of the first and the last point that may be nearest to a whisker: beyond the ends if closed."""
        return self.ends()

    def around(self, x: Scalar, y: Scalar, reach: Scalar) -> tuple[Scalar, Scalar]:
        """A range of parameters, within the span, of all points at most this far from (x, y)."""
        del x, y, reach
        return self.span()

    def facing(self, x: Scalar, y: Scalar) -> Scalar | None:
        """The parameter of a point that faces (x, y), a smooth function of both; None if it has to be searched for.

        For points on the profile it is their own parameter.
        """
        del x, y
        return None

    def lowest(self) -> Scalar:
        """The parameter of the object's lowest point."""
        return self.at_slope(0.0)

    def at_slope(self, slope: Scalar) -> Scalar:
        """The parameter, between the ends, at which the profile has this slope angle (rad); without a derivative."""

        def angle(p):
            at = self.point(p)
            return jnp.where(jnp.isfinite(at.y), jnp.arctan2(at.sin, at.cos), jnp.nan)

        return bisect_angle(angle, slope, *self.ends())

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domain that the constructor checks."""
        return checks.all_finite(self) & jnp.all(jnp.asarray(self._positive()) > 0)

    def convex(self, parameter: Scalar) -> Bool[Array, ""]:
        """Whether the profile curves away from the whisker at this parameter."""
        del parameter
        return jnp.asarray(True)

    def convex_on(self, piece: Int[Array, ""] | None, parameter: Scalar) -> Bool[Array, ""]:
        """Whether the profile curves away from the whisker at this parameter of a piece."""
        del piece
        return self.convex(parameter)

    @abc.abstractmethod
    def _positive(self) -> list[Scalar]:
        """Values that must be positive."""

    @abc.abstractmethod
    def __str__(self) -> str: ...


def bisect_angle(angle: Callable, slope: Scalar, low: Scalar, high: Scalar) -> Float[Array, ""]:
    """The parameter at which `angle`, an increasing function, reaches `slope`; without a derivative."""

    def flatter(parameter):
        here = angle(parameter)
        # Outside the domain (NaN) treat the object as ending in a vertical wall.
        return jnp.where(jnp.isfinite(here), here < slope, parameter < (low + high) / 2)

    return bisect(flatter, low, high)


def bisect(inside: Callable, low: Scalar, high: Scalar, *, steps: int = 80) -> Float[Array, ""]:
    """The end of the range, starting at `low`, in which `inside` holds, by default to rounding; no derivative."""

    def halve(_, bracket):
        low, high = bracket
        middle = (low + high) / 2
        yes = inside(middle)
        return jnp.where(yes, middle, low), jnp.where(yes, high, middle)

    low = jnp.asarray(low, dtype=float)
    return jax.lax.fori_loop(0, steps, halve, (low, jnp.asarray(high, dtype=float)))[0]
