"""Least squares: the steps of Levenberg-Marquardt, and where they end."""

import numpy as np
import pytest

from jaxwhisker._inverse.least_squares import FIT_STEPS, Evaluation, Minimum, minimise, possible_decrease

MINIMUM = 1e-6  # of variables of order one


def test_possible_decrease_of_a_linear_problem():
    rng = np.random.default_rng(0)
    jacobian, residual = rng.standard_normal((20, 3)) * [1.0, 1e-6, 1e6], rng.standard_normal(20)
    _, (left,), *_ = np.linalg.lstsq(jacobian / [1.0, 1e-6, 1e6], residual, rcond=None)
    expected = residual @ residual - left
    assert possible_decrease(residual, jacobian) == pytest.approx(expected)
    held = jacobian.copy()
    held[:, 1] = 0.0
    assert 0 < possible_decrease(residual, held) <= expected


def test_a_minimum_is_reached_where_another_step_would_hardly_help():
    jacobian, y = np.array([[1.0], [0.0]]), np.zeros(1)
    # A step of a tenth of a standard error lowers the sum of squares by 0.01.
    for slope, converged, reached in ((0.09, False, True), (0.11, False, False), (0.11, True, True)):
        solution = Minimum(y, np.array([slope, 1.0]), jacobian, (), 3, converged)
        assert solution.reached == reached


def rosenbrock(y):
    """Residuals of Rosenbrock's function, whose minimum, zero, lies in a bent valley."""
    residual = np.array([10 * (y[1] - y[0] ** 2), 1 - y[0]])
    return Evaluation(residual, np.array([[-20 * y[0], 10.0], [-1.0, 0.0]]))


def test_steps_lead_through_a_bent_valley():
    values = []

    def evaluate(y):
        values.append(y)
        return rosenbrock(y)

    solution = minimise(evaluate, np.array([-1.2, 1.0]), least=1e-14)
    assert solution.converged and solution.steps == len(values)
    np.testing.assert_allclose(solution.y, 1.0, atol=MINIMUM)
    assert solution.misfit == min(np.sum(rosenbrock(y).residual ** 2) for y in values)


def test_a_fit_ends_where_little_can_be_gained():
    start = np.array([-1.2, 1.0])
    assert minimise(rosenbrock, start, least=1e3).steps == 1
    assert minimise(rosenbrock, start, least=1e-2).steps < minimise(rosenbrock, start, least=1e-14).steps


def test_a_fit_that_noise_does_not_explain_ends_where_it_stalls():
    def far(offset):
        return lambda y: Evaluation(
            np.append(rosenbrock(y).residual, offset), np.pad(rosenbrock(y).jacobian, [(0, 1), (0, 0)])
        )

    start = np.array([-1.2, 1.0])
    steps = {offset: minimise(far(offset), start, 1e-14, share=1e-2).steps for offset in (0.0, 10.0)}
    assert steps[10.0] < steps[0.0] == minimise(rosenbrock, start, 1e-14).steps
    assert minimise(far(10.0), start, 1e-14).steps == steps[0.0]


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_fit_without_values_does_not_converge(wrong):
    solution = minimise(lambda y: Evaluation(np.full(3, wrong), np.ones((3, 1))), np.zeros(1), 1e-6)
    assert not solution.converged and solution.steps == 1


def test_a_step_without_a_value_is_replaced_by_shorter_ones():
    def wall(y):
        return Evaluation(np.array([y[0] + 1 if y[0] > 0 else np.nan]), np.ones((1, 1)))

    solution = minimise(wall, np.ones(1), 1e-6)
    assert 1 < solution.steps <= FIT_STEPS
    assert 0 < solution.y[0] < 1e-6 and np.isfinite(solution.misfit)
