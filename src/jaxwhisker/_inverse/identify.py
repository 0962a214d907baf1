"""Identification: estimate parameters of a scene from observed signals by least squares."""

import dataclasses
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.primitive import threads
from jaxwhisker._inverse import parameters
from jaxwhisker._inverse.features import features, neighbour_scatter
from jaxwhisker._inverse.fit import Fit, FitProblem
from jaxwhisker._inverse.least_squares import COARSE, LeastSquares, Minimum, possible_decrease
from jaxwhisker._inverse.linearised import check_used
from jaxwhisker._inverse.observations import Observations, read_observations
from jaxwhisker._inverse.parameters import Unknowns
from jaxwhisker._inverse.recording import check_recording
from jaxwhisker._inverse.statistics import FitStatus, chi_squared, correlation, identifiability
from jaxwhisker._model.scene import Scene, units
from jaxwhisker._path.path import Status
from jaxwhisker._scan.route import turns_of
from jaxwhisker._scan.scan import BLOCK

LEAST_NOISE = 1e-4  # of the peak: least noise assumed before the residuals give an estimate
SPREAD = np.log(4.0)  # largest distance of other starts from the guess in each of the fit's variables
ESTIMATES = 4  # of the noise from the residuals, at most
OVERESTIMATED = 0.5  # share of the degrees of freedom; below it, chi-squared shows that the noise was overestimated
BASELINE = 5  # first samples, from which constant offsets are guessed
ENOUGH = 3  # starts that must end in the same plausible minimum before the search stops
EQUAL = 1e-3  # difference of the fit's variables up to which two minima are the same
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
    guess = parameters.read_parameters("guess", guess)
    scene = parameters.build_scene("guess", build, guess)
    checks.count("starts", starts, least=0)
    transforms = parameters.transforms_of(build, guess, bounds, transform)
    parameters.check_traceable(build, guess)
    check_used(build, guess)
    observations = read_observations(measured, sigma, whiskers=len(scene.whiskers))

    channels = tuple((c.whisker, c.reaction) for c in observations.channels) if offsets else ()
    unknowns = Unknowns(tuple(guess), channels, shift)
    baseline = _baseline(observations) if offsets else np.zeros(observations.values.shape[1:])
    centred = dataclasses.replace(observations, values=observations.values - baseline)
    check_recording(centred, scene, len(unknowns.all_names))
    sizes = [float(observations.peaks[reaction]) for _, reaction in channels] + [float(units(scene).control)] * shift
    transforms = transforms.with_sizes(sizes)
    start = transforms.variables([*guess.values(), *(baseline[channel] for channel in channels), *[0.0] * shift])

    scatter = None
    if np.isnan(observations.sigma[observations.known]).all():
        scatter = neighbour_scatter(observations)
        observations = observations.with_sigma(np.maximum(scatter.sigma, LEAST_NOISE * observations.peaks))
        centred = centred.with_sigma(observations.sigma)
    first_leg = slice(0, min([*turns_of(observations.control), observations.control.size - 1]) + 1)
    problem = FitProblem(
        build=build,
        solve=LeastSquares(build, unknowns, transforms),
        unknowns=unknowns,
        transforms=transforms,
        observations=observations,
        landmarks=features(centred),
        first_leg=first_leg,
        landmarks_of_leg=features(centred.at(first_leg)),
        scatter=None,
        scene=scene,
    )
    search = _search(problem, start, starts, near)
    if scatter is not None:
        problem, search = _reweighted(problem._replace(scatter=scatter), search)
    return _fit_of(problem, search)


def _baseline(observations: Observations) -> np.ndarray:
    """Median of each channel's first samples, (whiskers, 3); 0 where nothing was measured."""
    baseline = np.zeros(observations.values.shape[1:])
    for whisker, reaction, _ in observations.channels:
        signal = observations.values[:, whisker, reaction]
        baseline[whisker, reaction] = np.median(signal[np.isfinite(signal)][:BASELINE])
    return baseline


def _can_be_overlaid(problem: FitProblem) -> bool:
    """Whether the drive starts in the direction of a default scan and a touch is visible."""
    leg = problem.observations.control[problem.first_leg]
    onwards = np.sign(leg[-1] - leg[0]) == problem.scene.motion.onwards
    return bool(onwards and np.isfinite(problem.landmarks_of_leg.touch).any())


