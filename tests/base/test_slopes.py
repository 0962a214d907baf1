"""Tangents by slopes: against JAX, with one further program for all transformations, and not for too many numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.program import Program
from jaxwhisker._base.slopes import MOST_NUMBERS, along, are_few, by_slopes, direction_of, jacobian

EXACT = 1e-13
NUMBERS = {"x": jnp.array([[0.3, -0.7, 1.1], [0.2, 0.5, 0.4]]), "y": jnp.asarray(0.6)}


def function(numbers):
    x, y = numbers["x"], numbers["y"]
    return {"a": jnp.sin(x) * y**2, "b": jnp.sum(x) * y, "count": jnp.asarray(3)}


def test_slopes_are_those_of_jax_in_the_order_of_the_numbers():
    slopes, own = jax.jit(
        lambda n: (jacobian(function, n), jax.jacrev(lambda n: (function(n)["a"], function(n)["b"]))(n))
    )(NUMBERS)
    assert slopes["count"] is None
    for slope, name in zip(own, ("a", "b"), strict=True):
        parts = [jnp.reshape(slope["x"], (*slope["y"].shape, 6)), slope["y"][..., None]]
        np.testing.assert_allclose(slopes[name], jnp.concatenate(parts, axis=-1), atol=EXACT)


def test_tangents_are_slopes_times_directions_of_which_some_are_zero():
    slopes = {"a": jnp.arange(14.0).reshape(2, 7), "none": None}
    direction = direction_of(NUMBERS, {"x": None, "y": jnp.asarray(2.0)})
    assert [leaf.shape for leaf in direction] == [(2, 3), ()]
    np.testing.assert_array_equal(along(slopes, direction)["a"], [12.0, 26.0])
    full = direction_of(NUMBERS, {"x": jnp.ones((2, 3)), "y": None})
    np.testing.assert_array_equal(along(slopes, full)["a"], [15.0, 57.0])
    np.testing.assert_array_equal(along({"a": jnp.zeros((2, 0))}, direction_of([], []))["a"], [0.0, 0.0])


def plain(x, power, y):
    return {"p": x**power * jnp.sin(y), "kind": power}


def test_a_program_with_slopes_has_the_derivatives_of_its_function():
    run = Program(plain, tangent=by_slopes(plain))
    x, power, y = jnp.array([0.3, 1.2]), jnp.asarray(3), jnp.asarray(0.7)

    def total(function, x, y):
        return jnp.sum(jnp.array([1.0, 2.0]) * function(x, power, y)["p"])

    for derivative in (jax.grad, jax.hessian):
        found, expected = (jax.tree.leaves(derivative(total, argnums=(1, 2))(f, x, y)) for f in (run, plain))
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, atol=EXACT)
    by_y = jax.vmap(jax.grad(total, argnums=2), (None, None, 0))(run, x, jnp.linspace(0.0, 1.0, 3))
    np.testing.assert_allclose(by_y, (x**3 @ jnp.array([1.0, 2.0])) * jnp.cos(jnp.linspace(0.0, 1.0, 3)), atol=EXACT)


@pytest.mark.parametrize("size", [MOST_NUMBERS, MOST_NUMBERS + 1])
def test_functions_of_many_numbers_are_left_to_jax(size):
    tangent = by_slopes(lambda x, n: n * x)
    x, n = jnp.zeros(size), jnp.asarray(2)
    assert are_few({"x": x}) == (size <= MOST_NUMBERS)
    found = tangent((x, n), (jnp.ones(size), None), None)
    if size > MOST_NUMBERS:
        assert found is NotImplemented
    else:
        np.testing.assert_array_equal(found, np.full(size, 2.0))
