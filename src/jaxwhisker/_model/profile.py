"""The object: a rigid, strictly convex body above its profile, the curve that whiskers touch."""

import abc
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar

STEEPEST = checks.RIGHT_ANGLE - 1e-6  # rad, almost vertical


class ContactPoint(NamedTuple):
    """A point of the profile and the slope angle alpha of its tangent there."""

    x: Float[Array, "*batch"]
    y: Float[Array, "*batch"]
    cos: Float[Array, "*batch"]
    sin: Float[Array, "*batch"]


class FirstTouch(NamedTuple):
    """Where an unloaded vertical whisker that approaches from one side first meets the object."""

    parameter: Float[Array, "*batch"]
    x: Float[Array, "*batch"]
    y: Float[Array, "*batch"]


class AbstractProfile(eqx.Module):
    """A profile: a smooth curve `point(parameter)`, traversed from left to right.

    Each profile chooses its parameter (slope angle, eccentric angle, abscissa) such that the curve is smooth and its
    derivative bounded. The contact force acts on the whisker along the outward normal (sin alpha, -cos alpha).
    """

    @abc.abstractmethod
    def point(self, parameter: Scalar) -> ContactPoint:
        """Point and slope at a parameter."""

    @abc.abstractmethod
    def first_touch(self, height: Scalar, side: Scalar) -> FirstTouch:
        """First contact of a vertical whisker of this height, coming from the right (side = +1) or left (-1).

        The result is finite but meaningless if the object's lowest point is not below `height`.
        """

    @abc.abstractmethod
    def vertex(self) -> tuple[Scalar, Scalar]:
        """The object's lowest point (x, y)."""

    @abc.abstractmethod
    def in_unit(self, length: Scalar) -> "AbstractProfile":
        """The same object with lengths measured in `length`."""

    def ends(self) -> tuple[Scalar, Scalar]:
        """Parameters of the profile's two ends; by default slope angles of almost a right angle."""
        return -STEEPEST, STEEPEST

    def around(self) -> tuple[Scalar, Scalar] | None:
        """Parameters between which `point` runs once around a closed object, for figures; None if it is open."""
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
