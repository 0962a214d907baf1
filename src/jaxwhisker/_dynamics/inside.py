"""How deep a moving whisker is inside the object, at any place of its shaft."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.interpolation import between
from jaxwhisker._dynamics.gap import Posed
from jaxwhisker._dynamics.legendre import weights_at
from jaxwhisker._dynamics.outline import objects_at
from jaxwhisker._equilibrium.clearance import DEPTH, least_gap

CELLS = 128  # of the whisker: the corner of an object may lie in one


def deepest(posed: Posed, parameter: Float[Array, ""]) -> Float[Array, ""]:
    """The least gap of a whisker whose closest point is at this parameter, infinite if all of it is outside.

    Without derivatives. Other objects than that with the closest point do not count.
    """
    arcs = jnp.linspace(0.0, 1.0, CELLS + 1)
    turned = jnp.stack([jnp.cos(posed.angle), jnp.sin(posed.angle)], axis=-1)
    direction, way = jnp.moveaxis(jax.vmap(lambda s: weights_at(posed.basis, s))(arcs) @ turned, 1, 0)
    cells = between(posed.base + posed.length * way, direction, jnp.asarray(posed.length / CELLS))
    least = jnp.asarray(jnp.inf)
    for one, at, is_own in objects_at(posed.profile, parameter):
        gap = least_gap(one, cells, at)
        least = jnp.where(is_own & (gap < -DEPTH), gap, least)
    return least
