"""Scenes written out as Python: expressions that make them anew from numbers."""

import inspect
from itertools import product
from typing import Any

import equinox as eqx
import jax
import numpy as np

import jaxwhisker
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support


class UnwritableError(ValueError):
    """What is no number, nor made of numbers."""


def written_scene(scene: Scene) -> str:
    """A scene, an argument a line."""
    lines = (f"    {argument},\n" for argument in _arguments(scene))
    return f"jw.Scene(\n{''.join(lines)})"


def written(value: Any) -> str:
    """An expression for numbers, words, containers of them and what this package makes of them.

    Raises:
        UnwritableError: if there is something else in it.
    """
    if value is None or isinstance(value, bool | str):
        return repr(value)
    if isinstance(value, int | float | np.number | np.ndarray | jax.Array):
        return _number(value)
    if isinstance(value, tuple | list):
        parts = ", ".join(map(written, value))
        if isinstance(value, list):
            return f"[{parts}]"
        return f"({parts},)" if len(value) == 1 else f"({parts})"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{written(key)}: {written(held)}" for key, held in value.items()) + "}"
    name = type(value).__name__
    if isinstance(value, eqx.Module) and getattr(jaxwhisker, name, None) is type(value):
        named = _named(value) if isinstance(value, Support) else None
        return named or f"jw.{name}({', '.join(_arguments(value))})"
    raise UnwritableError(f"{value!r} cannot be written as Python.")


def _number(value: Any) -> str:
    array = np.asarray(value)
    if array.ndim:
        return f"np.array({array.tolist()!r})".replace("nan", "np.nan").replace("inf", "np.inf")
    text = repr(array.item())
    return f"np.{text}" if text in ("inf", "nan") else "-np.inf" if text == "-inf" else text


def _arguments(value: Any) -> list[str]:
    """What has to be given to make the same, defaults left out."""
    found = []
    for name, parameter in inspect.signature(type(value)).parameters.items():
        held = getattr(value, name)
        text = written(held)
        usual = parameter.default
        if usual is parameter.empty or text != written(usual):
            found.append(f"{name}={text}")
    return found


def _named(support: Support) -> str | None:
    """A model of the thesis by its name, if it is one."""
    springs = support.springs
    if support.mount is not None or support.name not in ("FB", "FBFB", "FBFBR", "FBFBFBR"):
        return None
    if any(spring.stiffness is None for spring in springs):
        return None
    stiffness: Any = tuple(s.stiffness for s in springs)
    rest_length = tuple(s.rest_length for s in springs)
    # One number for all, where that makes the same.
    for c, rest in product((stiffness[0], stiffness), (rest_length[0], rest_length)):
        if written(Support.named(support.name, c, rest).springs) == written(springs):
            return f"jw.Support.{support.name.lower()}(stiffness={written(c)}, rest_length={written(rest)})"
    return None
