"""Surfaces made of plane profiles, extruded or revolved.

Those of conic sections are quadrics. The level of all others is the distance from the profile. It is found from the
foot of the perpendicular: the parameter p at which x - x(p) is orthogonal to the tangent.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from jaxwhisker._base import checks
from jaxwhisker._base.implicit import solution_of
from jaxwhisker._model.conic import Conic
from jaxwhisker._model.profile import AbstractProfile, ContactPoint
from jaxwhisker._model.profiles import Graph, Tilted
from jaxwhisker._model.surface import AbstractDescribed, AbstractSurface, Placed, Point, Quadric

STEPS = 100  # of a search for the foot of a perpendicular; Newton's method takes about 6
CONVERGED = 1e-14  # step of the parameter, relative if large
FAR_OUT = np.append(0.0, np.geomspace(1e-3, 1.0, 300))  # shares of the way to an end, at which a graph is checked
BENT_BACK = 1e-6  # of its largest curvature: rounding errors
SLOPES = (0.02, 0.1, 0.3, 0.6, 1.0, 1.3)  # rad, at which the two sides of a profile are compared
SYMMETRIC = 1e-6  # relative difference of the sides
# The distance from the axis is not smooth there, but sqrt(distance^2 + core^2) is. With a core of this size, over the
# radius of curvature at the vertex, the surface moves by 5e-13 of it, and the curvature is exact to 1e-10.
CORE = 1e-6


class _AbstractSolid(AbstractDescribed):
    """A surface made of a plane profile."""

    profile: eqx.AbstractVar[AbstractProfile]

    def _positive(self):
        return self.profile._positive()


class Extruded(_AbstractSolid):
    """The cylinder over a plane profile: its cross-section is the same for all z.

    Above its widest place, or where the profile ends, the object goes on straight up; ellipses and circles are closed.

    Args:
        profile: the cross-section, any convex profile without edges. For a concave graph, take a `Surface`.

    Raises:
        ValueError: if `profile` is not a profile, has edges, consists of several objects, or is a graph that is not
            convex, unless it is traced or the surface is made below `jax.jit`.

    Examples:
        >>> print(jw.Extruded(jw.Parabola(0.2)))
        parabola q = 0.2, extruded along z
        >>> leaning = jw.Extruded(jw.Circle(0.3, radius=0.9)).rotated((0.0, 0.4, 0.0))
        >>> print(leaning)
        circle q = 0.3, r = 0.9, extruded along z, turned by (0, 0.4, 0)
    """

    profile: AbstractProfile

    def __check_init__(self):
        _check_without_edges(self.profile)
        _check_convex(self.profile)

    def form(self):
        if isinstance(self.profile, Tilted):
            about = (*self.profile.about, 0.0)
            return Placed(Extruded(self.profile.profile), rotation=(0.0, 0.0, self.profile.angle), about=about)
        profile = self.profile.in_unit(1.0)
        return _quadric(profile, 0.0) if isinstance(profile, Conic) else Cylindrical.of(profile)

    def __str__(self):
        return f"{self.profile}, extruded along z"


class Revolved(_AbstractSolid):
    """The solid of revolution of a plane profile about the vertical axis through its lowest point.

    Above its widest place, or where the profile ends, the object goes on straight up; ellipses and circles are closed.
    The right-hand side of the profile is revolved. The left-hand side is its mirror image, which is checked unless the
    profile is traced or the surface is made below `jax.jit`.

    Args:
        profile: a profile without edges that is symmetric about its vertical axis.

    Raises:
        ValueError: if `profile` is not a profile, has edges, consists of several objects, or is not symmetric or
            convex. A tilted profile is not symmetric; turn the surface instead (`rotated`).

    Examples:
        >>> bowl = jw.Revolved(jw.Graph(lambda x: 0.2 + x**2 + x**4))
        >>> print(bowl.curvature(jnp.array([0.0, 0.2, 0.0])).diagonal().round(6))
        [2. 0. 2.]
    """

    profile: AbstractProfile

    def __check_init__(self):
        profile, needs = self.profile, "symmetric about the vertical axis through its lowest point"
        _check_without_edges(profile)
        if isinstance(profile, Tilted):
            raise ValueError(
                f"`profile` must be {needs}, got {profile}. Revolve the profile that is not tilted, and turn the "
                "surface with `rotated`."
            )
        symmetric = checks.is_traced(profile) or _is_symmetric(profile)
        if not (checks.is_traced(symmetric) or symmetric):  # below jit, all results are traced
            checks.fail("profile", needs, str(profile))
        _check_convex(profile)

    def form(self):
        profile = self.profile.in_unit(1.0)
        return _quadric(profile, 1.0) if isinstance(profile, Conic) else Rotational.of(profile)

    def __str__(self):
        return f"{self.profile}, revolved about its axis"


class _Foot(NamedTuple):
    """Foot of the perpendicular from a point to a profile."""

    at: ContactPoint
    off: Float[Array, ""]  # signed distance of the point
    parameter: Float[Array, ""]
    free: Bool[Array, ""]  # whether it lies on the profile, and not on a straight line beyond one of its ends


class _AbstractSwept(AbstractSurface):
    """A surface swept by a profile; its level is the distance from the profile."""

    profile: AbstractProfile
    lowest: Float[Array, ""]  # parameter of the lowest point
    inside: Point  # centre of curvature of the lowest point
    radius: Float[Array, ""]  # of curvature there

    @classmethod
    def of(cls, profile: AbstractProfile):
        """The surface of this profile."""
        found = jnp.reshape(_constant(profile).lowest(), 1)
        lowest = solution_of(_steepness, found, (profile, jnp.zeros(())))[0]
        at = profile.point(lowest)
        radius = 1 / _bend(profile, _Foot(at, jnp.zeros(()), lowest, jnp.asarray(True)))
        return cls(profile, lowest, jnp.stack([at.x, at.y + radius, jnp.zeros(())]), radius)

    def foot(self, x: Float[Array, ""], y: Float[Array, ""]) -> _Foot:
        """The foot of a point (x, y), with derivatives of any order."""
        found, free = _search(*_constant((self.profile, self.lowest, x, y)))
        parameter = solution_of(_misses, found[None], (self.profile, x, y, free))[0]
        at = self.profile.point(parameter)
        return _Foot(at, at.off(x, y), parameter, free)

    def in_unit(self, length):
        return type(self).of(self.profile.in_unit(length))

    def interior_point(self):
        return self.inside

    def _positive(self):
        return [*self.profile._positive(), self.radius]


class Cylindrical(_AbstractSwept):
    """The cylinder over a profile."""

    def level(self, x):
        return self.foot(x[0], x[1]).off

    def gradient(self, x):
        at = self.foot(x[0], x[1]).at
        return jnp.stack([at.sin, -at.cos, jnp.zeros(())])

    def hessian(self, x):
        foot = self.foot(x[0], x[1])
        tangent = jnp.stack([foot.at.cos, foot.at.sin, jnp.zeros(())])
        return _bend(self.profile, foot) * tangent[:, None] * tangent

    def __str__(self):
        return f"{self.profile}, extruded along z"


class Rotational(_AbstractSwept):
    """The surface of revolution of a profile about the vertical axis through its lowest point."""

    def _from_axis(self, x: Point) -> tuple[Float[Array, ""], Point]:
        """Distance from the axis, and its gradient; both smooth on the axis."""
        across = (x - self.inside).at[1].set(0.0)
        distance = jnp.sqrt(jnp.sum(across**2) + (CORE * self.radius) ** 2)
        return distance, across / distance

    def level(self, x):
        return self.foot(self.inside[0] + self._from_axis(x)[0], x[1]).off

    def gradient(self, x):
        distance, outwards = self._from_axis(x)
        at = self.foot(self.inside[0] + distance, x[1]).at
        return (at.sin * outwards).at[1].set(-at.cos)

    def hessian(self, x):
        distance, outwards = self._from_axis(x)
        foot = self.foot(self.inside[0] + distance, x[1])
        tangent = (foot.at.cos * outwards).at[1].set(foot.at.sin)
        around = jnp.diag(jnp.array([1.0, 0.0, 1.0])) - outwards[:, None] * outwards
        return _bend(self.profile, foot) * tangent[:, None] * tangent + foot.at.sin / distance * around

    def __str__(self):
        return f"{self.profile}, revolved about its axis"


def _check_without_edges(profile: AbstractProfile) -> None:
    checks.instance("profile", profile, AbstractProfile, "a profile such as Parabola or Graph")
    if len(profile.objects) > 1:
        checks.fail("profile", "a single object", str(profile))
    if profile.has_edges:
        raise ValueError(
            f"`profile` must be a profile without edges, such as Parabola, Circle, Ellipse, Graph or Contour, got "
            f"{profile}. In space, use a RoundedBox, or a Capsule for a peg with an end."
        )


def _check_convex(profile: AbstractProfile) -> None:
    """Check that a graph is convex; other profiles without edges are."""
    graph = profile.profile if isinstance(profile, Tilted) else profile
    bends_back = isinstance(graph, Graph) and not checks.is_traced(graph) and _bends_back(graph)
    if not checks.is_traced(bends_back) and bends_back:
        checks.fail("profile", "convex (if it is not, take a Surface with `convex=False`)", str(profile))


@eqx.filter_jit
def _bends_back(profile: AbstractProfile) -> Bool[Array, ""]:
    """Whether a profile is concave somewhere."""
    profile = profile.in_unit(1.0)
    lowest = profile.lowest()

    def bend(p):
        return _bend(profile, _Foot(profile.point(p), jnp.zeros(()), p, jnp.asarray(True)))

    ends = jnp.stack([jnp.asarray(end, dtype=float) for end in profile.ends()])
    bends = jax.vmap(bend)(jnp.ravel(lowest + (ends - lowest)[:, None] * FAR_OUT))
    return jnp.nanmin(bends) < -BENT_BACK * jnp.nanmax(bends)


def _quadric(conic: Conic, around: float) -> Quadric:
    """x^2 + around z^2 = 2 R y - k y^2, relative to the vertex; around = 1 for a solid of revolution, else 0."""
    size, shape = conic.radius, conic.shape
    up = size / jnp.maximum(shape, 1.0)  # the centre of a flat ellipse, the centre of curvature of a steep one
    rise = shape * up / size  # at most 1
    inside = jnp.stack([conic.position, conic.distance + up, jnp.zeros(())])
    matrix = jnp.diag(jnp.stack([jnp.ones(()), shape, jnp.asarray(around)])) / size
    return Quadric(inside, matrix, jnp.zeros(3).at[1].set(rise - 1), up * (1 - rise / 2))


def _misses(unknowns: Float[Array, "1"], known: PyTree) -> Float[Array, "1"]:
    """Distance along the tangent between a point and its foot; an end of the profile stays where it is."""
    profile, x, y, free = known
    along = profile.point(unknowns[0]).along(x, y)
    return jnp.where(free, along, unknowns - jax.lax.stop_gradient(unknowns))


def _search(
    profile: AbstractProfile, lowest: Float[Array, ""], x: Float[Array, ""], y: Float[Array, ""]
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """The parameter of the foot, and whether it is not an end of the profile; by Newton's method or bisection."""

    def along(p):
        at = profile.point(p)
        ahead = at.along(x, y)
        # Outside its domain (NaN), or where its slope overflows, treat the object as ending in a vertical wall.
        known = jnp.isfinite(ahead) & (at.cos**2 + at.sin**2 > 0.5)
        return jnp.where(known, ahead, jnp.where(p < lowest, jnp.inf, -jnp.inf))

    def improve(state):
        low, high, p, last, count = state
        ahead, rate = jax.jvp(along, (p,), (jnp.ones_like(p),))
        low, high = jnp.where(ahead > 0, p, low), jnp.where(ahead > 0, high, p)
        newton = p - ahead / rate
        converges = (newton >= low) & (newton <= high) & (jnp.abs(newton - p) < last / 2)
        better = jnp.where(converges, newton, (low + high) / 2)
        return low, high, better, jnp.abs(better - p), count + 1

    def goes_on(state):
        _, _, p, last, count = state
        return (last > CONVERGED * (1 + jnp.abs(p))) & (count < STEPS)

    # The foot of a point outside is on its side of the lowest point.
    left, right = (jnp.asarray(end, dtype=float) for end in profile.ends())
    on_right = along(lowest) > 0
    end = jnp.where(on_right, right, left)
    ahead = along(end)
    free = jnp.where(on_right, ahead <= 0, ahead >= 0)
    low, high = jnp.minimum(lowest, end), jnp.maximum(lowest, end)
    start = low, high, jnp.where(free, lowest, end), jnp.where(free, high - low, 0.0), jnp.asarray(0)
    low, high, p, _, _ = jax.lax.while_loop(goes_on, improve, start)
    # The profile may end before: where it is no longer defined.
    last, next_one = jnp.where(on_right, low, high), jnp.where(on_right, high, low)
    ends = free & (high - low < 10 * CONVERGED * (1 + jnp.abs(p))) & jnp.isinf(along(next_one))
    return jnp.where(ends, last, p), free & ~ends


