"""Values whose second derivatives are NaN."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._dynamics.first_order import first_order

X = jnp.array([0.0, -2.0, 3.0])


def cubed(x):
    return jnp.sum(first_order(x) ** 3)


def test_values_and_first_derivatives_stay():
    far = jnp.array([jnp.inf, jnp.nan, 1.0])
    given = jax.jit(
        lambda x: (first_order(far), jax.jacfwd(first_order)(far), jax.grad(cubed)(x), jax.jacfwd(cubed)(x))
    )
    for got, expected in zip(given(X), (far, np.eye(3), 3 * X**2, 3 * X**2), strict=True):
        np.testing.assert_array_equal(got, expected)


def test_second_derivatives_are_nan_however_they_are_taken():
    modes = jax.jacfwd, jax.jacrev
    second = jax.jit(lambda x: [outer(inner(cubed))(x) for inner in modes for outer in modes])(X)
    assert np.isnan([np.diagonal(each) for each in second]).all()
    # By what the values do not depend on, there is none.
    assert jax.hessian(lambda by: by**2 * first_order(X[1]))(1.0) == -4.0
