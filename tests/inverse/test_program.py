"""Programs: compiled once per function and shape, and the stopping rule of the least squares."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._inverse import program as module
from jaxwhisker._inverse.program import compile_all, possible_decrease, program


def scaled(factor, x, y):
    """A function that counts how often it is traced."""
    scaled.traced += 1
    return factor() * x, y["a"] + 1


def two():
    return 2.0


@pytest.fixture(autouse=True)
def _count():
    scaled.traced = 0
    module._kept.cache_clear()


def test_one_compilation_per_shape():
    run = program(scaled, two)
    for value in (1.0, 2.0):
        x, y = run(np.full(3, value), {"a": value})
        assert np.all(x == 2 * value) and y == value + 1
    assert scaled.traced == 1
    assert program(scaled, two) is run
    run(np.ones(4), {"a": 1.0})
    assert scaled.traced == 2
    compile_all(run, (np.ones(5), {"a": 1.0}), (np.ones(6), {"a": 1.0}), (np.ones(3), {"a": 1.0}))
    run(np.ones(5), {"a": 1.0})
    assert scaled.traced == 4


def test_functions_that_cannot_be_hashed_are_not_kept():
    class Unhashable:
        __hash__ = None  # pyright: ignore[reportAssignmentType]

        def __call__(self):
            return 3.0

    assert program(scaled, Unhashable())(2.0, {"a": 1.0}) == (6.0, 2.0)
    assert module._kept.cache_info().currsize == 0


def test_possible_decrease_of_a_linear_problem():
    rng = np.random.default_rng(0)
    jacobian, residual = rng.standard_normal((20, 3)) * [1.0, 1e-6, 1e6], rng.standard_normal(20)
    _, (left,), *_ = np.linalg.lstsq(jacobian / [1.0, 1e-6, 1e6], residual, rcond=None)
    expected = residual @ residual - left
    assert possible_decrease(jnp.asarray(residual), jnp.asarray(jacobian)) == pytest.approx(expected)
    held = jnp.asarray(jacobian).at[:, 1].set(0.0)
    assert 0 < possible_decrease(jnp.asarray(residual), held) <= expected
