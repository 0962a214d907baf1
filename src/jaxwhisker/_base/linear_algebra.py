"""Linear algebra for small dense systems, such as networks of a few whiskers.

LAPACK is not used: with jax 0.10, two of its batched calls that run at the same time may wait for each other forever.
With jax 0.12, no call in 59,000 did, but jax 0.10 is what Python 3.11 installs (docs/developing.md has the times).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

UNROLLED = 4  # elimination is unrolled up to this size; for larger systems, loops compile faster


def solve(matrix: Float[Array, "n n"], right: Float[Array, "n k"]) -> Float[Array, "n k"]:
    """Solve matrix @ x = right by elimination with partial pivoting.

    A singular matrix raises no error: it gives infinities or NaN in its own batch element. Small systems are unrolled,
    because one library call for each of a million 2 x 2 systems would cost more than the rods that they couple.
    """
    n = matrix.shape[0]
    if n > UNROLLED:
        return _solve_in_loop(matrix, right)
    rows = [jnp.concatenate([matrix[i], right[i]]) for i in range(n)]
    for i in range(n):
        for j in range(i + 1, n):
            swap = jnp.abs(rows[j][i]) > jnp.abs(rows[i][i])
            rows[i], rows[j] = jnp.where(swap, rows[j], rows[i]), jnp.where(swap, rows[i], rows[j])
        for j in range(i + 1, n):
            rows[j] = rows[j] - rows[i] * (rows[j][i] / rows[i][i])
    solution: list = [None] * n
    for i in reversed(range(n)):
        known = rows[i][n:] - sum(rows[i][j] * solution[j] for j in range(i + 1, n))
        solution[i] = known / rows[i][i]
    return jnp.stack(solution)


def _solve_in_loop(matrix: Float[Array, "n n"], right: Float[Array, "n k"]) -> Float[Array, "n k"]:
    def times(x):  # a batch of small products is faster as sums
        return jnp.sum(matrix[:, :, None] * x, axis=1)

    return jax.lax.custom_linear_solve(
        times, right, lambda _, b: _eliminated(matrix, b), lambda _, b: _eliminated(matrix.T, b)
    )


def _eliminated(matrix: Float[Array, "n n"], right: Float[Array, "n k"]) -> Float[Array, "n k"]:
    """The solution by Gauss-Jordan elimination with partial pivoting, in a loop, without derivatives of its own."""
    n = matrix.shape[0]
    rows = jnp.arange(n)

    def eliminate(k, both):
        both, _ = _with_pivot(both, k)
        row = both[k] / both[k, k]
        return jnp.where((rows == k)[:, None], row, both - both[:, k, None] * row)

    return jax.lax.fori_loop(0, n, eliminate, jnp.concatenate([matrix, right], axis=1))[:, n:]


def _with_pivot(
    matrix: Float[Array, "n columns"], k: Int[Array, ""]
) -> tuple[Float[Array, "n columns"], Bool[Array, ""]]:
    """The matrix with the largest number of column k, from row k on, in row k, and whether rows were exchanged."""
    rows = jnp.arange(matrix.shape[0])
    pivot = jnp.argmax(jnp.where(rows >= k, jnp.abs(matrix[:, k]), -1.0))
    return matrix[jnp.where(rows == k, pivot, jnp.where(rows == pivot, k, rows))], pivot != k


def determinant(matrix: Float[Array, "n n"]) -> Float[Array, ""]:
    """The determinant; 0 or NaN if the matrix is singular."""
    return _product_of_pivots(matrix, lambda pivot: pivot)


def sign_of_determinant(matrix: Float[Array, "n n"]) -> Float[Array, ""]:
    """1 or -1; 0 or NaN if the matrix is singular."""
    return _product_of_pivots(matrix, jnp.sign)


def _product_of_pivots(matrix: Float[Array, "n n"], factor: Callable[[Array], Array]) -> Float[Array, ""]:
    rows = jnp.arange(matrix.shape[0])

    def eliminate(k, carry):
        (matrix, exchanged), product = _with_pivot(carry[0], k), carry[1]
        below = jnp.where(rows > k, matrix[:, k] / matrix[k, k], 0.0)
        product *= jnp.where(exchanged, -1.0, 1.0) * factor(matrix[k, k])
        return matrix - below[:, None] * matrix[k], product

    return jax.lax.fori_loop(0, rows.size, eliminate, (matrix, jnp.ones(())))[1]


def positive_definite(matrix: Float[Array, "n n"]) -> Bool[Array, ""]:
    """Whether the symmetric matrix is positive definite; False if it contains NaN."""
    n = matrix.shape[0]
    if n > UNROLLED:

        def eliminate(i, carry):
            matrix, definite = carry
            below = jnp.where(jnp.arange(n) > i, matrix[:, i] / matrix[i, i], 0.0)
            return matrix - below[:, None] * matrix[i], definite & (matrix[i, i] > 0)

        return jax.lax.fori_loop(0, n, eliminate, (matrix, jnp.asarray(True)))[1]
    rows = [matrix[i] for i in range(n)]
    definite = rows[0][0] > 0
    for i in range(n - 1):
        for j in range(i + 1, n):
            rows[j] = rows[j] - rows[i] * (rows[j][i] / rows[i][i])
        definite &= rows[i + 1][i + 1] > 0
    return definite


def solve_definite(
    matrix: Float[Array, "n n"], right: Float[Array, " n"]
) -> tuple[Float[Array, " n"], Bool[Array, ""]]:
    """Solve matrix @ x = right by elimination without pivoting, and tell whether the matrix is positive definite.

    The matrix is symmetric. If it is not positive definite, the solution is meaningless.
    """
    n = matrix.shape[0]

    def eliminate(k, carry):
        both, definite = carry
        row = both[k] / both[k, k]
        rest = jnp.where(jnp.arange(n) == k, 0.0, both[:, k])
        return (both - rest[:, None] * row).at[k].set(row), definite & (both[k, k] > 0)

    start = jnp.concatenate([matrix, right[:, None]], axis=1), jnp.asarray(True)
    both, definite = jax.lax.fori_loop(0, n, eliminate, start)
    return both[:, n], definite


SQUARINGS = 40  # resolve eigenvalues of 1e-12 times the largest one


def eigenvalues_are_positive(matrix: Float[Array, "n n"]) -> Bool[Array, ""]:
    """Whether all eigenvalues of the matrix have a positive real part; False if it contains NaN.

    They have if the powers of the matrix (M - s)(M + s)^-1 vanish, with any s > 0.
    """
    n = matrix.shape[0]
    shift = jnp.sqrt(jnp.sum(matrix**2) / n) * jnp.eye(n)
    power = solve((matrix + shift).T, (matrix - shift).T)
    power = jax.lax.fori_loop(0, SQUARINGS, lambda _, power: jnp.sum(power[:, :, None] * power[None], axis=1), power)
    return jnp.sum(power**2) < 1


def block_diagonal(blocks: Float[Array, "n height width"]) -> Float[Array, "rows columns"]:
    """Block-diagonal matrix with these blocks."""
    n, height, width = blocks.shape
    if height == width == 1:
        return blocks[:, 0, 0, None] * jnp.eye(n)
    return jnp.reshape(jnp.eye(n)[:, None, :, None] * blocks[:, :, None, :], (n * height, n * width))


def times_block_diagonal(
    matrix: Float[Array, "rows rows"], blocks: Float[Array, "n size size"] | Float[Array, "rows rows"]
) -> Float[Array, "rows rows"]:
    """Product matrix @ block_diagonal(blocks); or matrix @ blocks, if these are a whole matrix."""
    if blocks.ndim == 2:
        return jnp.sum(matrix[:, :, None] * blocks, axis=1)
    n, size, _ = blocks.shape
    if size == 1:
        return matrix * blocks[:, 0, 0]
    return jnp.reshape(jnp.sum(jnp.reshape(matrix, (-1, n, size, 1)) * blocks, axis=2), matrix.shape)


@jax.custom_jvp
def inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Invert a matrix of at most a few dozen rows.

    A singular matrix gives infinities or NaN in its own batch element.
    """
    return solve(matrix, jnp.eye(matrix.shape[0]))


@inverse.defjvp
def _(primals, tangents):
    (matrix,), (change,) = primals, tangents
    inverted = inverse(matrix)
    return inverted, -inverted @ change @ inverted
