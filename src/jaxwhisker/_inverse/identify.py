"""Identification: parameters of a scene from signals that were measured, by least squares."""

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._inverse.features import Features, features, noise_of, peaks
from jaxwhisker._inverse.fit import Fit
from jaxwhisker._inverse.fit_status import FitStatus, plausible
from jaxwhisker._inverse.identifiability import identifiability
from jaxwhisker._inverse.kernel import COARSE, Kernel, Solved, could_fall, kernel
from jaxwhisker._inverse.measured import CHANNELS, Measured, has_contact, measured_of
from jaxwhisker._inverse.misfit import BLOCK, Samples, Sought, samples
from jaxwhisker._inverse.transforms import Transform, checked_scene, checked_values, natural, table, transforms_of
from jaxwhisker._model.scene import Scene, units
from jaxwhisker._path.path import Status
from jaxwhisker._scan.route import route_of

LEAST_NOISE = 1e-4  # as a share of the peak, until the residuals tell
MISFIT = 0.05  # share of the peak, root mean square, above which it is where the noise is not known
SPREAD = np.log(4.0)  # of starts around the guess: half the range of the fit's variables
FAR = {"control": (1e-2, 1e3), "reaction": (1e-3, 1e4)}  # ratios to the scene's units outside of which one is warned
REWEIGHTINGS = 4  # at most, where the residuals tell the noise
BASELINE = 5  # first samples, from which constant offsets are guessed
ENOUGH = 3  # starts that end in the same plausible minimum: no more are tried
SAME = 1e-3  # difference of the fit's variables up to which two minima are one
FALL = 1e-2  # of chi^2, within a tenth of a standard error: a minimum, although the solver did not come to an end
END = 1e-3  # share of the way between bounds: as near is at one


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
    """Find the parameters of a scene whose signals are those that were measured.

    Levenberg-Marquardt on whitened residuals, with exact derivatives. Snaps count by their positions: see misfit.py.
    A first stage lays the scans over each other, so that guesses may be wrong by a factor of three and more. If the
    misfit then is not plausible, fits from other starts follow.

    Args:
        build: makes a Scene from numbers given by name: any numbers, of springs, object, whiskers.
        guess: a first value for each parameter that is sought.
        measured: a mapping of arrays, a Result, a Dataset with one scan, a DataFrame or the path of a CSV file, with
            `control` and any of fx, fy, mz (fx_1, fx_2, ... of several whiskers), in the units of the scene and with
            the signs of `scene.py`; in the order in which the drive moved. NaN is skipped.
        sigma: standard deviation of the noise: a number, or a mapping from channels to numbers or arrays. Default: a
            number per channel, estimated from the residuals.
        offsets: whether every measured channel has an unknown constant added.
        shift: whether the control is off by an unknown constant: the scene's is the measured one plus `shift`.
        bounds: pairs (low, high) by name, None for no bound; they are kept.
        transform: "log" or "linear" by name. Default: log of what the scene wants to be positive.
        near: whether the guess is near: leaves out the first stage.
        starts: how many other starts to try at most where the first misfit is implausible; 0 for none.

    Returns:
        A Fit. Its status tells whether it ended well; what the data do not tell has no standard error, and
        `combinations` say what it is.

    Raises:
        ValueError: if an argument is wrong; if `build` ignores a parameter; if there are fewer data than parameters, or
            no contact in them.

    Warns:
        UserWarning: if measured values and the scene's units differ by orders of magnitude.
    """
    checks.float64_mode()
    guess = checked_values("guess", guess)
    checked_scene("guess", build, guess)
    if isinstance(starts, bool) or not isinstance(starts, int) or starts < 0:
        raise ValueError(f"`starts` must be an int of at least 0, but is {starts!r}.")
    transforms = transforms_of(build, guess, bounds or {}, transform or {})
    scene = build(**guess)
    _check_used(build, guess)
    data = measured_of(measured, sigma, whiskers=len(scene.whiskers))
    _check_data(data, scene, len(guess))

    peak, start = peaks(data), dict(guess)
    channels = [(k, c) for k in range(data.values.shape[1]) for c in range(len(CHANNELS)) if data.known[:, k, c].any()]
    channels = tuple(channels) if offsets else ()
    every = list(transforms.values())
    for k, c in channels:
        every.append(Transform(scale=float(peak[c])))
        first = data.values[:, k, c][data.known[:, k, c]][:BASELINE]
        start[f"offset {k} {c}"] = float(np.median(first)) if first.size else 0.0
    if shift:
        every.append(Transform(scale=float(units(scene).control)))
        start["shift"] = 0.0
    sought = Sought(tuple(guess), channels, shift)
    transforms = tuple(every)
    y = np.array([t.seen(x) for t, x in zip(every, start.values(), strict=True)])

    unknown = bool(np.isnan(data.sigma[data.known]).all())
    if unknown:
        noise = np.maximum(noise_of(data), LEAST_NOISE * peak)
        data = Measured(data.control, data.values, np.broadcast_to(noise, data.values.shape))
    zeroed = data.values.copy()
    for n, (k, c) in enumerate(channels):
        zeroed[:, k, c] -= list(start.values())[len(guess) + n]
    seen = features(Measured(data.control, zeroed, data.sigma))
    leg = _until_turn(data.control)
    begun = features(Measured(data.control[leg], zeroed[leg], data.sigma[leg]))
    problem = _Problem(kernel(build, sought), sought, transforms, data, seen, begun, scene)
    found, steps = problem.fit(y, near)
    tried = agreeing = 1
    if starts and not problem.plausible(found):
        others = [found]
        # Where a feature of the data is not what it seems, scans that are laid over each other mislead from everywhere.
        for k, other in enumerate([y, *_starts(y, starts - 1)]):
            others.append(problem.fit(other, near=k % 2 == 0)[0])
            found = min(others, key=lambda s: (not np.isfinite(s.misfit), s.misfit))
            agreeing = sum(bool(np.max(np.abs(s.y - found.y)) < SAME) for s in others)
            if agreeing >= ENOUGH and problem.plausible(found):
                break
        tried = len(others)
    for _ in range(REWEIGHTINGS if unknown else 0):
        problem = problem.with_noise(found)
        found, more = problem.fine(found.y)
        steps += more
        if found.misfit > problem.degrees(found) / 2:  # or the fit has gone on, and there is less noise than it seemed
            break
    return _told(build, problem, found, steps, tried, agreeing, unknown)


