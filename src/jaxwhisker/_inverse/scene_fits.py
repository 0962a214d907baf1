"""Least-squares fits of a scene's parameters to recordings.

Residuals and derivatives come from programs that do not depend on `build`, and that plain scans share, so that a fit of
another `build` compiles nothing but `build` itself.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxwhisker._base.primitive import threads
from jaxwhisker._base.settings import as_here
from jaxwhisker._inverse.least_squares import FINAL, Evaluation, Minimum, minimise
from jaxwhisker._inverse.linearised import ChannelSignals, LinearisedScan
from jaxwhisker._inverse.parameters import Transforms
from jaxwhisker._inverse.residuals import Comparison, Samples, placed_and_slopes_now, prior_weight
from jaxwhisker._inverse.statistics import chi_squared
from jaxwhisker._inverse.unknowns import Unknowns, split
from jaxwhisker._model.assembly import AbstractScene

COARSE = 1e-4  # decrease of the sum of squares below which the first stages of a fit end


class Scanned(NamedTuple):
    """What residuals and derivatives of a recording follow from, besides gains and offsets."""

    placed: Any  # where signals are compared
    by: Any  # its derivatives
    signals: ChannelSignals
    status: int  # of the path


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
        share: float = 0.0,
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

        return minimise(evaluate, y, least, with_best_gains, share)

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
