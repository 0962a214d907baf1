"""Profiles in general: their slopes, lowest points, bisection."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._model.profile import bisect

EXACT = 1e-12
SAME = 1e-8  # lowest points from two computations
PROFILES = [
    *(jw.Parabola(0.3, 2.0, 0.4), jw.Circle(0.2, 0.7, -0.1), jw.Ellipse(0.2, 0.5, 0.9)),
    *(jw.Graph(lambda x: 0.2 * jnp.cosh(9 * x)), jw.Tilted(jw.Ellipse(0.2, 0.5, 0.9), 0.4)),
    jw.Contour.like(jw.Circle(0.2, 0.7), (-1.0, 1.0)),
]


@pytest.mark.parametrize("profile", PROFILES, ids=str)
def test_the_slope_is_the_direction_of_the_tangent(profile):
    low, high = profile.ends()
    for share in (0.3, 0.5, 0.6):
        parameter = jnp.asarray(max(low, -1.5) * (1 - share) + min(high, 1.5) * share)
        point = profile.point(parameter)
        dx, dy = jax.jacfwd(lambda p: jnp.stack(profile.point(p)[:2]))(parameter)
        size = np.hypot(dx, dy)
        np.testing.assert_allclose([point.cos, point.sin], [dx / size, dy / size], atol=1e-9)


@pytest.mark.parametrize("profile", PROFILES, ids=str)
def test_the_speed_is_that_of_the_point(profile):
    for slope in (-0.9, 0.1, 0.6):
        parameter = profile.at_slope(slope)
        x, y = jax.jacfwd(lambda p: jnp.stack(profile.point(p)[:2]))(parameter)
        np.testing.assert_allclose(profile.speed(parameter), np.hypot(x, y), rtol=EXACT)


@pytest.mark.parametrize("profile", PROFILES, ids=str)
def test_the_parameter_of_a_slope(profile):
    for slope in (-0.9, 0.0, 0.6):
        at = profile.point(profile.at_slope(slope))
        np.testing.assert_allclose(jnp.arctan2(at.sin, at.cos), slope, atol=EXACT)
    at = profile.point(profile.lowest())
    np.testing.assert_allclose((at.x, at.y), profile.vertex(), atol=SAME)


@pytest.mark.parametrize("profile", PROFILES, ids=str)
def test_other_units_scale_points(profile):
    slope = 0.4
    at, small = (p.point(p.at_slope(slope)) for p in (profile, profile.in_unit(10.0)))
    np.testing.assert_allclose([10 * small.x, 10 * small.y, small.cos, small.sin], at, atol=SAME)


@pytest.mark.parametrize("profile", PROFILES, ids=str)
def test_the_first_touch_lies_on_the_object_at_the_height_of_the_tip(profile):
    for side in (1.0, -1.0):
        touch = profile.first_touch(0.5, side)
        at = profile.point(touch.parameter)
        np.testing.assert_allclose([touch.x, touch.y], [at.x, at.y], atol=EXACT)
        np.testing.assert_allclose(touch.y, 0.5, atol=SAME)
        assert side * (touch.x - profile.vertex()[0]) > 0


def test_bisection_ends_at_the_last_point_inside():
    root = bisect(lambda x: x**3 < 2.0, 0.0, 5.0)
    assert float(root) == pytest.approx(2.0 ** (1 / 3), abs=EXACT)
    assert float(bisect(lambda x: x < 9.0, 0.0, 5.0)) == pytest.approx(5.0, abs=EXACT)
    assert float(bisect(lambda x: x < -1.0, 0.0, 5.0)) == 0.0