def _until_turn(control: np.ndarray) -> slice:
    """The steps before the drive first turns back."""
    back = np.flatnonzero(np.diff(control) * _heading(control) < 0)
    return slice(0, back[0] + 1 if back.size else control.size)


def _heading(control: np.ndarray) -> float:
    """The sign of the drive's first move."""
    moves = np.diff(control)
    return float(np.sign(moves[moves != 0][:1]).sum())


def _starts(y: np.ndarray, count: int) -> list[np.ndarray]:
    """Other starts around a guess, evenly spread."""
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a count that is no power of two
        unit = qmc.Sobol(y.size, scramble=True, rng=0).random(count)
    return list(y + SPREAD * (2 * unit - 1))


class _Problem(NamedTuple):
    """Data and the kernel that fits them."""

    kernel: Kernel
    sought: Sought
    transforms: tuple[Transform, ...]
    data: Measured
    seen: Features
    begun: Features  # of the data before the drive turns, which can be laid over a scan
    scene: Scene

    def samples(self, prior: np.ndarray, *, overlaid: bool, thin: bool) -> Samples:
        """What is compared: all of it, or so much as one block holds."""
        data, seen = self.data, self.seen
        if overlaid:
            leg, seen = _until_turn(data.control), self.begun
            data = Measured(data.control[leg], data.values[leg], data.sigma[leg])
        if thin and data.control.size > BLOCK:
            pick = np.unique(np.linspace(0, data.control.size - 1, BLOCK).astype(int))
            data = Measured(data.control[pick], data.values[pick], data.sigma[pick])
            seen = seen._replace(way=seen.way[pick])
        length = float(units(self.scene).control)
        route = route_of(self.data.control)
        return samples(data, seen, self.transforms, prior, (route.stops, route.last), overlaid=overlaid, length=length)

    @property
    def overlayable(self) -> bool:
        """Whether the drive sets out as a default scan does and there is a touch, so that scans have a beginning."""
        sets_out = _heading(self.data.control) == self.scene.motion.onwards
        return sets_out and bool(np.isfinite(self.begun.touch).any())

    def fit(self, y: np.ndarray, near: bool = False) -> tuple[Solved, int]:
        """From a guess, in stages."""
        whole, part = (self.samples(y, overlaid=False, thin=thin) for thin in (False, True))
        two = whole.control.size != part.control.size
        if two:
            self.kernel.compile(part, whole)
        steps = 0
        if self.overlayable and not near:
            found = self.kernel(y, self.samples(y, overlaid=True, thin=True), fall=COARSE)
            y, steps = (found.y if np.isfinite(found.y).all() else y), int(found.steps)
        if two:
            found = self.kernel(y, self.samples(y, overlaid=False, thin=True), fall=COARSE)
            y, steps = (found.y if np.isfinite(found.y).all() else y), steps + int(found.steps)
        found, more = self.fine(y)
        return found, steps + more

    def fine(self, y: np.ndarray) -> tuple[Solved, int]:
        """From nearby."""
        found = self.kernel(y, self.samples(y, overlaid=False, thin=False))
        return found, int(found.steps)

    def compared(self, found: Solved) -> np.ndarray:
        """Which measured values have an equal of the model's: (steps, whiskers, 3)."""
        steps = self.data.control.size
        return self.data.known & ~found.compared.left_out[:steps, None, None]

    def misses(self, found: Solved) -> np.ndarray:
        """Measured - model, (steps, whiskers, 3); NaN where nothing is compared."""
        signals = found.compared.signals[: self.data.control.size]
        return np.where(self.compared(found), self.data.values - signals, np.nan)

    def degrees(self, found: Solved) -> int:
        """Of freedom."""
        return int(self.compared(found).sum()) - found.y.size

    def plausible(self, found: Solved, unknown: bool = False) -> bool:
        """Whether noise explains the misfit; where nothing is known of the noise, whether it is small."""
        misses = self.misses(found)
        if not np.isfinite(misses[self.compared(found)]).all() or not np.isfinite(found.misfit):
            return False
        if unknown:
            return bool(np.sqrt(np.nanmean((misses / peaks(self.data)) ** 2)) < MISFIT)
        degrees = max(1, self.degrees(found))
        return plausible(found.misfit, degrees)

    def with_noise(self, found: Solved) -> "_Problem":
        """The same with the noise of each channel that the residuals tell."""
        misses, compared = self.misses(found), self.compared(found)
        lost = compared.sum() / max(1, self.degrees(found))
        size, count = np.where(compared, misses, 0.0), compared.sum(axis=(0, 1))
        noise = np.sqrt(lost * np.sum(size**2, axis=(0, 1)) / np.maximum(count, 1))
        least = np.finfo(float).eps * peaks(self.data)
        noise = np.where(count > 0, np.maximum(noise, least), 1.0)
        return self._replace(data=Measured(self.data.control, self.data.values, self.data.sigma * 0 + noise))


