"""Identification: estimate parameters of a scene from observed signals by least squares."""

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._inverse.features import Features, Scatter, features, neighbour_scatter
from jaxwhisker._inverse.fit import Fit, FitInternals
from jaxwhisker._inverse.observations import Observations, read_observations
from jaxwhisker._inverse.parameters import (
    Transforms,
    Unknowns,
    build_scene,
    check_traceable,
    check_used,
    read_parameters,
    transforms_of,
)
from jaxwhisker._inverse.program import COARSE, LeastSquares, Solution, possible_decrease
from jaxwhisker._inverse.recording import check_recording
from jaxwhisker._inverse.residuals import BLOCK, Samples, samples_of
from jaxwhisker._inverse.statistics import FitStatus, chi_squared, correlation, identifiability, is_plausible
from jaxwhisker._model.scene import Scene, units
from jaxwhisker._path.path import Status
from jaxwhisker._scan.route import route_of

LEAST_NOISE = 1e-4  # of the peak: least noise assumed before the residuals give an estimate
EXACT = 1e-6  # of the peak: residuals below it are numerical
SCATTER_ERROR = 6.0  # relative error that the scatter between n neighbours may have, times sqrt(n): 3.4 standard errors
SPREAD = np.log(4.0)  # largest distance of other starts from the guess in each of the fit's variables
REWEIGHTINGS = 4  # at most, where the noise is estimated from the residuals
SETTLED = 0.5  # share of the degrees of freedom above which chi-squared of reweighted residuals has settled
BASELINE = 5  # first samples, from which constant offsets are guessed
ENOUGH = 3  # starts that must end in the same plausible minimum before the search stops
SAME = 1e-3  # difference of the fit's variables up to which two minima are the same
NEGLIGIBLE = 1e-2  # possible decrease of chi-squared (a tenth of a standard error) that a converged fit may leave
AT_BOUND = 1e-3  # dv/dy, relative to that in the middle if it is larger than 1, below which a parameter is at its bound


def identify(
    build: Callable[..., Scene],
    guess: Mapping[str, float],
    measured: Any,
    *,
    sigma: Any = None,
    offsets: bool = False,
    shift: bool = False,
    bounds: Mapping[str, Any] | None = None,
    transform: Mapping[str, str] | None = None,
    starts: int = 16,
    near: bool = False,
) -> Fit:
    """Estimate the parameters of a scene from measured signals.

    The method is Levenberg-Marquardt on whitened residuals, with exact derivatives. Snaps contribute by their positions
    (see residuals.py). A first stage overlays the scans; therefore guesses may be off by a factor of three or more. If
    the residuals are not plausible, fits from other starts follow.

    Args:
        build: makes a Scene from named numbers: parameters of springs, object and whiskers. JAX must be able to trace
            it.
        guess: an initial value of each unknown parameter.
        measured: `control` and any of fx, fy, mz (fx_1, fx_2, ... of several whiskers): a mapping of arrays, a Result,
            a Dataset with one scan, a DataFrame or the path of a CSV file. Arrays are (steps,) or (steps, whiskers), in
            the units of the scene, with the signs of `scene.py` (forces and moments of the support on the whisker), and
            in the order in which the drive moved. NaN is skipped.
        sigma: standard deviation of the noise: a number, or a mapping from channels to numbers or arrays. Default: one
            number per channel, estimated from the residuals; the fit is then plausible if the residuals are not larger
            than the scatter between neighbouring samples. Noise that is correlated between samples needs `sigma`.
        offsets: whether an unknown constant is added to every measured channel.
        shift: whether the control is off by an unknown constant: the scene's is the measured one plus `shift`.
        bounds: pairs (low, high) by name, None for no bound.
        transform: "log" or "linear" by name. Default: log for parameters that `build` rejects if they are negative.
        starts: largest number of further fits if the first one is not plausible; 0 for none.
        near: whether the guess is close to the solution; the first stage is then skipped.

    Returns:
        A Fit. Unless its status is `ok`, `reason` says why and there are no standard errors: `implausible` (noise does
        not explain the residuals), `not_converged`, `at_bound` or `failed` (the scene cannot be scanned there).
        Parameters that are not identifiable have no standard error, and `combinations` describes them.

    Raises:
        ValueError: if an argument is wrong; if JAX cannot trace `build`, or `build` ignores a parameter; if `measured`
            has too few values, shows no contact, is in other units than the scene, or is in reversed order (which is
            recognised for translations that start free, if fx of all whiskers is measured).
    """
    checks.float64_mode()
    guess = read_parameters("guess", guess)
    scene = build_scene("guess", build, guess)
    if isinstance(starts, bool) or not isinstance(starts, int) or starts < 0:
        raise ValueError(f"`starts` must be an int of at least 0, got {starts!r}.")
    transforms = transforms_of(build, guess, bounds, transform)
    check_traceable(build, guess)
    check_used(build, guess)
    observations = read_observations(measured, sigma, whiskers=len(scene.whiskers))

    channels = tuple((c.whisker, c.reaction) for c in observations.channels) if offsets else ()
    unknowns = Unknowns(tuple(guess), channels, shift)
    baselines = [_baseline(observations, *channel) for channel in channels]
    centred = _without_offsets(observations, unknowns, baselines)
    check_recording(centred, scene, len(unknowns.all_names))
    sizes = [float(observations.peaks[reaction]) for _, reaction in channels] + [float(units(scene).control)] * shift
    transforms = transforms.then(Transforms.of([False] * len(sizes), sizes, [(-np.inf, np.inf)] * len(sizes)))
    start = transforms.variables([*guess.values(), *baselines, *[0.0] * shift])

    scatter = None
    if np.isnan(observations.sigma[observations.known]).all():
        scatter = neighbour_scatter(observations)
        noise = np.maximum(scatter.sigma, LEAST_NOISE * observations.peaks)
        observations, centred = observations.with_sigma(noise), centred.with_sigma(noise)
    leg = _until_turn(observations.control)
    problem = _Problem(
        build=build,
        solve=LeastSquares(build, unknowns),
        unknowns=unknowns,
        transforms=transforms,
        observations=observations,
        landmarks=features(centred),
        landmarks_until_turn=features(centred.at(leg)),
        scatter=None,
        scene=scene,
    )
    search = _search(problem, start, starts, near)
    if scatter is not None:
        problem, search = _reweighted(problem._replace(scatter=scatter), search)
    return _fit_of(problem, search)


