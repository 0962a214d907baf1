"""The slowest modes against SciPy's generalised eigenvalues, and their derivatives against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import eigh

from jaxwhisker._base.program import Program
from jaxwhisker._dynamics.eigen import slowest
from scenes import in_both_modes

N, COUNT = 20, 3
CONVERGED = 1e-10  # relative, of modes whose ratio to the others is at least 1e-2 per iteration
DIFFERENCE = 3e-6  # of central differences with a step of 1e-5


def system(seed, spread=1.5):
    """A flexibility whose largest eigenvalues are apart, and a mass matrix that is positive definite."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(N, N))
    mass = root @ root.T / N + np.eye(N)
    modes = np.linalg.qr(rng.normal(size=(N, N)))[0]
    return modes @ np.diag(spread ** -np.arange(N, dtype=float)) @ modes.T, mass


def exact(flexibility, mass):
    """All modes, in descending order: H M q = mu q, that is M H M q = mu M q."""
    mu, mode = eigh(mass @ flexibility @ mass, mass)
    return mu[::-1], mode.T[::-1]


@Program
def found(flexibility, mass):
    return slowest(flexibility, mass, COUNT)


def of(flexibility, mass):
    return jax.tree.map(np.asarray, found(jnp.asarray(flexibility), jnp.asarray(mass)))


@pytest.mark.parametrize("seed", range(3))
def test_modes_are_those_of_the_generalised_eigenvalue_problem(seed):
    flexibility, mass = system(seed)
    pairs, (mu, mode) = of(flexibility, mass), exact(flexibility, mass)
    np.testing.assert_allclose(pairs.mu, mu[:COUNT], rtol=CONVERGED)
    np.testing.assert_allclose(np.abs(pairs.mode @ mass @ mode[:COUNT].T), np.eye(COUNT), atol=1e-6)
    np.testing.assert_allclose(pairs.mode @ mass @ pairs.mode.T, np.eye(COUNT), atol=CONVERGED)
    np.testing.assert_allclose(pairs.mode @ (flexibility @ mass).T, pairs.mu[:, None] * pairs.mode, atol=1e-7)


def test_coordinates_that_are_held_rigidly_do_not_move():
    flexibility, mass = system(4)
    flexibility[-5:] = flexibility[:, -5:] = 0
    flexibility[:-5, :-5] = flexibility[:-5, :-5] @ flexibility[:-5, :-5].T  # positive semidefinite
    pairs, (mu, _) = of(flexibility, mass), exact(flexibility, mass)
    np.testing.assert_allclose(pairs.mu, mu[:COUNT], rtol=CONVERGED)
    np.testing.assert_allclose(pairs.mode[:, -5:], 0, atol=CONVERGED)
    assert pairs.least > -CONVERGED


def test_an_unstable_equilibrium_has_a_negative_mode():
    flexibility, mass = system(5)
    flexibility -= 3.0 * np.outer(np.ones(N), np.ones(N)) / N
    assert of(flexibility, mass).least == pytest.approx(exact(flexibility, mass)[0][-1], rel=CONVERGED)


def test_a_double_eigenvalue_has_two_different_modes():
    flexibility, mass = np.diag(2.0 ** -np.maximum(np.arange(N), 1.0)), np.eye(N)
    pairs = of(flexibility, mass)
    np.testing.assert_allclose(pairs.mu, [0.5, 0.5, 0.25], rtol=CONVERGED)
    np.testing.assert_allclose(pairs.mode @ pairs.mode.T, np.eye(COUNT), atol=CONVERGED)
    np.testing.assert_allclose(pairs.mode[:2, 2:], 0, atol=1e-7)


def test_derivatives_in_both_modes_and_a_batch_with_a_failing_lane():
    flexibility, mass = (jnp.asarray(each) for each in system(0))
    rng = np.random.default_rng(6)
    changes = [jnp.asarray((change + change.T) / 2) for change in rng.normal(size=(2, N, N))]
    probe = rng.normal(size=N)

    def measured(by):
        """Eigenvalues, and what does not depend on the sign of a mode."""
        pairs = slowest(flexibility + by * changes[0], mass + by * changes[1], COUNT)
        return jnp.concatenate([pairs.mu, (pairs.mode @ probe) ** 2, pairs.mode[:, 0] * pairs.mode[:, 5]])

    weights, step = jnp.asarray(rng.normal(size=3 * COUNT)), 1e-5
    both = jax.jit(jax.vmap(in_both_modes(measured, 1.0), in_axes=(0, None)))
    values, slopes, reverse = both(jnp.array([0.0, step, -step, jnp.nan]), weights)
    np.testing.assert_allclose(slopes[0], (values[1] - values[2]) / (2 * step), rtol=DIFFERENCE, atol=DIFFERENCE)
    np.testing.assert_allclose(reverse[:3], slopes[:3] @ weights, rtol=1e-9)
    assert np.isnan(values[3]).all() and np.isnan(slopes[3]).all()
