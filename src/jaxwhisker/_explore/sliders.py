"""Sliders: the ranges over which the parameters of a scene are dragged."""

import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from jaxwhisker._model.scene import Scene

DECADES = 20.0  # a range from a positive number to more than this many times of it is logarithmic
DIGITS = 4  # of a value in the middle, as of those that are dragged to


class Slider(NamedTuple):
    """A parameter and its range."""

    name: str
    low: float
    high: float
    start: float
    logarithmic: bool


def sliders_of(build: Callable[..., Scene], ranges: Mapping[str, Any]) -> tuple[Slider, ...]:
    """A slider for each range.

    Raises:
        ValueError: if a range is none, names no parameter of `build`, or a parameter that needs one has none.
    """
    if not callable(build):
        raise ValueError(f"`build` must be a function that returns a Scene, but is {build!r}.")
    _check_names(build, ranges)
    return tuple(_slider(name, given) for name, given in ranges.items())


def _check_names(build: Callable[..., Scene], ranges: Mapping[str, Any]) -> None:
    try:
        parameters = inspect.signature(build).parameters.values()
    except (TypeError, ValueError):  # a callable that does not tell
        return
    named = {p.name: p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)}
    anything = any(p.kind is p.VAR_KEYWORD for p in parameters)
    for p in parameters:
        if p.kind is p.POSITIONAL_ONLY and p.default is p.empty:
            raise ValueError(f"`build` must take its parameters by name, but `{p.name}` is positional only.")
    unknown = [name for name in ranges if name not in named]
    if unknown and not anything:
        raise ValueError(
            f"`{unknown[0]}` must be a parameter of `build`, but `build` takes {', '.join(named) or 'none'}."
        )
    for name, p in named.items():
        if p.default is p.empty and name not in ranges:
            raise ValueError(f"`{name}` must be given a range (low, high), but has none, and `build` needs it.")


def _slider(name: str, given: Any) -> Slider:
    try:
        low, high, *rest = numbers = [float(value) for value in given]
    except (TypeError, ValueError):
        low, high, *rest = numbers = [math.nan, math.nan]
    if len(rest) > 1 or not all(map(math.isfinite, numbers)):
        raise ValueError(f"`{name}` must be (low, high) or (low, high, start), finite numbers, but is {given!r}.")
    if not low < high:
        raise ValueError(f"`{name}` must be a range with low < high, but is {given!r}.")
    logarithmic = low > 0 and high / low > DECADES
    middle = math.sqrt(low * high) if logarithmic else (low + high) / 2
    start = rest[0] if rest else min(max(float(f"{middle:.{DIGITS}g}"), low), high)
    if not low <= start <= high:
        raise ValueError(f"`{name}` must start between its ends {low:g} and {high:g}, but does at {start:g}.")
    return Slider(name, low, high, start, logarithmic)
