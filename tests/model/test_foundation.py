"""Foundations: what the constructor accepts, and the same for traced values, each in its own lane."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

GOOD = [(0.0, 0.1, 2000.0, 0.0), (0.2, 0.3, 1e-9, -0.4), (0.0, 1e-6, 1.0, 0.5)]
BAD = {
    (-1e-9, 0.1, 1.0, 0.0): "`start` must be a non-negative",
    (0.1, 0.1, 1.0, 0.0): "`stop` must be greater than start = 0.1",
    (0.2, 0.1, 1.0, 0.0): "`stop` must be greater than start = 0.2",
    (0.0, np.inf, 1.0, 0.0): "`stop` must be a positive",
    (0.0, 0.1, 0.0, 0.0): "`stiffness` must be a positive",
    (0.0, 0.1, np.inf, 0.0): "`stiffness` must be a positive",
    (0.0, 0.1, 1.0, np.nan): "`rest_length` must be a",
}


@pytest.mark.parametrize(("values", "message"), BAD.items())
def test_wrong_foundations(values, message):
    with pytest.raises(ValueError, match=message):
        jw.Foundation(*values)


def test_a_traced_foundation_is_valid_where_the_constructor_accepts_it():
    for values in GOOD:
        assert bool(jw.Foundation(*values).valid())
    rows = jnp.array([GOOD[0], *BAD, *GOOD[1:]])
    valid = jax.jit(jax.vmap(lambda row: jw.Foundation(*row).valid()))(rows)
    assert valid.tolist() == [True, *[False] * len(BAD), True, True]
