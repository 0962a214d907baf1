"""User-defined surfaces that are not convex; those that are convex are tested with solids."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from jaxwhisker._model.user_surface import Surface

EXACT = 1e-12


def wave(x):
    """Negative above a wave with walls of a slope of 2."""
    return 0.5 + 0.2 * jnp.sin(10.0 * x[0]) - x[1]


WAVE = Surface(wave, (0.0, 2.0, 0.0), convex=False)


def distance(x, y):
    places = np.linspace(x - 1.5, x + 1.5, 3001)

    def away(at):
        return np.hypot(at - x, 0.5 + 0.2 * np.sin(10.0 * at) - y)

    nearest = places[np.argmin(away(places))]
    found: Any = minimize_scalar(away, bounds=(nearest - 1e-3, nearest + 1e-3), method="bounded")
    return found.fun


def test_the_surface_does_not_enter_balls_before_it():
    points = np.random.default_rng(0).uniform((-0.6, -0.5, -1.0), (0.6, 0.65, 1.0), (200, 3))
    points = points[np.asarray(jax.vmap(WAVE.level)(jnp.asarray(points))) > 0]
    radii, ways = map(np.asarray, jax.vmap(WAVE.ball_before)(jnp.asarray(points)))
    exact = np.array([distance(x, y) for x, y, _ in points])
    assert np.all(radii < exact + 1e-9)
    assert np.all(radii > 0.2 * exact)  # steps of free whiskers are not much shorter than they could be
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 1.0, atol=EXACT)


def test_near_the_surface_the_radius_is_the_distance():
    for x in (-0.1, 0.0, 0.13):
        at = jnp.array([x, 0.5 + 0.2 * np.sin(10.0 * x), 0.3])
        for off in (1e-4, -1e-4):
            radius, _ = WAVE.ball_before(at + off * WAVE.normal(at))
            np.testing.assert_allclose(radius, off, rtol=0.01)


def test_far_away_and_where_the_gradient_vanishes_balls_are_finite():
    well = Surface(lambda x: 1.0 - jnp.sum(x**2), (2.0, 0.0, 0.0), convex=False)
    radius, way = well.ball_before(jnp.zeros(3))
    assert 0.4 < radius <= 1.0 and np.all(np.isfinite(way))
    radius, _ = WAVE.ball_before(jnp.array([0.0, -1e4, 0.0]))
    assert 50.0 < radius <= 1e4


def test_no_plane_is_known_before_an_object_that_is_not_convex():
    assert WAVE.plane_before(jnp.array([0.0, -1.0, 0.0]))[0] < 0
    assert not WAVE.is_convex and not WAVE.in_unit(2.0).is_convex and not WAVE.moved((0.1, 0.0, 0.0)).is_convex
    assert Surface(lambda x: jnp.sum(x**2) - 1, (0.0, 0.0, 0.0)).is_convex


def test_convex_must_be_true_or_false():
    with pytest.raises(ValueError, match="`convex` must be True or False, got 1"):
        Surface(wave, (0.0, 2.0, 0.0), convex=1)
