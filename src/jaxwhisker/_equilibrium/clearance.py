"""Clearance: the least gap between a whole shaft and an object.

The gap is the signed distance of a point from the object, negative inside. A convex object lies on one side of its
tangent at the contact. A shaft that stays on the other side is clear of it, and this is all that most states need.
Otherwise the nearest points on the profile are searched for.

Between two points, a straight shaft cannot be nearer to a convex object than the tangents of the gap at both points
allow; a bent one may be nearer by a known amount. Where this bound is below the limit, as at a sharp corner between the
points, the gap is computed there as well, until it is certain.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, ContactPoint
from jaxwhisker._rod.rod import Along

DEPTH = 2e-5  # least depth of a second contact, in lengths of the first whisker: twice the error of the cubics
CERTAIN = 1e-8  # largest difference between the least gap that was computed and the bound
MOST_CUTS = 60  # few are needed, except by a shaft that touches an object along many cells
NEAREST_ERROR = 1e-5  # distance along the profile from the nearest point; the gap is off by its square
NEAREST_STEPS = 50  # as many as bisection needs; Newton's method needs six
TANGENT_STEPS = 2  # along the profile, which come close to the nearest point where a shaft is close to the object
PARTS = 2  # of each cell, in which gaps from turning tangents are cubics
LARGEST_TURN = 0.3  # sine of the angle between the tangents at both ends of a part; its cubic is off by less than 1e-6
TANGENTS = 16  # of a closed object, from one of which Newton's method starts


class _GapPlace(NamedTuple):
    """A place in a cell, the gap there, and its derivative by the place."""

    t: Float[Array, "*cells"]
    gap: Float[Array, "*cells"]
    slope: Float[Array, "*cells"]


class _CellParts(NamedTuple):
    """The parts of cells in which the shaft may come nearest."""

    start: _GapPlace
    end: _GapPlace
    bend: Float[Array, " cells"]  # how far at most a whole cell leaves the tangent at one of its ends

    def lowest(self) -> tuple[Float[Array, " cells"], Float[Array, " cells"]]:
        """Where the tangents of the gap at both ends meet, and a lower bound of the gap."""
        (low, gap, leaving), (high, end_gap, arriving) = self.start, self.end
        turns, size = (leaving < 0) & (arriving > 0), high - low
        share = jnp.where(
            turns, (end_gap - gap - arriving * size) / jnp.where(turns, leaving - arriving, 1.0), size / 2
        )
        bound = jnp.where(turns, gap + leaving * share, jnp.minimum(gap, end_gap))
        return low + share, bound - self.bend * size**2

    def least(self) -> Float[Array, ""]:
        """The least gap that was computed."""
        return jnp.min(jnp.minimum(self.start.gap, self.end.gap))


def clear_of_tangent(profile: AbstractProfile, cells: Cubic, parameter: Scalar) -> Bool[Array, " cells"]:
    """Whether cells of a shaft do not dip below the object's tangent at a parameter by more than `DEPTH`."""
    at = profile.point(parameter)
    off = at.off(*_points(cells).T)
    leaving, arriving = (x * at.sin - y * at.cos for x, y in (cells.leaving.T, cells.arriving.T))
    return Cubic(off[:-1], off[1:], leaving, arriving).least() >= -DEPTH


