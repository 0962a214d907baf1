"""Profiles fitted to points: shapes, contours, points without errors, wrong shapes and wrong input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from contacts import noisy, sensor, signals
from jaxwhisker._inverse.fit_profile import fit_profile, points_and_rates
from jaxwhisker._inverse.reconstruct import reconstruct
from jaxwhisker._inverse.statistics import FitStatus
from jaxwhisker._model.contour import Contour

POINT = 1e-7  # of the length
BIAS = 4.0  # standard errors
DIFFERENCE = 1e-6

FITS = [("FBFBR", jw.Parabola, jw.Parabola(0.2)), ("circle", jw.Circle, jw.Circle(0.3, 0.6))]


@pytest.mark.parametrize(("name", "family", "truth"), FITS)
def test_fits(name, family, truth):
    exactly = fit_profile(reconstruct(signals(name)[1], sensor(name)), family)
    assert exactly.status == FitStatus.ok
    for field, value in exactly.estimates.items():
        assert abs(value - getattr(truth, field)) < POINT
    measured, sigma = noisy(name, 2)
    fit = fit_profile(reconstruct(measured, sensor(name), sigma=sigma), family)
    assert 0.8 < fit.chi2 / fit.degrees_of_freedom < 1.2
    for field, value in fit.estimates.items():
        assert abs(value - getattr(truth, field)) < BIAS * fit.standard_error[field] < 0.01
    assert family.__name__.lower() in str(fit)


def test_a_shape_that_is_another_one_is_implausible():
    measured, sigma = noisy("circle", 2)
    fit = fit_profile(reconstruct(measured, sensor("circle"), sigma=sigma), jw.Parabola)
    assert fit.status == FitStatus.implausible and fit.chi2 > 2 * fit.degrees_of_freedom
    assert np.isnan(list(fit.standard_error.values())).all() and "implausible" in str(fit)


def test_a_contour_is_fitted():
    measured, sigma = noisy("circle", 3)
    fit = fit_profile(reconstruct(measured, sensor("circle"), sigma=sigma), Contour, knots=5)
    assert fit.status == FitStatus.ok
    x, y, error = fit.band(np.linspace(-0.5, 0.5, 5))
    off = np.hypot(x, y - 0.9) - 0.6
    assert np.all(np.abs(off) < BIAS * error) and np.all(error < 5e-3)


def test_points_without_slopes_or_errors():
    slopes = jnp.linspace(-0.8, 0.9, 40)
    at = jax.vmap(jw.Ellipse(0.2, 0.5, 0.8, 0.1).point)(slopes)
    fit = fit_profile({"x": np.asarray(at.x), "y": np.asarray(at.y)}, jw.Ellipse)
    np.testing.assert_allclose(list(fit.estimates.values()), [0.2, 0.5, 0.8, 0.1], atol=1e-6)
    few = fit_profile({"x": np.array([0.0, 0.0, 0.0]), "y": np.array([0.2, 0.2, 0.2])}, jw.Circle)
    assert few.status != FitStatus.ok and np.isnan(few.standard_error["radius"]) and "unknown" in str(few)


def test_rates_of_a_contour_are_those_of_differences():
    contour, slopes = Contour(0.2, np.log([0.5, 0.8, 0.4]), (-0.6, 0.1, 0.7), 0.1), np.array([-0.5, 0.0, 0.4])
    x, y, by = points_and_rates(contour, slopes)
    at = jax.vmap(contour.point)(jnp.asarray(slopes))
    np.testing.assert_allclose((x, y), (at.x, at.y), rtol=1e-12)

    def normal(distance, position, *log_radius):
        at = jax.vmap(Contour(distance, np.array(log_radius), contour.slopes, position).point)(jnp.asarray(slopes))
        return np.asarray(at.x * jnp.sin(slopes) - at.y * jnp.cos(slopes))

    values = np.array([0.2, 0.1, *contour.log_radius])
    for k, step in enumerate(DIFFERENCE * np.eye(values.size)):
        difference = (normal(*(values + step)) - normal(*(values - step))) / (2 * DIFFERENCE)
        np.testing.assert_allclose(by[:, k], difference, atol=1e-8)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("points", "family", "guess", "words"),
    [
        ({"x": np.zeros(3), "y": np.zeros(3)}, jw.Graph, None, "`family`.*Graph"),
        ({"x": np.zeros(3)}, jw.Circle, None, r"`points`.*\['x'\]"),
        (3.0, jw.Circle, None, "`points`.*3.0"),
        ({"x": np.zeros(3), "y": np.zeros(4)}, jw.Circle, None, r"`points`.*\(4,\) for y"),
        ({"x": np.zeros(3), "y": np.full(3, np.nan)}, jw.Circle, None, "`points`.*finite"),
        ({"x": np.zeros(3), "y": np.zeros(3), "sigma": 0.0}, jw.Circle, None, "`points`.*sigma, got 0.0"),
        ({"x": np.zeros(3), "y": np.zeros(3), "covariance": np.eye(2)}, jw.Circle, None, r"`points`.*\(2, 2\)"),
        ({"x": np.arange(2.0), "y": np.ones(2)}, jw.Circle, None, "`points`.*3 parameters, got 2"),
        ({"x": np.zeros(3), "y": np.zeros(3)}, jw.Circle, jw.Parabola(0.2), "`guess` must be a Circle"),
    ],
)
def test_wrong_arguments(points, family, guess, words):
    with pytest.raises(ValueError, match=words):
        fit_profile(points, family, guess=guess)
