"""A spring between the drive and a base, or between two bases."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar

AXES = ("x", "y", "phi")


class Spring(eqx.Module):
    """A linear spring: it pulls with stiffness * (length - rest_length), length = x_second - x_first (or y, or angle).

    Args:
        between: (first, second): 0 is the drive, 1 to N are the bases.
        stiffness: c, force per length, of a torsion spring moment per rad; positive, `jnp.inf` for a rigid link.
        rest_length: lambda, a length, of a torsion spring an angle, rad: where `second` rests beyond `first`.
        axis: "x" or "y", across and along the upright whisker in the frame of the drive, or "phi", a torsion spring;
            lengths and angles are counted along +x, +y and counter-clockwise.
        compliance: 1/c, instead of the stiffness; 0 for a rigid link, with derivatives by it that do not vanish there.

    Raises:
        ValueError: if a value is out of its domain, or not exactly one of stiffness and compliance is given.
    """

    between: tuple[int, int] = eqx.field(static=True)
    stiffness: Scalar | None = None
    rest_length: Scalar = 0.0
    axis: str = eqx.field(static=True, default="x")
    compliance: Scalar | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        ends = self.between
        if not (isinstance(ends, tuple) and len(ends) == 2 and all(isinstance(e, int) and e >= 0 for e in ends)):
            raise ValueError(
                f"`between` must be a pair of ints, 0 for the drive or 1 to N for a base, but is {ends!r}."
            )
        if ends[0] == ends[1]:
            raise ValueError(f"`between` must name two different ends, but is {ends!r}.")
        if (self.stiffness is None) == (self.compliance is None):
            raise ValueError(
                f"`stiffness` or `compliance` must be given, and not both, but they are {self.stiffness!r} and "
                f"{self.compliance!r}."
            )
        if self.stiffness is not None:
            checks.number("stiffness", self.stiffness, positive=True, finite=False)
        if self.compliance is not None:
            checks.number("compliance", self.compliance)
            if not checks.is_traced(self.compliance) and self.compliance < 0:
                raise ValueError(f"`compliance` must be at least 0, but is {self.compliance}.")
        checks.number("rest_length", self.rest_length)
        if self.axis not in AXES:
            raise ValueError(f"`axis` must be one of {', '.join(AXES)}, but is {self.axis!r}.")

    @property
    def softness(self) -> Float[Array, ""]:
        """1/c, whichever of the two was given."""
        if self.compliance is not None:
            return jnp.asarray(self.compliance, dtype=float)
        return 1 / jnp.asarray(self.stiffness, dtype=float)

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters lie where the constructor would have let them."""
        positive = self.softness >= 0 if self.stiffness is None else jnp.asarray(self.stiffness) > 0
        return positive & jnp.isfinite(self.softness) & jnp.isfinite(self.rest_length)