def _told(
    build: Callable[..., Scene], problem: _Problem, found: Solved, steps: int, tried: int, agreeing: int, unknown: bool
) -> Fit:
    """The fit that is handed out."""
    sought, names = problem.sought, problem.sought.all_names
    x = np.asarray(natural(jnp.asarray(found.y), table(problem.transforms)))
    estimates = dict(zip(names, x.tolist(), strict=True))
    status, reason = _judged(problem, found, unknown)
    stretch = np.array([t.stretch(float(v)) for t, v in zip(problem.transforms, found.y, strict=True)])
    rows = found.residual.size - found.y.size  # without the prior
    with np.errstate(divide="ignore", invalid="ignore"):
        jacobian = np.nan_to_num(found.jacobian[:rows] / stretch)
    log = np.array([t.log for t in problem.transforms])
    scale = np.array([t.scale for t in problem.transforms])
    known = identifiability(jacobian, names, log, scale)
    per = np.array([t.per_inner(v) for t, v in zip(problem.transforms, x, strict=True)])
    covariance = known.covariance * np.outer(per, per)
    if status != FitStatus.ok:
        covariance = np.full_like(covariance, np.nan)
    errors = np.sqrt(np.diag(covariance))
    intervals = [t.interval(v, e) for t, v, e in zip(problem.transforms, x, errors, strict=True)]
    return Fit(
        names=names,
        estimates=estimates,
        standard_error=dict(zip(names, errors.tolist(), strict=True)),
        interval=dict(zip(names, intervals, strict=True)),
        covariance=covariance,
        correlation=covariance / np.outer(errors, errors),
        identified=dict(zip(names, known.identified.tolist(), strict=True)),
        combinations=known.combinations,
        status=status,
        reason=reason,
        chi2=float(np.sum(np.square(found.residual[:rows]))),
        degrees=problem.degrees(found),
        residuals=problem.misses(found),
        signals=found.compared.signals[: problem.data.control.size],
        measured=problem.data,
        steps=steps,
        starts=tried,
        agreeing=agreeing,
        scene=build(**{name: estimates[name] for name in sought.names}) if np.isfinite(x).all() else problem.scene,
        _sought=sought,
        _transforms=problem.transforms,
        _kernel=problem.kernel,
        _data=problem.samples(found.y, overlaid=False, thin=False),
        _solved=found,
        _build=build,
    )


