"""Transforms: parameters as a fit sees them, unbounded and of size one, and as a scene is built from them."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._model.scene import Scene

KINDS = ("log", "linear")


class Transform(NamedTuple):
    """x = scale y; with `log` x = exp(y); between bounds a logistic curve from one to the other, of x or of log x."""

    log: bool = False
    scale: float = 1.0
    low: float = -math.inf
    high: float = math.inf

    @property
    def bounded(self) -> bool:
        """Whether there are bounds to keep (zero is none of a parameter in log)."""
        return math.isfinite(self._inner(self.low)) or math.isfinite(self._inner(self.high))

    def _inner(self, x: float) -> float:
        """log x or x over its scale."""
        if not self.log:
            return x / self.scale
        return math.log(x) if x > 0 else -math.inf

    def seen(self, x: float) -> float:
        """The fit's variable."""
        inner = self._inner(x)
        if not self.bounded:
            return inner
        low, high = self._inner(self.low), self._inner(self.high)
        if math.isfinite(low) and math.isfinite(high):
            share = (inner - low) / (high - low)
            return math.log(share / (1 - share))
        bent = inner - low if math.isfinite(low) else high - inner
        return bent + math.log(-math.expm1(-bent))

    def stretch(self, y: float) -> float:
        """d inner / d y: what a step of the fit's variable is as a relative one, or in units of the scale."""
        if not self.bounded:
            return 1.0
        low, high = self._inner(self.low), self._inner(self.high)
        share = 1 / (1 + math.exp(-y))
        if math.isfinite(low) and math.isfinite(high):
            return (high - low) * share * (1 - share)
        return share if math.isfinite(low) else -share

    def per_inner(self, x: float) -> float:
        """d x / d inner."""
        return x if self.log else self.scale

    def interval(self, x: float, error: float) -> tuple[float, float]:
        """From a standard error of x the 95 % interval, which is one of log x where that is fitted."""
        reach = 1.959964 * error
        low, high = (x * math.exp(-reach / x), x * math.exp(reach / x)) if self.log else (x - reach, x + reach)
        return max(low, self.low), min(high, self.high)


def table(transforms: Sequence[Transform]) -> Float[np.ndarray, "parameters 4"]:
    """Transforms as numbers: whether in log, the scale, and the bounds of log x or x over its scale."""
    return np.array([(t.log, t.scale, t._inner(t.low), t._inner(t.high)) for t in transforms])


def natural(y: Float[Array, " parameters"], table: Any) -> Float[Array, " parameters"]:
    """Parameters from the fit's variables."""
    log, scale, low, high = table.T
    above, below = jnp.isfinite(low), jnp.isfinite(high)
    low, high = jnp.where(above, low, 0.0), jnp.where(below, high, 0.0)
    # One bound: the curve leaves it like an exponential and goes on like a straight line.
    bent = jnp.logaddexp(y, 0.0)
    one = jnp.where(above, low + bent, jnp.where(below, high - bent, y))
    inner = jnp.where(above & below, low + (high - low) / (1 + jnp.exp(-y)), one)
    return jnp.where(log > 0, jnp.exp(jnp.where(log > 0, inner, 0.0)), inner * scale)


def transforms_of(
    build: Callable[..., Scene],
    guess: Mapping[str, float],
    bounds: Mapping[str, Any],
    asked: Mapping[str, str],
) -> dict[str, Transform]:
    """A transform per parameter: positive ones, which the scene's own rules find out, are fitted in log.

    Raises:
        ValueError: if a name is unknown, bounds do not hold the guess, or a transform does not exist or does not fit.
    """
    for argument, given in (("bounds", bounds), ("transform", asked)):
        for name in given:
            if name not in guess:
                allowed = ", ".join(guess)
                raise ValueError(f"`{argument}` must name parameters of `guess` ({allowed}), but one is {name!r}.")
    found = {}
    for name, value in guess.items():
        low, high = _bounds_of(name, bounds.get(name), value)
        kind = asked.get(name)
        if kind is not None and kind not in KINDS:
            raise ValueError(f"`transform` must be one of {', '.join(KINDS)}, but of {name} it is {kind!r}.")
        log = kind == "log" if kind else value > 0 and _has_to_be_positive(build, guess, name)
        if log and not value > 0:
            raise ValueError(
                f"`transform` must be linear where the guess is not positive, but {name} = {value} has log."
            )
        found[name] = Transform(log, 1.0 if log else max(abs(value), _length(build, guess)), low, high)
    return found


def _bounds_of(name: str, given: Any, value: float) -> tuple[float, float]:
    if given is None:
        return -math.inf, math.inf
    try:
        low, high = (math.inf * sign if end is None else float(end) for end, sign in zip(given, (-1, 1), strict=True))
    except (TypeError, ValueError):
        raise ValueError(
            f"`bounds` must be pairs (low, high), None for no bound, but of {name} are {given!r}."
        ) from None
    if not low < value < high:
        raise ValueError(f"`guess` must lie between its bounds, but {name} = {value} is not inside ({low}, {high}).")
    return low, high


def _has_to_be_positive(build: Callable[..., Scene], guess: Mapping[str, float], name: str) -> bool:
    try:
        build(**{**guess, name: -guess[name]})
    except ValueError:
        return True
    return False


def _length(build: Callable[..., Scene], guess: Mapping[str, float]) -> float:
    return float(np.asarray(build(**guess).whiskers[0].length))


def checked_values(argument: str, given: Any) -> dict[str, float]:
    """Values of parameters as floats.

    Raises:
        ValueError: if they are not a mapping of finite numbers, naming the argument.
    """
    if not isinstance(given, Mapping) or not given:
        raise ValueError(f"`{argument}` must be a mapping of parameters to numbers, but is {given!r}.")
    for name, value in given.items():
        try:
            checks.number(str(name), value)
        except ValueError as error:
            raise ValueError(f"`{argument}` must hold finite numbers: {error}") from None
    return {str(name): float(value) for name, value in given.items()}


def checked_scene(argument: str, build: Any, values: Mapping[str, float]) -> Scene:
    """The scene that `build` makes of values.

    Raises:
        ValueError: if `build` does not take them, naming the argument they come from, or makes no scene.
    """
    if not callable(build):
        raise ValueError(f"`build` must be a function that returns a Scene, but is {build!r}.")
    try:
        scene = build(**values)
    except TypeError as error:
        raise ValueError(f"`{argument}` must name the parameters of `build`: {error}.") from None
    if not isinstance(scene, Scene):
        raise ValueError(f"`build` must return a Scene, but returned {scene!r}.")
    return scene
