"""Small dense systems, unrolled and in loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxwhisker._base.linear_algebra import (
    UNROLLED,
    eigenvalues_are_positive,
    inverse,
    positive_definite,
    sign_of_determinant,
    solve,
    solve_definite,
)

ROUNDING = 1e-12
SIZES = (1, 2, 3, UNROLLED, UNROLLED + 1)


@pytest.mark.parametrize("n", SIZES)
def test_solutions(n):
    rng = np.random.default_rng(n)
    matrix, right = rng.normal(size=(n, n)), rng.normal(size=(n, 2))
    np.testing.assert_allclose(solve(jnp.asarray(matrix), jnp.asarray(right)), np.linalg.solve(matrix, right), ROUNDING)


@pytest.mark.parametrize("n", SIZES)
def test_solutions_of_definite_systems(n):
    rng = np.random.default_rng(n)
    root, right = rng.normal(size=(n, n)), rng.normal(size=n)
    matrix = root @ root.T + np.eye(n)
    solution, definite = solve_definite(jnp.asarray(matrix), jnp.asarray(right))
    assert bool(definite)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), ROUNDING)
    lowest = np.linalg.eigvalsh(matrix)[0]
    assert not bool(solve_definite(jnp.asarray(matrix - 1.001 * lowest * np.eye(n)), jnp.asarray(right))[1])


@pytest.mark.parametrize("n", (3, UNROLLED + 1))
def test_a_vanishing_pivot_needs_another_row(n):
    matrix = jnp.eye(n).at[:3, :3].set(jnp.array([[0.0, 2.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 1.0]]))
    np.testing.assert_allclose(matrix @ solve(matrix, jnp.eye(n)), np.eye(n), atol=ROUNDING)


@pytest.mark.parametrize("n", SIZES)
def test_derivatives_of_solutions_in_both_modes(n):
    rng = np.random.default_rng(n)
    matrix, right = 3 * jnp.eye(n) + rng.normal(size=(n, n)), jnp.asarray(rng.normal(size=(n, 2)))
    check_grads(jax.jit(solve), (matrix, right), order=2, modes=("fwd", "rev"))


@pytest.mark.parametrize(
    "function", (lambda m: solve(m, m), inverse, positive_definite, eigenvalues_are_positive, sign_of_determinant)
)
def test_lapack_is_not_called(function):
    # Two batches in LAPACK at the same time would wait for each other forever.
    batch = jax.ShapeDtypeStruct((600, UNROLLED + 2, UNROLLED + 2), float)
    assert "lapack" not in jax.jit(jax.vmap(function)).lower(batch).as_text()
    assert "lapack" in jax.jit(jnp.linalg.inv).lower(batch).as_text()


def test_inverses_and_their_derivatives():
    rng = np.random.default_rng(0)
    matrix, change = jnp.asarray(rng.normal(size=(2, 30, 30)))
    matrix = matrix.at[0, 0].set(0.0)
    np.testing.assert_allclose(inverse(matrix) @ matrix, np.eye(30), atol=1e-10)
    _, tangent = jax.jvp(inverse, (matrix,), (change,))
    np.testing.assert_allclose(tangent, jax.jvp(jnp.linalg.inv, (matrix,), (change,))[1], rtol=1e-7, atol=1e-7)
    batch = jax.vmap(inverse)(jnp.stack([matrix, 0 * matrix]))
    np.testing.assert_allclose(batch[0], inverse(matrix), rtol=ROUNDING)
    assert not np.isfinite(batch[1]).any()


@pytest.mark.parametrize("n", SIZES)
def test_a_singular_matrix_spoils_only_its_own_batch_element(n):
    matrices = jnp.stack([jnp.eye(n), jnp.zeros((n, n))])
    good, bad = jax.vmap(lambda m: solve(m, jnp.ones((n, 1))))(matrices)
    np.testing.assert_array_equal(good, np.ones((n, 1)))
    assert not np.any(np.isfinite(bad))


@pytest.mark.parametrize("n", SIZES)
def test_positive_definite(n):
    rng = np.random.default_rng(n)
    factor = rng.normal(size=(n, n))
    matrix = jnp.asarray(factor @ factor.T + 0.1 * np.eye(n))
    assert positive_definite(matrix)
    least = float(np.linalg.eigvalsh(matrix)[0])
    assert not positive_definite(matrix - 1.01 * least * jnp.eye(n))
    assert positive_definite(matrix - 0.99 * least * jnp.eye(n))
    assert not positive_definite(matrix.at[0, 0].set(jnp.nan))


@pytest.mark.parametrize("n", SIZES)
def test_eigenvalues_with_positive_real_parts(n):
    rng = np.random.default_rng(n)
    matrix = rng.normal(size=(n, n))
    shift = np.min(np.linalg.eigvals(matrix).real)
    for by, positive in ((1e-6, True), (-1e-6, False), (10.0, True)):
        moved = jnp.asarray(matrix - (shift - by) * np.eye(n))
        assert eigenvalues_are_positive(moved) == positive
    assert not eigenvalues_are_positive(jnp.full((n, n), jnp.nan))
    assert not eigenvalues_are_positive(jnp.zeros((n, n)))


@pytest.mark.parametrize("n", SIZES)
def test_signs_of_determinants(n):
    rng = np.random.default_rng(n)
    matrices = rng.normal(size=(20, n, n))
    signs = jax.vmap(sign_of_determinant)(jnp.asarray(matrices))
    np.testing.assert_array_equal(signs, np.sign(np.linalg.det(matrices)))
    assert set(signs.tolist()) == {-1.0, 1.0}
    # Exchanged rows, with pivots that vanish, change the sign.
    assert sign_of_determinant(jnp.eye(n)[::-1]) == (-1) ** (n * (n - 1) // 2)
    for singular in (jnp.zeros((n, n)), jnp.full((n, n), jnp.nan)):
        assert not jnp.abs(sign_of_determinant(singular)) > 0
