"""Identification: estimate parameters of a scene from observed signals by least squares."""

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeAlias, overload

import numpy as np

from jaxwhisker._base import announce, checks
from jaxwhisker._base.primitive import threads
from jaxwhisker._base.settings import as_here, with_own_settings
from jaxwhisker._inverse import parameters
from jaxwhisker._inverse.bending import BendingFit, bending_test, identify_bending
from jaxwhisker._inverse.channels import Channels, channels_from, table_of_result
from jaxwhisker._inverse.estimates import estimates_of
from jaxwhisker._inverse.features import features, neighbour_scatter
from jaxwhisker._inverse.fit import Fit, FitProblem, FittedRecording, Recording
from jaxwhisker._inverse.gains import gains_from
from jaxwhisker._inverse.least_squares import Minimum
from jaxwhisker._inverse.linearised import check_used
from jaxwhisker._inverse.observations import Observations, read_observations
from jaxwhisker._inverse.recording import check_recording, check_units_of_guess, without_jitter
from jaxwhisker._inverse.scene_fits import COARSE, LeastSquares
from jaxwhisker._inverse.statistics import noise_of_residuals
from jaxwhisker._inverse.unknowns import unknowns_of
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.scene import units
from jaxwhisker._scan.blocks import BLOCK
from jaxwhisker._scan.channels import arguments_of
from jaxwhisker._scan.result import AbstractResult
from jaxwhisker._scan.route import turns_of

LEAST_NOISE = 1e-4  # of the peak: least noise assumed before the residuals give an estimate
SPREAD = np.log(4.0)  # largest distance of other starts from the guess in each of the fit's variables
ESTIMATES = 4  # of the noise from the residuals, at most
ROUGH = 1e-2  # share of the sum of squares: decrease below which a stage without crosstalk ends
STALLED = 1e-4  # the same for fits that noise does not explain
EXACT = 1e-10  # of the peak: signals are not more exact, so that smaller residuals are no noise
OVERESTIMATED = 0.5  # share of the degrees of freedom; below it, chi-squared shows that the noise was overestimated
BASELINE = 5  # first samples, from which constant offsets are guessed
ENOUGH = 3  # starts that must end in the best minimum before the search stops
EQUAL = 1e-3  # difference of the fit's variables up to which two minima are the same


Options: TypeAlias = Mapping[str, Any] | None


@overload
def identify(
    build: Callable[..., AbstractScene],
    guess: Mapping[str, Any],
    measured: Any,
    *,
    sigma: Any = None,
    channels: Any = None,
    offsets: bool = False,
    gains: Any = False,
    shift: bool = False,
    individual: Any = (),
    bounds: Options = None,
    transform: Options = None,
    starts: int = 16,
    near: bool = False,
    snaps: bool = True,
) -> Fit: ...


@overload
def identify(
    build: Callable[..., tuple],
    guess: Mapping[str, Any],
    measured: Any,
    *,
    sigma: Any = None,
    bounds: Options = None,
    transform: Options = None,
) -> BendingFit: ...


