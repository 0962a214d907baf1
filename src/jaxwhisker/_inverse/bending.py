"""Bending tests: estimate parameters of a whisker from its deflections under known loads."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.program import Program
from jaxwhisker._inverse.estimates import Estimates, estimates_of
from jaxwhisker._inverse.least_squares import FINAL, Evaluation, Minimum, minimise
from jaxwhisker._inverse.observations import as_numbers, named_values
from jaxwhisker._inverse.parameters import Transforms, check_traceable, transforms_of
from jaxwhisker._inverse.statistics import FitStatus, is_plausible, noise_of_residuals
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import Status
from jaxwhisker._scan.deflect import CLAMP, Deflection, deflect

AT_BASE = ("fx", "fy", "mz", "base_x", "base_y", "base_angle")
AT_TIP = ("x", "y", "angle")  # as tip_x, tip_y, tip_angle
ALONG = ("x", "y", "angle")  # at the arc length in the column s
COLUMNS = (*AT_BASE, *(f"tip_{name}" for name in AT_TIP), *ALONG)
DISTANCE = len(COLUMNS)  # place of the distance between a point and the shape, after all columns
NAMES = (*COLUMNS, "distance")  # by which the shape is to the left of the point, seen from the base

FOOT_STEPS = 4  # of Newton, from the nearest point of a deflection, to a point's foot; the third is exact to rounding
GUESSED_NOISE = 0.01  # of the peak: noise assumed before the residuals give an estimate
ESTIMATES = 4  # of the noise from the residuals, at most
SETTLED = 0.01  # relative change of the noise below which its estimate has settled
EXACT = 1e-9  # of the peak: smaller residuals are numerical
LARGEST_SCATTER = 0.05  # of the peak: without `sigma`, larger residuals are more than noise


class BendingTest(NamedTuple):
    """Measured deflections, and the function that makes the whisker and its loads."""

    build: Callable[..., tuple]
    conditions: dict[str, Float[np.ndarray, " rows"]]  # further arguments of `build`
    first: Int[np.ndarray, " cases"]  # a row of each set of conditions
    case: Int[np.ndarray, " rows"]  # the set of conditions of each row
    s: Float[np.ndarray, " rows"]  # arc length from the base where something was measured along the whisker, or NaN
    points: Float[np.ndarray, "rows 2"]  # of the shape, at unknown arc lengths; NaN if there is none
    values: Float[np.ndarray, "rows 13"]  # of NAMES, 0 for the distance of a point; NaN where nothing was measured

    @property
    def known(self) -> Bool[np.ndarray, "rows 13"]:
        """Where something was measured."""
        return np.isfinite(self.values)

    @property
    def names(self) -> list[str]:
        """Names of the columns that are compared."""
        return [NAMES[k] for k in np.flatnonzero(self.known.any(axis=0)).tolist()]

    @property
    def peaks(self) -> Float[np.ndarray, " 13"]:
        """Largest magnitude in each column; of the points' coordinates for their distance; 1 where all are zero."""
        peak = np.nanmax(np.abs(np.where(self.known, self.values, 0.0)), axis=0)
        peak[DISTANCE] = np.max(np.abs(np.nan_to_num(self.points)), initial=0.0)
        return np.where(peak > 0, peak, 1.0)

    def of_first_case(self, **parameters: Any) -> tuple:
        """The whisker and its loads under the conditions of the first case."""
        return self.build(**parameters, **{name: float(values[0]) for name, values in self.conditions.items()})


@dataclass(frozen=True, eq=False, repr=False)
class BendingFit(Estimates):
    """Parameters of a whisker estimated from bending tests, in the units of the whisker.

    `measured`, `fitted`, `residuals` (measured - fitted) and `sigma` hold an array (rows,) for each column that was
    compared, NaN where nothing was measured. The residual `distance` of a point without an arc length is positive to
    the left of the whisker, seen from its base.
    """

    measured: dict[str, np.ndarray]
    fitted: dict[str, np.ndarray]
    residuals: dict[str, np.ndarray]
    sigma: dict[str, np.ndarray]
    deflections: Deflection  # at the estimates, with a leading axis: one for each set of conditions
    case: np.ndarray  # (rows,) which of them each row belongs to