def _judged(problem: _Problem, found: Solved, unknown: bool) -> tuple[FitStatus, str]:
    """How the fit ended, and why it is no good one."""
    if not np.isfinite(found.y).all() or int(found.compared.status) != Status.ok:
        return FitStatus.failed, f"the scene cannot be scanned there ({Status(int(found.compared.status)).name})"
    estimates = np.asarray(natural(jnp.asarray(found.y), table(problem.transforms)))
    for name, t, x, y in zip(problem.sought.all_names, problem.transforms, estimates, found.y, strict=True):
        if t.bounded and abs(t.stretch(float(y))) < END * max(1.0, abs(t.stretch(0.0))):
            return FitStatus.at_bound, f"{name} = {float(x):.6g} ended at its bound ({t.low:g}, {t.high:g})"
    if not problem.plausible(found, unknown):
        size = np.sqrt(np.nanmean((problem.misses(found) / problem.data.sigma) ** 2))
        share = np.sqrt(np.nanmean((problem.misses(found) / peaks(problem.data)) ** 2))
        words = f"{share:.2g} of the peaks" + ("" if unknown else f", {size:.3g} standard deviations of the noise")
        return FitStatus.implausible, f"the residuals are {words} (root mean square)"
    if not bool(found.converged) and float(could_fall(jnp.asarray(found.residual), jnp.asarray(found.jacobian))) > FALL:
        return FitStatus.not_converged, f"no minimum was found in {int(found.steps)} steps"
    return FitStatus.ok, ""


def _check_used(build: Callable[..., Scene], guess: dict[str, float]) -> None:
    def leaves(values):
        return [leaf for leaf in jax.tree.leaves(jax.tree.map(checks.as_float, build(**values))) if _numeric(leaf)]

    changes = jax.jacfwd(leaves)(guess)
    for name in guess:
        if not any(np.any(np.asarray(change[name]) != 0) for change in changes):
            raise ValueError(
                f"`guess` must name parameters that `build` uses, but nothing in its scene depends on {name}."
            )


def _numeric(leaf: Any) -> bool:
    return isinstance(leaf, (jax.Array, np.ndarray))


def _check_data(data: Measured, scene: Scene, sought: int) -> None:
    if data.known.sum() <= sought:
        raise ValueError(
            f"`measured` must hold more values than there are parameters ({sought}), but holds {data.known.sum()}."
        )
    if not has_contact(data):
        raise ValueError(
            "`measured` must show a contact, but no value stands out of the noise by five standard deviations."
        )
    unit = units(scene)
    ratios = {
        "control": (float(np.ptp(data.control)) / float(unit.control), FAR["control"], "the range of `control`"),
        **{
            name: (float(np.nanmax(np.abs(data.values[:, :, k]), initial=0.0)) / float(size), FAR["reaction"], name)
            for k, (name, size) in enumerate(zip(CHANNELS, (unit.force, unit.force, unit.moment), strict=True))
        },
    }
    for ratio, (low, high), name in ratios.values():
        if ratio > 0 and not low < ratio < high:
            warnings.warn(
                f"{name} of `measured` is {ratio:.2g} of the scene's unit at the guess (L, EI/L^2 or EI/L of the first "
                "whisker): are both in the same units?",
                stacklevel=3,
            )
