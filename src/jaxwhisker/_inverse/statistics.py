"""Statistics that all fits share: how a fit ended, chi-squared, 95 % intervals, and what the data determine."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxwhisker._base.types import NamedInt

NORMAL_95 = 1.959963984540054  # standard deviations on either side of the mean that hold 95 %
CHI2_95 = NORMAL_95**2  # rise of chi-squared at the ends of a 95 % interval of one parameter
DEVIATIONS = 6.0  # standard deviations of chi-squared above its mean from which a misfit is implausible

RELATIVE_ZERO = 1e-7  # of the largest singular value: below it a direction changes no signal; derivatives err by 1e-9
NOTHING = 1e-9  # of the largest column of derivatives: a parameter with a smaller one changes no signal
LARGEST_LOG_ERROR = 1.0  # standard error of a logarithm above which a parameter is not identified: a factor of e
NAMED = 0.05  # of a direction's largest component: parameters with smaller components are not named
INVOLVED = 1e-4  # a parameter with a larger component in a direction that changes no signal is not identified

SETTLED = 0.1  # of the standard errors: largest remaining Gauss-Newton step of a converged fit to points
EXACTLY = 1e-8  # the same in absolute terms, for logs of lengths
WORST_CONDITION = 1e13  # of the scaled normal matrix: beyond, the points do not determine all parameters


class FitStatus(NamedInt):
    """How a fit ended; only a fit with status `ok` has standard errors."""

    ok = 0
    implausible = 1  # noise does not explain the residuals: another scene, another minimum, or too small a `sigma`
    not_converged = 2  # the least-squares solver did not reach a minimum
    at_bound = 3  # a parameter ended at its bound
    failed = 4  # the scene cannot be scanned at the estimates
    undetermined = 5  # the points do not determine all parameters of a profile or a surface


def chi_squared(whitened: np.ndarray) -> float:
    """Sum of squares of whitened residuals."""
    return float(np.sum(np.square(whitened)))


def is_plausible(chi2: float, degrees: int) -> bool:
    """Whether noise explains a sum of squares with this number of degrees of freedom."""
    return bool(chi2 < degrees + DEVIATIONS * math.sqrt(2 * max(degrees, 1)))


def judged(residual: np.ndarray, gradient: np.ndarray) -> tuple[FitStatus, np.ndarray]:
    """Status of a fit to points from whitened residuals and their derivatives, and the covariance of its values.

    The covariance is NaN where the status is not ok.
    """
    unknown = np.full((gradient.shape[1],) * 2, np.nan)
    size = np.linalg.norm(gradient, axis=0)
    if not (np.isfinite(residual).all() and np.isfinite(size).all()):
        return FitStatus.not_converged, unknown
    scaled = gradient / np.where(size > 0, size, 1.0)
    if not ((size > 0).all() and np.linalg.cond(scaled.T @ scaled) < WORST_CONDITION):
        return FitStatus.undetermined, unknown
    covariance = np.linalg.inv(scaled.T @ scaled) / np.outer(size, size)
    step = np.abs(covariance @ (gradient.T @ residual))
    if not ((step < SETTLED * np.sqrt(np.diag(covariance))) | (step < EXACTLY)).all():
        return FitStatus.not_converged, unknown
    return FitStatus.ok, covariance


def noise_of_residuals(
    off: np.ndarray, known: np.ndarray, unknowns: int, least: np.ndarray
) -> Float[np.ndarray, " kinds"]:
    """Standard deviation of the noise of each kind of signal, estimated from the residuals of a fit.

    Args:
        off: residuals, (..., kinds).
        known: which of them are compared, (..., kinds).
        unknowns: number of fitted parameters, which all kinds share.
        least: least estimate of each kind, (kinds,). The estimate of a kind without residuals is 1.
    """
    axes = tuple(range(off.ndim - 1))
    count, squares = known.sum(axis=axes), np.sum(np.where(known, off, 0.0) ** 2, axis=axes)
    noise = np.sqrt(count.sum() / max(1, count.sum() - unknowns) * squares / np.maximum(count, 1))
    return np.where(count > 0, np.maximum(noise, least), 1.0)


def correlation(covariance: np.ndarray) -> np.ndarray:
    """Correlation matrix of a covariance matrix."""
    errors = np.sqrt(np.diag(covariance))
    return covariance / np.outer(errors, errors)


class Identifiability(NamedTuple):
    """What signals determine: relative changes of parameters in log, and changes of others in units of `scale`."""

    covariance: np.ndarray  # (parameters, parameters); NaN for parameters that are not identified
    identified: np.ndarray  # (parameters,) bool
    combinations: tuple[str, ...]  # of parameters that are not identifiable, in words
    rank: int  # number of combinations that are identifiable
    condition: float  # ratio of the largest to the smallest singular value of the whitened derivatives


def identifiability(jacobian: np.ndarray, names: Sequence[str], log: np.ndarray, scale: np.ndarray) -> Identifiability:
    """Find the combinations of parameters that signals determine, from the singular values of their derivatives.

    Args:
        jacobian: derivatives of whitened residuals, (residuals, parameters): with respect to log x of parameters in
            log, and to x / scale of the others.
        names: of the parameters.
        log: which parameters are in log, (parameters,) bool.
        scale: units in which changes of the others are measured, (parameters,).
    """
    # Thousands of residuals and a handful of parameters: QR first.
    triangle = np.linalg.qr(jacobian, mode="r")
    size = np.linalg.norm(triangle, axis=0)
    # In units in which each parameter alone changes the signals equally: the scales of some may be far off.
    seen = size > NOTHING * np.max(size)
    _, singular, shares = np.linalg.svd(triangle / np.where(seen, size, np.inf))
    shares = shares[singular <= RELATIVE_ZERO * singular[0]]
    null = np.linalg.qr((shares / np.where(seen, size, 1.0)).T)[0].T
    determined = size.size - len(null)
    _, singular, directions = np.linalg.svd(triangle @ (np.eye(size.size) - null.T @ null))
    singular, directions = singular[:determined], directions[:determined]
    with np.errstate(divide="ignore"):
        error = 1 / singular
    # Only a logarithm has an absolute limit; a parameter of either sign has no natural size.
    leading = np.argmax(np.abs(directions), axis=1)
    weak = (error > LARGEST_LOG_ERROR) & log[leading]
    covariance = (directions.T * error**2) @ directions
    involved = np.any(np.abs(shares) > INVOLVED, axis=0)
    identified = ~involved & (~log | (np.sqrt(np.diag(covariance)) <= LARGEST_LOG_ERROR)) & seen
    covariance = np.where(identified[:, None] & identified[None, :], covariance, np.nan)
    words = [_in_words(direction, np.inf, names, log, scale) for direction in _simplest_basis(null)]
    words += [_in_words(d, e, names, log, scale) for d, e in zip(directions[weak], error[weak], strict=True)]
    condition = np.inf if len(null) else float(singular[0] / singular[-1])
    return Identifiability(covariance, identified, tuple(words), determined - int(weak.sum()), condition)


def _simplest_basis(null: np.ndarray) -> np.ndarray:
    """Eliminate as many components of a null space's basis as possible: combinations of few parameters."""
    rows = null.copy()
    for k in range(rows.shape[0]):
        column = int(np.argmax(np.abs(rows[k])))
        rows[k] /= rows[k, column]
        for other in range(rows.shape[0]):
            if other != k:
                rows[other] -= rows[other, column] * rows[k]
    return rows


def _in_words(direction: np.ndarray, error: float, names: Sequence[str], log: np.ndarray, scale: np.ndarray) -> str:
    """A combination of parameters, described by changes that compensate each other."""
    size = np.abs(direction)
    leading = int(np.argmax(size))
    direction = direction / direction[leading]
    members = [int(k) for k in np.argsort(-size) if size[k] > NAMED * size[leading]]

    def change(k: int) -> str:
        step = 0.01 * direction[k]
        return f"{names[k]} {100 * step:+.3g} %" if log[k] else f"{names[k]} {step * scale[k]:+.3g}"

    changes = f"{names[leading]} alone" if len(members) == 1 else " with ".join(change(k) for k in members)
    if not np.isfinite(error):
        return f"{changes} changes no signal"
    within = f"a factor of {np.exp(min(error, 700.0)):.3g}" if log[leading] else f"{error * scale[leading]:.3g}"
    return f"{changes} is determined only to within {within}"
