"""Blocks of rows: one program for every number of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._scan.blocks import in_blocks


def squares(x, y):
    assert x.shape[0] == 4  # every block has one size
    return {"square": x**2, "sum": x + y[:, 0]}


@pytest.mark.parametrize("count", [1, 4, 5, 11])
def test_blocks_equal_the_whole(count):
    x, y = np.arange(count, dtype=float), np.ones((count, 2))
    found = in_blocks(squares, (x, y), 4)
    np.testing.assert_array_equal(found["square"], x**2)
    np.testing.assert_array_equal(found["sum"], x + 1)


def test_blocks_have_derivatives():
    x, y = jnp.arange(5.0), jnp.ones((5, 2))
    slope = jax.grad(lambda x: jnp.sum(in_blocks(squares, (x, y), 4)["square"]))(x)
    np.testing.assert_array_equal(slope, 2 * x)
