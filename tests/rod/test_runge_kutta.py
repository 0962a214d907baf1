"""The Runge-Kutta method of order 8."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._rod.runge_kutta import runge_kutta

ORDER = 8


@jax.jit
def error(of_steps):
    """Error at the time 2 of an equation in time and value with a solution in closed form."""

    def rates(t, values, factor):
        return factor * jnp.cos(t) * values

    times = jnp.linspace(0.0, 2.0, of_steps.size + 1)
    return runge_kutta(rates, jnp.ones(1), times, of_steps)[0] - jnp.exp(jnp.sin(2.0))


def test_errors_fall_with_the_eighth_power_of_the_step():
    coarse, fine = (abs(error(jnp.ones(steps))) for steps in (4, 8))
    assert ORDER - 0.5 < np.log2(coarse / fine) < ORDER + 1.5
    assert fine < 1e-9


def test_each_step_has_its_own_numbers():
    def rates(t, values, slope):
        return jnp.full_like(values, slope)

    end = runge_kutta(rates, jnp.zeros(2), jnp.array([0.0, 0.5, 2.0]), jnp.array([3.0, -2.0]))
    np.testing.assert_allclose(end, 0.5 * 3.0 - 2.0 * 1.5, rtol=1e-14)