def clear_of_tangents(profile: AbstractProfile, cells: Cubic, parameter: Scalar) -> Bool[Array, ""]:
    """Whether a shaft stays outside of tangents that turn with it, which proves that it is clear of the object.

    The object is on the inner side of each of its tangents. A shaft that touches it at this parameter, and curves
    towards it there, is compared with the tangents near the nearest points. It may be clear even if this is false.
    """
    points = _points(cells)

    def off(parameter: Scalar, x: Array, y: Array) -> tuple[Array, ContactPoint]:
        at = profile.point(parameter)
        return at.off(x, y), at

    def closer(_, p: Float[Array, " points"]) -> Float[Array, " points"]:
        at, rates = jax.jvp(jax.vmap(profile.point), (p,), (jnp.ones_like(p),))
        turn = at.cos * rates.sin - at.sin * rates.cos
        radius = (rates.x * at.cos + rates.y * at.sin) / turn
        return p + jnp.arctan2(at.along(*points.T), radius + at.off(*points.T)) / turn  # exact for a circle

    near = jnp.clip(jax.lax.fori_loop(0, TANGENT_STEPS, closer, jnp.full(points.shape[0], parameter)), *profile.span())
    t = jnp.arange(PARTS + 1)[:, None] / PARTS
    change = near[1:] - near[:-1]
    place, rate = cells.value(t[..., None]), cells.rate(t[..., None])
    gap, slope, at = jax.vmap(jax.vmap(lambda *own: jax.jvp(off, own[:3], own[3:], has_aux=True)))(
        near[:-1] + t * change,
        *jnp.moveaxis(place, -1, 0),
        jnp.broadcast_to(change, t.shape[:1] + change.shape),
        *jnp.moveaxis(rate, -1, 0),
    )
    least = Cubic(gap[:-1], gap[1:], slope[:-1] / PARTS, slope[1:] / PARTS).least()
    turn = jnp.abs(at.sin[1:] * at.cos[:-1] - at.cos[1:] * at.sin[:-1])
    smooth = (turn < LARGEST_TURN) & (at.cos[1:] * at.cos[:-1] + at.sin[1:] * at.sin[:-1] > 0)
    far = jnp.maximum(gap[:-1], gap[1:]) > jnp.linalg.norm(cells.leaving, axis=1) / PARTS
    return jnp.all(far | (smooth & (least >= -DEPTH)))


def _points(cells: Cubic) -> Float[Array, "points 2"]:
    return jnp.append(cells.start, cells.end[-1:], axis=0)


def least_gap(
    profile: AbstractProfile,
    cells: Cubic,
    parameter: Scalar,
    here: Bool[Array, ""] | None = None,
    *,
    enough: float = -jnp.inf,
) -> Float[Array, ""]:
    """The least gap of a shaft whose cells follow one another, exact only if it is below `-DEPTH`; no derivatives.

    A gap below `enough` ends the search.

    The shaft touches the object at this parameter, or is closest to it there. If `here` is false, it does not
    touch it, and this is the parameter of the lowest point.
    """
    profile, cells, parameter, here = jax.lax.stop_gradient((profile, cells, parameter, here))
    points = _points(cells)
    searched = ~clear_of_tangent(profile, cells, parameter)
    if here is not None:
        above = points[:, 1] > profile.vertex()[1]
        searched = jnp.where(here, searched, above[:-1] | above[1:])
    gap, normal = _gaps(profile, points, parameter, jnp.append(searched, False) | jnp.append(False, searched))
    zero, bend = jnp.zeros(gap.size - 1), jnp.linalg.norm(cells.arriving - cells.leaving, axis=1) / 2
    start = _GapPlace(zero, jnp.where(searched, gap[:-1], jnp.inf), jnp.sum(cells.leaving * normal[:-1], axis=1))
    end = _GapPlace(zero + 1, jnp.where(searched, gap[1:], jnp.inf), jnp.sum(cells.arriving * normal[1:], axis=1))

    def goes_on(carry) -> Bool[Array, ""]:
        section, cuts = carry
        bound = jnp.min(section.lowest()[1])
        least = section.least()
        return (bound < -DEPTH) & (bound < least - CERTAIN) & (least >= enough) & (cuts < MOST_CUTS)

    def cut(carry):
        section, cuts = carry
        t, bound = section.lowest()
        k = jnp.argmin(bound)
        # Tangents alone might always cut off the same side.
        t = jnp.where(cuts % 2 == 1, (section.start.t + section.end.t) / 2, t)
        cell, t = jax.tree.map(lambda leaf: leaf[k], (cells, t))
        gap, normal = _gaps(profile, cell.value(t)[None], parameter, jnp.ones(1, bool))
        place = _GapPlace(t, gap[0], jnp.sum(cell.rate(t) * normal[0]))

        def renewed(places: _GapPlace, renew: Bool[Array, ""]) -> _GapPlace:
            return jax.tree.map(lambda old, new: old.at[k].set(jnp.where(renew, new, old[k])), places, place)

        falls = place.slope < 0
        return _CellParts(renewed(section.start, falls), renewed(section.end, ~falls), section.bend), cuts + 1

    return jax.lax.while_loop(goes_on, cut, (_CellParts(start, end, bend), jnp.asarray(0)))[0].least()


