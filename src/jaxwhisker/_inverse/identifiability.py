"""Identifiability: which combinations of parameters signals tell, and which they do not, by their information."""

from typing import NamedTuple

import numpy as np

NULL = 1e-7  # of the largest singular value: below it a combination changes no signal, derivatives being good to 1e-9
UNTOLD = 1.0  # standard error of a logarithm above which data do not tell it: a factor of e
SHARE = 0.05  # of a combination's largest member: what is named with it
INVOLVED = 1e-4  # share of a direction that no signal sees, above which a parameter is not known


class Identifiability(NamedTuple):
    """What is known of parameters, in relative changes (those fitted in log) or in units of their scales."""

    covariance: np.ndarray  # (parameters, parameters); NaN where there is none
    identified: np.ndarray  # (parameters,)
    combinations: tuple[str, ...]  # that cannot be told, in words
    rank: int
    condition: float  # ratio of the largest to the smallest singular value of the whitened derivatives


def identifiability(
    jacobian: np.ndarray, names: tuple[str, ...], log: np.ndarray, scale: np.ndarray
) -> Identifiability:
    """From derivatives of whitened residuals by relative changes, (residuals, parameters).

    Args:
        jacobian: by log x of parameters in log, by x / scale of the others.
        names: of the parameters.
        log: which are in log.
        scale: of the others.
    """
    # Reduced first: thousands of residuals by a handful of parameters.
    _, singular, directions = np.linalg.svd(np.linalg.qr(jacobian, mode="r"))
    largest = float(singular[0]) if singular.size else 0.0
    null = singular <= NULL * largest
    with np.errstate(divide="ignore"):
        error = np.where(null, np.inf, 1 / np.where(singular > 0, singular, 1.0))
    # Of a parameter that may have any sign there is no telling what would be a large error.
    leading = np.argmax(np.abs(directions), axis=1) if singular.size else np.zeros(0, int)
    weak = ~null & (error > UNTOLD) & log[leading]
    told = ~null & ~weak
    safe = np.where(null, 0.0, error)
    covariance = (directions.T * safe**2) @ directions
    involved = np.any(np.abs(directions[null]) > INVOLVED, axis=0) if null.any() else np.zeros(len(names), bool)
    identified = ~involved & (~log | (np.sqrt(np.diag(covariance)) <= UNTOLD)) & (largest > 0)
    covariance = np.where(identified[:, None] & identified[None, :], covariance, np.nan)
    rotated = _simplest(directions[null]) if null.any() else directions[:0]
    words = [_words(v, np.inf, names, log, scale) for v in rotated]
    words += [_words(v, e, names, log, scale) for v, e in zip(directions[weak], error[weak], strict=True)]
    smallest = float(singular[-1]) if singular.size else 0.0
    condition = np.inf if null.any() else largest / smallest
    return Identifiability(covariance, identified, tuple(words), int(np.sum(told)), condition)


def _simplest(null: np.ndarray) -> np.ndarray:
    """A basis of a null space with as many zeros as elimination gives: combinations of few parameters."""
    rows = null.copy()
    for k in range(rows.shape[0]):
        column = int(np.argmax(np.abs(rows[k])))
        rows[k] /= rows[k, column]
        for other in range(rows.shape[0]):
            if other != k:
                rows[other] -= rows[other, column] * rows[k]
    return rows


def _words(direction: np.ndarray, error: float, names: tuple[str, ...], log: np.ndarray, scale: np.ndarray) -> str:
    """A combination of parameters, as changes that go together."""
    size = np.abs(direction)
    leading = int(np.argmax(size))
    direction = direction / direction[leading]
    members = [int(k) for k in np.argsort(-size) if size[k] > SHARE * size[leading]]

    def change(k: int) -> str:
        step = 0.01 * direction[k]
        return f"{names[k]} {100 * step:+.3g} %" if log[k] else f"{names[k]} {step * scale[k]:+.3g}"

    what = f"{names[leading]} alone" if len(members) == 1 else " with ".join(change(k) for k in members)
    if not np.isfinite(error):
        return f"{what} changes no signal"
    grows = f"a factor of {np.exp(min(error, 700.0)):.3g}" if log[leading] else f"{error * scale[leading]:.3g}"
    return f"{what} is told no better than to {grows}"
