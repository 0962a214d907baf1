"""Gaps between a shaft and objects, and the contacts that begin where they close.

Along the shaft, the gap to an object has a minimum at each contact. All other minima are candidates for a new contact,
and so is the tip. Minima lie where the rate of the gap along the shaft changes its sign; the lowest one of each object
is then solved for.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.polygons import SHALLOW, AtFace, at_corner, faces_of, nearest_face, of_corners
from jaxwhisker._chain.shaft import WholeShaft, cell_of
from jaxwhisker._chain.valleys import GapAlong, gap_facing, lowest_valley
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.objects import Objects, of_each_object
from jaxwhisker._model.polygon_chain import PolygonChain
from jaxwhisker._model.profile import AbstractProfile, ContactPoint

FAR = jnp.inf
TABLE = 72  # points of an object from which the nearest one is looked for
NEAREST_STEPS = 3
ENDS = 2e-4  # share of an outline that is left out at both ends
LOWEST_STEPS = 4
INSIDE = 1e3  # puts corners that are inside before all others
BIAS = 2e-10  # lengths by which gaps are changed to decide between corners, and between a corner and the tip


class Candidate(NamedTuple):
    """A contact that would begin if its gap closed; fields (*batch,)."""

    gap: Float[Array, "*batch"]  # negative inside
    numbers: Float[Array, "*batch 3"]  # of the contact that would begin, without force
    phase: Int[Array, "*batch"]
    side: Float[Array, "*batch"]
    piece: Int[Array, "*batch"]


class Gaps(NamedTuple):
    """The candidates of a whisker, and its distance from the objects."""

    candidates: Candidate  # fields (candidates,)
    distance: Scalar  # least distance of any point from any object
    base: Scalar  # distance of the base; negative inside an object


def gaps_of(profile: Objects, shaft: WholeShaft, reach: Scalar) -> Gaps:
    """The candidates for new contacts of a shaft: for each object one on the shaft, one at the tip and one at corners.

    `reach` is the length of the whisker.
    """

    def of_one(one, first):
        is_polygon = isinstance(one, PolygonChain)
        found = _of_polygon(one, first, shaft) if is_polygon else _of_smooth(one, first, shaft, reach)
        candidates, distance, base = found
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *candidates), distance, base

    candidates, distance, base = zip(*of_each_object(profile, of_one), strict=True)
    return Gaps(
        jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *candidates),
        jnp.min(jnp.stack(distance)),
        jnp.min(jnp.stack(base)),
    )


class ObjectOutline(NamedTuple):
    """Points of a smooth object, from which the nearest one to a point is looked for."""

    parameters: Float[Array, " table"]
    x: Float[Array, " table"]
    y: Float[Array, " table"]
    spacing: Scalar


def outline_of(one: AbstractProfile, x: Scalar, y: Scalar, reach: Scalar) -> ObjectOutline:
    """Points of an object that may be within reach of a point."""
    low, high = one.around(x, y, reach)
    # Where a closed outline ends, conic sections lose their digits.
    low, high = low + ENDS * (high - low), high - ENDS * (high - low)
    parameters = low + (high - low) * jnp.asarray(np.arange(TABLE + 1) / TABLE)
    at = jax.vmap(one.point)(parameters)
    return ObjectOutline(parameters, at.x, at.y, (high - low) / TABLE)


def nearest(one: AbstractProfile, outline: ObjectOutline, x: Scalar, y: Scalar) -> Float[Array, ""]:
    """The parameter of the point of an object that is nearest to a point close to it."""
    apart = (outline.x - x) ** 2 + (outline.y - y) ** 2
    apart = jnp.where(jnp.isfinite(apart), apart, jnp.inf)
    closest = jnp.argmin(apart)
    start, spacing = outline.parameters[closest], outline.spacing
    facing = one.facing(x, y)
    if facing is not None:
        # Waves may be shorter than the spacing.
        at = one.point(facing)
        start = jnp.where((at.x - x) ** 2 + (at.y - y) ** 2 < apart[closest], facing, start)

    def step(_, within):
        p, low, high = within
        at, rate = jax.jvp(one.point, (p,), (jnp.ones_like(p),))
        speed = rate.x * at.cos + rate.y * at.sin
        slope = -speed + (x - at.x) * rate.cos + (y - at.y) * rate.sin
        along = at.along(x, y)
        low, high = jnp.where(along > 0, p, low), jnp.where(along > 0, high, p)
        p = p - along / slope
        # Far inside a hollow, or beyond a crest, Newton's method leads away from the nearest point.
        return jnp.where((slope < 0) & (p >= low) & (p <= high), p, (low + high) / 2), low, high

    ends = outline.parameters[0], outline.parameters[-1]
    within = start, *(jnp.clip(start + way, *ends) for way in (-spacing, spacing))
    return jax.lax.fori_loop(0, NEAREST_STEPS, step, within)[0]


def _of_smooth(
    one: AbstractProfile, first: Int[Array, ""], shaft: WholeShaft, reach: Scalar
) -> tuple[list[Candidate], Scalar, Scalar]:
    outline = outline_of(one, shaft.x[-1, -1], shaft.y[-1, -1], 1.5 * reach)
    spacing = outline.spacing
    found = jax.vmap(jax.vmap(lambda x, y: nearest(one, outline, x, y)))(shaft.x, shaft.y)
    at = jax.vmap(jax.vmap(one.point))(found)
    gap = jax.vmap(jax.vmap(ContactPoint.off))(at, shaft.x, shaft.y)
    normal_x, normal_y = at.sin, -at.cos
    # Beyond an end of the object, the end itself is nearest.
    right, up = shaft.x - at.x, shaft.y - at.y
    past = (found <= outline.parameters[0]) | (found >= outline.parameters[-1])
    apart = jnp.where(past, jnp.hypot(right, up), 1.0)
    past &= apart > 0
    gap = jnp.where(past, apart, gap)
    normal_x, normal_y = jnp.where(past, right / apart, normal_x), jnp.where(past, up / apart, normal_y)
    # By the arc length towards the base.
    rate = -(shaft.cos * normal_x + shaft.sin * normal_y)
    beside = gap_facing(one, shaft)
    along = GapAlong(gap, rate, shaft.beyond) if beside is None else beside
    lowest = lowest_valley(along, shaft.x.shape[1] - 1, shaft.starts == first, shaft.ends == first)
    segment, index, t0 = lowest.segment, lowest.index, lowest.share
    cell = cell_of(shaft, segment, index)

    def stationary(unknowns):
        t, p = unknowns
        at, (x, y) = one.point(p), cell.point(t)
        dx, dy = cell.direction(t)
        return jnp.stack([(dx * at.sin - dy * at.cos) / cell.length, at.along(x, y)])

    def newton(_, unknowns):
        (a, b), (c, d) = jax.jacfwd(stationary)(unknowns)
        e, f = stationary(unknowns)
        step = jnp.stack([d * e - b * f, a * f - c * e]) / (a * d - b * c)
        return unknowns - jnp.where(jnp.isfinite(step), step, 0.0)

    p0 = (1 - t0) * found[segment, index] + t0 * found[segment, index + 1]
    room = 3 * spacing + jnp.abs(found[segment, index] - p0)
    if beside is not None:
        p0, room = nearest(one, outline, *cell.point(t0)), 3 * spacing
    t, p = jax.lax.fori_loop(0, LOWEST_STEPS, newton, jnp.stack([t0, p0]))
    astray = ~((jnp.abs(t - t0) < lowest.width) & (jnp.abs(p - p0) < room))
    t, p = jnp.where(astray, t0, t), jnp.where(astray, p0, p)
    there, (x, y), (dx, dy) = one.point(p), cell.point(t), cell.direction(t)
    piece = first
    on_shaft = Candidate(
        jnp.where(lowest.some, there.off(x, y), FAR),
        jnp.stack([jnp.zeros(()), p, cell.beyond + t * cell.length]),
        jnp.asarray(int(Phase.tangential)),
        jnp.where(dx * there.cos + dy * there.sin > 0, -1.0, 1.0),
        piece,
    )
    tip = jax.tree.map(lambda leaf: leaf[0, 0], at)
    into, along = rate[0, 0], shaft.cos[0, 0] * tip.cos + shaft.sin[0, 0] * tip.sin
    # Where the tip points away from the object, a point behind it is nearer.
    touches_there = (shaft.starts[1] >= 0) & (shaft.beyond[1, 0] <= 0)
    at_tip = Candidate(
        jnp.where((into > 0) & ~touches_there & ~past[0, 0], gap[0, 0], FAR),
        jnp.stack([jnp.zeros(()), found[0, 0], -jnp.arctan2(into, jnp.abs(along))]),
        jnp.asarray(int(Phase.tip)),
        jnp.where(along < 0, -1.0, 1.0),
        piece,
    )
    return [on_shaft, at_tip], jnp.min(gap), gap[-1, -1]


def _of_polygon(one: PolygonChain, first: Int[Array, ""], shaft: WholeShaft) -> tuple[list[Candidate], Scalar, Scalar]:
    faces = faces_of(one)
    near = jax.vmap(jax.vmap(lambda x, y: nearest_face(faces, x, y)))(shaft.x, shaft.y)
    corners, distance = _past_corners(one, first, shaft)
    candidates = [_along_faces(one, first, shaft), _tip_at_face(one, first, shaft, near), corners]
    return candidates, jnp.minimum(jnp.min(near.distance), distance), jnp.asarray(near.distance)[-1, -1]


def _tip_at_face(one: PolygonChain, first: Int[Array, ""], shaft: WholeShaft, near: AtFace) -> Candidate:
    """The tip, before the nearest face."""
    faces, tip = faces_of(one), jax.tree.map(lambda leaf: leaf[0, 0], near)
    cos, sin = faces.cos[tip.number], faces.sin[tip.number]
    into, along = shaft.sin[0, 0] * cos - shaft.cos[0, 0] * sin, shaft.cos[0, 0] * cos + shaft.sin[0, 0] * sin
    touches_there = (shaft.starts[1] >= 0) & (shaft.beyond[1, 0] <= 0)
    may_touch = faces.touchable[tip.number] & (into > 0) & ~touches_there
    start = one.start[jnp.minimum(2 * tip.number + 1, one.start.size - 1)]
    return Candidate(
        jnp.where(may_touch, tip.distance + BIAS, FAR),
        jnp.stack([jnp.zeros(()), start + tip.along, -jnp.arctan2(into, jnp.abs(along))]),
        jnp.asarray(int(Phase.tip)),
        jnp.where(along < 0, -1.0, 1.0),
        first + 2 * tip.number + 1,
    )


def _past_corners(one: PolygonChain, first: Int[Array, ""], shaft: WholeShaft) -> tuple[Candidate, Scalar]:
    """The corner that is nearest to the shaft, of those that it may touch, and the distance of the nearest one."""
    faces = faces_of(one)

    def of_corner(k):
        right, up = one.xy[k, 0] - shaft.x, one.xy[k, 1] - shaft.y
        along = right * shaft.cos + up * shaft.sin
        passes = (along[:, :-1] < 0) & (along[:, 1:] >= 0)
        share = along[:, :-1] / jnp.where(passes, along[:, :-1] - along[:, 1:], 1.0)
        apart = jnp.abs(right * shaft.sin - up * shaft.cos)
        apart = jnp.where(passes, (1 - share) * apart[:, :-1] + share * apart[:, 1:], FAR)
        index = jnp.argmin(apart)
        cell, start = cell_of(shaft, index // apart.shape[1], index % apart.shape[1]), jnp.ravel(share)[index]

        def step(_, t):
            (x, y), (dx, dy) = cell.point(t), cell.direction(t)
            return t + ((one.xy[k, 0] - x) * dx + (one.xy[k, 1] - y) * dy) / (dx**2 + dy**2)

        t = jnp.clip(jax.lax.fori_loop(0, LOWEST_STEPS, step, start), 0.0, 1.0)
        (x, y), (dx, dy) = cell.point(t), cell.direction(t)
        size = jnp.hypot(dx, dy)
        at = at_corner(one, faces, k, x, y, -dx / size, -dy / size)
        some = jnp.isfinite(jnp.min(apart)) & at.meets & ~jnp.any(shaft.starts == first + 2 * k)
        gap = jnp.where(some, at.gap, FAR)
        numbers = jnp.stack([jnp.zeros(()), at.parameter, cell.beyond + t * cell.length])
        apart = jnp.hypot(one.xy[k, 0] - x, one.xy[k, 1] - y)
        return gap, numbers, at.side, jnp.where(jnp.isfinite(jnp.min(jnp.where(passes, 0.0, FAR))), apart, FAR)

    gap, numbers, side, apart = of_corners(one, of_corner)
    # A shaft that meets a flank touches it all at once: first at the corner that is nearest to the base.
    # If the shaft is inside, it has come in past the corner to which it is nearest.
    order = jnp.where(gap < 0, -gap - INSIDE, gap) - BIAS * numbers[:, 2]
    k = jnp.argmin(jnp.where(jnp.isfinite(gap), order, FAR))
    found = Candidate(gap[k], numbers[k], jnp.asarray(int(Phase.tangential)), side[k], first + 2 * k)
    return found, jnp.min(apart)


def _along_faces(one: PolygonChain, first: Int[Array, ""], shaft: WholeShaft) -> Candidate:
    """The point of the shaft that is nearest to a face to which it is parallel there."""
    faces = faces_of(one)

    def of_face(k):
        cos, sin = faces.cos[k], faces.sin[k]
        gap = (shaft.x - faces.x[k]) * sin - (shaft.y - faces.y[k]) * cos
        rate = -(shaft.cos * sin - shaft.sin * cos)
        last, piece = jnp.arange(gap.shape[1] - 1) == gap.shape[1] - 2, first + 2 * k + 1
        starts, ends = shaft.starts == piece, shaft.ends == piece
        falls = jnp.where(starts[:, None] & (jnp.arange(gap.shape[1] - 1) == 0), 1.0, rate[:, :-1]) < 0
        rises = jnp.where(ends[:, None] & last, -1.0, rate[:, 1:]) > 0
        lengths = shaft.beyond[:, 1:] - shaft.beyond[:, :-1]
        cubic = Cubic(gap[:, :-1], gap[:, 1:], lengths * rate[:, :-1], lengths * rate[:, 1:])
        share = cubic.valley()
        right, up = shaft.x - faces.x[k], shaft.y - faces.y[k]
        along = right * cos + up * sin
        along = (1 - share) * along[:, :-1] + share * along[:, 1:]
        valleys = jnp.where(falls & rises & (along > 0) & (along < faces.length[k]), cubic.value(share), FAR)
        index = jnp.argmin(jnp.where(valleys > -SHALLOW, valleys, FAR))
        cell = cell_of(shaft, index // valleys.shape[1], index % valleys.shape[1])

        def step(_, t):
            slope = cell.direction(t)[0] * sin - cell.direction(t)[1] * cos
            bend = jax.jvp(cell.direction, (t,), (jnp.ones_like(t),))[1]
            rise = bend[0] * sin - bend[1] * cos
            return jnp.clip(t - slope / jnp.where(rise == 0, 1.0, rise), 0.0, 1.0)

        t = jax.lax.fori_loop(0, LOWEST_STEPS, step, jnp.ravel(share)[index])
        (x, y), (dx, dy) = cell.point(t), cell.direction(t)
        there = (x - faces.x[k]) * sin - (y - faces.y[k]) * cos
        place = (x - faces.x[k]) * cos + (y - faces.y[k]) * sin
        some = (jnp.ravel(valleys)[index] > -SHALLOW) & (place >= 0) & (place <= faces.length[k])
        start = one.start[jnp.minimum(2 * k + 1, one.start.size - 1)]
        return (
            jnp.where(some & faces.touchable[k] & jnp.isfinite(jnp.ravel(valleys)[index]), there, FAR),
            jnp.stack([jnp.zeros(()), start + place, cell.beyond + t * cell.length]),
            jnp.where(dx * cos + dy * sin > 0, -1.0, 1.0),
        )

    gap, numbers, side = of_corners(one, of_face)
    k = jnp.argmin(gap)
    return Candidate(gap[k], numbers[k], jnp.asarray(int(Phase.tangential)), side[k], first + 2 * k + 1)
