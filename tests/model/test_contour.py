"""Contours given by their radius of curvature: points, vertex, first touch, scans, derivatives, errors."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

import jaxwhisker as jw
from scenes import all_ok, in_both_modes

EXACT = 1e-12  # rounding: every spline represents the radius of a circle
QUADRATURE = 1e-11  # relative to the radius: the interpolation between nodes
CIRCLE = 1e-9  # of signals: the tolerance of Newton's method
PARABOLA = 1e-4  # relative to peaks: log rho = -3 log cos(alpha) as a spline through 16 knots
DIFFERENCE = 1e-5
DIFFERENCES = 1e-5  # of central differences, relative: some steps change their phase between the two
MODES = 1e-9
KNOTS = tuple(np.linspace(-1.2, 1.2, 16))
CONTROL = np.linspace(0.9, -1.7, 131)


def quadrature(contour, slope):
    """x and y relative to the vertex, by quadrature with scipy."""
    spline = CubicSpline(contour.slopes, np.asarray(contour.log_radius))
    low, high = sorted([0.0, slope])
    ends = [low, *[k for k in contour.slopes if low < k < high], high]

    def along(function):
        pieces = pairwise(ends)
        return np.sign(slope) * sum(
            quad(lambda a: np.exp(spline(a)) * function(a), *p, epsabs=1e-14)[0] for p in pieces
        )

    return along(np.cos), along(np.sin)


def test_a_constant_radius_is_a_circle():
    contour, circle = jw.Contour.like(jw.Circle(0.2, 0.7, -0.1), KNOTS), jw.Circle(0.2, 0.7, -0.1)
    slopes = jnp.linspace(-1.57, 1.57, 201)
    ours, exact = (jax.vmap(profile.point)(slopes) for profile in (contour, circle))
    for actual, expected in zip(ours, exact, strict=True):
        np.testing.assert_allclose(actual, expected, rtol=0, atol=EXACT)
    assert contour.vertex() == pytest.approx(circle.vertex(), abs=EXACT)
    for side in (1.0, -1.0):
        for height in (0.5, 0.85):
            actual, expected = (profile.first_touch(height, side)[:3] for profile in (contour, circle))
            np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-10)
    higher = contour.first_touch(1.5, 1.0)
    assert abs(higher.x - 0.6) < EXACT and abs(higher.y - 0.9) < 1e-5


@pytest.mark.parametrize("slope", [-1.15, -0.3, 0.01, 0.7, 1.19])
def test_points_are_integrals_of_the_radius(slope):
    contour = jw.Contour.like(jw.Parabola(0.2, 1.0, 0.3), KNOTS)
    x, y = quadrature(contour, slope)
    at = contour.point(slope)
    radius = float(contour.radius(slope))
    assert abs(at.x - 0.3 - x) < QUADRATURE * radius
    assert abs(at.y - 0.2 - y) < QUADRATURE * radius
    np.testing.assert_allclose([at.cos, at.sin], [np.cos(slope), np.sin(slope)], atol=EXACT)


def test_the_vertex_may_lie_beyond_the_knots():
    contour = jw.Contour(0.3, np.zeros(3), (0.2, 0.5, 0.9), 0.1)
    at, circle = contour.point(-0.7), jw.Circle(0.3, 1.0, 0.1).point(-0.7)
    np.testing.assert_allclose(at, circle, atol=EXACT)


def test_other_units():
    contour = jw.Contour.like(jw.Parabola(0.2), KNOTS)
    at, small = contour.point(0.6), contour.in_unit(10.0).point(0.6)
    np.testing.assert_allclose([small.x, small.y], [at.x / 10, at.y / 10], atol=EXACT)


@pytest.fixture(scope="module")
def scan():
    return lambda contour: jw.scan(jw.Scene(jw.Whisker(), contour, jw.Support.fb(70.0)), CONTROL)


@pytest.mark.parametrize(("profile", "error"), [(jw.Circle(0.3, 1.0), CIRCLE), (jw.Parabola(0.2), PARABOLA)])
def test_scans(scan, profile, error):
    actual = scan(jw.Contour.like(profile, KNOTS))
    exact = jw.scan(jw.Scene(jw.Whisker(), profile, jw.Support.fb(70.0)), CONTROL)
    assert all_ok(actual)
    for name in ("fx", "fy", "mz"):
        expected = np.asarray(getattr(exact, name))
        assert np.max(np.abs(getattr(actual, name) - expected)) < error * np.max(np.abs(expected)), name


def test_derivatives(scan):
    contour = jw.Contour.like(jw.Parabola(0.2), KNOTS)

    def touch_and_signal(log_radius):
        contour = jw.Contour(0.2, log_radius, KNOTS)
        return jnp.stack([contour.first_touch(1.0, 1.0).x, jnp.sum(scan(contour).mz ** 2)])

    direction = jnp.asarray(np.random.default_rng(3).standard_normal(len(KNOTS)))
    both = in_both_modes(touch_and_signal, direction)
    ends = [both(contour.log_radius + h * direction, jnp.ones(2))[0] for h in (DIFFERENCE, -DIFFERENCE)]
    difference = (ends[0] - ends[1]) / (2 * DIFFERENCE)
    assert np.all(np.abs(difference) > 1e-3)
    for weights in jnp.eye(2):
        _, forward, reverse = both(contour.log_radius, weights)
        np.testing.assert_allclose(forward, difference, rtol=DIFFERENCES)
        np.testing.assert_allclose(reverse @ direction, weights @ forward, rtol=MODES)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-0.1, [0.0, 0.0], (0.0, 1.0)), "`distance` must be a positive finite number, got -0.1"),
        ((0.1, [0.0, 0.0], (1.0, 0.0)), r"`slopes` must be at least two strictly increasing .*, got \(1.0, 0.0\)"),
        ((0.1, [0.0, 0.0], (0.0, 1.6)), "`slopes` must be at least two .* each less than a right angle"),
        ((0.1, [0.0], (0.0,)), "`slopes` must be at least two"),
        ((0.1, [0.0, 0.0, 0.0], (0.0, 1.0)), r"`log_radius` must be one value per knot \(2\), got .* shape \(3,\)"),
        ((0.1, [0.0, np.nan], (0.0, 1.0)), "`log_radius` must be .* finite numbers, got nan at index 1"),
        ((0.1, np.ma.masked_equal([0.0, 1.0], 1.0), (0.0, 1.0)), "`log_radius` must be .* got nan at index 1"),
        ((0.1, [0.0, 0.0], (0.0, 1.0), np.inf), "`position` must be a finite number, got inf"),
    ],
)
def test_wrong_contours(arguments, message):
    with pytest.raises(ValueError, match=message):
        jw.Contour(*arguments)
