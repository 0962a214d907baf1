"""Values whose second derivatives are not known."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@jax.custom_jvp
def first_order(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The values with their first derivatives, and NaN as their second ones."""
    return x


@first_order.defjvp
def _(primals, tangents):
    (x,), (dot,) = primals, tangents
    # The factor is 1. Its derivative is NaN, because the square root has no derivative at 0.
    return first_order(x), dot * (1.0 + jnp.sqrt(jnp.where(jnp.isfinite(x), 0.0 * x, 0.0)))