def _baseline(observations: Observations, whisker: int, reaction: int) -> float:
    """Median of a channel's first samples."""
    signal = observations.values[:, whisker, reaction]
    first = signal[np.isfinite(signal)][:BASELINE]
    return float(np.median(first)) if first.size else 0.0


def _without_offsets(observations: Observations, unknowns: Unknowns, offsets: list[float]) -> Observations:
    values = observations.values.copy()
    for (whisker, reaction), offset in zip(unknowns.offsets, offsets, strict=True):
        values[:, whisker, reaction] -= offset
    return Observations(observations.control, values, observations.sigma)


def _heading(control: np.ndarray) -> float:
    """Sign of the drive's first move."""
    moves = np.diff(control)
    return float(np.sign(moves[moves != 0][:1]).sum())


def _until_turn(control: np.ndarray) -> slice:
    """The steps before the drive first turns back."""
    back = np.flatnonzero(np.diff(control) * _heading(control) < 0)
    return slice(0, back[0] + 1 if back.size else control.size)


class _Problem(NamedTuple):
    """Observations and the program that fits them."""

    build: Callable[..., Scene]
    solve: LeastSquares
    unknowns: Unknowns
    transforms: Transforms
    observations: Observations
    landmarks: Features
    landmarks_until_turn: Features  # of the samples before the drive first turns, which can be overlaid with a scan
    scatter: Scatter | None  # of neighbouring samples, to judge a fit whose noise was estimated from its residuals
    scene: Scene  # at the guess

    def samples(self, prior: np.ndarray, *, overlaid: bool = False, thin: bool = False) -> Samples:
        """The observations for one stage: all of them, or as many as one block holds."""
        observations, landmarks = self.observations, self.landmarks
        if overlaid:
            observations, landmarks = observations.at(_until_turn(observations.control)), self.landmarks_until_turn
        if thin and observations.control.size > BLOCK:
            pick = np.unique(np.linspace(0, observations.control.size - 1, BLOCK).astype(int))
            observations, landmarks = observations.at(pick), landmarks._replace(travel=landmarks.travel[pick])
        route, length = route_of(self.observations.control), float(units(self.scene).control)
        return samples_of(observations, landmarks, self.transforms, prior, route, overlaid=overlaid, length=length)

    @property
    def can_be_overlaid(self) -> bool:
        """Whether the drive starts in the direction of a default scan and a touch is visible."""
        sets_out = _heading(self.observations.control) == self.scene.motion.onwards
        return sets_out and bool(np.isfinite(self.landmarks_until_turn.touch).any())

    def fit(self, y: np.ndarray, near: bool = False) -> tuple[Solution, int]:
        """Fit from a guess, in stages, and count the steps."""
        whole, part = self.samples(y), self.samples(y, thin=True)
        thinned = whole.control.size != part.control.size
        if thinned:
            self.solve.compile_all(part, whole)
        steps = 0
        for overlaid in [True] * (self.can_be_overlaid and not near) + [False] * thinned:
            solution = self.solve(y, self.samples(y, overlaid=overlaid, thin=True), least=COARSE)
            y, steps = solution.y if np.isfinite(solution.y).all() else y, steps + int(solution.steps)
        solution = self.solve(y, self.samples(y))
        return solution, steps + int(solution.steps)

    def compared(self, solution: Solution) -> np.ndarray:
        """Which values are compared with the model, (steps, whiskers, 3): all but those left out at snaps."""
        steps = self.observations.control.size
        return self.observations.known & ~solution.compared.left_out[:steps, None, None]

    def off(self, solution: Solution) -> np.ndarray:
        """Measured - model, (steps, whiskers, 3); NaN where nothing is compared."""
        signals = solution.compared.signals[: self.observations.control.size]
        return np.where(self.compared(solution), self.observations.values - signals, np.nan)

    def degrees(self, solution: Solution) -> int:
        """Degrees of freedom."""
        return int(self.compared(solution).sum()) - solution.y.size

    def largest_noise(self) -> np.ndarray:
        """Largest noise that the observations may have, (..., 3): as given, or from the scatter between neighbours."""
        if self.scatter is None:
            return self.observations.sigma
        uncertainty = 1 + SCATTER_ERROR / np.sqrt(max(1, self.scatter.count))
        return uncertainty * np.maximum(self.scatter.sigma, EXACT * self.observations.peaks)

    def is_plausible(self, solution: Solution) -> bool:
        """Whether noise explains the residuals.

        Noise that was estimated from the residuals explains them by construction, unless samples are left out.
        Therefore the residuals are also compared with the scatter between neighbouring samples.
        """
        off, degrees = self.off(solution), max(1, self.degrees(solution))
        if not (np.isfinite(off[self.compared(solution)]).all() and np.isfinite(solution.misfit)):
            return False
        return is_plausible(solution.misfit, degrees) and (
            self.scatter is None or is_plausible(chi_squared(np.nan_to_num(off / self.largest_noise())), degrees)
        )

    def with_noise_of(self, solution: Solution) -> "_Problem":
        """The same problem with the noise of each reaction estimated from the residuals."""
        off, compared = self.off(solution), self.compared(solution)
        correction = compared.sum() / max(1, self.degrees(solution))
        count = compared.sum(axis=(0, 1))
        squares = np.sum(np.where(compared, off, 0.0) ** 2, axis=(0, 1))
        noise = np.sqrt(correction * squares / np.maximum(count, 1))
        noise = np.where(count > 0, np.maximum(noise, np.finfo(float).eps * self.observations.peaks), 1.0)
        return self._replace(observations=self.observations.with_sigma(noise))


