"""Estimates of parameters by least squares, their uncertainty, and whether they can be trusted."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxwhisker._inverse.parameters import Transforms
from jaxwhisker._inverse.statistics import FitStatus, chi_squared, correlation, identifiability
from jaxwhisker._scan.report import table


@dataclass(frozen=True, eq=False, repr=False)
class Estimates:
    """Estimated parameters, in the units of the model.

    Standard errors and covariance are those of least squares: the inverse of the information matrix at the estimates,
    with the noise that was given, or estimated from the residuals. They are NaN for a parameter that is not
    identifiable, and for all parameters if the status is not `ok`.
    """

    names: tuple[str, ...]
    estimates: dict[str, float]
    standard_error: dict[str, float]
    interval: dict[str, tuple[float, float]]  # 95 %; symmetric in log x for parameters fitted in log
    covariance: np.ndarray  # (parameters, parameters)
    correlation: np.ndarray  # (parameters, parameters)
    identified: dict[str, bool]
    combinations: tuple[str, ...]  # of parameters that are not identifiable, in words
    status: FitStatus
    reason: str  # for a status that is not ok; else empty
    chi2: float  # sum of squares of the whitened residuals
    degrees: int  # degrees of freedom
    steps: int  # of Levenberg-Marquardt, over all stages

    def __str__(self) -> str:
        lines = []
        if self.status != FitStatus.ok:
            lines += [f"NOT A GOOD FIT ({self.status.name}): {self.reason}", ""]
        rows = []
        for name in self.names:
            good = self.status == FitStatus.ok and self.identified[name]
            verdict = "identified" if good else "not identified" if self.status == FitStatus.ok else "unknown"
            low, high = self.interval[name]
            error, interval = (f"{self.standard_error[name]:.3g}", f"{low:.6g} to {high:.6g}") if good else ("", "")
            rows.append([name, f"{self.estimates[name]:.8g}", error, interval, verdict])
        lines.append(table(["parameter", "estimate", "standard error", "95 % interval", ""], rows))
        lines += ["", *(f"not identifiable: {words}." for words in self.combinations)]
        chi2 = f"{self.chi2:.6g}" if np.isfinite(self.chi2) else "unknown"
        lines.append(f"chi^2 = {chi2} with {self.degrees} degrees of freedom, {self.steps} steps{self._search()}")
        return "\n".join(lines)

    __repr__ = __str__

    def _search(self) -> str:
        """What else to say of the search."""
        return ""


def estimates_of(
    names: Sequence[str],
    transforms: Transforms,
    y: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
    status: FitStatus,
) -> dict[str, Any]:
    """Estimates and their uncertainty, by name of the field, at the end of a fit.

    Args:
        names: of the parameters.
        transforms: from the fit's variables to the parameters.
        y: the fit's variables, (parameters,).
        residual: whitened, (residuals,).
        jacobian: its derivatives by the fit's variables, (residuals, parameters).
        status: how the fit ended.
    """
    x = transforms.natural(y, np)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_inner = np.nan_to_num(jacobian / transforms.stretch(y))
    information = identifiability(by_inner, names, transforms.log, transforms.scale)
    rate = transforms.per_inner(x)
    covariance = information.covariance * np.outer(rate, rate)
    if status != FitStatus.ok:
        covariance = np.full_like(covariance, np.nan)
    errors = np.sqrt(np.diag(covariance))
    return {
        "names": tuple(names),
        "estimates": dict(zip(names, x.tolist(), strict=True)),
        "standard_error": dict(zip(names, errors.tolist(), strict=True)),
        "interval": dict(zip(names, transforms.interval(x, errors), strict=True)),
        "covariance": covariance,
        "correlation": correlation(covariance),
        "identified": dict(zip(names, information.identified.tolist(), strict=True)),
        "combinations": information.combinations,
        "status": status,
        "chi2": chi_squared(residual),
    }
