"""The gap between a moving whisker and the object: the points of both that are closest to each other."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.first_order import first_order
from jaxwhisker._dynamics.legendre import Basis, weights_at
from jaxwhisker._dynamics.outline import number_of, samples
from jaxwhisker._model.profile import AbstractProfile, ContactPoint


class Gap(NamedTuple):
    """A point of a whisker and a point of the object; they are closest if `foot` and `end` vanish."""

    distance: Float[Array, ""]  # along the object's normal, positive outside
    foot: Float[Array, ""]  # distance along the object's tangent
    end: Float[Array, ""]  # arc length beyond the point, or decrease of the gap with the arc length on the shaft
    at_tip: Float[Array, ""]  # positive if the tip is the closest point, negative if a point of the shaft is
    normal: Float[Array, "2"]  # of the object, outward
    across: Float[Array, " points"]  # derivative of the gap by the angles at the Gauss points
    tangent: Float[Array, "2"]  # of the object
    along: Float[Array, " points"]  # derivative of the position along the tangent by the angles
    object: ContactPoint


class Posed(NamedTuple):
    """A whisker in one pose, and the object."""

    basis: Basis
    profile: AbstractProfile
    length: Scalar
    base: Float[Array, "2"]
    angle: Float[Array, " points"]


def gap_at(posed: Posed, arc: Scalar, parameter: Scalar) -> Gap:
    """The gap between the whisker at a fraction `arc` of its length and the object at a parameter."""
    cos, sin = jnp.cos(posed.angle), jnp.sin(posed.angle)
    weights, bends = with_rate(lambda arc: weights_at(posed.basis, arc), arc)
    at, moves = with_rate(posed.profile.point, parameter)
    turned = jnp.stack([cos, sin], axis=-1)
    direction, way = weights @ turned
    normal, tangent = at.normal, jnp.stack([at.cos, at.sin])
    reach = posed.length * weights[1]
    apart = posed.base + posed.length * way - jnp.stack([at.x, at.y])
    closes = -normal @ direction
    beyond = 1 - arc
    distance, foot = apart @ normal, apart @ tangent
    inner = (closes < beyond) & _is_least(at, moves, direction, bends[0] @ turned / posed.length, distance)
    if posed.profile.has_edges:
        # On an edge, the derivative of `foot` by the parameter is minus the distance. Newton's method needs one that
        # neither vanishes in contact nor changes its sign inside the object.
        turn = at.cos * moves.sin - at.sin * moves.cos
        steeper = turn * (jnp.maximum(jnp.abs(distance), LEAST) - distance)
        foot = foot - jax.lax.stop_gradient(steeper) * (parameter - jax.lax.stop_gradient(parameter))
    return Gap(
        distance=distance,
        foot=foot,
        end=jnp.where(inner, closes, beyond),
        at_tip=jnp.where(inner, closes - beyond, jnp.abs(closes - beyond)),
        normal=normal,
        across=reach * (normal[1] * cos - normal[0] * sin),
        tangent=tangent,
        along=reach * (tangent[1] * cos - tangent[0] * sin),
        object=at,
    )


def with_rate(function: Callable[[Scalar], Any], at: Scalar) -> tuple[Any, Any]:
    """Values and their derivative, which is computed once instead of in all directions; exact to first order."""
    at = first_order(jnp.asarray(at))
    here = jax.lax.stop_gradient(at)
    values, rates = jax.jvp(function, (here,), (jnp.ones_like(here),))
    return jax.tree.map(lambda value, rate: value + rate * (at - here), values, rates), rates


def _is_least(at: ContactPoint, moves: ContactPoint, direction: Array, bend: Array, gap: Scalar) -> Bool[Array, ""]:
    """Whether the gap, as a function of the arc length, has a minimum where it is stationary; otherwise the tip counts.

    A whisker that vibrates may be bent towards the object more than the object is curved. `moves` is the derivative of
    the object's point by its parameter, `bend` that of the whisker's direction by the arc length.
    """
    turn, speed = at.cos * moves.sin - at.sin * moves.cos, jnp.hypot(moves.x, moves.y)
    along = at.cos * direction[0] + at.sin * direction[1]
    return (at.sin * bend[0] - at.cos * bend[1]) * (speed + turn * jnp.maximum(gap, 0.0)) + turn * along**2 > 0


CLOSEST = 1e-7  # accepted residual of closest points
MOST = 0.2  # largest change of the closest points in one iteration
SAMPLES = 33  # points of the whisker, for the first guess of the closest point
PARAMETERS = 257  # points of each object, likewise
LEAST = 1e-9  # distance from an edge below which its tangent is not iterated
TIES = 1e-6  # weight of the normal distance among points of the object that are equally close
ITERATIONS = 12  # of Newton's method from the first guess
FOLLOWING = 3  # of Newton's method from points that were the closest one step before

Points = tuple[Float[Array, ""], Float[Array, ""]]  # fraction of the length, parameter of the object


def followed(posed: Posed, arc: Scalar, parameter: Scalar) -> tuple[Points, Bool[Array, ""]]:
    """The closest points near these, and whether they were found; without derivatives."""
    return _improved(posed, jnp.stack([arc, parameter]), FOLLOWING)


class _Sampled(NamedTuple):
    """Points of a whisker, and of all objects."""

    arcs: Float[Array, " samples"]
    parameters: Float[Array, " parameters"]
    nearest: Int[Array, " samples"]  # parameter of the closest point of each, an index
    distance: Float[Array, " samples"]  # along its normal


def _sampled(posed: Posed, but: Float[Array, ""] | None = None) -> _Sampled:
    """Samples of the whisker and of the objects, without that with the parameter `but`."""
    basis, profile, length, base, angle = posed
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    arcs = jnp.linspace(1 / SAMPLES, 1.0, SAMPLES)
    reach = length * jax.vmap(lambda s: weights_at(basis, s)[1])(arcs)
    x, y = base[0] + reach @ cos, base[1] + reach @ sin
    parameters = samples(profile, PARAMETERS)
    at = jax.vmap(profile.point)(parameters)
    distance = jnp.hypot(x[:, None] - at.x, y[:, None] - at.y)
    # On an edge, all tangents have the same point: that counts whose normal leads to the whisker.
    off = at.off(x[:, None], y[:, None])
    sought = jnp.where(jnp.isfinite(distance), distance - TIES * off, jnp.inf)
    if but is not None:
        sought = jnp.where(number_of(profile, parameters) == number_of(profile, but), jnp.inf, sought)
    nearest = jnp.argmin(sought, axis=1)
    return _Sampled(arcs, parameters, nearest, jnp.take_along_axis(off, nearest[:, None], axis=1)[:, 0])


def others_distance(posed: Posed, parameter: Float[Array, ""]) -> Float[Array, ""]:
    """The distance of all objects but that with this parameter, approximately; without derivatives."""
    return jnp.min(_sampled(posed, parameter).distance)


def closest(posed: Posed) -> Points:
    """The closest points from scratch, without derivatives."""
    (first, last), (arcs, parameters, nearest, distance) = posed.profile.span(), _sampled(posed)
    k = jnp.argmin(distance)

    def improve_foot(_, parameter):
        value, slope = jax.value_and_grad(lambda parameter: gap_at(posed, arcs[k], parameter).foot)(parameter)
        return jnp.clip(parameter - jnp.clip(value / slope, -MOST, MOST), first, last)

    # A whisker may have several points with a least gap, or none but the tip: then the sample is good enough.
    sample = jnp.stack([arcs[k], jax.lax.fori_loop(0, ITERATIONS, improve_foot, parameters[nearest[k]])])
    exact, found = _improved(posed, sample, ITERATIONS)
    better = found & (jnp.abs(exact[0] - sample[0]) < MOST)
    arc, parameter = jax.lax.stop_gradient(jnp.where(better, jnp.stack(exact), sample))
    return arc, parameter


def _improved(posed: Posed, guess: Float[Array, "2"], iterations: int) -> tuple[Points, Bool[Array, ""]]:
    """Closest points by Newton's method, and whether it has converged."""
    first, last = posed.profile.span()

    def equations(guess):
        gap = gap_at(posed, *guess)
        return jnp.stack([gap.end, gap.foot])

    def improve(_, guess):
        value, slope = equations(guess), jax.jacfwd(equations)(guess)
        change = jnp.clip(solve(slope, value[:, None])[:, 0], -MOST, MOST)
        return jnp.clip(guess - change, jnp.stack([0.0, first]), jnp.stack([1.0, last]))

    arc, parameter = exact = jax.lax.fori_loop(0, iterations, improve, guess)
    return (arc, parameter), jnp.all(jnp.abs(equations(exact)) < CLOSEST)
