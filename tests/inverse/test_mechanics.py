"""Readings within jit and outside it, and values in units of their noise."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._inverse.mechanics import Readings, root_of, whitened
from jaxwhisker._inverse.observations import read_observations

KINDS = ("fx", "fy", "mz")
RANDOM = np.random.default_rng(0)
MEASURED = {"control": np.arange(5.0)} | {kind: RANDOM.standard_normal((5, 2)) for kind in KINDS}
SIGMA = {"fx": 0.1, "fy": 0.2, "mz": np.full((5, 2), 0.3)}
ROUNDING = 1e-14


def test_readings_within_jit_are_those_of_observations():
    outside = Readings.of(read_observations(MEASURED, SIGMA))
    inside = jax.jit(lambda measured: Readings.traced(measured, SIGMA, KINDS, 2))(MEASURED)
    assert outside.poses is None and outside.slips is None
    jax.tree.map(np.testing.assert_array_equal, inside, outside)


def test_signals_of_unknown_noise_are_exact():
    assert Readings.of(read_observations(MEASURED)).noise is None
    assert jax.jit(lambda measured: Readings.traced(measured, None, KINDS, 2))(MEASURED).noise is None
    first = {name: values if name == "control" else values[:, 0] for name, values in MEASURED.items()}
    noise = Readings.of(read_observations(first, 0.1, whiskers=2)).noise
    assert np.all(noise[:, 0] == 0.1) and np.all(np.isfinite(noise[:, 1]))  # nothing was measured of the second whisker


def test_values_in_units_of_their_noise():
    deviation, values = RANDOM.uniform(0.1, 1.0, (2, 3)), jnp.asarray(RANDOM.standard_normal((2, 3)))
    root = root_of(deviation)
    np.testing.assert_array_equal(root @ root.swapaxes(1, 2), [np.diag(own**2) for own in deviation])
    np.testing.assert_allclose(whitened(jnp.asarray(1 / deviation), values), values / deviation, rtol=ROUNDING)
    inverse = jnp.asarray(np.linalg.inv(root))
    np.testing.assert_allclose(whitened(inverse, values), values / deviation, rtol=ROUNDING)
    # Channels that share their noise.
    root = np.tril(RANDOM.standard_normal((2, 3, 3))) + 2 * np.eye(3)
    white = whitened(jnp.asarray(np.linalg.inv(root)), values)
    np.testing.assert_allclose(np.einsum("kij,kj->ki", root, white), values, atol=ROUNDING)
