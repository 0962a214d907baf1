"""The problem of an identification, and its result: estimates, their uncertainty, and whether they can be trusted."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.settings import in_double
from jaxwhisker._inverse.estimates import Estimates
from jaxwhisker._inverse.features import Features, Scatter
from jaxwhisker._inverse.least_squares import Minimum
from jaxwhisker._inverse.observations import OWN_REACTIONS, Observations
from jaxwhisker._inverse.parameters import Transforms
from jaxwhisker._inverse.points import perpendicular
from jaxwhisker._inverse.residuals import Comparison, Samples, log_density, samples_of
from jaxwhisker._inverse.scene_fits import LeastSquares
from jaxwhisker._inverse.statistics import CHI2_95, FitStatus, chi_squared, is_plausible
from jaxwhisker._inverse.unknowns import Unknowns, split
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.scene import units
from jaxwhisker._path.path import Status
from jaxwhisker._scan.blocks import BLOCK
from jaxwhisker._scan.quantities import REACTIONS_IN_SPACE
from jaxwhisker._scan.route import route_of

SINGULAR = 1e-9  # least singular value of whitened gains, with columns of length 1, that determine six reactions
NUMERICAL = 1e-6  # of the peak: residuals below it are numerical
SCATTER_ERROR = 6.0  # relative error that the scatter between n neighbours may have, times sqrt(n): 3.4 standard errors


class Recording(NamedTuple):
    """One scan that was measured."""

    observations: Observations
    landmarks: Features
    first_leg: slice  # the samples before the drive first turns, which can be overlaid with a scan
    landmarks_of_leg: Features
    scene: AbstractScene  # at the guess

    def samples(self, *, overlaid: bool = False, thin: bool = False) -> Samples:
        """The observations for one stage: all of them, or as many as one block holds."""
        observations, landmarks = self.observations, self.landmarks
        if overlaid:
            observations, landmarks = observations.at(self.first_leg), self.landmarks_of_leg
        if thin and observations.control.size > BLOCK:
            pick = np.unique(np.linspace(0, observations.control.size - 1, BLOCK).astype(int))
            observations, landmarks = observations.at(pick), landmarks._replace(travel=landmarks.travel[pick])
        route, length = route_of(self.observations.control), float(units(self.scene).control)
        friction = self.scene.friction is not None
        return samples_of(observations, landmarks, route, overlaid=overlaid, length=length, friction=friction)

    @property
    def can_be_overlaid(self) -> bool:
        """Whether the drive starts in the direction of a default scan and a touch is visible."""
        leg = self.observations.control[self.first_leg]
        onwards = np.sign(leg[-1] - leg[0]) == self.scene.motion.onwards
        return bool(onwards and np.isfinite(self.landmarks_of_leg.touch).any())

    def compared(self, comparison: Comparison) -> np.ndarray:
        """Which values are compared with the model, (steps, whiskers, 3): all but those left out at snaps."""
        steps = self.observations.control.size
        return self.observations.known & ~comparison.left_out[:steps, None, None]

    def off(self, comparison: Comparison) -> np.ndarray:
        """Measured - model, (steps, whiskers, 3); NaN where nothing is compared."""
        signals = comparison.signals[: self.observations.control.size]
        return np.where(self.compared(comparison), self.observations.values - signals, np.nan)


class FitProblem(NamedTuple):
    """Recordings, and the program that fits them."""

    build: Callable[..., AbstractScene]
    solve: LeastSquares
    recordings: tuple[Recording, ...]
    scatter: Scatter | None  # of neighbouring samples, to judge a fit whose noise was estimated from its residuals

    @property
    def unknowns(self) -> Unknowns:
        """What is fitted."""
        return self.solve.unknowns

    @property
    def transforms(self) -> Transforms:
        """How the fit's variables follow from the unknowns."""
        return self.solve.transforms

    @property
    def peaks(self) -> np.ndarray:
        """Largest magnitude of each kind of signal, (3,)."""
        return np.max([recording.observations.peaks for recording in self.recordings], axis=0)

    def samples(self, *, overlaid: bool = False, thin: bool = False) -> list[Samples]:
        """The observations of every recording for one stage."""
        return [recording.samples(overlaid=overlaid, thin=thin) for recording in self.recordings]

    def with_noise(self, sigma: np.ndarray) -> "FitProblem":
        """The same problem with this standard deviation of the noise of each kind of signal, (3,)."""
        return self._replace(
            recordings=tuple(
                recording._replace(observations=recording.observations.with_sigma(sigma))
                for recording in self.recordings
            )
        )

    def compared(self, solution: Minimum) -> np.ndarray:
        """Which values are compared with the model, (steps of all recordings, whiskers, 3)."""
        pairs = zip(self.recordings, solution.compared, strict=True)
        return np.concatenate([recording.compared(comparison) for recording, comparison in pairs])

    def off(self, solution: Minimum) -> np.ndarray:
        """Measured - model, (steps of all recordings, whiskers, 3); NaN where nothing is compared."""
        pairs = zip(self.recordings, solution.compared, strict=True)
        return np.concatenate([recording.off(comparison) for recording, comparison in pairs])

    def degrees(self, solution: Minimum) -> int:
        """Degrees of freedom."""
        return int(self.compared(solution).sum()) - solution.y.size

    def is_plausible(self, solution: Minimum) -> bool:
        """Whether noise explains the residuals.

        Noise that was estimated from the residuals explains them by construction, unless samples are left out.
        Therefore the residuals are also compared with the scatter between neighbouring samples.
        """
        off, degrees = self.off(solution), max(1, self.degrees(solution))
        if not np.isfinite(off[self.compared(solution)]).all() or not is_plausible(solution.misfit, degrees):
            return False
        if self.scatter is None:
            return True
        uncertainty = 1 + SCATTER_ERROR / np.sqrt(max(1, self.scatter.count))
        largest_noise = uncertainty * np.maximum(self.scatter.sigma, NUMERICAL * self.peaks)
        return is_plausible(chi_squared(np.nan_to_num(off / largest_noise)), degrees)

    def status(self, solution: Minimum) -> tuple[FitStatus, str]:
        """How the fit ended, and the reason for failure."""
        path = max(Status(comparison.status) for comparison in solution.compared)
        if not np.isfinite(solution.y).all() or path != Status.ok:
            return FitStatus.failed, f"the scene cannot be scanned there ({path.name})"
        if reason := self.transforms.at_bound(solution.y, self.unknowns.all_names):
            return FitStatus.at_bound, reason
        if not self.is_plausible(solution):
            return FitStatus.implausible, self._why_implausible(solution)
        if not solution.reached:
            return FitStatus.not_converged, f"no minimum was reached in {solution.steps} steps"
        return FitStatus.ok, ""

    def _why_implausible(self, solution: Minimum) -> str:
        off, given = self.off(solution), self.scatter is None
        each = [recording.observations for recording in self.recordings]
        noise = np.concatenate([one.sigma for one in each]) if self.scatter is None else self.scatter.sigma
        with np.errstate(divide="ignore", invalid="ignore"):
            share, size = (_rms(off / unit) for unit in (self.peaks, noise))
        unit = "standard deviations of the noise" if given else "times the scatter between neighbouring samples"
        degrees, compared = self.degrees(solution), int(self.compared(solution).sum())
        reason = f"the residuals are {share:.2g} of the peaks, {size:.3g} {unit} (root mean square)"
        known = sum(int(one.known.sum()) for one in each)
        if compared < known / 2:
            reason += f", and only {compared} of {known} values lie on the same side of a snap"
        reason += f"; chi^2 = {chi_squared(solution.observed[0]):.3g} with {degrees} degrees of freedom"
        return reason if given else f"{reason}. If the noise is correlated between samples, give `sigma`"

    def force_moment(self, own: np.ndarray, observations: Observations) -> tuple[np.ndarray, np.ndarray] | None:
        """Cosine of the angle between measured force and moment, and their product in standard deviations of its noise.

        Both have shape (steps, whiskers), with NaN where the measured channels do not determine six reactions. The
        result is None if the signals are not the six reactions in space.

        Args:
            own: the unknowns of the recording, whose gains and offsets are removed from the signals.
            observations: its signals, with their noise.
        """
        if self.unknowns.channels.names not in (REACTIONS_IN_SPACE, OWN_REACTIONS):
            return None
        parts, values = split(self.unknowns, own), observations.values.copy()
        for (whisker, channel), offset in zip(self.unknowns.offsets, parts.offsets, strict=True):
            values[:, whisker, channel] -= offset
        known = np.isfinite(values)
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = np.where(known, 1 / observations.sigma, 0.0)
        whitened = weight[..., None] * self.unknowns.gains.filled(parts.gains)
        size = np.linalg.norm(whitened, axis=-2, keepdims=True)
        missing = np.linalg.matrix_rank(whitened / np.where(size > 0, size, 1.0), tol=SINGULAR) < whitened.shape[-1]
        # Measured channels may be more than six, and of any unit: columns of equal length make the inverse accurate.
        root = np.linalg.pinv(np.where(missing[..., None, None], 0.0, whitened / np.where(size > 0, size, 1.0)))
        root = root / np.where(size > 0, size, 1.0).swapaxes(-1, -2)
        reactions = np.einsum("...ij,...j->...i", root, weight * np.where(known, values, 0.0))
        return perpendicular(reactions, root, missing, np)