def bending_test(build: Any, guess: Mapping[str, Any], measured: Any) -> BendingTest | None:
    """The bending test that `build` and the data describe; None if `build` does not return a whisker and loads.

    Raises:
        ValueError: if it does, and the data lack an argument of `build` or a value to compare.
    """
    try:
        taken = inspect.signature(build).parameters
    except (TypeError, ValueError):
        return None
    if isinstance(measured, list | tuple):  # several scans
        return None
    others = [name for name in taken if name not in guess]
    required = [name for name in others if taken[name].default is inspect.Parameter.empty]
    if not set(guess) <= set(taken) or not (required or isinstance(build(**guess), tuple)):
        return None
    table = named_values(measured, (*COLUMNS, "s", *others))
    if not set(required) <= set(table):
        return None
    columns = {n: as_numbers("measured", n, table[n]) for n in (*others, "s", *COLUMNS) if n in table}
    if not columns:
        checks.fail("measured", f"columns among {', '.join(COLUMNS)}", ", ".join(map(str, table)) or "none")
    rows = max(values.size for values in columns.values())
    if not rows or any(values.shape != (rows,) for values in columns.values()):
        checks.fail(
            "measured", "columns of one length, not empty", ", ".join(f"{v.shape} for {n}" for n, v in columns.items())
        )
    conditions = {name: columns[name] for name in others if name in columns}
    for name, values in conditions.items():
        if not np.isfinite(values).all():
            checks.fail("measured", f"finite numbers in the column {name}, an argument of `build`", values)
    missing = np.full(rows, np.nan)
    s, x, y, *each = (columns.get(name, missing) for name in ("s", "x", "y", *COLUMNS))
    on_shape = np.isnan(s) & np.isfinite(x) & np.isfinite(y)
    values = np.stack([*each, np.where(on_shape, 0.0, np.nan)], axis=1)
    values[~np.isfinite(values)] = np.nan
    values[np.isnan(s), DISTANCE - len(ALONG) : DISTANCE] = np.nan
    of_rows = np.stack([np.zeros_like(s), *conditions.values()], axis=1)
    _, first, case = np.unique(of_rows, axis=0, return_index=True, return_inverse=True)
    points = np.where(on_shape[:, None], np.stack([x, y], axis=1), np.nan)
    test = BendingTest(build, conditions, first, case.ravel(), s, points, values)
    if not isinstance(test.of_first_case(**guess), tuple):
        return None
    if int(test.known.sum()) <= len(guess):
        allowed = f"more values than the {len(guess)} parameters, in columns among {', '.join(COLUMNS)}"
        checks.fail("measured", f"{allowed}; angles need the arc length s", int(test.known.sum()))
    return test


def identify_bending(test: BendingTest, guess: dict[str, Any], sigma: Any, bounds: Any, transform: Any) -> BendingFit:
    """Estimate parameters of a whisker from bending tests; see `identify`."""
    built = test.of_first_case(**guess)
    if not built or not isinstance(built[0], Whisker):
        checks.fail("build", "a function that returns a Scene, or a Whisker and its loads", repr(built))
    transforms = transforms_of(test.of_first_case, guess, bounds, transform)
    check_traceable(test.of_first_case, guess)
    given = sigma is not None
    noise = _read_sigma(test, sigma) if given else np.broadcast_to(GUESSED_NOISE * test.peaks, test.values.shape)
    problem = _BendingProblem(test, tuple(guess), transforms, noise)
    solution = problem.fit(transforms.variables(list(guess.values())))
    steps = solution.steps
    for _ in range(0 if given or not np.isfinite(solution.residual).all() else ESTIMATES):
        before, problem = problem, problem._replace(sigma=_noise_of(problem, solution))
        solution = problem.fit(solution.y)
        steps += solution.steps
        if np.max(np.abs(problem.sigma / before.sigma - 1)) < SETTLED:
            break
    status, reason = _status_of(problem, solution, given)
    x = transforms.natural(solution.y, np)
    at = problem.compared(x)
    off = np.where(test.known, test.values - at.values, np.nan)
    fields = {name: NAMES.index(name) for name in test.names}
    return BendingFit(
        **estimates_of(problem.names, transforms, solution.y, solution.residual, solution.jacobian, status),
        reason=reason,
        degrees=solution.residual.size - solution.y.size,
        steps=steps,
        measured={name: test.values[:, k] for name, k in fields.items()},
        fitted={name: np.where(test.known[:, k], at.values[:, k], np.nan) for name, k in fields.items()},
        residuals={name: off[:, k] for name, k in fields.items()},
        sigma={name: problem.sigma[:, k] for name, k in fields.items()},
        deflections=problem.deflections(x),
        case=test.case,
    )


