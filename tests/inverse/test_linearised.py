"""Linearised scans: slopes of signals with friction are those of the scan."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._inverse.linearised import LinearisedScan
from jaxwhisker._scan.route import route_of

SAME = 1e-9  # relative to the largest slope: both compute the same numbers


def test_slopes_remember_where_contacts_began_to_stick():
    def build(mu, distance):
        return jw.Scene(jw.Whisker(), jw.Parabola(distance), friction=mu)

    def signals(x):
        result = jw.scan(build(*x), control)
        return jnp.stack([result.fx, result.fy, result.mz], axis=-1)

    control = np.array([0.7, 0.2, -0.1, -0.099, -0.0985, 0.3])
    route = route_of(control)
    x = {"mu": 0.3, "distance": 0.2}
    linear = LinearisedScan(build, x, np.asarray(route.stops), route.last).signals(control, np.asarray(route.travel))
    exact = np.asarray(jax.jacfwd(signals)(jnp.array(list(x.values()))))
    np.testing.assert_allclose(linear.slopes[..., :2], exact, atol=SAME * np.max(np.abs(exact)))
    assert np.max(np.abs(exact[3:5, ..., 0])) > 1  # the contact sticks there
