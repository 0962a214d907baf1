"""Clearance: the gap between a shaft and the object, and where two shafts cross.

The gap is the signed distance of a point from the object, negative inside. Between two points of the shaft it is taken
for the cubic with its values and slopes there, whose minimum is known in closed form: a contact between two points is
not overlooked.

A convex object lies on one side of its tangent at the contact. A shaft that stays on the other side is clear of it, and
this is all that most states need. Otherwise the nearest points on the profile are searched for.

Two shafts cross where their cubics do. The pair of chords that cross deepest is the first guess for Newton's method.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.interpolation import Cubic, between
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.shaft import Line, Shaft
from jaxwhisker._model.profile import AbstractProfile, ContactPoint
from jaxwhisker._rod.rod import Along

DEPTH = 2e-5  # least depth of a second contact, in lengths of the first whisker: twice the error of the cubics
NEAREST_ERROR = 1e-5  # distance along the profile from the nearest point; the gap is off by its square
NEAREST_STEPS = 50  # as many as bisection needs; Newton's method needs six
CROSSING_STEPS = 4
CROSSING_ERROR = 1e-9  # distance of two shafts where they cross
OUTSIDE = 0.25  # of a cell: how far a crossing may lie outside the cells whose chords cross


def meets_again(profile: AbstractProfile, own: Shaft) -> Bool[Array, ""]:
    """Whether a shaft dips into the object by more than `DEPTH`."""
    gaps = dips(profile, own.parameter, (own.to_base, own.to_tip))
    return jnp.any(jnp.concatenate(gaps) < jnp.inf)


def dips(profile: AbstractProfile, parameter: Scalar, lines: tuple[Line, ...]) -> list[Float[Array, " cells"]]:
    """The smallest gap in each cell of lines, infinite unless it is inside the object by more than `DEPTH`.

    The lines touch the object at this parameter, or are closest to it there.
    """
    at = profile.point(parameter)
    # Cells on the wrong side of the tangent at the contact, and their points.
    beyond = [_least(line, *_gap(line, at)) < -DEPTH for line in lines]
    wanted = [jnp.append(cells, False) | jnp.append(False, cells) for cells in beyond]
    x, y = (jnp.concatenate([getattr(line, name) for line in lines]) for name in ("x", "y"))
    feet = nearest(profile, parameter, x, y, jnp.concatenate(wanted))
    at, found = jax.vmap(profile.point)(feet), []
    for k, line in enumerate(lines):
        part = slice(lines[0].x.size) if k == 0 else slice(lines[0].x.size, None)
        gap, slope = _gap(line, jax.tree.map(lambda leaf, part=part: leaf[part], at))
        # Where an object ends, there is no nearest point.
        known = jnp.abs(_along(line.x, line.y, jax.tree.map(lambda leaf, part=part: leaf[part], at))) < NEAREST_ERROR
        least = _least(line, gap, slope)
        found.append(jnp.where(beyond[k] & known[:-1] & known[1:] & (least < -DEPTH), least, jnp.inf))
    return found


def _gap(line: Line, at: ContactPoint) -> tuple[Along, Along]:
    """Distances of points from a tangent of the object, or from one each, and their derivatives by arc length."""
    return (line.x - at.x) * at.sin - (line.y - at.y) * at.cos, line.cos * at.sin - line.sin * at.cos


def _along(x: Scalar | Along, y: Scalar | Along, at: ContactPoint) -> Scalar | Along:
    """Distances of points from a point of the object along its tangent."""
    return (x - at.x) * at.cos + (y - at.y) * at.sin


def _least(line: Line, gap: Along, slope: Along) -> Float[Array, " cells"]:
    """The smallest gap in each cell of a line."""
    return between(gap, slope, line.cell).least()


def nearest(
    profile: AbstractProfile, parameter: Scalar, x: Along, y: Along, wanted: Bool[Array, " points"]
) -> Float[Array, " points"]:
    """Parameters of the nearest points on the profile of those points that are wanted.

    Newton's method starts at the contact. It keeps to the interval in which the nearest point is known to lie, and
    bisects that where it would leave it.
    """
    around = profile.around()
    low, high = profile.ends() if around is None else (parameter + s * (around[1] - around[0]) / 2 for s in (-1, 1))

    def step(p, low, high, x, y, searched):
        def offset(p):
            at = profile.point(p)
            return _along(x, y, at)

        value, slope = jax.value_and_grad(offset)(p)
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

    everywhere = jnp.zeros_like(x)
    start = (jnp.asarray(0), *(everywhere + value for value in (parameter, low, high)), wanted)
    return jax.lax.while_loop(searching, newton, start)[1]


def _cells(own: Shaft) -> Cubic:
    """Cells of a shaft from base to tip, (cells, 2)."""

    def part(line: Line, towards_tip: bool) -> Cubic:
        points, directions = jnp.stack([line.x, line.y], -1), jnp.stack([line.cos, line.sin], -1)
        size = jnp.abs(line.cell)[:, None]
        return between(points, directions, size) if towards_tip else between(points[::-1], directions[::-1], size[::-1])

    parts = part(own.to_base, False), part(own.to_tip, True)
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def _cross(a: Float[Array, "... 2"], b: Float[Array, "... 2"]) -> Float[Array, "..."]:
    """The sine of the angle from one vector to another, times their lengths."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def cross(one: Shaft, other: Shaft) -> Bool[Array, ""]:
    """Whether two shafts cross."""
    first, second = _cells(one), _cells(other)
    along, across = (first.end - first.start)[:, None], second.end - second.start
    apart = second.start - first.start[:, None]
    sine = _cross(along, across)
    t, r = _cross(apart, across) / sine, _cross(apart, along) / sine
    off_middle = jnp.maximum(jnp.abs(t - 0.5), jnp.abs(r - 0.5))
    deepest = jnp.argmin(jnp.where(jnp.isfinite(off_middle), off_middle, jnp.inf))
    a, b = jnp.unravel_index(deepest, off_middle.shape)
    one_cell, other_cell = jax.tree.map(lambda leaf: leaf[a], first), jax.tree.map(lambda leaf: leaf[b], second)

    def newton(_, at):
        (p, v), (q, w) = ((cell.value(t), cell.rate(t)) for cell, t in zip((one_cell, other_cell), at, strict=True))
        step = jnp.stack([_cross(q - p, w), _cross(q - p, v)]) / _cross(v, w)
        return at + jnp.where(jnp.isfinite(step), step, 0.0)

    at = jax.lax.fori_loop(0, CROSSING_STEPS, newton, jnp.stack([t[a, b], r[a, b]]))
    miss = one_cell.value(at[0]) - other_cell.value(at[1])
    inside = _inside(at[0], a, first) & _inside(at[1], b, second)
    return inside & (jnp.sum(miss**2) < CROSSING_ERROR**2)


def _inside(t: Scalar, cell: Scalar, cells: Cubic) -> Bool[Array, ""]:
    """Whether a place is on the shaft, at most `OUTSIDE` away from its cell."""
    # The cells beyond a contact at the tip have no length: the last cell need not be the one that ends at the tip.
    size = jnp.sqrt(jnp.sum(cells.leaving**2, axis=-1))
    place = jnp.sum(jnp.where(jnp.arange(size.size) < cell, size, 0.0)) + t * size[cell]
    return (jnp.abs(t - 0.5) <= 0.5 + OUTSIDE) & (place >= 0) & (place <= jnp.sum(size))
