"""Loads that grow: solutions in closed form, limit points and bifurcations where stability is lost, failed lanes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from jaxwhisker._base.load_path import SHORTEST, follow

SOLVED = 1e-12
NEAR = 1e-3  # a limit point is approached with the square root of the distance in load


@jax.jit
@jax.vmap
def cubic(stiffening, load):
    """One unknown with the force a + stiffening a^3."""

    def equations(a, share):
        return a + stiffening * a**3 - share * load

    return follow(equations, jnp.zeros(1), load)


def test_solutions_in_closed_form_and_a_lane_that_fails():
    stiffening, load = np.array([0.0, 2.0, np.nan, 0.5]), np.array([3.0, 40.0, 1.0, 1e-3])
    path = cubic(stiffening, load)
    assert path.share.tolist() == [1.0, 1.0, 0.0, 1.0] and not path.lost.any()
    for k in (0, 1, 3):
        exact = brentq(lambda a, k=k: a + stiffening[k] * a**3 - load[k], 0.0, 50.0, xtol=1e-15)
        assert path.unknowns[k, 0] == pytest.approx(exact, rel=SOLVED)


def test_stability_is_lost_at_the_largest_load():
    # a - a^3 / 3 has its maximum 2/3 at 1.
    path = cubic(np.full(3, -1 / 3), np.array([0.66, 0.67, 5.0]))
    assert path.lost.tolist() == [False, True, True] and path.share[0] == 1.0
    np.testing.assert_allclose(path.share[1:] * np.array([0.67, 5.0]), 2 / 3, atol=NEAR**2)
    np.testing.assert_allclose(path.unknowns[1:, 0], 1.0, atol=NEAR)
    exact = brentq(lambda a: a - a**3 / 3 - 0.66, 0.0, 1.0, xtol=1e-15)
    assert path.unknowns[0, 0] == pytest.approx(exact, rel=SOLVED)


def test_stability_is_lost_where_another_branch_begins():
    @jax.jit
    @jax.vmap
    def column(load):
        """One unknown grows with the load; the other one stays zero, and buckles at a load of 2."""

        def equations(a, share):
            return jnp.stack([a[0] - 0.1 * share * load, a[1] * (2.0 - share * load) + a[1] ** 3])

        return follow(equations, jnp.zeros(2), load)

    load = np.array([1.9, 2.5])
    path = column(load)
    assert path.lost.tolist() == [False, True]
    np.testing.assert_allclose(path.share * load, [1.9, 2.0], atol=10 * SHORTEST)
    np.testing.assert_allclose(path.unknowns, np.stack([0.1 * path.share * load, np.zeros(2)], axis=1), atol=SOLVED)
