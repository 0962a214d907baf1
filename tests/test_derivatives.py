"""Derivatives of steps and events: both modes against each other and against differences of the engine."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from scenes import model, told

MODES = 1e-10  # forward against reverse
DIFFERENCES = 1e-6  # central differences with step 1e-5 lose half the digits
CONTROL = jnp.array([0.72, 0.3, 0.0, -0.5, -1.0, -1.25, -1.38])
EVENTS = 9


def observed(parameters):
    stiffness, distance, length, bending_stiffness, rest_length = parameters
    whisker = jw.Whisker(length, bending_stiffness)
    support = jw.Support.fbfb([stiffness, 1.3 * stiffness], rest_length)
    result = jw.scan(jw.Scene(whisker, jw.Parabola(distance), support), CONTROL)
    events = jnp.concatenate([result.events.control[:EVENTS], result.events.after.mz[:EVENTS].ravel()])
    return jnp.concatenate([result.fx.ravel(), result.mz.ravel(), result.base_x.ravel()]), events


compiled = jax.jit(observed)
at = jnp.array([80.0, 0.25, 1.1, 0.9, 0.2])


@pytest.fixture(scope="module")
def forward():
    return jax.jit(jax.jacfwd(observed))(at)


def test_forward_agrees_with_differences(forward):
    # Steps before, between and after the snaps, and the positions of all events, snap-off included.
    value = compiled(at)
    for part in (0, 1):
        known = np.isfinite(value[part])
        assert known.sum() >= 4 * EVENTS if part == 0 else known.sum() > EVENTS
        for k in range(at.size):
            step = 1e-5 * jnp.eye(at.size)[k]
            difference = (np.asarray(compiled(at + step)[part]) - np.asarray(compiled(at - step)[part])) / 2e-5
            error = np.abs(np.asarray(forward[part])[:, k] - difference) / (1 + np.abs(difference))
            assert np.max(error[known]) < DIFFERENCES
            assert np.max(np.abs(difference[known])) > 1e-4  # not a comparison of zeros


def test_reverse_is_forward(forward):
    reverse = jax.jit(jax.jacrev(observed))(at)
    for a, b in zip(forward, reverse, strict=True):
        np.testing.assert_allclose(a, b, atol=MODES)


def test_free_whiskers_have_zero_derivatives():
    def force(stiffness):
        return jw.scan(model("FB", stiffness), jnp.array([0.75, 0.7])).fx

    assert np.all(np.asarray(jax.jacrev(force)(70.0)) == 0)
    assert np.all(np.asarray(jax.jacfwd(force)(70.0)) == 0)


def test_a_snap_moves_with_the_stiffness_as_differences_say():
    def snap_off(stiffness):
        return jw.scan(model("FB", stiffness), jnp.array([0.75, -1.5])).events.control[4]

    slope = jax.grad(snap_off)(70.0)
    ends = [told(jw.scan(model("FB", 70.0 + d)))[-1][2] for d in (-1e-3, 1e-3)]
    assert abs(slope - (ends[1] - ends[0]) / 2e-3) < DIFFERENCES
    assert slope < -1e-4
