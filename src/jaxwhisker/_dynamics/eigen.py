"""The slowest modes of a vibrating system, with derivatives.

The system is given by its mass matrix M and its flexibility H, the inverse of the stiffness: H M q = mu q with
mu = 1 / omega^2. A flexibility may be singular, because coordinates that are held rigidly do not move.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.linear_algebra import inverse

FURTHER = 12  # directions that are iterated besides those of the wanted modes
ITERATIONS = 30  # of the subspace; each one reduces other modes by the ratio of their mu
SWEEPS = 9  # of Jacobi rotations, for the largest subspace
ROUNDING = 1e-15  # added to a matrix of products of unit vectors, whose Cholesky factor then exists


class Eigenpairs(NamedTuple):
    """The modes with the largest mu, in descending order, and the smallest mu in the iterated subspace.

    The subspace converges to the modes with the largest |mu|; its smallest mu is no less than that of all modes.
    """

    mu: Float[Array, " count"]
    mode: Float[Array, "count n"]  # normalised to q . M q = 1, with any sign
    least: Float[Array, ""]  # negative only if the equilibrium is not stable


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def slowest(flexibility: Float[Array, "n n"], mass: Float[Array, "n n"], count: int) -> Eigenpairs:
    """The slowest modes. Derivatives are those of simple eigenvalues; at multiple ones they are infinite or NaN."""
    # Subspace iteration (Bathe and Wilson 1972). With jax 0.10, programs with LAPACK calls that run at the same time
    # may wait for each other forever, even if each product of matrices runs in one thread.
    size = count + FURTHER + count % 2

    def improved(_, modes):
        modes = flexibility @ (mass @ modes)
        return _orthonormal(modes, mass)

    start = _orthonormal(jnp.asarray(np.random.default_rng(0).normal(size=(mass.shape[0], size))), mass)
    modes = jax.lax.fori_loop(0, ITERATIONS, improved, start)
    momenta = mass @ modes
    values, turned = _eigen(momenta.T @ flexibility @ momenta)
    order = jnp.argsort(-values)
    return Eigenpairs(values[order][:count], (modes @ turned[:, order]).T[:count], jnp.min(values))


def _orthonormal(modes: Float[Array, "n k"], mass: Float[Array, "n n"]) -> Float[Array, "n k"]:
    """A basis of the same space with q . M q = 1 and no products between different modes."""
    size = jnp.sqrt(jnp.sum(modes * (mass @ modes), axis=0))
    modes = modes / size
    product = modes.T @ (mass @ modes) + ROUNDING * size.size * jnp.eye(size.size)
    return modes @ inverse(_cholesky(product)).T


def _cholesky(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    rows = jnp.arange(matrix.shape[0])

    def column(k, both):
        rest, factor = both
        own = jnp.where(rows >= k, rest[:, k] / jnp.sqrt(rest[k, k]), 0.0)
        return rest - own[:, None] * own, factor.at[:, k].set(own)

    return jax.lax.fori_loop(0, rows.size, column, (matrix, jnp.zeros_like(matrix)))[1]


def _eigen(matrix: Float[Array, "n n"]) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Eigenvalues and eigenvectors of a symmetric matrix with an even number of rows, by Jacobi rotations.

    Each round rotates the pairs (k, n/2 + k). As in a tournament, all others but one then move on by one place.
    """
    n = matrix.shape[0]
    half = n // 2
    ring = [*range(1, half), *range(n - 1, half - 1, -1)]
    moved = np.arange(n)
    moved[ring] = np.roll(ring, 1)

    def rotated(a, cos, sin):
        return jnp.concatenate([cos * a[:half] - sin * a[half:], sin * a[:half] + cos * a[half:]])[moved]

    def turn(_, both):
        matrix, vectors = both
        first, second = jnp.diagonal(matrix)[:half], jnp.diagonal(matrix)[half:]
        across = jnp.diagonal(matrix[:half, half:])
        done = across == 0
        slope = (second - first) / (2 * jnp.where(done, 1.0, across))
        tangent = jnp.where(slope < 0, -1.0, 1.0) / (jnp.abs(slope) + jnp.sqrt(1 + slope**2))
        tangent = jnp.where(done, 0.0, tangent)[:, None]
        cos = 1 / jnp.sqrt(1 + tangent**2)
        sin = tangent * cos
        return rotated(rotated(matrix, cos, sin).T, cos, sin).T, rotated(vectors, cos, sin)

    matrix, vectors = jax.lax.fori_loop(0, SWEEPS * (n - 1), turn, (matrix, jnp.eye(n)))
    return jnp.diagonal(matrix), vectors.T


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