def _bend(profile: AbstractProfile, foot: _Foot) -> Float[Array, ""]:
    """Curvature of the curve through a point at a constant distance from the profile."""
    at, rate = jax.jvp(profile.point, (foot.parameter,), (jnp.ones_like(foot.parameter),))
    turn, speed = rate.sin * at.cos - rate.cos * at.sin, rate.x * at.cos + rate.y * at.sin
    return jnp.where(foot.free, turn / (speed + turn * foot.off), 0.0)


def _steepness(unknowns: Float[Array, "1"], known: PyTree) -> Float[Array, "1"]:
    """Difference between the sine of the slope angle and a given one."""
    profile, sine = known
    return profile.point(unknowns[0]).sin[None] - sine


@eqx.filter_jit
def _is_symmetric(profile: AbstractProfile) -> Bool[Array, ""]:
    """Whether both sides have points of the same slopes, and these are equally high."""
    profile = profile.in_unit(1.0)

    def at_slope(slope):
        at = profile.point(profile.at_slope(slope))
        return at, jnp.abs(jnp.arctan2(at.sin, at.cos) - slope) < SYMMETRIC  # False for NaN

    at, is_there = jax.vmap(jax.vmap(at_slope))(jnp.asarray([SLOPES, [-slope for slope in SLOPES]]))
    same = jnp.abs(at.y[0] - at.y[1]) < SYMMETRIC * (at.x[0] - at.x[1])
    return jnp.all(same | ~jnp.any(is_there, axis=0))


def _constant(tree: PyTree) -> PyTree:
    return jax.tree.map(lambda leaf: jax.lax.stop_gradient(leaf) if eqx.is_inexact_array(leaf) else leaf, tree)