def _rms(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else np.nan


class FittedRecording(NamedTuple):
    """One recording, and what the fit says of it."""

    measured: Observations  # with the noise that was assumed
    signals: np.ndarray  # (steps, whiskers, 3) of the model, or (steps, 1, channels) with `channels`
    residuals: np.ndarray  # measured - model; NaN where nothing was compared
    parameters: dict[str, float]  # arguments of `build`
    scene: AbstractScene  # at the estimates
    # Cosine of the angle between measured force and moment, which are perpendicular for every contact at a point, and
    # their product in standard deviations of its noise, (steps, whiskers): without gains and offsets, and NaN where the
    # channels do not determine six reactions. None in the plane.
    force_moment: np.ndarray | None = None
    force_moment_score: np.ndarray | None = None
    in_units: bool = True  # whether the channels are reactions in the units of the scene


class LikelihoodProfile(NamedTuple):
    """The least misfit at each value of one parameter, with all other parameters fitted again."""

    name: str
    values: np.ndarray  # (points,)
    misfit: np.ndarray  # (points,) chi-squared above its minimum; NaN where a fit failed
    interval: tuple[float, float]  # 95 %; infinite where the misfit does not rise enough within the values


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Estimates):
    """Parameters of a scene estimated from observed signals, in the units of the scene."""

    recordings: tuple[FittedRecording, ...]
    starts: int  # number of starts
    agreeing: int  # number of starts that ended in this minimum
    _problem: FitProblem
    _solution: Minimum

    @property
    def measured(self) -> Observations:
        """The measured signals of the only recording, with the noise that was assumed."""
        return self._only_recording.measured

    @property
    def signals(self) -> np.ndarray:
        """Signals of the model for the only recording, (steps, whiskers, 3), or (steps, 1, channels)."""
        return self._only_recording.signals

    @property
    def residuals(self) -> np.ndarray:
        """Measured - model for the only recording; NaN where nothing was compared."""
        return self._only_recording.residuals

    @property
    def scene(self) -> AbstractScene:
        """The scene of the only recording at the estimates."""
        return self._only_recording.scene

    @property
    def force_moment(self) -> np.ndarray | None:
        """Cosine of the angle between measured force and moment in space; see FittedRecording."""
        return self._only_recording.force_moment

    @property
    def force_moment_score(self) -> np.ndarray | None:
        """Product of measured force and moment in standard deviations of its noise; see FittedRecording."""
        return self._only_recording.force_moment_score

    @property
    def _only_recording(self) -> FittedRecording:
        first, *others = self.recordings
        if others:
            raise ValueError(
                f"Each of the {len(self.recordings)} recordings has its own: ask `recordings[k]` of the fit instead."
            )
        return first

    @in_double
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
        checks.count("points", points, least=3)
        problem, solution, transforms = self._problem, self._solution, self._problem.transforms
        data = problem.samples()
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
                solved = problem.solve(y, data, solution.y, free=free)
                misfit[k] = solved.misfit
                y = solved.y.copy()
        values = np.array([transforms.natural(y, np)[at] for y in solution.y + np.outer(offsets, ~free)])
        rise = misfit - np.nanmin(misfit)
        return LikelihoodProfile(name, values, rise, (_crossing(values, rise, -1), _crossing(values, rise, 1)))

    @in_double
    def log_density(self, y: Any) -> Any:
        """Logarithm of the likelihood up to an additive constant, for samplers; traceable and differentiable.

        Args:
            y: the fit's variables, (parameters,), see `variables`. With a prior that is flat in them, this is the log
                density of the posterior; add the logarithm of any other prior.

        Raises:
            ValueError: if the fit is one of scenes in space.
        """
        build, unknowns, transforms, _ = self._problem.solve
        if unknowns.channels.in_space:
            raise ValueError("`log_density` must be asked of a fit in the plane, got one in space.")
        return log_density(build, unknowns, transforms, jnp.asarray(y), self._problem.samples(), self._solution.y)

    @property
    def variables(self) -> np.ndarray:
        """The fit's variables at the estimates, (parameters,): logarithms of parameters that must be positive."""
        return np.array(self._solution.y)

    @in_double
    def parameters(self, y: Any) -> dict[str, Any]:
        """Parameters by name from the fit's variables, (parameters,); traceable."""
        transforms = jax.tree.map(jnp.asarray, self._problem.transforms)
        return dict(zip(self.names, transforms.natural(jnp.asarray(y)), strict=True))

    def _search(self) -> str:
        scores = [
            recording.force_moment_score[np.any(np.nan_to_num(at.unscaled[: len(recording.signals)]) != 0, axis=-1)]
            for recording, at in zip(self.recordings, self._solution.compared, strict=True)
            if recording.force_moment_score is not None
        ]
        score = _rms(np.concatenate([*scores, np.zeros(0)]))
        words = f"\nforce . moment: {score:.3g} standard deviations of its noise (rms)" if np.isfinite(score) else ""
        return f", {self.agreeing} of {self.starts} starts ended here{words}"


def _crossing(values: np.ndarray, rise: np.ndarray, side: int) -> float:
    """Where the misfit rises above that of a 95 % interval, from its minimum to one side."""
    least = int(np.nanargmin(rise))
    values, rise = values[least::side], rise[least::side]
    above = np.flatnonzero(~(rise < CHI2_95))
    if above.size == 0 or not np.isfinite(rise[above[0]]):
        return side * np.inf
    around = slice(above[0] - 1, above[0] + 1)
    # Interpolate chi, which is nearly linear; its square is not.
    return float(np.interp(np.sqrt(CHI2_95), np.sqrt(rise[around]), values[around]))
