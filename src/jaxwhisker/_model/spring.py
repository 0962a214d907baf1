"""A spring between the drive and a base, or between two bases."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar

AXES = ("x", "y", "phi")


class Spring(eqx.Module):
    """A linear spring between two ends, each of them the drive or a base.

    Its tension is stiffness * (length - rest_length), with length = x_second - x_first (or y, or the angle).

    Args:
        between: (first, second): 0 is the drive, 1 to N are the bases.
        stiffness: c, force per length, or moment per rad for a torsion spring; positive, `jnp.inf` for a rigid link.
        rest_length: lambda, a length, or an angle in rad for a torsion spring: position of `second` relative to
            `first` at rest; may be negative.
        axis: "x" or "y", across or along the upright whisker in the frame of the drive, or "phi" for a torsion spring.
            Lengths and angles are positive along +x, +y and counter-clockwise.
        compliance: 1/c, not negative, an alternative to `stiffness`; 0 for a rigid link. Unlike derivatives with
            respect to an infinite stiffness, those with respect to a compliance of 0 do not vanish.

    Raises:
        ValueError: if a value is out of its domain, or if not exactly one of stiffness and compliance is given.

    Examples:
        >>> spring = jw.Spring(between=(0, 1), stiffness=70.0, rest_length=0.2)
        >>> support = jw.Support((spring, jw.Spring((1, 2), compliance=0.01)))
        >>> support.name, support.whiskers
        ('FBFB', 2)
    """

    between: tuple[int, int] = eqx.field(static=True)
    stiffness: Scalar | None = None
    rest_length: Scalar = 0.0
    axis: str = eqx.field(static=True, default="x")
    compliance: Scalar | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        ends = self.between
        if not (isinstance(ends, tuple) and len(ends) == 2 and all(isinstance(e, int) and e >= 0 for e in ends)):
            checks.fail("between", "a pair of ints, 0 for the drive or 1 to N for a base", repr(ends))
        if ends[0] == ends[1]:
            checks.fail("between", "two different ends", repr(ends))
        if (self.stiffness is None) == (self.compliance is None):
            raise ValueError(
                "Exactly one of `stiffness` and `compliance` must be given, got "
                f"{self.stiffness!r} and {self.compliance!r}."
            )
        if self.stiffness is not None:
            checks.number("stiffness", self.stiffness, positive=True, finite=False)
        if self.compliance is not None:
            checks.number("compliance", self.compliance, non_negative=True)
        checks.number("rest_length", self.rest_length)
        if self.axis not in AXES:
            checks.fail("axis", f"one of {', '.join(AXES)}", repr(self.axis))

    @property
    def softness(self) -> Float[Array, ""]:
        """1/c, from the stiffness or the compliance."""
        if self.compliance is not None:
            return jnp.asarray(self.compliance, dtype=float)
        return 1 / jnp.asarray(self.stiffness, dtype=float)

    def is_rigid(self) -> bool:
        """Whether the stiffness of a concrete spring is infinite."""
        return bool(np.isinf(np.asarray(self.stiffness)) if self.compliance is None else self.compliance == 0)

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domain that the constructor checks."""
        positive = self.softness >= 0 if self.stiffness is None else jnp.asarray(self.stiffness) > 0
        return positive & jnp.isfinite(self.softness) & jnp.isfinite(self.rest_length)
