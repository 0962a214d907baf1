"""The result of an identification: estimates, their uncertainty, and whether they can be trusted."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._inverse.observations import Observations
from jaxwhisker._inverse.parameters import Transforms, Unknowns
from jaxwhisker._inverse.program import LeastSquares, Solution
from jaxwhisker._inverse.residuals import Samples, residuals
from jaxwhisker._inverse.statistics import CHI2_95, FitStatus
from jaxwhisker._model.scene import Scene
from jaxwhisker._scan.report import table


class LikelihoodProfile(NamedTuple):
    """The least misfit at each value of one parameter, with all other parameters fitted again."""

    name: str
    values: np.ndarray  # (points,)
    misfit: np.ndarray  # (points,) chi-squared above its minimum; NaN where a fit failed
    interval: tuple[float, float]  # 95 %; infinite where the misfit does not rise enough within the values


class FitInternals(NamedTuple):
    """What a Fit keeps for further fits."""

    build: Callable[..., Scene]
    unknowns: Unknowns
    transforms: Transforms
    solve: LeastSquares
    data: Samples
    solution: Solution


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """Parameters of a scene estimated from observed signals, in the units of the scene.

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
    residuals: np.ndarray  # (steps, whiskers, 3) measured - model; NaN where nothing was compared
    signals: np.ndarray  # (steps, whiskers, 3) of the model
    measured: Observations  # with the noise that was assumed
    steps: int  # of Levenberg-Marquardt, over all stages
    starts: int  # number of starts
    agreeing: int  # number of starts that ended in this minimum
    scene: Scene  # at the estimates
    _internals: FitInternals

    def profile(self, name: str, points: int = 21, width: float = 3.0) -> LikelihoodProfile:
        """Compute the likelihood profile of one parameter, which does not assume that the misfit is quadratic.

        Args:
            name: name of the parameter.
            points: number of values; an odd number includes the estimate.
            width: range on either side, in standard errors. Without a standard error: in factors of e for a parameter
                in log, else in its scale.

        Returns:
            A LikelihoodProfile: the least misfit at each value, and the 95 % interval.

        Raises:
            ValueError: if the fit has no such parameter, or there are fewer than three points.
        """
        if name not in self.names:
            raise ValueError(f"`name` must be one of {', '.join(self.names)}, got {name!r}.")
        if not isinstance(points, int) or points < 3:
            raise ValueError(f"`points` must be an int of at least 3, got {points!r}.")
        _, _, transforms, solve, data, solution = self._internals
        at = self.names.index(name)
        x = np.array(list(self.estimates.values()))
        error = self.standard_error[name] / abs(transforms.per_inner(x)[at])
        reach = width * (error if np.isfinite(error) else 1.0) / abs(transforms.stretch(solution.y)[at])
        offsets = np.linspace(-reach, reach, points)
        free = np.arange(len(self.names)) != at
        misfit = np.full(points, np.nan)
        # Proceed outwards from the middle; each fit starts from its neighbour's solution.
        for side in (range(points // 2, points), range(points // 2, -1, -1)):
            y = np.array(solution.y)
            for k in side:
                y[at] = solution.y[at] + offsets[k]
                solved = solve(y, data, free)
                misfit[k] = solved.misfit
                y = np.array(solved.y)
        values = np.array([transforms.natural(y, np)[at] for y in solution.y + np.outer(offsets, ~free)])
        rise = misfit - np.nanmin(misfit)
        return LikelihoodProfile(name, values, rise, (_crossing(values, rise, -1), _crossing(values, rise, 1)))

    def log_density(self, y: Any) -> Any:
        """Logarithm of the likelihood up to an additive constant, for samplers; traceable and differentiable.

        Args:
            y: the fit's variables, (parameters,), see `variables`. With a prior that is flat in them, this is the log
                density of the posterior; add the logarithm of any other prior.
        """
        build, unknowns, _, _, data, _ = self._internals
        residual, _ = residuals(build, unknowns, y, jax.tree.map(jnp.asarray, data))
        return -0.5 * jnp.sum(residual**2)

    @property
    def variables(self) -> np.ndarray:
        """The fit's variables at the estimates, (parameters,): logarithms of parameters that must be positive."""
        return np.array(self._internals.solution.y)

    def parameters(self, y: Any) -> dict[str, Any]:
        """Parameters by name from the fit's variables, (parameters,); traceable."""
        transforms = jax.tree.map(jnp.asarray, self._internals.transforms)
        return dict(zip(self.names, transforms.natural(jnp.asarray(y)), strict=True))

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
        count = f"chi^2 = {self.chi2:.6g} with {self.degrees} degrees of freedom"
        lines.append(f"{count}, {self.steps} steps, {self.agreeing} of {self.starts} starts ended here")
        return "\n".join(lines)

    __repr__ = __str__


def _crossing(values: np.ndarray, rise: np.ndarray, side: int) -> float:
    """Where the misfit rises above that of a 95 % interval, from its minimum to one side."""
    least = int(np.nanargmin(rise))
    for k in range(least, values.size - 1) if side > 0 else range(least, 0, -1):
        here, there = rise[k], rise[k + side]
        if not np.isfinite(there):
            break
        if there >= CHI2_95:
            # Interpolate chi, which is nearly linear; its square is not.
            a, b, c = np.sqrt(here), np.sqrt(there), np.sqrt(CHI2_95)
            return float(values[k] + (values[k + side] - values[k]) * (c - a) / (b - a))
    return side * np.inf