class _Compared(NamedTuple):
    """What the model says of every row."""

    values: Any  # (rows, 13): NAMES
    status: Any  # (cases,)


class _BendingProblem(NamedTuple):
    """A bending test as a least-squares problem."""

    test: BendingTest
    names: tuple[str, ...]
    transforms: Transforms
    sigma: Float[np.ndarray, "rows 13"]

    def fit(self, y: np.ndarray) -> Minimum:
        """The minimum that Levenberg-Marquardt reaches from these variables."""
        return minimise(self.evaluate, y, FINAL)

    def deflections(self, x: Any) -> Deflection:
        """A deflection for each set of conditions; their parameters are traced or not."""
        test, values = self.test, dict(zip(self.names, x, strict=True))

        def one(_, conditions):
            whisker, *loads = test.build(**values, **conditions)
            support = loads.pop() if loads and isinstance(loads[-1], Support) else CLAMP
            return cast(Deflection, deflect(whisker, *loads, support=support))

        conditions = {name: jnp.asarray(values[test.first]) for name, values in test.conditions.items()}
        return jax.vmap(one)(jnp.arange(test.first.size), conditions)

    def compared(self, x: Any) -> _Compared:
        """What the model says of every row."""
        test, bent = self.test, self.deflections(x)
        fields = {name: getattr(bent, name) for name in (*AT_BASE, "s", "x", "y", "angle", "curvature", "status")}
        return _compare(fields, test.case, np.nan_to_num(test.s), np.nan_to_num(test.points))

    def evaluate(self, y: np.ndarray) -> Evaluation:
        """Whitened residuals, and their derivatives by the fit's variables; NaN if a deflection fails."""
        with np.errstate(over="ignore"):  # an infinite parameter is invalid
            x = self.transforms.natural(y, np)

        def smooth(x):
            at = self.compared(x)
            return at.values, at

        slopes, at = jax.tree.map(np.asarray, jax.jacfwd(smooth, has_aux=True)(jnp.asarray(x)))
        known, rate = self.test.known, self.transforms.per_inner(x) * self.transforms.stretch(y)
        residual = (self.test.values - at.values)[known] / self.sigma[known]
        failed = (at.status != Status.ok).any()
        return Evaluation(np.where(failed, np.nan, residual), -slopes[known] / self.sigma[known][:, None] * rate)


@Program
def _compare(
    bent: dict[str, Array], case: Int[Array, " rows"], s: Float[Array, " rows"], points: Float[Array, "rows 2"]
) -> _Compared:
    tips = [bent[name][:, -1] for name in AT_TIP]
    of_cases = jnp.stack([*(bent[name] for name in AT_BASE), *tips], axis=1)

    def of_row(case, s, point):
        shape = {name: bent[name][case] for name in ("s", "x", "y", "angle", "curvature")}
        x, y, angle = _at(shape, s)
        foot = _foot(jax.lax.stop_gradient(shape), point)
        # To first order, the distance does not depend on the position of the foot.
        foot_x, foot_y, foot_angle = _at(shape, foot)
        left_of_point = (point[0] - foot_x) * jnp.sin(foot_angle) - (point[1] - foot_y) * jnp.cos(foot_angle)
        return jnp.stack([*of_cases[case], x, y, angle, left_of_point])

    return _Compared(jax.vmap(of_row)(case, s, points), bent["status"])


