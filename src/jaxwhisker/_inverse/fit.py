"""The fit: estimates, how well they are known, and whether they may be believed at all."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._inverse.fit_status import FitStatus
from jaxwhisker._inverse.kernel import Kernel, Solved
from jaxwhisker._inverse.measured import Measured
from jaxwhisker._inverse.misfit import Samples, Sought, residuals
from jaxwhisker._inverse.transforms import Transform, natural
from jaxwhisker._model.scene import Scene
from jaxwhisker._scan.report import table

LIKELY = 3.841459  # rise of chi^2 at the ends of a 95 % interval of one parameter


class Profile(NamedTuple):
    """A profile likelihood: the least misfit at each value of one parameter, all others fitted anew."""

    name: str
    values: np.ndarray  # (points,)
    misfit: np.ndarray  # (points,) chi^2 above its minimum; NaN where a fit failed
    interval: tuple[float, float]  # of 95 %; infinite where the misfit does not rise enough within the values


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """Parameters identified from measured signals.

    Standard errors and covariance are those of least squares, from the information matrix at the estimates, with the
    noise that was given, or estimated from the residuals. They are NaN where the data do not tell a parameter and
    where the fit did not end well.
    """

    names: tuple[str, ...]
    estimates: dict[str, float]
    standard_error: dict[str, float]
    interval: dict[str, tuple[float, float]]  # of 95 %; of parameters fitted in log one of the logarithm
    covariance: np.ndarray  # (parameters, parameters)
    correlation: np.ndarray
    identified: dict[str, bool]
    combinations: tuple[str, ...]  # of parameters that the data do not tell, in words
    status: FitStatus
    reason: str  # why it did not end well; else empty
    chi2: float  # sum of squares of whitened residuals
    degrees: int  # of freedom
    residuals: np.ndarray  # (steps, whiskers, 3) measured - model; NaN where nothing was compared
    signals: np.ndarray  # (steps, whiskers, 3) of the model
    measured: Measured  # with the noise that was assumed
    steps: int  # of Levenberg-Marquardt, over all stages
    starts: int  # from which it was fitted
    agreeing: int  # of them, that led to this minimum
    scene: Scene
    _sought: Sought = field()
    _transforms: tuple[Transform, ...] = field()
    _kernel: Kernel = field()
    _data: Samples = field()
    _solved: Solved = field()
    _build: Callable[..., Scene] = field()

    def profile(self, name: str, points: int = 21, width: float = 3.0) -> Profile:
        """The profile likelihood of one parameter: how the misfit grows where least squares are no parabola.

        Args:
            name: of the parameter.
            points: values, an odd number so that the estimate is one of them.
            width: how far to go on either side, in standard errors (of what is not identified, in factors of e).

        Raises:
            ValueError: if the name is none of the fit's, or there are fewer than three points.
        """
        if name not in self.names:
            raise ValueError(f"`name` must be one of {', '.join(self.names)}, but is {name!r}.")
        if not isinstance(points, int) or points < 3:
            raise ValueError(f"`points` must be an int of at least 3, but is {points!r}.")
        at = self.names.index(name)
        transform = self._transforms[at]
        error = self.standard_error[name] / abs(transform.per_inner(self.estimates[name]))
        reach = width * (error if np.isfinite(error) else 1.0) / abs(transform.stretch(float(self._solved.y[at])))
        offsets = np.linspace(-reach, reach, points)
        free = np.arange(len(self.names)) != at
        misfit = np.full(points, np.nan)
        # Outwards from the middle, each from its neighbour's solution.
        for side in (range(points // 2, points), range(points // 2, -1, -1)):
            y = np.array(self._solved.y)
            for k in side:
                y[at] = self._solved.y[at] + offsets[k]
                solved = self._kernel(y, self._data, free)
                misfit[k] = solved.misfit
                y = np.array(solved.y)
        moved = self._solved.y + np.outer(offsets, ~free)
        values = np.array([natural(jnp.asarray(y), self._data.transforms)[at] for y in moved])
        rise = misfit - np.nanmin(misfit)
        return Profile(name, values, rise, (_crossing(values, rise, -1), _crossing(values, rise, 1)))

    def log_density(self, y: Any) -> Any:
        """Logarithm of the likelihood, up to a constant, for a sampler; traceable, with derivatives.

        Args:
            y: the fit's variables (parameters,): see `parameters`. A prior that is flat in them makes this the
                posterior's density; add another one's logarithm to it.
        """
        found, _ = residuals(self._build, self._sought, y, jax.tree.map(jnp.asarray, self._data))
        return -0.5 * jnp.sum(found**2)

    @property
    def variables(self) -> np.ndarray:
        """The fit's variables at the estimates: logarithms of parameters that have to be positive."""
        return np.array(self._solved.y)

    def parameters(self, y: Any) -> dict[str, Any]:
        """The parameters from the fit's variables."""
        return dict(zip(self.names, natural(jnp.asarray(y), jnp.asarray(self._data.transforms)), strict=True))

    def __str__(self) -> str:
        lines = []
        if self.status != FitStatus.ok:
            lines += [f"NOT A GOOD FIT ({self.status.name}): {self.reason}", ""]
        rows = []
        for name in self.names:
            good = self.status == FitStatus.ok and self.identified[name]
            low, high = self.interval[name]
            told = "identified" if good else "not identified" if self.status == FitStatus.ok else "not known"
            error, interval = ("", "") if not good else (f"{self.standard_error[name]:.3g}", f"{low:.6g} to {high:.6g}")
            rows.append([name, f"{self.estimates[name]:.8g}", error, interval, told])
        lines.append(table(["parameter", "estimate", "standard error", "95 % interval", ""], rows))
        lines += ["", *(f"not told by these data: {words}." for words in self.combinations)]
        count = f"chi^2 = {self.chi2:.6g} with {self.degrees} degrees of freedom"
        lines.append(f"{count}, {self.steps} steps, {self.agreeing} of {self.starts} starts ended here")
        return "\n".join(lines)

    __repr__ = __str__


def _crossing(values: np.ndarray, rise: np.ndarray, side: int) -> float:
    """Where the misfit rises above a 95 % interval's, going from its minimum to one side."""
    least = int(np.nanargmin(rise))
    order = range(least, values.size - 1) if side > 0 else range(least, 0, -1)
    for k in order:
        here, there = rise[k], rise[k + side]
        if not np.isfinite(there):
            break
        if there >= LIKELY:
            # chi grows nearly in proportion, its square does not.
            a, b, c = np.sqrt(here), np.sqrt(there), np.sqrt(LIKELY)
            return float(values[k] + (values[k + side] - values[k]) * (c - a) / (b - a))
    return side * np.inf
