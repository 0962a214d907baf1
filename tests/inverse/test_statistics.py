"""Statistics: plausibility of chi-squared, and the combinations of parameters that signals do not determine."""

import numpy as np
import pytest

from jaxwhisker._inverse.statistics import (
    CHI2_95,
    NORMAL_95,
    chi_squared,
    correlation,
    identifiability,
    is_plausible,
    noise_of_residuals,
)

NAMES, LOG, SCALE = ("a", "b", "x"), np.array([True, True, False]), np.array([1.0, 1.0, 0.5])


@pytest.fixture
def jacobian():
    return 1e3 * np.random.default_rng(0).standard_normal((50, 3))


def test_95_percent():
    draws = np.random.default_rng(0).standard_normal(200_000)
    assert np.mean(np.abs(draws) < NORMAL_95) == pytest.approx(0.95, abs=2e-3)
    assert np.mean(draws**2 < CHI2_95) == pytest.approx(0.95, abs=2e-3)


def test_plausible_sums_of_squares():
    draws = np.random.default_rng(0).standard_normal((1000, 500))
    assert all(is_plausible(chi_squared(row), 500) for row in draws)
    assert not any(is_plausible(chi_squared(1.5 * row), 500) for row in draws)
    assert not is_plausible(9.5e6, 85) and not is_plausible(np.nan, 85)
    assert chi_squared(np.array([[3.0], [4.0]])) == 25.0


def test_noise_is_the_root_mean_square_of_residuals_with_fewer_degrees_of_freedom():
    off = np.array([[3.0, 1e-9, 7.0], [-4.0, np.nan, 7.0], [0.0, -1e-9, np.nan]])
    known = np.array([[True, True, False], [True, False, False], [True, True, False]])
    noise = noise_of_residuals(off, known, 1, np.array([0.0, 1e-3, 1e-3]))
    # 5 values and one unknown; the second kind is at its least noise, and the third has no residuals.
    np.testing.assert_allclose(noise, [np.sqrt(25 / 3 * 5 / 4), 1e-3, 1.0])


def test_everything_is_identifiable(jacobian):
    known = identifiability(jacobian, NAMES, LOG, SCALE)
    assert known.rank == 3 and known.identified.all() and not known.combinations
    np.testing.assert_allclose(known.covariance, np.linalg.inv(jacobian.T @ jacobian))
    np.testing.assert_allclose(np.diag(correlation(known.covariance)), 1.0)


def test_one_parameter_changes_no_signal(jacobian):
    alone = identifiability(jacobian * [1.0, 0.0, 1.0], NAMES, LOG, SCALE)
    assert alone.combinations == ("b alone changes no signal",) and alone.identified.tolist() == [True, False, True]
    assert alone.rank == 2 and alone.condition == np.inf


def test_two_parameters_change_signals_alike(jacobian):
    together = identifiability(jacobian[:, [0, 0, 1]] * [1.0, -2.0, 1.0], NAMES, LOG, SCALE)
    assert together.combinations == ("a +1 % with b +0.5 % changes no signal",)
    assert np.isnan(together.covariance[0]).all() and together.covariance[2, 2] > 0


def test_a_logarithm_that_is_known_to_a_factor_is_not_identifiable(jacobian):
    weak = identifiability(jacobian * [1e-5, 1.0, 1.0], NAMES, LOG, SCALE)
    assert weak.rank == 2 and "a alone is determined only to within a factor of" in weak.combinations[0]
    # A parameter of either sign has no natural size: a large error is an error.
    assert identifiability(jacobian * [1.0, 1.0, 1e-5], NAMES, LOG, SCALE).identified.all()
