"""The part of a path right across an object on which whiskers touch it."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.continuation import Limits
from jaxwhisker._path.path import Path, Status, select

MARGIN = 0.01  # of the default control before the first touch and after the last release, dimensionless


def crop(
    onwards: Int[Array, ""], path: Path, limits: Limits, whole: Array
) -> tuple[Path, Float[Array, ""], Float[Array, ""]]:
    """The path, and the first and last control at which whiskers touch on it, with a margin.

    There is no path, and no such range, right across an object whose extent along the drive is not known.
    """
    nodes = path.nodes
    known = jnp.any(nodes.state.phase != Phase.free, axis=1) | (nodes.kind >= 0)
    place = jnp.arange(nodes.kind.shape[0])
    known &= place < path.count
    known |= (place == path.count - 1) & (path.status != Status.ok)  # a base may arrive at a wall before a whisker does
    way = onwards * nodes.point.u
    some = jnp.any(known)
    first = jnp.where(some, jnp.min(jnp.where(known, way, jnp.inf)) - MARGIN, onwards * limits.start)
    last = jnp.where(some, jnp.max(jnp.where(known, way, -jnp.inf)) + MARGIN, onwards * limits.far)
    first = jnp.maximum(first, onwards * limits.start)
    last = jnp.minimum(last, onwards * limits.far)
    start, stop = onwards * first, onwards * last
    travel = nodes.travel - jnp.where(whole, jnp.abs(start - limits.start), 0.0)
    path = path._replace(nodes=nodes._replace(travel=travel))
    if limits.known is not True:
        none = path._replace(count=jnp.asarray(0), status=jnp.asarray(int(Status.lost)))
        nowhere = jnp.asarray(jnp.nan)
        path, start, stop = select(whole & ~limits.known, (none, nowhere, nowhere), (path, start, stop))
    return path, start, stop
