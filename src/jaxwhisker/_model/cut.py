"""A smooth profile that is cut off, and whose ends are edges."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, ContactPoint, FirstTouch, bisect

FAR = 1e9  # parameter at which the arc of a profile ends that is not cut on this side
ON_PROFILE = 1e-9  # relative to 1 + |x|: largest distance in x between the cut and the profile's point there


class Cut(AbstractProfile):
    """A smooth profile that is cut off at one or both sides, where the object ends in an edge.

    The object does not continue beyond its ends: like a bent plate, it has no wall above the edge. Its parameter is
    that of the profile, continued on an edge by the angle (rad) by which the tangent turns.

    Args:
        profile: a smooth profile, such as a Parabola or a Graph.
        left: x at which the object begins, a length; None if it is not cut on this side.
        right: x at which it ends, a length; None if it is not cut on this side.

    Raises:
        ValueError: if `profile` is not a smooth profile, an end is not a finite number, both are None, `left` is not
            less than `right`, or the profile has no point at one of them.

    Examples:
        >>> plate = jw.Cut(jw.Parabola(distance=0.2), left=-0.3, right=0.5)
        >>> print(plate)
        parabola q = 0.2, cut to -0.3 < x < 0.5
    """

    profile: AbstractProfile
    left: Scalar | None = None
    right: Scalar | None = None

    def __check_init__(self):
        checks.instance("profile", self.profile, AbstractProfile, "a smooth profile such as Parabola or Graph")
        if self.profile.has_edges or len(self.profile.objects) > 1:
            checks.fail("profile", "a smooth profile such as Parabola or Graph", str(self.profile))
        ends = {name: value for name in ("left", "right") if (value := getattr(self, name)) is not None}
        if not ends:
            checks.fail("right", "a number, at least if `left` is None", None)
        for name, value in ends.items():
            checks.number(name, value)
        if checks.is_traced((self.profile, self.left, self.right)):
            return
        if len(ends) == 2 and not float(ends["left"]) < float(ends["right"]):
            checks.fail("right", f"greater than `left` ({float(ends['left']):g})", float(ends["right"]))
        for name, value in ends.items():
            with jax.ensure_compile_time_eval():
                has_point = _has_point_now(*jax.tree.map(checks.as_float, (self.profile, value)))
            if not bool(has_point):
                checks.fail(name, f"an x at which the profile ({self.profile}) has a point", float(value))

    def canonical(self):
        return eqx.tree_at(lambda own: own.profile, self, self.profile.canonical())

    @property
    def has_edges(self):
        return True

    def trimmed(self) -> "Trimmed":
        """The same object by the parameters of its ends."""
        ends = (None if x is None else _parameter_at(self.profile, x) for x in (self.left, self.right))
        return Trimmed(self.profile, *ends)

    def point(self, parameter):
        return self.trimmed().point(parameter)

    def point_on(self, piece, parameter):
        return self.trimmed().point_on(piece, parameter)

    def breaks(self):
        return self.trimmed().breaks()

    def convex(self, parameter):
        return self.trimmed().convex(parameter)

    def ends(self):
        return self.trimmed().ends()

    def lowest(self):
        return self.trimmed().lowest()

    def first_touch(self, height, side):
        return self.trimmed().first_touch(height, side)

    def vertex(self):
        return self.trimmed().vertex()

    def in_unit(self, length):
        profile = self.profile.in_unit(length)
        ends = (None if x is None else _parameter_at(profile, x / length) for x in (self.left, self.right))
        return Trimmed(profile, *ends)

    def valid(self):
        valid = super().valid()
        for x in (self.left, self.right):
            if x is not None:
                valid &= _has_point(self.profile, x)
        return valid

    def _positive(self):
        width = [] if self.left is None or self.right is None else [self.right - self.left]
        return [self.vertex()[1], *width]

    def __str__(self):
        left = "" if self.left is None else f"{as_text(self.left)} < "
        right = "" if self.right is None else f" < {as_text(self.right)}"
        return f"{self.profile}, cut to {left}x{right}"


class Trimmed(AbstractProfile):
    """A smooth profile between two of its parameters: piece 0 is the left edge, 1 the arc, 2 the right edge."""

    profile: AbstractProfile
    low: Scalar | None
    high: Scalar | None

    @property
    def has_edges(self):
        return True

    def breaks(self):
        return jnp.stack([jnp.asarray(v, dtype=float) for v in self._limits()])

    def _limits(self) -> tuple[Scalar, Scalar]:
        return -FAR if self.low is None else self.low, FAR if self.high is None else self.high

    def point(self, parameter):
        return self.point_on(self.piece_at(parameter), parameter)

    def point_on(self, piece, parameter):
        at = parameter
        if self.low is not None:
            at = jnp.where(piece == 0, self.low, at)
        if self.high is not None:
            at = jnp.where(piece == 2, self.high, at)
        point = self.profile.point(at)
        # Zero along the arc.
        cos, sin = jnp.cos(parameter - at), jnp.sin(parameter - at)
        return ContactPoint(point.x, point.y, point.cos * cos - point.sin * sin, point.sin * cos + point.cos * sin)

    def convex(self, parameter):
        low, high = self._limits()
        return ((parameter < low) | (parameter > high)) | self.profile.convex(jnp.clip(parameter, low, high))

    def ends(self):
        # The edges turn to the vertical at least.
        low, high = self.profile.ends()
        half = 2 * checks.RIGHT_ANGLE
        return low if self.low is None else self.low - half, high if self.high is None else self.high + half

    def lowest(self):
        low, high = self._limits()
        within = jnp.clip(self.profile.lowest(), low, high)
        # At a lowest end, the tangent turns until it is horizontal.
        at = self.profile.point(within)
        turn = jnp.where((within == low) | (within == high), jnp.arctan2(at.sin, at.cos), 0.0)
        return jax.lax.stop_gradient(within - turn)

    def first_touch(self, height, side):
        arc = self.profile.first_touch(jnp.maximum(height, self.vertex()[1]), side)
        found = arc._replace(piece=jnp.asarray(1))
        for end, direction, piece in ((self.low, -1.0, 0), (self.high, 1.0, 2)):
            if end is None:
                continue
            at = self.profile.point(end)
            # An upright whisker that is long enough touches the edge with its shaft.
            upright = end + direction * checks.RIGHT_ANGLE - jnp.arctan2(at.sin, at.cos)
            edge = FirstTouch(upright, at.x, at.y, jnp.asarray(piece))
            there = (side * direction > 0) & (height >= at.y)
            found = jax.tree.map(lambda a, b, there=there: jnp.where(there, a, b), edge, found)
        return found

    def vertex(self):
        low, high = self._limits()
        at = self.profile.point(jnp.clip(self.profile.lowest(), low, high))
        return at.x, at.y

    def in_unit(self, length):
        raise NotImplementedError  # never asked for: it is made in the unit of the problem

    def _positive(self):
        return [self.vertex()[1]]

    def __str__(self):
        return f"{self.profile}, cut"


def _parameter_at(profile: AbstractProfile, x: Scalar) -> Float[Array, ""]:
    """The parameter of the profile's point at x."""
    still, at = jax.lax.stop_gradient((profile, jnp.asarray(x, dtype=float)))
    p = jax.lax.stop_gradient(bisect(lambda p: still.point(p).x < at, *still.ends()))
    for _ in range(2):  # Newton steps carry the first and second derivatives
        here, rate = jax.jvp(lambda p: profile.point(p).x, (p,), (jnp.ones_like(p),))
        good = jnp.isfinite(here) & (rate > 0)
        p = p - jnp.where(good, (here - x) / jnp.where(good, rate, 1.0), 0.0)
    return p


def _has_point(profile: AbstractProfile, x: Scalar):
    at = profile.point(_parameter_at(profile, x))
    return (jnp.abs(at.x - x) < ON_PROFILE * (1 + jnp.abs(x))) & jnp.isfinite(at.y) & (at.cos > 0)


_has_point_now = Program(_has_point)
