"""The whole shaft of a whisker in space, from the tip to the base, at the ends of all integration steps."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.quaternions import third_axis, turned
from jaxwhisker._base.rotation import quaternion_of
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import fractions
from jaxwhisker._chain.shaft import Cell, cell_between
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.drives import Placement
from jaxwhisker._rod.rod import graded
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, curvature, points
from jaxwhisker._space.contact import SpaceWhisker
from jaxwhisker._space_chain.contacts import SegmentsInSpace

Along = Float[Array, "segments points 3"]


class WholeShaftInSpace(NamedTuple):
    """Points of a shaft. The first segment lies beyond all contacts, each other one begins at a contact."""

    beyond: Float[Array, "segments points"]  # arc length of the whisker beyond a point
    position: Along
    tangent: Along
    bend: Along  # derivative of the tangent by arc length, towards the tip
    side: Along  # the first director
    starts: Bool[Array, " segments"]  # whether a segment begins at a contact, towards the base
    ends: Bool[Array, " segments"]  # the same where it ends


class PiecesInSpace(NamedTuple):
    """All segments of a whisker: first the one beyond its contacts, from there outwards, then one from each contact."""

    position: Float[Array, "segments 3"]
    rotation: Float[Array, "segments 3 3"]
    force: Float[Array, "segments 3"]
    moment: Float[Array, "segments 3"]  # about the start
    arc: Float[Array, " segments"]  # towards the base; negative outwards
    from_base: Float[Array, " segments"]  # arc length at the start


def pieces_of(
    body: SpaceWhisker, chain: SegmentsInSpace, phase: Int[Array, " contacts"], base: Placement
) -> PiecesInSpace:
    """All segments of a whisker with these contacts; a free one is integrated from its base on."""
    touches = phase != Phase.free
    from_base = jnp.where(touches[0], body.length - chain.beyond[0], 0.0)

    def with_first(at: Array, there: Array) -> Array:
        # Places that are not used are at the base.
        own = jnp.where(touches.reshape(-1, *[1] * at.ndim), there, at)
        return jnp.concatenate([own[:1], own])

    return PiecesInSpace(
        with_first(base.position, chain.position),
        with_first(base.rotation, chain.rotation),
        jnp.concatenate([jnp.zeros((1, 3)), chain.force]),
        jnp.concatenate([jnp.zeros((1, 3)), chain.moment]),
        jnp.append(from_base - body.length, chain.arc),
        jnp.append(from_base, body.length - chain.beyond),
    )


def _states(body: SpaceWhisker, steps: int, piece: PiecesInSpace):
    """States along one segment, its load, and the arc lengths from the base there."""
    section = body.section
    assert isinstance(section, SpaceSection)
    at, along = jnp.asarray(fractions(steps)), section.in_plane
    if along is not None:
        at = graded(at, along.stiffness(piece.from_base), along.stiffness(piece.from_base - piece.arc))
    load = SpaceLoad(tuple(piece.force), tuple(piece.moment + jnp.cross(piece.position, piece.force)))
    start = tuple(piece.position), tuple(quaternion_of(piece.rotation))
    states = points(start, piece.arc, load, section, at=at, from_base=piece.from_base)
    return states, load, piece.from_base - at * piece.arc


def shaft_of(
    body: SpaceWhisker, steps: int, chain: SegmentsInSpace, phase: Int[Array, " contacts"], base: Placement
) -> WholeShaftInSpace:
    """The shaft of a whisker with these contacts, in so many steps for each segment."""

    section = body.section
    assert isinstance(section, SpaceSection)

    def one(piece):
        (r, q), load, s = _states(body, steps, piece)

        def at(r, q, s):
            k1, k2, _ = curvature((r, q), load, section, s)
            first, second = (jnp.stack(turned(q, axis)) for axis in ((1.0, None, None), (None, 1.0, None)))
            return jnp.stack(r), jnp.stack(third_axis(q)), k2 * first - k1 * second, first

        return body.length - s, *jax.vmap(at)(r, q, s)

    leaves = jax.vmap(one)(pieces_of(body, chain, phase, base))
    # The part beyond all contacts has been integrated outwards.
    beyond, position, tangent, bend, side = (leaf.at[0].set(leaf[0, ::-1]) for leaf in leaves)
    touches = phase != Phase.free
    return WholeShaftInSpace(
        beyond, position, tangent, bend, side, jnp.append(False, touches), jnp.append(touches, False)
    )


def point_at(
    body: SpaceWhisker,
    steps: int,
    chain: SegmentsInSpace,
    phase: Int[Array, " contacts"],
    base: Placement,
    beyond: Scalar,
) -> Float[Array, "3"]:
    """The position of the point that has this arc length of the whisker beyond it."""
    pieces = pieces_of(body, chain, phase, base)
    before = (phase != Phase.free) & (body.length - pieces.from_base[1:] <= beyond)
    own = jax.tree.map(lambda leaf: leaf[jnp.sum(before)], pieces)
    (r, _), _, _ = _states(body, steps, own._replace(arc=own.from_base - (body.length - beyond)))
    return jnp.stack([part[-1] for part in r])


def cell_of(shaft: WholeShaftInSpace, segment: Int[Array, ""], k: Int[Array, ""]) -> Cell:
    """The cell between the points k and k + 1 of a segment."""
    beyond = shaft.beyond[segment, k]
    h = shaft.beyond[segment, k + 1] - beyond

    def jet(j):
        return shaft.position[segment, j], -h * shaft.tangent[segment, j], h**2 * shaft.bend[segment, j]

    return cell_between(beyond, h, jet(k), jet(k + 1))


def within_cells(shaft: WholeShaftInSpace, count: int) -> tuple[Float[Array, "segments samples"], Along, Along]:
    """Arc lengths beyond, positions and tangents at so many equidistant places of each cell, from the tip on."""
    segments, points = shaft.beyond.shape
    sample = np.arange((points - 1) * count + 1)
    k = np.minimum(sample // count, points - 2)

    def at(segment, k, t):
        cell = cell_of(shaft, segment, k)
        way = cell.direction(t)
        size = jnp.sqrt(jnp.sum(way**2))
        return cell.beyond + t * cell.length, cell.point(t), -way / jnp.where(size > 0, size, 1.0)

    along = jax.vmap(jax.vmap(at, (None, 0, 0)), (0, None, None))
    return along(jnp.arange(segments), jnp.asarray(k), jnp.asarray(sample / count - k))
