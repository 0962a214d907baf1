"""The slowest modes of a vibrating system, with derivatives.

The system is given by its mass matrix M and its flexibility H, the inverse of the stiffness: H M q = mu q with
mu = 1 / omega^2. A flexibility may be singular, because coordinates that are held rigidly do not move.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.linear_algebra import inverse

ROUNDING = 1e-15  # of a matrix of masses whose diagonal is 1, per row


class Eigenpairs(NamedTuple):
    """The modes with the largest mu, in descending order, and the smallest mu of all."""

    mu: Float[Array, " count"]
    mode: Float[Array, "count n"]  # normalised to q . M q = 1, with any sign
    least: Float[Array, ""]  # negative if the equilibrium is not stable


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def slowest(flexibility: Float[Array, "n n"], mass: Float[Array, "n n"], count: int) -> Eigenpairs:
    """The slowest modes. Derivatives are those of simple eigenvalues; at multiple ones they are infinite or NaN."""
    # Fast coordinates have so little mass that M is positive definite only up to rounding.
    size = jnp.sqrt(jnp.diagonal(mass))
    scale = jnp.where(size > 0, size, 1.0)
    scaled = mass / (scale[:, None] * scale) + ROUNDING * mass.shape[0] * jnp.eye(mass.shape[0])
    root = size[:, None] * jnp.linalg.cholesky(scaled)
    pulled = flexibility @ root
    values, vectors = jnp.linalg.eigh(root.T @ pulled)
    mu = values[::-1][:count]
    return Eigenpairs(mu, ((pulled @ vectors)[:, ::-1][:, :count] / mu).T, values[0])


@slowest.defjvp
def _(count, primals, tangents):
    flexibility, mass = primals
    flexibility_dot, mass_dot = tangents
    pairs = slowest(flexibility, mass, count)

    def change(mu, mode):
        # The derivative of H M q = mu q and q . M q = 1: a linear system for the changes of q and mu.
        momentum = mass @ mode
        left = flexibility @ mass - mu * jnp.eye(mode.size)
        bordered = jnp.block([[left, -mode[:, None]], [momentum[None, :], jnp.zeros((1, 1))]])
        right = -(flexibility_dot @ momentum) - flexibility @ (mass_dot @ mode)
        solution = inverse(bordered) @ jnp.append(right, -mode @ (mass_dot @ mode) / 2)
        return solution[-1], solution[:-1]

    mu_dot, mode_dot = jax.vmap(change)(pairs.mu, pairs.mode)
    return pairs, Eigenpairs(mu_dot, mode_dot, jnp.zeros_like(pairs.least))