class _Search(NamedTuple):
    """The best solution from several starts."""

    solution: Solution
    steps: int
    starts: int
    agreeing: int  # starts that ended in the same minimum


def _search(problem: _Problem, start: np.ndarray, starts: int, near: bool) -> _Search:
    """Fit from the guess, and then from other starts until enough of them agree on a plausible fit."""
    best, steps = problem.fit(start, near)
    if not starts or problem.is_plausible(best):
        return _Search(best, steps, 1, 1)
    solutions, agreeing = [best], 1
    # If a feature of the data is misread, overlaid scans mislead from every start: skip them every other time.
    for k, y in enumerate([start, *_other_starts(start, starts - 1)]):
        solutions.append(problem.fit(y, near=k % 2 == 0)[0])
        best = min(solutions, key=lambda s: (not np.isfinite(s.misfit), s.misfit))
        agreeing = sum(bool(np.max(np.abs(s.y - best.y)) < SAME) for s in solutions)
        if agreeing >= ENOUGH and problem.is_plausible(best):
            break
    return _Search(best, steps, len(solutions), agreeing)


def _other_starts(y: np.ndarray, count: int) -> list[np.ndarray]:
    """Starts spread evenly around a guess."""
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a count that is not a power of two
        unit = qmc.Sobol(y.size, scramble=True, rng=0).random(count)
    return list(y + SPREAD * (2 * unit - 1))


