"""Estimates of a fit: uncertainty of parameters from derivatives by the fit's variables, against the inverse matrix."""

import numpy as np
import pytest

from jaxwhisker._inverse.estimates import Estimates, estimates_of
from jaxwhisker._inverse.parameters import Transforms
from jaxwhisker._inverse.statistics import NORMAL_95, FitStatus

NAMES = ("stiffness", "place", "share")
DIFFERENCE = 1e-6
SAME = 1e-8  # with derivatives by differences
# In log, linear with a scale, and linear between bounds.
TRANSFORMS = Transforms.of([True, False, False], [1.0, 10.0, 1.0], [(0.0, np.inf), (-np.inf, np.inf), (0.0, 1.0)])
X = np.array([70.0, -3.0, 0.9])
BY_X = np.array([[0.3, 1.0, 2.0], [0.1, -2.0, 5.0], [0.0, 4.0, 1.0], [-0.2, 1.0, 9.0]])


def found(by_x=BY_X, status=FitStatus.ok):
    """Estimates of a model that is linear in the parameters, from its derivatives by the fit's variables."""
    y = TRANSFORMS.variables(X)
    rates = [
        (TRANSFORMS.natural(y + DIFFERENCE * step, np) - TRANSFORMS.natural(y - DIFFERENCE * step, np))
        for step in np.eye(3)
    ]
    by_y = by_x @ np.array(rates).T / (2 * DIFFERENCE)
    fields = estimates_of(NAMES, TRANSFORMS, y, np.array([1.0, -2.0, 0.5, 0.0]), by_y, status)
    return Estimates(**fields, reason="" if status == FitStatus.ok else "too noisy", degrees=1, steps=7)


def test_errors_are_those_of_the_inverse_of_the_information():
    fit, covariance = found(), np.linalg.inv(BY_X.T @ BY_X)
    np.testing.assert_allclose(list(fit.estimates.values()), X, rtol=1e-12)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=SAME)
    errors = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(list(fit.standard_error.values()), errors, rtol=SAME)
    np.testing.assert_allclose(fit.correlation, covariance / np.outer(errors, errors), rtol=SAME)
    assert fit.chi2 == 5.25 and all(fit.identified.values()) and not fit.combinations


def test_intervals_are_symmetric_in_log_and_end_at_bounds():
    fit, reach = found(), NORMAL_95 * np.sqrt(np.diag(np.linalg.inv(BY_X.T @ BY_X)))
    low, high = fit.interval["stiffness"]
    assert low * high == pytest.approx(X[0] ** 2) and high / X[0] == pytest.approx(np.exp(reach[0] / X[0]))
    assert fit.interval["place"] == pytest.approx((X[1] - reach[1], X[1] + reach[1]))
    low, high = fit.interval["share"]
    assert low == pytest.approx(X[2] - reach[2]) and X[2] + reach[2] > 1.0 and high == 1.0


def test_a_parameter_that_changes_no_signal_has_no_error():
    fit = found(BY_X * [1.0, 0.0, 1.0])
    assert fit.identified == {"stiffness": True, "place": False, "share": True}
    assert np.isnan(fit.standard_error["place"]) and np.isfinite(fit.standard_error["share"])
    expected = np.linalg.inv(BY_X[:, ::2].T @ BY_X[:, ::2])
    np.testing.assert_allclose(fit.covariance[::2, ::2], expected, rtol=SAME)
    words = str(fit)
    assert "not identifiable: place alone changes no signal." in words
    (row,) = (line for line in words.splitlines() if line.strip().startswith("place"))
    assert "not identified" in row and " to " not in row and "nan" not in words


def test_a_fit_that_failed_has_no_errors():
    fit = found(status=FitStatus.implausible)
    assert np.isnan(fit.covariance).all() and np.isnan(list(fit.standard_error.values())).all()
    np.testing.assert_allclose(list(fit.estimates.values()), X, rtol=1e-12)
    first, *_, last = str(fit).splitlines()
    assert first == "NOT A GOOD FIT (implausible): too noisy"
    assert last == "chi^2 = 5.25 with 1 degrees of freedom, 7 steps"
    assert "unknown" in str(fit) and "identified" not in str(fit)