def _fit_in_stages(problem: FitProblem, y: np.ndarray, near: bool) -> tuple[Minimum, int]:
    """Fit from a guess, and count the steps."""
    thinned = problem.observations.control.size > BLOCK
    steps = 0
    for overlaid in [True] * (_can_be_overlaid(problem) and not near) + [False] * thinned:
        solution = problem.solve(y, problem.samples(overlaid=overlaid, thin=True), y, least=COARSE)
        y, steps = solution.y, steps + solution.steps
    solution = problem.solve(y, problem.samples(), y)
    return solution, steps + solution.steps


class _Search(NamedTuple):
    """The best solution from several starts."""

    solution: Minimum
    steps: int
    starts: int
    agreeing: int  # starts that ended in the same minimum


def _search(problem: FitProblem, start: np.ndarray, starts: int, near: bool) -> _Search:
    """Fit from the guess, and then from other starts until enough of them agree on a plausible fit."""
    best, steps = _fit_in_stages(problem, start, near)
    if not starts or problem.is_plausible(best):
        return _Search(best, steps, 1, 1)
    solutions, agreeing = [best], 1

    def fit(number: int, y: np.ndarray) -> Minimum:
        # If a feature of the data is misread, overlaid scans mislead from every start: skip them every other time.
        return _fit_in_stages(problem, y, near=number % 2 == 0)[0]

    others = [start, *_other_starts(start, starts - 1)]
    with ThreadPoolExecutor(threads()) as pool:
        for solution in pool.map(fit, range(len(others)), others):
            solutions.append(solution)
            best = min(solutions, key=lambda s: (not np.isfinite(s.misfit), s.misfit))
            agreeing = sum(bool(np.max(np.abs(s.y - best.y)) < EQUAL) for s in solutions)
            if agreeing >= ENOUGH and problem.is_plausible(best):
                pool.shutdown(wait=False, cancel_futures=True)
                break
    return _Search(best, steps, len(solutions), agreeing)


def _other_starts(y: np.ndarray, count: int) -> list[np.ndarray]:
    """Starts spread evenly around a guess."""
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a count that is not a power of two
        unit = qmc.Sobol(y.size, scramble=True, rng=0).random(count)
    return list(y + SPREAD * (2 * unit - 1))


def _reweighted(problem: FitProblem, search: _Search) -> tuple[FitProblem, _Search]:
    """Estimate the noise from the residuals and fit again, until both have settled."""
    for _ in range(ESTIMATES):
        problem = _with_noise_of(problem, search.solution)
        solution = problem.solve(search.solution.y, problem.samples(), search.solution.y)
        search = search._replace(solution=solution, steps=search.steps + solution.steps)
        if solution.misfit > OVERESTIMATED * problem.degrees(solution):
            break
    return problem, search


def _with_noise_of(problem: FitProblem, solution: Minimum) -> FitProblem:
    """The same problem with the noise of each reaction estimated from the residuals."""
    compared = problem.compared(solution)
    count = compared.sum(axis=(0, 1))
    correction = count.sum() / max(1, problem.degrees(solution))
    squares = np.sum(np.where(compared, problem.off(solution), 0.0) ** 2, axis=(0, 1))
    noise = np.sqrt(correction * squares / np.maximum(count, 1))
    noise = np.where(count > 0, np.maximum(noise, np.finfo(float).eps * problem.observations.peaks), 1.0)
    return problem._replace(observations=problem.observations.with_sigma(noise))


def _fit_of(problem: FitProblem, search: _Search) -> Fit:
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
        _problem=problem,
        _solution=solution,
    )


def _status_of(problem: FitProblem, solution: Minimum, x: np.ndarray) -> tuple[FitStatus, str]:
    """How the fit ended, and the reason for failure."""
    path = Status(solution.compared.status)
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
    if not solution.converged and possible_decrease(solution.residual, solution.jacobian) > NEGLIGIBLE:
        return FitStatus.not_converged, f"no minimum was reached in {solution.steps} steps"
    return FitStatus.ok, ""


def _why_implausible(problem: FitProblem, solution: Minimum) -> str:
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