def _reweighted(problem: _Problem, search: _Search) -> tuple[_Problem, _Search]:
    """Estimate the noise from the residuals and fit again, until both have settled."""
    for _ in range(REWEIGHTINGS):
        problem = problem.with_noise_of(search.solution)
        solution = problem.solve(search.solution.y, problem.samples(search.solution.y))
        search = search._replace(solution=solution, steps=search.steps + int(solution.steps))
        if solution.misfit > SETTLED * problem.degrees(solution):  # otherwise the noise was overestimated
            break
    return problem, search


def _fit_of(problem: _Problem, search: _Search) -> Fit:
    solution, transforms, names = search.solution, problem.transforms, problem.unknowns.all_names
    x = transforms.natural(solution.y, np)
    status, reason = _status_of(problem, solution, x)
    residual, jacobian = solution.observed
    with np.errstate(divide="ignore", invalid="ignore"):
        by_inner = np.nan_to_num(jacobian / transforms.stretch(solution.y))
    information = identifiability(by_inner, names, transforms.log, transforms.scale)
    rate = transforms.per_inner(x)
    covariance = information.covariance * np.outer(rate, rate)
    if status != FitStatus.ok:
        covariance = np.full_like(covariance, np.nan)
    errors = np.sqrt(np.diag(covariance))
    estimates = dict(zip(names, x.tolist(), strict=True))
    at_estimates = {name: estimates[name] for name in problem.unknowns.names}
    return Fit(
        names=names,
        estimates=estimates,
        standard_error=dict(zip(names, errors.tolist(), strict=True)),
        interval=dict(zip(names, transforms.interval(x, errors), strict=True)),
        covariance=covariance,
        correlation=correlation(covariance),
        identified=dict(zip(names, information.identified.tolist(), strict=True)),
        combinations=information.combinations,
        status=status,
        reason=reason,
        chi2=chi_squared(residual),
        degrees=problem.degrees(solution),
        residuals=problem.off(solution),
        signals=solution.compared.signals[: problem.observations.control.size],
        measured=problem.observations,
        steps=search.steps,
        starts=search.starts,
        agreeing=search.agreeing,
        scene=problem.build(**at_estimates) if np.isfinite(x).all() else problem.scene,
        _internals=FitInternals(
            problem.build, problem.unknowns, transforms, problem.solve, problem.samples(solution.y), solution
        ),
    )


def _status_of(problem: _Problem, solution: Solution, x: np.ndarray) -> tuple[FitStatus, str]:
    """How the fit ended, and the reason for failure."""
    path = Status(int(solution.compared.status))
    if not np.isfinite(solution.y).all() or path != Status.ok:
        return FitStatus.failed, f"the scene cannot be scanned there ({path.name})"
    transforms = problem.transforms
    stretch, middle = (np.abs(transforms.stretch(y)) for y in (solution.y, np.zeros_like(solution.y)))
    for k in np.flatnonzero(transforms.bounded & (stretch < AT_BOUND * np.maximum(1.0, middle))):
        low, high = transforms.bounds[k]
        name = problem.unknowns.all_names[k]
        return FitStatus.at_bound, f"{name} = {x[k]:.6g} ended at its bound ({low:g}, {high:g})"
    if not problem.is_plausible(solution):
        return FitStatus.implausible, _why_implausible(problem, solution)
    decrease = possible_decrease(jnp.asarray(solution.residual), jnp.asarray(solution.jacobian))
    if not bool(solution.converged) and float(decrease) > NEGLIGIBLE:
        return FitStatus.not_converged, f"no minimum was reached in {int(solution.steps)} steps"
    return FitStatus.ok, ""


def _why_implausible(problem: _Problem, solution: Solution) -> str:
    off, given = problem.off(solution), problem.scatter is None
    noise = problem.observations.sigma if problem.scatter is None else problem.scatter.sigma
    with np.errstate(divide="ignore", invalid="ignore"):
        share, size = (_rms(off / unit) for unit in (problem.observations.peaks, noise))
    unit = "standard deviations of the noise" if given else "times the scatter between neighbouring samples"
    degrees, compared = problem.degrees(solution), int(problem.compared(solution).sum())
    reason = f"the residuals are {share:.2g} of the peaks, {size:.3g} {unit} (root mean square)"
    if compared < problem.observations.known.sum() / 2:
        reason += f", and only {compared} of {problem.observations.known.sum()} values lie on the same side of a snap"
    reason += f"; chi^2 = {chi_squared(solution.observed[0]):.3g} with {degrees} degrees of freedom"
    return reason if given else f"{reason}. If the noise is correlated between samples, give `sigma`"


def _rms(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else np.nan
