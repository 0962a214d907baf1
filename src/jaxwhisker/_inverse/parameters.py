"""Parameters of a `build` function: checks, and transforms to the unbounded variables of a fit."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import name_of
from jaxwhisker._inverse.statistics import NORMAL_95
from jaxwhisker._model.assembly import AbstractScene

AT_BOUND = 1e-3  # dv/dy, relative to that in the middle if it is larger than 1, below which a parameter is at its bound


class Transforms(eqx.Module):
    """Invertible maps from the fit's variables y, unbounded and of order one, to parameters x.

    x = scale * v, or x = exp(v) in log, where v = y without bounds. With two bounds, v is a logistic curve from one to
    the other; with one bound, v is exponential near it and linear far away (softplus).
    """

    table: Any  # (parameters, 4): whether in log, the scale, the lower and the upper bound of v

    @classmethod
    def of(cls, log: Sequence[bool], scale: Sequence[float], bounds: Sequence[tuple[float, float]]) -> "Transforms":
        """Transforms with bounds of x; for a parameter in log, a lower bound of 0 means no bound."""
        is_log, size, x = np.array(log), np.array(scale, dtype=float), np.array(bounds, dtype=float).T
        with np.errstate(divide="ignore"):
            return cls(np.column_stack([is_log, size, *np.where(is_log, np.log(np.maximum(x, 0.0)), x / size)]))

    def with_sizes(self, sizes: Sequence[float]) -> "Transforms":
        """These transforms, followed by those of parameters of these sizes, without bounds."""
        rows = [self.table, *([[0.0, size, -np.inf, np.inf]] for size in sizes)]
        return Transforms(np.concatenate(rows))

    def at(self, index: Any) -> "Transforms":
        """The transforms of some of the parameters, which may repeat."""
        return Transforms(self.table[index])

    @property
    def log(self) -> Bool[np.ndarray, " parameters"]:
        """Which parameters are fitted in log."""
        return np.asarray(self.table[:, 0] > 0)

    @property
    def scale(self) -> Float[np.ndarray, " parameters"]:
        """Scales of the parameters that are not fitted in log; 1 for the others."""
        return np.asarray(self.table[:, 1])

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of x."""
        low, high = (np.where(self.log, np.exp(v), v * self.scale) for v in self.table[:, 2:].T)
        return list(zip(low.tolist(), high.tolist(), strict=True))

    @property
    def bounded(self) -> Bool[np.ndarray, " parameters"]:
        """Which parameters have a finite bound of v."""
        return np.isfinite(self.table[:, 2:]).any(axis=1)

    def natural(self, y: Any, xp: Any = jnp) -> Any:
        """Parameters x from the fit's variables; traceable, or in numpy with `xp=numpy`."""
        log, scale, low, high = self.table.T
        above, below = xp.isfinite(low), xp.isfinite(high)
        low, high = xp.where(above, low, 0.0), xp.where(below, high, 0.0)
        bent = xp.logaddexp(y, 0.0)
        one = xp.where(above, low + bent, xp.where(below, high - bent, y))
        inner = xp.where(above & below, low + (high - low) / (1 + xp.exp(-y)), one)
        return xp.where(log > 0, xp.exp(xp.where(log > 0, inner, 0.0)), inner * scale)

    def variables(self, x: Any) -> Float[np.ndarray, " parameters"]:
        """The fit's variables y from parameters x within their bounds."""
        _, scale, low, high = self.table.T
        above, below = np.isfinite(low), np.isfinite(high)
        with np.errstate(divide="ignore", invalid="ignore"):
            v = np.where(self.log, np.log(x), np.array(x) / scale)
            both = np.log((v - low) / (high - v))
            bent = np.where(above, v - low, high - v)
            one = bent + np.log(-np.expm1(-bent))
        return np.where(above & below, both, np.where(above | below, one, v))

    def stretch(self, y: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """dv/dy, from a change of y to a relative change of x in log, or to a change of x in units of its scale."""
        _, _, low, high = self.table.T
        above, below = np.isfinite(low), np.isfinite(high)
        with np.errstate(over="ignore", invalid="ignore"):
            share = 1 / (1 + np.exp(-y))
            both = (high - low) * share * (1 - share)
        return np.where(above & below, both, np.where(above, share, np.where(below, -share, 1.0)))

    def at_bound(self, y: Float[np.ndarray, " parameters"], names: Sequence[str]) -> str:
        """Which parameter lies at its bound, in words; empty if none does."""
        stretch, middle = (np.abs(self.stretch(each)) for each in (y, np.zeros_like(y)))
        for k in np.flatnonzero(self.bounded & (stretch < AT_BOUND * np.maximum(1.0, middle))).tolist():
            low, high = self.bounds[k]
            return f"{names[k]} = {self.natural(y, np)[k]:.6g} ended at its bound ({low:g}, {high:g})"
        return ""

    def per_inner(self, x: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """dx/dv."""
        return np.where(self.log, x, self.scale)

    def interval(self, x: np.ndarray, error: np.ndarray) -> list[tuple[float, float]]:
        """95 % intervals from standard errors of x; symmetric in log x for parameters in log, cut off at the bounds."""
        reach = NORMAL_95 * error
        with np.errstate(over="ignore", invalid="ignore"):
            factor = np.exp(reach / np.where(self.log, x, 1.0))
        low, high = np.where(self.log, x / factor, x - reach), np.where(self.log, x * factor, x + reach)
        rows = zip(low.tolist(), high.tolist(), self.bounds, strict=True)
        return [(max(a, bounds[0]), min(b, bounds[1])) for a, b, bounds in rows]


def transforms_of(
    build: Callable[..., Any],
    guess: Mapping[str, float],
    bounds: Mapping[str, Any] | None = None,
    kinds: Mapping[str, str] | None = None,
    further: Mapping[str, float] | None = None,
) -> Transforms:
    """Transforms of the parameters: in log by default for parameters that `build` rejects if they are negative.

    `build` makes a scene, or a whisker and loads on it. Parameters of the channels' function are `further` ones.

    Raises:
        ValueError: if a name is unknown, the guess is not within its bounds, or a kind does not exist or does not fit.
    """
    bounds, kinds, further = bounds or {}, kinds or {}, further or {}
    values = {**guess, **further}
    for argument, given in (("bounds", bounds), ("transform", kinds)):
        for name in given:
            if name not in values:
                raise ValueError(f"`{argument}` must name parameters of `guess` ({', '.join(values)}), got {name!r}.")
    pairs = [_bounds_of(name, bounds.get(name), value) for name, value in values.items()]
    logs = [_is_log(build, guess, name, value, kinds.get(name)) for name, value in values.items()]
    built = build(**guess)
    whisker = built.whiskers[0] if isinstance(built, AbstractScene) else built[0]
    sizes = [float(np.asarray(whisker.length))] * len(guess) + [1.0] * len(further)
    scales = [1.0 if log else max(abs(v), size) for log, v, size in zip(logs, values.values(), sizes, strict=True)]
    return Transforms.of(logs, scales, pairs)


def _is_log(build: Callable[..., Any], guess: Mapping[str, float], name: str, value: float, kind: str | None) -> bool:
    positive = value > 0
    if kind not in (None, "log", "linear"):
        raise ValueError(f"`transform` must be one of log, linear, got {kind!r} for {name}.")
    if kind == "log" and not positive:
        raise ValueError(f"`transform` must be linear where the guess is not positive, got log for {name} = {value}.")
    if kind is not None or not positive or name not in guess:
        return kind == "log"
    try:
        build(**{**guess, name: -value})
    except ValueError:
        return True
    return False


def _bounds_of(name: str, given: Any, value: float) -> tuple[float, float]:
    if given is None:
        return -math.inf, math.inf
    try:
        low, high = (math.inf * sign if end is None else float(end) for end, sign in zip(given, (-1, 1), strict=True))
    except (TypeError, ValueError):
        raise ValueError(f"`bounds` must be pairs (low, high), None for no bound, got {given!r} for {name}.") from None
    if not low < value < high:
        raise ValueError(f"`guess` must lie between its bounds, got {name} = {value} for ({low}, {high}).")
    return low, high


def read_parameters(argument: str, given: Any) -> dict[str, Any]:
    """Values of parameters as floats; traced values stay as they are.

    Raises:
        ValueError: if they are not a mapping to finite numbers; the message names `argument`.
    """
    if not isinstance(given, Mapping) or not given:
        raise ValueError(f"`{argument}` must be a mapping of parameters to numbers, got {given!r}.")
    for name, value in given.items():
        try:
            checks.number(str(name), value)
        except ValueError as error:
            raise ValueError(f"`{argument}` must hold finite numbers: {error}") from None
    return {str(name): value if checks.is_traced(value) else float(value) for name, value in given.items()}


def build_scene(argument: str, build: Any, values: Mapping[str, float]) -> Any:
    """The scene that `build` makes of values.

    Raises:
        ValueError: if `build` does not take these names, or does not return such a scene.
    """
    checks.arguments(argument, build, list(values))
    scene = build(**values)
    checks.instance("build", scene, AbstractScene, "a Scene", verb="return")
    return scene


def numbers_of(tree: Any) -> list[Array]:
    """All numeric leaves of a scene, or of another tree, as arrays."""
    return [jnp.asarray(leaf, dtype=float) for leaf in jax.tree.leaves(tree) if checks.is_numeric(leaf)]


def hashable(function: Callable) -> Callable:
    """The function itself, or a function that is equal to itself only: static arguments of programs need a hash."""
    try:
        hash(function)
    except TypeError:
        return partial(function)
    return function


def check_traceable(build: Callable[..., Any], values: Mapping[str, float], called: str = "build") -> None:
    """Check that JAX can trace a user's function, as every compiled program must.

    Raises:
        ValueError: if not; the message names the function and the remedy.
    """
    with checks.traceable(called, name_of(build)):
        jax.eval_shape(lambda values: numbers_of(build(**values)), {k: jnp.asarray(v) for k, v in values.items()})
