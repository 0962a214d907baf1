"""Rows of contacts of several whiskers."""

import jax.numpy as jnp
import numpy as np

from jaxwhisker._chain.rows import with_row, without_row

CONTACTS = 2
ROWS = {"z": jnp.arange(1.0, 9.0).reshape(4, 2), "phase": jnp.array([1, 0, 2, 2])}
EMPTY = {"z": jnp.zeros((4, 2)), "phase": jnp.zeros(4, int)}


def test_a_new_row_moves_those_behind_it_of_its_own_whisker():
    rows = with_row(ROWS, jnp.asarray(0), {"z": jnp.full(2, 9.0), "phase": jnp.asarray(3)}, CONTACTS)
    np.testing.assert_array_equal(rows["z"], [[9.0, 9.0], [1.0, 2.0], [5.0, 6.0], [7.0, 8.0]])
    assert rows["phase"].tolist() == [3, 1, 2, 2]


def test_a_row_that_ends_is_filled_by_those_behind_it():
    rows = without_row(ROWS, jnp.arange(4) == 2, EMPTY, CONTACTS)
    np.testing.assert_array_equal(rows["z"], [[1.0, 2.0], [3.0, 4.0], [7.0, 8.0], [0.0, 0.0]])
    assert rows["phase"].tolist() == [1, 0, 2, 0]
    same = without_row(ROWS, jnp.zeros(4, bool), EMPTY, CONTACTS)
    np.testing.assert_array_equal(same["z"], ROWS["z"])
