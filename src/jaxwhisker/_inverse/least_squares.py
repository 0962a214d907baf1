"""The least-squares loop of all fits: Levenberg-Marquardt in NumPy.

Residuals and their derivatives come from functions that each kind of fit supplies.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxwhisker._inverse.statistics import chi_squared

FIT_STEPS = 60  # of Levenberg-Marquardt
FINAL = 1e-6  # decrease of the sum of squares below which a fit ends: within 1e-3 standard errors of the minimum
SMALL = 1e-7  # change of variables of order one, and of residuals, below which a fit ends as well
RIDGE = 1e-14  # added to the diagonal of a scaled normal matrix, which is zero for an unknown that stays fixed
LEAST_SHARE, GOOD_SHARE = 0.01, 0.99  # of the predicted decrease: a step is accepted, the damping is reduced
NEGLIGIBLE = 1e-2  # possible decrease of chi-squared (a tenth of a standard error) that a converged fit may leave
LESS, MORE = 1 / 3.5, 4.0  # factors of the damping after a good step and after a rejected one

Residuals = Float[np.ndarray, " residuals"]
Jacobian = Float[np.ndarray, "residuals unknowns"]


class Evaluation(NamedTuple):
    """Residuals at one point, and their derivatives with respect to the fit's variables."""

    residual: Residuals
    jacobian: Jacobian
    compared: tuple[Any, ...] = ()  # values behind the residuals of each recording
    scans: tuple[Any, ...] = ()  # scans that these follow from


class Minimum(NamedTuple):
    """The end of a least-squares fit: a minimum, if it converged."""

    y: Float[np.ndarray, " unknowns"]
    residual: Residuals
    jacobian: Jacobian
    compared: tuple[Any, ...]  # of the last evaluation
    steps: int
    converged: bool

    @property
    def misfit(self) -> float:
        """Sum of squares of all residuals, including those of the prior."""
        return chi_squared(self.residual)

    @property
    def reached(self) -> bool:
        """Whether this is a minimum, or so close to one that another step would hardly lower the sum of squares."""
        return self.converged or not possible_decrease(self.residual, self.jacobian) > NEGLIGIBLE

    @property
    def observed(self) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and their derivatives, without those of the prior."""
        rows = self.residual.size - self.y.size
        return self.residual[:rows], self.jacobian[:rows]


def minimise(
    evaluate: Callable[[np.ndarray], Evaluation],
    y: np.ndarray,
    least: float,
    improve: Callable[[np.ndarray, Evaluation], tuple[np.ndarray, Evaluation]] = lambda y, at: (y, at),
    share: float = 0.0,
) -> Minimum:
    """Levenberg-Marquardt: end when another step would not lower the sum of squares by more than `least`.

    `improve` may move each trial to a better one nearby. A fit that noise does not explain also ends where a step would
    not lower the sum of squares by more than this `share` of what exceeds one for each residual.

    Otherwise unknowns that are hardly determined would keep moving for many steps, and near the minimum rounding would
    decide which steps are accepted.

    Source: Gould, Orban, Sartenaer, Toint (2005), 4OR 3, "Sensitivity of trust-region algorithms to their parameters"
    (for the rule that changes the damping).
    """
    y, at = improve(y, evaluate(y))
    steps, damping, small = 1, 1.0, False
    while steps < FIT_STEPS and np.isfinite(at.residual).all() and np.isfinite(at.jacobian).all():
        enough = max(least, share * (chi_squared(at.residual) - at.residual.size))
        if small or possible_decrease(at.residual, at.jacobian) < enough:
            return Minimum(y, *at[:3], steps, True)
        step = _damped_step(at, damping)
        (moved, trial), steps = improve(y + step, evaluate(y + step)), steps + 1
        decrease = chi_squared(at.residual) - chi_squared(trial.residual)
        predicted = chi_squared(at.residual) - chi_squared(at.residual + at.jacobian @ step)
        if not decrease >= LEAST_SHARE * predicted:
            damping *= MORE
            continue
        damping *= LESS if decrease > GOOD_SHARE * predicted > 0 else 1.0
        small = _is_small(moved - y, moved) and _is_small(trial.residual - at.residual, trial.residual)
        y, at = moved, trial
    return Minimum(y, *at[:3], steps, False)


def _damped_step(at: Evaluation, damping: float) -> np.ndarray:
    rotated, triangle = np.linalg.qr(at.jacobian)
    rows = np.concatenate([triangle, np.sqrt(damping) * np.eye(triangle.shape[1])])
    right = np.concatenate([rotated.T @ at.residual, np.zeros(triangle.shape[1])])
    return -np.linalg.lstsq(rows, right, rcond=None)[0]


def _is_small(change: np.ndarray, value: np.ndarray) -> bool:
    return bool(np.all(np.abs(change) < SMALL * (1 + np.abs(value))))


def possible_decrease(residual: Residuals, jacobian: Jacobian) -> float:
    """Decrease of the sum of squares that a Gauss-Newton step predicts."""
    size = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(size > 0, size, 1.0)
    slope, bend = scaled.T @ residual, scaled.T @ scaled + RIDGE * np.eye(size.size)
    return float(slope @ np.linalg.solve(bend, slope))