@with_own_settings
def identify(
    build: Callable[..., Any],
    guess: Mapping[str, Any],
    measured: Any,
    *,
    sigma: Any = None,
    channels: Any = None,
    offsets: bool = False,
    gains: Any = False,
    shift: bool = False,
    individual: Any = (),
    bounds: Options = None,
    transform: Options = None,
    starts: int = 16,
    near: bool = False,
    snaps: bool = True,
) -> Fit | BendingFit:
    """Estimate the parameters of a scene from the measured signals of one scan or of several.

    The method is Levenberg-Marquardt on whitened residuals, with exact derivatives. Snaps contribute by their positions
    (see residuals.py). A first stage overlays the scans; therefore guesses may be off by a factor of three or more. If
    the residuals are not plausible, other fits follow: with crosstalk among the unknown gains, one that begins without
    crosstalk, and fits from other starts, until one is plausible. A fit that takes longer than two seconds shows its
    progress on terminals and in notebooks.

    **Bending tests**: `build` may return a whisker and loads instead, as `deflect` takes them, and last of all a
    support: `return whisker, load, ...`. `measured` then holds a row for each measurement. Columns with the name of an
    argument of `build` that `guess` does not name, such as a force, are passed to it. Columns to compare are fx, fy,
    mz, base_x, base_y, base_angle; tip_x, tip_y, tip_angle; and x, y, angle at the arc length in the column s. x and y
    without s are points of the shape, which are compared by their `distance` from it. `sigma` is a number or a mapping
    from these names; without it, the noise of each column is estimated from the residuals, which must not be larger
    than 5 % of the peak. Of the other options, `bounds` and `transform` apply. The result is a BendingFit.

    Args:
        build: makes a Scene from named numbers: parameters of springs, object and
            whiskers; or a whisker and loads. JAX must be able to trace it.
        guess: an initial value of each unknown parameter.
        measured: `control` and any of fx, fy, mz (fx_1, fx_2, ... of several whiskers; in space also fz, mx, my), or of
            the names in `channels` or `gains`: a mapping of arrays, a Result, a Dataset with one scan, a DataFrame or
            the path of a CSV file. Arrays are (steps,) or (steps, whiskers), in the units of the scene, with the signs
            of `scene.py` (forces and moments of the support on the whisker), and in the order in which the drive moved.
            NaN is skipped. A list of these: several recordings, which are fitted together.
        sigma: standard deviation of the noise: a number, or a mapping from channels to numbers or arrays. Default: one
            number per channel, estimated from the residuals; the fit is then plausible if the residuals are not larger
            than the scatter between neighbouring samples. Noise that is correlated between samples needs `sigma`.
        channels: what the sensor measures, if not reactions: a function of the Result of a scan that returns a mapping
            from names to arrays (steps,), such as `lambda result: {"bend": result.base_angle}`. Its further arguments
            are unknown parameters as well, which `guess` names. It must not ask for events.
        offsets: whether an unknown constant is added to every measured channel.
        gains: True if every measured channel is a signal times an unknown factor of either sign, before its offset is
            added, so that it may be in any unit. Or a matrix G, (channels, signals): measured = G signals + offsets.
            The signals are the reactions, or what `channels` computes, in their order. An entry that is NaN is an
            unknown, such as `gain_fx_my`, the part of my in fx, or `gain_fx`, that of fx. The same matrix holds for
            all whiskers, unless its shape is (whiskers, channels, signals); each has its own unknowns. A mapping from
            the names of measured channels to rows of G also stands for other channels than the signals.
        shift: whether the control is off by an unknown constant: the scene's is the measured one plus `shift`.
        individual: names of unknowns that recordings do not share (parameters, "offsets", "gains", "shift"): each
            recording has its own. A mapping from names to one label per recording: recordings with the same label share
            the value, `name[label]`.
        bounds: pairs (low, high) by name, None for no bound.
        transform: "log" or "linear" by name. Default: log for parameters that `build` rejects if they are negative.
        starts: largest number of further fits while none is plausible; 0 for none.
        near: whether the guess is close to the solution; the first stage is then skipped.
        snaps: whether jumps of the signals are snaps, whose positions are then compared. Use False for `channels` that
            jump for other reasons, such as frequencies, which change suddenly at the first touch.

    Returns:
        A Fit, or a BendingFit. Unless its status is `ok`, `reason` says why and there are no standard errors:
        `implausible` (noise does not explain the residuals), `not_converged`, `at_bound` or `failed` (no scan or
        deflection there). Parameters that are not identifiable have no standard error, and `combinations` describes
        them.

    Raises:
        ValueError: if an argument is wrong; if JAX cannot trace `build`, or `build` ignores a parameter; if `measured`
            has too few values, shows no contact, is in other units than the scene, or is in reversed order (which is
            recognised for translations that start free, if fx of all whiskers is measured).
    """
    checks.float64_mode()
    guess = parameters.read_parameters("guess", guess)
    if (test := bending_test(build, guess, measured)) is not None:
        options = {"channels": channels, "offsets": offsets, "gains": gains, "shift": shift, "individual": individual}
        for name, value in options.items():
            if value is not None and value is not False and value != ():
                checks.fail(name, "omitted for bending tests", value)
        return identify_bending(test, guess, sigma, bounds, transform)
    checks.count("starts", starts, least=0)
    for name, value in {"offsets": offsets, "shift": shift, "near": near, "snaps": snaps}.items():
        checks.instance(name, value, bool, "True or False")
    own = arguments_of(channels)
    scene = parameters.build_scene("guess", build, {name: v for name, v in guess.items() if name not in own})
    measures, values = channels_from(channels, scene, guess)
    further = {name: guess[name] for name in measures.parameters}
    transforms = parameters.transforms_of(build, values, bounds, transform, further)
    parameters.check_traceable(build, values)
    check_used(build, values)
    scale = gains_from(gains, measures, len(scene.whiskers))
    recorded = _read(measured, sigma, measures, scale.names, len(scene.whiskers))
    observations = [dataclasses.replace(one, control=without_jitter(one.control)) for one in recorded]

    present = tuple(dict.fromkeys((c.whisker, c.kind) for one in observations for c in one.channels))
    scale, moved = scale.of_measured(present), present if offsets else ()
    unknowns = unknowns_of(tuple(values), measures, moved, scale, shift, individual, len(observations))
    baselines = [_baseline(one) if offsets else np.zeros(one.values.shape[1:]) for one in observations]
    centred = [dataclasses.replace(o, values=o.values - base) for o, base in zip(observations, baselines, strict=True)]
    in_units = channels is None and scale.matrix is None
    for one in centred:
        check_recording(one, scene, len(unknowns.all_names) if len(centred) == 1 else 0, in_units=in_units)

    scatter = None
    if all(np.isnan(one.sigma[one.known]).all() for one in observations):
        scatter = neighbour_scatter(*observations)
        noise = np.maximum(scatter.sigma, LEAST_NOISE * np.max([one.peaks for one in observations], axis=0))
        observations, centred = ([one.with_sigma(noise) for one in several] for several in (observations, centred))
    recordings = tuple(_recording(*pair, scene, snaps) for pair in zip(observations, centred, strict=True))
    with announce.progress("fitting") as report:
        solve = LeastSquares(build, unknowns, transforms, report)
        solve, start = _ready(solve, [*values.values(), *further.values()], baselines, recordings)
        if in_units:
            for one in centred:
                check_units_of_guess(one, scene)
        problem = FitProblem(build, solve, recordings, None)
        search = _search(problem, start, starts, near)
        if scatter is not None:
            problem, search = _reweighted(problem._replace(scatter=scatter), search)
    # A fit keeps its problem, but no callback: fits can be pickled.
    return _fit_of(problem._replace(solve=problem.solve._replace(report=None)), search)


