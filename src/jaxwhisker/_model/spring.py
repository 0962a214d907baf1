"""A spring between the drive and a whisker, or between two whiskers."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import name_of, number_or_function
from jaxwhisker._base.quadrature import gauss
from jaxwhisker._base.types import Scalar

AXES = ("x", "y", "phi")  # in the plane
AXES_IN_SPACE = ("x", "y", "z", "phi_x", "phi_y", "phi")  # phi is the angle about z
ONE_SIDED = ("tension", "compression")
POINTS, WEIGHTS = gauss(16)  # for the energies of user-defined springs
SPACING = 0.2  # default distance between neighbours in a row, in lengths of the first whisker


class Spring(eqx.Module):
    """A spring between two ends, each of them the drive or a whisker.

    Its tension is stiffness * (length - rest_length), with length = x_second - x_first (or y, or the angle), or the
    distance of its ends if it is axial.

    The end at the drive of a spring that is attached to a shaft, or whose tension is not proportional to its extension,
    is where the attachment is in the drive's frame if all rest lengths are 0 and nothing is loaded. If the springs do
    not agree with that, they bend the whisker before it touches anything. The length along x or y of a spring between
    two shafts, and the angle of one that acts on both, are relative to such places, too.

    Args:
        between: (first, second): 0 is the drive, 1 to N are the whiskers.
        stiffness: c, force per length, or moment per rad for a torsion spring; positive, `jnp.inf` for a rigid link
            between bases. Or a function of the extension, length - rest_length, that returns the tension; it is called
            with one traced number, and the parameters of an `equinox.Module` are differentiable.
        rest_length: lambda, a length, or an angle in rad for a torsion spring: position of `second` relative to
            `first` at rest; may be negative. That of an axial spring is its absolute value, and its sign tells on which
            side of `first`, along x, `second` is before any contact. None, along x or axial: `second` - `first` times
            0.2 lengths of the first whisker of the scene, so that the bases rest in a row at equal distances.
        axis: "x" or "y", across or along the upright whisker in the frame of the drive, "phi" for a torsion spring, or
            "axial" for a spring along the line between its ends, whichever way that turns. Lengths and angles are
            positive along +x, +y and counter-clockwise. With objects in space also "z", and "phi_x" and "phi_y" for
            torsion springs about the x and y axes, right-handed; "phi" is the one about z. Angles in space are the
            components of the rotation vector of the base relative to the drive, along the axes of the drive's frame.
        compliance: 1/c, not negative, an alternative to `stiffness`; 0 for a rigid link. Unlike derivatives with
            respect to an infinite stiffness, those with respect to a compliance of 0 do not vanish.
        at: arc length from the base to where the spring is attached to the shaft; negative on a rigid follicle that
            extends the whisker straight below its base. Default: the base. A pair for a spring between two whiskers.
        anchor: (x, y) of the drive's end in the drive's frame, instead of the place described above.
        one_sided: "tension" if the spring only pulls, "compression" if it only pushes, like an end stop.

    Raises:
        ValueError: if a value is out of its domain, if not exactly one of stiffness and compliance is given, or if a
            spring on a shaft is rigid.

    Examples:
        >>> spring = jw.Spring(between=(0, 1), stiffness=70.0, rest_length=0.2)
        >>> support = jw.Support((spring, jw.Spring((1, 2), compliance=0.01)))
        >>> support.name, support.whiskers
        ('FBFB', 2)
        >>> above = jw.Spring((0, 1), stiffness=70.0, rest_length=0.2, axis="axial", at=0.1)
        >>> across = jw.Spring((1, 2), stiffness=10.0, rest_length=0.2, axis="axial", at=(0.3, 0.3))
    """

    between: tuple[int, int] = eqx.field(static=True)
    stiffness: Scalar | Callable[[Any], Any] | None = eqx.field(default=None, converter=number_or_function("stiffness"))
    rest_length: Scalar | Any = 0.0  # None only until a scene replaces it by a number
    axis: str = eqx.field(static=True, default="x")
    compliance: Scalar | None = eqx.field(default=None, kw_only=True)
    at: Scalar | tuple[Scalar, Scalar] | None = eqx.field(default=None, kw_only=True)
    anchor: tuple[Scalar, Scalar] | None = eqx.field(default=None, kw_only=True)
    one_sided: str | None = eqx.field(static=True, default=None, kw_only=True)

    def __check_init__(self):
        ends = self.between
        if not (isinstance(ends, tuple) and len(ends) == 2 and all(isinstance(e, int) and e >= 0 for e in ends)):
            checks.fail("between", "a pair of ints, 0 for the drive or 1 to N for a whisker", repr(ends))
        if ends[0] == ends[1]:
            checks.fail("between", "two different ends", repr(ends))
        if (self.stiffness is None) == (self.compliance is None):
            raise ValueError(
                "Exactly one of `stiffness` and `compliance` must be given, got "
                f"{self.stiffness!r} and {self.compliance!r}."
            )
        if self.stiffness is not None and not callable(self.stiffness):
            checks.number("stiffness", self.stiffness, positive=True, finite=False)
        if self.compliance is not None:
            checks.number("compliance", self.compliance, non_negative=True)
        if self.axis not in (*AXES_IN_SPACE, "axial"):
            checks.fail("axis", f"one of {', '.join(AXES_IN_SPACE)}, axial", repr(self.axis))
        if self.rest_length is not None or self.axis not in ("x", "axial"):
            checks.number("rest_length", self.rest_length)
        if self.at is not None and self.between[0] != 0:
            checks.pair("at", self.at)
        elif self.at is not None:
            checks.number("at", self.at)
        if self.anchor is not None:
            checks.pair("anchor", self.anchor)
        if self.one_sided not in (None, *ONE_SIDED):
            checks.fail("one_sided", " or ".join(map(repr, ONE_SIDED)), repr(self.one_sided))
        if not self.linear:
            self._check_attached()

    def _check_attached(self) -> None:
        if self.axis not in (*AXES, "axial"):
            allowed = f"one of {', '.join(AXES)}, axial for a spring that is on a shaft or not linear"
            checks.fail("axis", allowed, repr(self.axis))
        if self.between[1] == 0:
            checks.fail("between", "(0, k) for a spring from the drive to a shaft", repr(self.between))
        if self.anchor is not None and self.between[0] != 0:
            checks.fail("anchor", "None for a spring between two whiskers", repr(self.anchor))
        if not callable(self.stiffness) and not checks.is_traced(self.softness) and self.is_rigid():
            name = "stiffness" if self.compliance is None else "compliance"
            allowed = f"{'finite' if self.compliance is None else 'positive'} for a spring on a shaft"
            checks.fail(name, allowed, getattr(self, name))

    @property
    def turns(self) -> bool:
        """Whether it is a torsion spring, whose length is an angle."""
        return self.axis.startswith("phi")

    def check_in_plane(self) -> None:
        """Raise a ValueError if it acts along an axis that needs an object in space."""
        if self.axis not in (*AXES, "axial"):
            allowed = f"one of {', '.join(AXES)}, axial in the plane: others need an object in space"
            checks.fail("axis", allowed, repr(self.axis))

    def check_in_space(self) -> None:
        """Raise a ValueError if it is not linear along a coordinate of the bases, as springs in space must be."""
        if self.axis == "axial":
            checks.fail("axis", f"one of {', '.join(AXES_IN_SPACE)} in space", repr(self.axis))
        if callable(self.stiffness):
            checks.fail("stiffness", "a number in space", name_of(self.stiffness))
        for name in ("at", "anchor", "one_sided"):
            if getattr(self, name) is not None:
                checks.fail(name, "None in space", repr(getattr(self, name)))

    @property
    def linear(self) -> bool:
        """Whether it is one of the linear springs along the coordinates of the bases, which form the network."""
        plain = self.axis != "axial" and self.at is None and self.anchor is None
        return plain and self.one_sided is None and not callable(self.stiffness)

    @property
    def ends(self) -> tuple[tuple[int, Scalar], ...]:
        """The whiskers that it holds, and the arc lengths to where it does; without the drive."""
        places = (0.0, 0.0) if self.at is None else self.at if isinstance(self.at, tuple) else (0.0, self.at)
        return tuple((whisker, at) for whisker, at in zip(self.between, places, strict=True) if whisker != 0)

    @property
    def softness(self) -> Float[Array, ""]:
        """1/c, from the stiffness or the compliance."""
        if self.compliance is not None:
            return jnp.asarray(self.compliance, dtype=float)
        return 1 / jnp.asarray(self.stiffness, dtype=float)

    def in_row(self, whisker: Scalar) -> "Spring":
        """The spring with its rest length, whose default depends on the length of the first whisker."""
        if self.rest_length is not None:
            return self
        first, second = self.between
        rest = (second - first) * (SPACING * whisker)
        return eqx.tree_at(lambda spring: spring.rest_length, self, rest, is_leaf=lambda leaf: leaf is None)

    def energy(self, length: Scalar) -> Float[Array, ""]:
        """Energy stored at this length or angle."""
        rest = jnp.abs(jnp.asarray(self.rest_length)) if self.axis == "axial" else self.rest_length
        extension, sign = length - rest, {"tension": 1.0, "compression": -1.0, None: 0.0}[self.one_sided]

        def tension(extension: Scalar) -> Float[Array, ""]:
            soft = jnp.where(self.softness > 0, self.softness, jnp.inf) if not callable(self.stiffness) else 1.0
            pull = jnp.asarray(self.stiffness(extension) if callable(self.stiffness) else extension / soft)
            return pull if sign == 0 else sign * jnp.maximum(sign * pull, 0.0)

        return extension * jnp.sum(WEIGHTS * jax.vmap(tension)(jnp.asarray(POINTS) * extension))

    def is_rigid(self) -> bool:
        """Whether the stiffness of a concrete spring is infinite."""
        if callable(self.stiffness):
            return False
        return bool(np.isinf(np.asarray(self.stiffness)) if self.compliance is None else self.compliance == 0)

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domain that the constructor checks."""
        valid = checks.all_finite((self.rest_length, self.at, self.anchor))
        if callable(self.stiffness):
            return valid & checks.all_finite(self.stiffness)
        positive = self.softness >= 0 if self.stiffness is None else jnp.asarray(self.stiffness) > 0
        if not self.linear:
            positive &= self.softness > 0
        return valid & positive & jnp.isfinite(self.softness)