def _at(shape: dict[str, Array], s: Float[Array, ""]) -> tuple[Array, Array, Array]:
    """Position and angle at an arc length, by cubic Hermite interpolation."""
    knots = shape["s"]
    k = jnp.clip(jnp.searchsorted(knots, s, side="right") - 1, 0, knots.size - 2)
    step = knots[k + 1] - knots[k]  # zero between the two sides of a load
    t = jnp.clip((s - knots[k]) / jnp.where(step > 0, step, 1.0), 0.0, 1.0)

    def between(values, rates):
        return Cubic(values[k], values[k + 1], step * rates[k], step * rates[k + 1]).value(t)

    angle = shape["angle"]
    each = [(shape["x"], jnp.cos(angle)), (shape["y"], jnp.sin(angle)), (angle, shape["curvature"])]
    x, y, angle = (between(*pair) for pair in each)
    return x, y, angle


def _foot(shape: dict[str, Array], point: Float[Array, "2"]) -> Float[Array, ""]:
    """Arc length at the point of the shape that is nearest to a point."""
    knots = shape["s"]
    nearest = jnp.argmin((shape["x"] - point[0]) ** 2 + (shape["y"] - point[1]) ** 2)

    def step(_, s):
        x, y, angle = _at(shape, s)
        ahead = (point[0] - x) * jnp.cos(angle) + (point[1] - y) * jnp.sin(angle)
        beside = (point[1] - y) * jnp.cos(angle) - (point[0] - x) * jnp.sin(angle)
        curvature = jnp.interp(s, knots, shape["curvature"])
        return jnp.clip(s + ahead / jnp.maximum(1 - curvature * beside, 0.5), 0.0, knots[-1])

    return jax.lax.fori_loop(0, FOOT_STEPS, step, knots[nearest])


def _read_sigma(test: BendingTest, sigma: Any) -> np.ndarray:
    """Standard deviation of every value, (rows, 13); 1 where nothing was measured."""
    noise = np.ones(test.values.shape)
    given = sigma if isinstance(sigma, Mapping) else dict.fromkeys(test.names, sigma)
    if set(given) != set(test.names):
        checks.fail("sigma", f"a number, or a mapping with {', '.join(test.names)}", ", ".join(map(str, given)))
    for name, value in given.items():
        numbers = as_numbers("sigma", name, value)
        if numbers.shape not in ((), test.s.shape) or not (np.isfinite(numbers) & (numbers > 0)).all():
            checks.fail("sigma", f"positive, a number or one for each row, for {name}", value)
        noise[:, NAMES.index(name)] = numbers
    return noise


def _noise_of(problem: _BendingProblem, solution: Minimum) -> np.ndarray:
    """Noise of each column, estimated from the residuals."""
    known = problem.test.known
    off = np.zeros(known.shape)
    off[known] = solution.residual * problem.sigma[known]
    noise = noise_of_residuals(off, known, solution.y.size, EXACT * problem.test.peaks)
    return np.broadcast_to(noise, known.shape)


def _status_of(problem: _BendingProblem, solution: Minimum, given: bool) -> tuple[FitStatus, str]:
    """How the fit ended, and the reason for failure."""
    test, transforms = problem.test, problem.transforms
    if not np.isfinite(solution.residual).all():
        status = max(Status(int(status)) for status in problem.compared(transforms.natural(solution.y, np)).status)
        return FitStatus.failed, f"the whisker cannot be deflected there ({status.name})"
    if reason := transforms.at_bound(solution.y, problem.names):
        return FitStatus.at_bound, reason
    degrees = solution.residual.size - solution.y.size
    if given and not is_plausible(solution.misfit, degrees):
        size = np.sqrt(np.mean(solution.residual**2))
        return FitStatus.implausible, f"the residuals are {size:.3g} standard deviations of the noise"
    scatter = (problem.sigma[0] / test.peaks)[test.known.any(axis=0)]
    if not given and np.max(scatter) > LARGEST_SCATTER:
        name = test.names[int(np.argmax(scatter))]
        return FitStatus.implausible, f"the residuals of {name} are {np.max(scatter):.2g} of its peak: give `sigma`"
    if not solution.reached:
        return FitStatus.not_converged, f"no minimum was reached in {solution.steps} steps"
    return FitStatus.ok, ""