def _read(measured: Any, sigma: Any, channels: Channels, names: tuple[str, ...], whiskers: int) -> list[Observations]:
    """All recordings, with these names of measured channels."""
    recordings = measured if isinstance(measured, (list, tuple)) else [measured]
    if not recordings:
        raise ValueError("`measured` must hold at least one recording, got an empty list.")
    if channels.function is None:
        return [read_observations(one, sigma, whiskers=whiskers, kinds=names) for one in recordings]
    tables = [table_of_result(channels, one) if isinstance(one, AbstractResult) else one for one in recordings]
    return [read_observations(table, sigma, whiskers=1, kinds=names) for table in tables]


def _recording(observations: Observations, centred: Observations, scene: AbstractScene, snaps: bool) -> Recording:
    first_leg = slice(0, min([*turns_of(observations.control), observations.control.size - 1]) + 1)
    options = {"snaps": snaps, "friction": scene.friction is not None}
    landmarks = (features(one, **options) for one in (centred, centred.at(first_leg)))
    return Recording(observations, next(landmarks), first_leg, next(landmarks), scene)


def _baseline(observations: Observations) -> np.ndarray:
    """Median of each channel's first samples, (whiskers, 3); 0 where nothing was measured."""
    baseline = np.zeros(observations.values.shape[1:])
    for whisker, kind, _ in observations.channels:
        signal = observations.values[:, whisker, kind]
        baseline[whisker, kind] = np.median(signal[np.isfinite(signal)][:BASELINE])
    return baseline


def _ready(
    solve: LeastSquares, values: list[float], baselines: list[np.ndarray], recordings: tuple[Recording, ...]
) -> tuple[LeastSquares, np.ndarray]:
    """The solver, with natural sizes of all unknowns, and the variables from which it starts."""
    unknowns, scene = solve.unknowns, recordings[0].scene
    nothing = [np.zeros_like(baseline) for baseline in baselines]
    peaks = np.max([recording.observations.peaks for recording in recordings], axis=0)
    offsets = [float(peaks[kind]) for _, kind in unknowns.offsets]
    shifts = [float(units(scene).control)] * unknowns.shift

    def with_gains(sizes, gains, baselines: list[np.ndarray]) -> tuple[LeastSquares, np.ndarray]:
        transforms = solve.transforms.with_sizes([*offsets, *sizes, *shifts]).at(unknowns.own_index)
        x = np.zeros(len(unknowns.all_names))
        for baseline, columns in zip(baselines, unknowns.columns, strict=True):
            own = [*values, *(baseline[channel] for channel in unknowns.offsets), *gains, *[0.0] * unknowns.shift]
            x[columns] = own
        return solve._replace(transforms=transforms), transforms.variables(x)

    count = len(unknowns.gains.unknown)
    if not count:
        return with_gains([], [], baselines)
    # The signals of the scene at the guess tell how large a gain is.
    plain, y = with_gains([1.0] * count, [1.0] * count, nothing)
    at = plain.evaluate(y, [r.samples(overlaid=r.can_be_overlaid, thin=True) for r in recordings], y)
    signals = np.concatenate([each.unscaled for each in at.compared])
    return with_gains(*unknowns.gains.sizes(peaks, signals), baselines)


