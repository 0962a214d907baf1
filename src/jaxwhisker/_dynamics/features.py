"""Gaps between a moving whisker that may have several contacts and the features of objects: curves, corners and faces.

With one contact, an outline is one curve that turns at its corners, and the closest point runs along it. Where a
whisker touches a polygon twice, a corner and the face beside it may both be near, and each has a minimum of its own.

At a corner, the object is where it is behind both faces; at an inner corner, it is where it is behind one of them. The
outline therefore consists of convex stretches, which inner corners separate. The tip meets the outermost face of each
stretch, and in an inner corner it touches one of each.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.gaps import Candidate
from jaxwhisker._chain.polygons import corner_signs, faces_of
from jaxwhisker._chain.shaft import WholeShaft
from jaxwhisker._dynamics.gap import Gap, Posed, gap_at, with_rate
from jaxwhisker._dynamics.legendre import weights_at
from jaxwhisker._dynamics.outline import ObjectChain
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.objects import numbered
from jaxwhisker._model.polygon_chain import PolygonChain
from jaxwhisker._model.profile import ContactPoint

AT_TIP = 1e-6  # share of the length beyond contacts at the tip


def gap_on(posed: Posed, piece: Int[Array, ""], arc: Scalar, parameter: Scalar) -> Gap:
    """The gap between the whisker at a fraction `arc` of its length and a piece of an object.

    Of a corner, `foot` gives the parameter the direction of the whisker.
    """
    profile = posed.profile
    assert isinstance(profile, ObjectChain)
    if not profile.has_edges:
        return gap_at(posed, arc, parameter)
    number, gaps = profile.object_of(piece), []
    assert number is not None and profile.placeholder_parameter is not None
    firsts = profile.first_pieces()
    for k, each in enumerate(zip(profile.each, firsts, profile.shift, profile.placeholder_parameter, strict=True)):
        one, first, shift, placeholder = each
        own = jnp.where(number == k, parameter - shift, placeholder)
        if isinstance(one, PolygonChain):
            last = one.start.size - 1
            gaps.append(_at_polygon(posed, one, jnp.clip(piece - first, 0, last), arc, own))
        else:
            gaps.append(gap_at(posed._replace(profile=one), arc, own))
    return numbered(number, gaps)


def _at_polygon(posed: Posed, one: PolygonChain, piece: Int[Array, ""], arc: Scalar, parameter: Scalar) -> Gap:
    corner, is_face = piece // 2, piece % 2 == 1
    cos, sin = jnp.cos(posed.angle), jnp.sin(posed.angle)
    turned = jnp.stack([cos, sin], axis=-1)
    weights, bends = with_rate(lambda arc: weights_at(posed.basis, arc), arc)
    direction, way = weights @ turned
    direction = direction / jnp.sqrt(direction @ direction)
    apart = posed.base + posed.length * way - one.xy[corner]
    start = one.start[piece]

    # The normal of a corner is that of the whisker, on the outer side.
    before, after = one.slopes[corner], one.slopes[corner + 1]
    middle = (before + after) / 2
    outer = jnp.stack([jnp.sin(middle), -jnp.cos(middle)])
    across = jnp.stack([direction[1], -direction[0]])
    across = jnp.where(across @ outer > 0, across, -across)
    off = jnp.arctan2(outer[0] * across[1] - outer[1] * across[0], outer @ across)
    normal = jnp.where(is_face, jnp.stack([jnp.sin(after), -jnp.cos(after)]), across)
    tangent = jnp.stack([-normal[1], normal[0]])

    beyond, closes = 1 - arc, -normal @ direction
    inner = (closes < beyond) & (normal @ (bends[0] @ turned) > 0)
    on_face = jnp.where(inner, closes, beyond)
    along = jnp.where(is_face, tangent @ apart, off + (after - before) / 2)
    reach = posed.length * weights[1]
    place = jnp.where(is_face, one.xy[corner] + (parameter - start) * tangent, one.xy[corner])
    return Gap(
        distance=apart @ normal,
        foot=start + along - parameter,
        end=jnp.where(is_face, on_face, -(apart @ direction) / posed.length),
        at_tip=jnp.where(is_face, jnp.where(inner, closes - beyond, jnp.abs(closes - beyond)), -1.0),
        normal=normal,
        across=reach * (normal[1] * cos - normal[0] * sin),
        tangent=tangent,
        along=reach * (tangent[1] * cos - tangent[0] * sin),
        object=ContactPoint(place[0], place[1], tangent[0], tangent[1]),
    )


def stretches_of(profile: ObjectChain) -> Int[Array, " pieces"]:
    """The number of the convex stretch of all outlines that each piece belongs to."""
    begins = corner_signs(profile) < 0
    for first in profile.first_pieces():
        begins = begins.at[first].set(True)
    return jnp.cumsum(begins)


def slips_off(profile: ObjectChain, piece: Array, arc: Array, parameter: Array) -> Array:
    """Whether contacts have passed an end of what they touch: the tip that of a face, or a corner the tip."""
    low, high = ends_of(profile, piece)
    past = (parameter < low) | (parameter > high)
    return jnp.where(corner_signs(profile)[piece] > 0, arc > 1, past & (arc > 1 - AT_TIP))


def next_piece(profile: ObjectChain, piece: Array, parameter: Array) -> Array:
    """The piece of a contact that may have passed from a corner to a face, or onto a corner."""
    low, high = ends_of(profile, piece)
    return piece + (parameter > high).astype(int) - (parameter < low).astype(int)


def ends_of(profile: ObjectChain, piece: Array) -> tuple[Array, Array]:
    """Parameters of the outline at which pieces begin and end; faces have no end at inner corners."""
    number = profile.object_of(piece)
    assert number is not None
    shift = jnp.stack([jnp.asarray(shift) for shift in profile.shift])[number]
    low, high = profile.ends_on(piece)
    inner = jnp.pad(corner_signs(profile) < 0, 1)
    low, high = low + shift, high + shift
    return jnp.where(inner[piece], -jnp.inf, low), jnp.where(inner[piece + 2], jnp.inf, high)


def wedged(profile: ObjectChain, piece: Array, arc: Array, presses: Array) -> Array:
    """Whether contacts hold the tip in an inner corner, two of them at once: then nothing is left for friction."""
    holds, stretch = presses & (arc > 1 - AT_TIP), stretches_of(profile)[piece]
    return holds & jnp.any(holds & (stretch != stretch[:, None]), axis=1)


def with_tips_at_faces(profile: ObjectChain, candidates: Candidate, shaft: WholeShaft) -> Candidate:
    """The candidates with others for the tip at polygons.

    In motion, a tip that has just slipped off a corner may be inside, closer to the face that it has left than to that
    on which it lands. Of each convex stretch, it meets the outermost one of the faces into which it points.
    """
    x, y, cos, sin = shaft.x[0, 0], shaft.y[0, 0], shaft.cos[0, 0], shaft.sin[0, 0]
    stretches, at_tip = stretches_of(profile), (shaft.starts >= 0) & (shaft.beyond[:, 0] <= 0)
    touched = jnp.where(at_tip, stretches[shaft.starts], 0)
    is_smooth = ~jnp.stack([jnp.asarray(isinstance(one, PolygonChain)) for one in profile.each])
    number = profile.object_of(candidates.piece)
    assert number is not None
    keeps = (candidates.phase != Phase.tip) | is_smooth[number]
    every = [candidates._replace(gap=jnp.where(keeps, candidates.gap, jnp.inf))]
    for one, first in zip(profile.each, profile.first_pieces(), strict=True):
        if not isinstance(one, PolygonChain):
            continue
        faces = faces_of(one)
        # As many faces as corners; the last one is the top, and no piece.
        own = jnp.minimum(2 * np.arange(faces.x.size) + 1, one.start.size - 1)
        right, up = x - faces.x, y - faces.y
        distance, along = right * faces.sin - up * faces.cos, right * faces.cos + up * faces.sin
        into, stretch = sin * faces.cos - cos * faces.sin, stretches[first + own]
        meets = faces.touchable & (into > 0) & (along > 0) & (along < faces.length)
        meets &= ~jnp.any(stretch[:, None] == touched, axis=1)
        others = meets & (stretch == stretch[:, None]) & (distance > distance[:, None])
        meets &= ~jnp.any(others, axis=1)
        none = jnp.zeros(along.size)
        tips = Candidate(
            gap=jnp.where(meets, distance, jnp.inf),
            numbers=jnp.stack([none, one.start[own] + along, none], axis=-1),
            phase=jnp.full(along.shape, int(Phase.tip)),
            side=none + 1,
            piece=first + own,
        )
        every.append(tips)
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *every)
