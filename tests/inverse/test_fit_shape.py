"""Fits of shapes to points: weights, errors and status, with circles about the origin, whose fits are exact means."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._inverse.fit_shape import (
    OUTLIER,
    PADDED,
    AbstractShapeFamily,
    AbstractShapeFit,
    Facet,
    ShapePoints,
    _carried_over,
    _inverse_root,
    fit_shape,
    nearest_quadric,
    supported_points,
)
from jaxwhisker._inverse.statistics import FitStatus

ROUNDING = 1e-12
CONVERGED = 1e-5  # standard errors
RADIUS, NOISE = 0.7, 0.01


class Rings(AbstractShapeFamily):
    """Circles about the origin, by the logarithm of their radius."""

    def shape(self, values):
        return jnp.exp(values[0])

    def facet(self, shape, position, covariance):
        turn = jnp.stack([-_outwards(position)[1], _outwards(position)[0]]) / shape
        return Facet(shape, jnp.ones((1, 1)), jnp.stack([_outwards(position), turn]), jnp.zeros(()))

    def residuals(self, shape, position, direction):
        return jnp.sum(position * _outwards(position)) - shape, direction, _outwards(position)

    def supported(self, estimates, direction):
        return estimates[0], estimates[0] * direction

    def estimates(self, values):
        return np.exp(values), np.diag(np.exp(values))


class RingFit(AbstractShapeFit):
    """A fitted circle."""

    @property
    def _shape(self):
        return "ring"


def _outwards(position):
    return position / jnp.sqrt(jnp.sum(position**2))


def points_at(distance, sigma=None):
    """Points at these distances from the origin; errors are larger along the circle."""
    angle = np.linspace(0.0, 5.0, distance.size)
    normal, along = np.stack([np.cos(angle), np.sin(angle)], 1), np.stack([-np.sin(angle), np.cos(angle)], 1)
    noise = None
    if sigma is not None:
        square = np.broadcast_to(sigma, distance.shape)[:, None, None] ** 2
        noise = square * (normal[:, :, None] * normal[:, None] + 9 * along[:, :, None] * along[:, None])
    return ShapePoints(distance[:, None] * normal, np.zeros(distance.size), noise, np.ones(distance.size), False)


def ring(distance, sigma=None, start=0.1):
    fields, facing = fit_shape(Rings(("radius",), 1.0), np.array([start]), points_at(distance, sigma))
    assert facing.shape == (PADDED, 2)
    return RingFit(**fields)


@pytest.fixture
def distance():
    return RADIUS + NOISE * np.random.default_rng(0).standard_normal(50)


def test_without_covariances_the_scatter_is_the_noise(distance):
    fit = ring(distance)
    assert fit.status == FitStatus.ok and fit.degrees_of_freedom == 49
    error = np.std(distance, ddof=1) / np.sqrt(50)
    assert abs(fit.estimates["radius"] - distance.mean()) < CONVERGED * error
    assert fit.standard_error["radius"] == pytest.approx(error)
    assert fit.chi2 == pytest.approx(50 * np.var(distance))
    assert str(fit).startswith("ring: chi^2 = ") and "\n  radius   0.70" in str(fit) and "+-" in str(fit)


def test_covariances_weight_the_points():
    sigma = NOISE * np.linspace(0.5, 2.0, 50)
    distance = RADIUS + sigma * np.random.default_rng(0).standard_normal(50)
    fit = ring(distance, sigma)
    weight = sigma**-2
    mean, error = np.sum(weight * distance) / weight.sum(), weight.sum() ** -0.5
    size = np.abs(distance - mean) / sigma
    assert fit.status == FitStatus.ok and np.sum(size > OUTLIER) == 0
    assert abs(fit.estimates["radius"] - mean) < CONVERGED * error
    assert fit.standard_error["radius"] == pytest.approx(error) and fit.chi2 == pytest.approx(np.sum(size**2))
    np.testing.assert_allclose(fit._across(np.array([[1.0], [2.0]])), [error, 2 * error])


def test_outliers_pull_no_more_than_the_limit(distance):
    distance[:3] += 20 * NOISE
    fit = ring(distance, NOISE)
    off = (distance - fit.estimates["radius"]) / NOISE
    # The condition of Huber's estimate.
    assert abs(np.sum(np.clip(off, -OUTLIER, OUTLIER))) < CONVERGED * np.sqrt(50)
    assert fit.chi2 == pytest.approx(np.sum(off**2 * np.minimum(1.0, OUTLIER / np.abs(off))))


def test_exact_points_give_the_shape_back():
    for scale in (1e-6, 1.0, 1e6):
        fit = ring(np.full(50, scale * RADIUS), start=np.log(2 * scale))
        assert fit.status == FitStatus.ok and fit.estimates["radius"] == pytest.approx(scale * RADIUS, rel=ROUNDING)


def test_a_fit_that_ends_badly_has_no_errors(distance):
    implausible = ring(distance, 0.3 * NOISE)
    assert implausible.status == FitStatus.implausible and "implausible" in str(implausible)
    assert np.isnan(implausible.standard_error["radius"]) and np.isnan(implausible._across(np.ones((1, 1)))).all()
    assert ring(distance, start=np.nan).status == FitStatus.not_converged


def test_a_parameter_that_does_not_move_the_shape_is_undetermined(distance):
    assert ring(distance, start=-1e3).status == FitStatus.undetermined


def test_points_are_padded_without_weight(distance):
    padded = points_at(distance, NOISE).padded()
    assert padded.position.shape == (PADDED, 2) and padded.covariance is not None
    assert padded.covariance.shape == (PADDED, 2, 2)
    assert padded.weight.sum() == 50 and padded.residuals == PADDED


def test_supported_points():
    direction = np.array([[1.0, 0.0], [0.6, 0.8]])
    points, by = supported_points(Rings(("radius",), 1.0), [RADIUS], direction)
    np.testing.assert_allclose(points, RADIUS * direction)
    np.testing.assert_allclose(by, [[1.0], [1.0]])


@pytest.mark.parametrize("size", [2, 3])
def test_whitened_residuals_have_unit_covariance(size):
    root = np.random.default_rng(6).standard_normal((size, size))
    white = np.asarray(_inverse_root(jnp.asarray(root @ root.T)))
    np.testing.assert_allclose(white @ root @ root.T @ white.T, np.eye(size), atol=ROUNDING)
    assert np.all(np.triu(white, 1) == 0)


def test_linear_least_squares_give_exact_quadrics_back():
    rng = np.random.default_rng(1)
    normals = rng.standard_normal((20, 2))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    matrix, linear, constant = nearest_quadric([0.2, -0.3] + RADIUS * normals)
    np.testing.assert_array_equal(matrix, np.eye(2))
    np.testing.assert_allclose(linear, [-0.4, 0.6], atol=ROUNDING)
    assert constant == pytest.approx(0.13 - RADIUS**2)
    # An ellipse: x.A x = 1 with A = diag(1.5, 0.5), whose normals are along A x.
    x = normals / np.sqrt([1.5, 0.5])
    gradient = x * [1.5, 0.5]
    for known in (None, gradient / np.linalg.norm(gradient, axis=1)[:, None]):
        matrix, linear, constant = nearest_quadric(x, known, [[[1, 0], [0, -1]], [[0, 1], [1, 0]]])
        np.testing.assert_allclose(matrix, np.diag([1.5, 0.5]), atol=ROUNDING)
        np.testing.assert_allclose([*linear, constant], [0.0, 0.0, -1.0], atol=ROUNDING)


def test_errors_are_carried_over_and_unknown_ones_only_to_what_depends_on_them():
    covariance = np.array([[4.0, 1.0, np.nan], [1.0, 9.0, np.nan], [np.nan, np.nan, np.nan]])
    rates = np.array([[2.0, 0.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 3.0]])
    found = _carried_over(covariance, rates)
    np.testing.assert_allclose(found[:2, :2], [[16.0, 6.0], [6.0, 11.0]])
    assert np.isnan(found[2]).all() and np.isnan(found[:, 2]).all()