def _fit_in_stages(problem: FitProblem, y: np.ndarray, near: bool, plain: bool = False) -> tuple[Minimum, int]:
    """Fit from a guess, and count the steps; `plain` says whether the first stage is without crosstalk."""
    thinned = any(recording.observations.control.size > BLOCK for recording in problem.recordings)
    overlaid = not near and all(recording.can_be_overlaid for recording in problem.recordings)
    steps = 0
    first = {"free": ~problem.unknowns.crosstalk, "share": 0.0 if overlaid else ROUGH} if plain else {}
    for over, options in [(overlaid, first)] * (overlaid or plain) + [(False, {})] * thinned:
        data = problem.samples(overlaid=over, thin=True)
        solution = problem.solve(y, data, y, least=COARSE, **options)
        y, steps = solution.y, steps + solution.steps
    data = problem.samples()
    solution = problem.solve(y, data, y, share=STALLED)
    return solution, steps + solution.steps


class _Search(NamedTuple):
    """The best solution from several starts."""

    solution: Minimum
    steps: int
    starts: int
    agreeing: int  # starts that ended in the same minimum


def _search(problem: FitProblem, start: np.ndarray, starts: int, near: bool) -> _Search:
    """Fit from the guess; if that is not plausible, from other starts until one is, or enough agree on the best fit."""
    best, steps = _fit_in_stages(problem, start, near)
    if not starts or problem.is_plausible(best):
        return _Search(best, steps, 1, 1)
    solutions, agreeing = [best], 1
    crosstalk = bool(problem.unknowns.crosstalk.any())

    def fit(number: int, y: np.ndarray) -> Minimum:
        # If a feature of the data is misread, overlaid scans mislead from every start: skip them every other time.
        # A whole gain matrix explains most of the signals of a wrong scene: then fit without crosstalk first.
        other = number % 2 == 0
        return _fit_in_stages(problem, y, near=other and not crosstalk, plain=other and crosstalk)[0]

    def fits(pool: ThreadPoolExecutor) -> Iterator[Minimum]:
        yield fit(0, start)  # alone: it often succeeds, and fits that run beside it would have to end first
        yield from pool.map(as_here(fit), range(1, starts), _other_starts(start, starts - 1))

    with ThreadPoolExecutor(threads()) as pool:
        for solution in fits(pool):
            solutions.append(solution)
            best = min(solutions, key=lambda s: (not np.isfinite(s.misfit), s.misfit))
            agreeing = sum(bool(np.max(np.abs(s.y - best.y)) < EQUAL) for s in solutions)
            if agreeing >= ENOUGH or problem.is_plausible(best):
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
        off, compared, y = problem.off(search.solution), problem.compared(search.solution), search.solution.y
        problem = problem.with_noise(noise_of_residuals(off, compared, y.size, EXACT * problem.peaks))
        solution = problem.solve(y, problem.samples(), y)
        search = search._replace(solution=solution, steps=search.steps + solution.steps)
        if solution.misfit > OVERESTIMATED * problem.degrees(solution):
            break
    return problem, search


def _fit_of(problem: FitProblem, search: _Search) -> Fit:
    solution, transforms, names = search.solution, problem.transforms, problem.unknowns.all_names
    x = transforms.natural(solution.y, np)
    status, reason = problem.status(solution)
    residual, jacobian = solution.observed
    return Fit(
        **estimates_of(names, transforms, solution.y, residual, jacobian, status),
        reason=reason,
        degrees=problem.degrees(solution),
        recordings=tuple(_fitted(problem, solution, x, k) for k in range(len(problem.recordings))),
        steps=search.steps,
        starts=search.starts,
        agreeing=search.agreeing,
        _problem=problem,
        _solution=solution,
    )


def _fitted(problem: FitProblem, solution: Minimum, x: np.ndarray, k: int) -> FittedRecording:
    recording, comparison = problem.recordings[k], solution.compared[k]
    unknowns = problem.unknowns
    force_moment = problem.force_moment(x[unknowns.columns[k]], recording.observations)
    values = {name: float(value) for name, value in unknowns.scene_values(x, k).items()}
    return FittedRecording(
        measured=recording.observations,
        signals=comparison.signals[: recording.observations.control.size],
        residuals=recording.off(comparison),
        parameters=values,
        scene=problem.build(**values) if np.isfinite(x).all() else recording.scene,
        force_moment=None if force_moment is None else force_moment[0],
        force_moment_score=None if force_moment is None else force_moment[1],
        in_units=unknowns.channels.function is None and unknowns.gains.matrix is None,
    )
