"""Least-squares fits of a scene's parameters by Levenberg-Marquardt.

The loop runs in NumPy. Residuals and derivatives come from programs that do not depend on `build`, and that plain scans
share, so that a fit of another `build` compiles nothing but `build` itself.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxwhisker._base.primitive import threads
from jaxwhisker._base.settings import as_here
from jaxwhisker._inverse.linearised import ChannelSignals, LinearisedScan
from jaxwhisker._inverse.parameters import Transforms
from jaxwhisker._inverse.residuals import Comparison, Samples, placed_and_slopes_now, prior_weight
from jaxwhisker._inverse.statistics import chi_squared
from jaxwhisker._inverse.unknowns import Unknowns, split
from jaxwhisker._model.assembly import AbstractScene

FIT_STEPS = 60  # of Levenberg-Marquardt
FINAL = 1e-6  # decrease of the sum of squares below which a fit ends: within 1e-3 standard errors of the minimum
COARSE = 1e-4  # the same for the first stages
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
    compared: tuple[Comparison, ...]  # one for each recording
    scans: tuple["Scanned", ...] = ()  # one for each recording


class Scanned(NamedTuple):
    """What residuals and derivatives of a recording follow from, besides gains and offsets."""

    placed: Any  # where signals are compared
    by: Any  # its derivatives
    signals: ChannelSignals
    status: int  # of the path


class Minimum(NamedTuple):
    """The end of a least-squares fit: a minimum, if it converged."""

    y: Float[np.ndarray, " unknowns"]
    residual: Residuals
    jacobian: Jacobian
    compared: tuple[Comparison, ...]  # one for each recording
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


class LeastSquares(NamedTuple):
    """Least-squares fits of one `build`."""

    build: Callable[..., AbstractScene]
    unknowns: Unknowns
    transforms: Transforms
    report: Callable[[float], None] | None = None  # is called with the misfit of every trial

    def __call__(
        self,
        y: Float[np.ndarray, " unknowns"],
        data: Sequence[Samples],
        prior: Float[np.ndarray, " unknowns"],
        *,
        free: Bool[np.ndarray, " unknowns"] | None = None,
        least: float = FINAL,
    ) -> Minimum:
        """Fit, starting from y, with a weak prior about these values; unknowns that are not free stay fixed."""
        held = np.zeros(y.size, bool) if free is None else ~free

        def evaluate(y):
            at = self.evaluate(y, data, prior)
            at.jacobian[:, held] = 0.0
            if self.report is not None:
                self.report(chi_squared(at.residual))
            return at

        def with_best_gains(y, at):
            """Gains and offsets that fit best for these values of the others: residuals are linear in them."""
            linear = self.unknowns.linear
            if not self.unknowns.gains.unknown or not all(np.isfinite(part).all() for part in at[:2]):
                return y, at
            y = y.copy()
            y[linear] -= np.linalg.lstsq(at.jacobian[:, linear], at.residual, rcond=None)[0]
            at = self.evaluate(y, data, prior, at.scans)
            at.jacobian[:, held] = 0.0
            return y, at

        return minimise(evaluate, y, least, with_best_gains)

    def evaluate(
        self, y: np.ndarray, data: Sequence[Samples], prior: np.ndarray, scans: Sequence[Scanned] | None = None
    ) -> Evaluation:
        """Residuals of all recordings and of the prior, with their derivatives; `scans` are known for equal scenes."""
        with np.errstate(over="ignore"):  # an infinite parameter is invalid
            x = self.transforms.natural(y, np)
        columns = self.unknowns.columns
        if scans is None and len(data) == 1:
            scans = [self._scanned(x[columns[0]], data[0])]
        elif scans is None:
            with ThreadPoolExecutor(threads()) as pool:
                scans = list(pool.map(as_here(self._scanned), [x[own] for own in columns], data))
        each = [self._of_recording(x[own], one, scan) for own, one, scan in zip(columns, data, scans, strict=True)]
        by_y = self.transforms.per_inner(x) * self.transforms.stretch(y)
        jacobians = []
        for at, own in zip(each, columns, strict=True):
            jacobian = np.zeros((at.residual.size, x.size))
            jacobian[:, own] = at.jacobian
            jacobians.append(jacobian * by_y)
        weight = prior_weight(data[0])
        residual = np.concatenate([*(at.residual for at in each), (y - prior) * weight])
        compared = tuple(comparison for at in each for comparison in at.compared)
        return Evaluation(residual, np.concatenate([*jacobians, weight * np.eye(x.size)]), compared, tuple(scans))

    def _scanned(self, x: Float[np.ndarray, " own"], data: Samples) -> Scanned:
        unknowns, parts = self.unknowns, split(self.unknowns, x)
        shift = parts.shift[0] if unknowns.shift else np.asarray(0.0)
        stops, last = (np.full_like(data.stops, np.nan), 1) if data.overlaid else (data.stops + shift, data.last)
        parameters = dict(zip(unknowns.build, parts.build, strict=True))
        known = {"channels": unknowns.channels, "values": parts.channels, "shift": unknowns.shift}
        scan = LinearisedScan(self.build, parameters, stops, last, **known)
        placed, by = placed_and_slopes_now(shift, scan.start, scan.events, data, scan.shift_slopes, scan.event_slopes)
        placed, by = jax.tree.map(np.asarray, (placed, by))
        signals = scan.signals(placed.control, placed.travel, by.control)
        return Scanned(placed, by, signals, int(scan.status))

    def _of_recording(self, x: Float[np.ndarray, " own"], data: Samples, scanned: Scanned) -> Evaluation:
        """Residuals of one recording's signals, snaps, touches and releases, and their derivatives by its unknowns."""
        unknowns, (placed, by, signals, status) = self.unknowns, scanned
        values, by_signals = unknowns.measured(x, signals.values, signals.slopes)
        by_signals *= placed.weight[..., None]

        by_parts = by_signals, unknowns.by_own(by.of_snaps), unknowns.by_own(by.of_ends)
        slopes = [part.reshape(-1, x.size) for part in by_parts]
        compared = Comparison(values, placed.left_out, status, signals.values)
        residual, jacobian = np.concatenate(placed.residuals(values, data)), np.concatenate(slopes)
        return Evaluation(residual, jacobian, (compared,))


def minimise(
    evaluate: Callable[[np.ndarray], Evaluation],
    y: np.ndarray,
    least: float,
    improve: Callable[[np.ndarray, Evaluation], tuple[np.ndarray, Evaluation]] = lambda y, at: (y, at),
) -> Minimum:
    """Levenberg-Marquardt: end when another step would not lower the sum of squares by more than `least`.

    `improve` may move each trial to a better one nearby.

    Otherwise unknowns that are hardly determined would keep moving for many steps, and near the minimum rounding would
    decide which steps are accepted.

    Source: Gould, Orban, Sartenaer, Toint (2005), 4OR 3, "Sensitivity of trust-region algorithms to their parameters"
    (for the rule that changes the damping).
    """
    y, at = improve(y, evaluate(y))
    steps, damping, small = 1, 1.0, False
    while steps < FIT_STEPS and np.isfinite(at.residual).all() and np.isfinite(at.jacobian).all():
        if small or possible_decrease(at.residual, at.jacobian) < least:
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