def _gaps(
    profile: AbstractProfile, points: Float[Array, "points 2"], near: Scalar, wanted: Bool[Array, " points"]
) -> tuple[Float[Array, " points"], Float[Array, "points 2"]]:
    """Gaps of points, and the outward normals of the object there; infinite if not wanted."""
    x, y = points.T
    faces = profile.faces()
    if faces is not None:  # the farthest face bounds the gap, and is the nearest one of a point inside
        gaps = faces.off(x[:, None], y[:, None])
        return jnp.where(wanted, jnp.max(gaps, axis=1), jnp.inf), faces.normal[jnp.argmax(gaps, axis=1)]
    at = jax.vmap(profile.point)(nearest(profile, near, x, y, wanted))
    # Where an object ends, there is no nearest point.
    known = wanted & (jnp.abs(at.along(x, y)) < NEAREST_ERROR)
    return jnp.where(known, at.off(x, y), jnp.inf), jnp.where(known[:, None], at.normal, 0.0)


def nearest(
    profile: AbstractProfile, parameter: Scalar, x: Along, y: Along, wanted: Bool[Array, " points"]
) -> Float[Array, " points"]:
    """Parameters of the nearest points on the profile of those points that are wanted.

    Newton's method keeps to the interval in which the nearest point is known to lie, and bisects that where it would
    leave it. It starts at the contact or, on a closed object, at the tangent that is farthest below a point: at other
    places, on the far side of a flat object, a point that is outside may seem to be inside.
    """
    (low, high), everywhere = profile.span(), jnp.zeros_like(x)
    closed = jnp.asarray(profile.closed)
    size = (high - low) / TANGENTS
    guesses = parameter + size * (jnp.arange(TANGENTS) - TANGENTS // 2)
    at = jax.vmap(profile.point)(jnp.where(closed, guesses, parameter))
    farthest = jnp.argmax(at.off(x[:, None], y[:, None]), axis=1)
    start = jnp.where(closed & wanted, guesses[farthest], parameter)
    low, high = (jnp.where(closed, start + way * size, everywhere + end) for way, end in ((-1, low), (1, high)))

    def step(p, low, high, x, y, searched):
        value, slope = jax.jvp(lambda p: profile.point(p).along(x, y), (p,), (jnp.ones_like(p),))
        # Outside its domain (NaN) the object has ended.
        ahead = jnp.where(jnp.isfinite(value), value > 0, p < parameter)
        low, high = jnp.where(ahead, p, low), jnp.where(ahead, high, p)
        new = p - value / slope
        new = jnp.where((new > low) & (new < high), new, (low + high) / 2)
        searched &= ~(jnp.abs(value) < NEAREST_ERROR)
        return jnp.where(searched, new, p), low, high, searched

    def newton(carry):
        count, p, low, high, searched = carry
        return count + 1, *jax.vmap(step)(p, low, high, x, y, searched)

    def searching(carry):
        return jnp.any(carry[-1]) & (carry[0] < NEAREST_STEPS)

    begin = jnp.asarray(0), start, low, high, wanted
    return jax.lax.while_loop(searching, newton, begin)[1]
