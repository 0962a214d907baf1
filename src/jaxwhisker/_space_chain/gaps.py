"""Gaps between a shaft in space and objects, and the contacts that begin where they close.

Along the shaft, the gap to an object has a minimum at each contact. The lowest other minimum is a candidate for a new
contact, and so is the tip.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.valleys import WITHIN, GapAlong, lowest_valley
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._space.free import Nearest, contact_at
from jaxwhisker._space_chain.shaft import WholeShaftInSpace, cell_of, within_cells

FAR = jnp.inf
OWN_CONTACT = 1e-7  # lengths: contacts that are so close to an object are contacts with it
LOWEST_STEPS = 4


class GapsInSpace(NamedTuple):
    """The candidates of a whisker, and its distance from the objects."""

    candidates: Nearest  # fields (candidates, ...)
    distance: Scalar  # least distance of any point from any object
    base: Scalar  # distance of the base; negative inside an object


def gaps_of(surface: AbstractSurface, shaft: WholeShaftInSpace) -> GapsInSpace:
    """The candidates for new contacts of a shaft: for each object one on the shaft, and one at the tip."""

    def of_one(one: AbstractSurface):
        # The gap to a convex object has one valley between two contacts.
        beyond, position, tangent = shaft[:3] if one.is_convex else within_cells(shaft, WITHIN)
        off, out = jax.vmap(jax.vmap(lambda x: (one.off(x), one.normal(x))))(position)
        distance = jnp.min(jax.vmap(jax.vmap(lambda x: one.ball_before(x)[0]))(position))
        # By the arc length towards the base.
        rate = -jnp.sum(tangent * out, axis=-1)
        starts, ends = (
            here & (jnp.abs(gap) < OWN_CONTACT) for here, gap in ((shaft.starts, off[:, 0]), (shaft.ends, off[:, -1]))
        )
        own = _on_shaft(one, shaft, GapAlong(off, rate, beyond), starts, ends), _at_tip(shaft, off, out, starts)
        # Between two points, a shaft may be closer to a thin object than at both.
        distance = jnp.minimum(distance, own[0].distance)
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *own), distance, off[-1, -1]

    candidates, distance, base = surface.of_each(of_one)
    flat = jax.tree.map(lambda leaf: jnp.reshape(leaf, (-1, *leaf.shape[2:])), candidates)
    return GapsInSpace(flat, jnp.min(distance), jnp.min(base))


def _on_shaft(one: AbstractSurface, shaft: WholeShaftInSpace, along: GapAlong, starts: Array, ends: Array) -> Nearest:
    lowest = lowest_valley(along, shaft.beyond.shape[1] - 1, starts, ends)
    cell = cell_of(shaft, lowest.segment, lowest.index)
    rate = jax.jacfwd(cell.direction)

    def newton(_, t):
        x, way = cell.point(t), cell.direction(t)
        slope = one.gradient(x)
        rise = jnp.sum(way * jnp.sum(one.hessian(x) * way, axis=1)) + jnp.sum(slope * rate(t))
        step = jnp.sum(slope * way) / rise
        return t - jnp.where(jnp.isfinite(step), step, 0.0)

    t = jax.lax.fori_loop(0, LOWEST_STEPS, newton, lowest.share)
    t = jnp.where(jnp.abs(t - lowest.share) < lowest.width, t, lowest.share)
    point, way, gap = cell.point(t), cell.direction(t), one.off(cell.point(t))
    side = shaft.side[lowest.segment, lowest.index + (t > 0.5)]
    out = one.normal(point)
    tangent = -way / jnp.sqrt(jnp.sum(way**2))
    contact = contact_at(point - gap * out, out, tangent, side, cell.beyond + t * cell.length)
    return Nearest(jnp.where(lowest.some, gap, FAR), contact, jnp.asarray(int(Phase.tangential)))


def _at_tip(shaft: WholeShaftInSpace, off: Float[Array, "s p"], out: Float[Array, "s p 3"], starts: Array) -> Nearest:
    point, tangent, normal, gap = shaft.position[0, 0], shaft.tangent[0, 0], out[0, 0], off[0, 0]
    touches_there = starts[1] & (shaft.beyond[1, 0] <= 0)
    begins = (jnp.sum(tangent * normal) < 0) & ~touches_there
    contact = contact_at(point - gap * normal, normal, tangent, shaft.side[0, 0], jnp.zeros(()))
    return Nearest(jnp.where(begins, gap, FAR), contact, jnp.asarray(int(Phase.tip)))
