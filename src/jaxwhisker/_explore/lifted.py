"""Functions that `build` makes anew at every call, made one function of the numbers that they close over.

A scene's plain functions (of arc length, of abscissa) are structure to jax: a new one is compiled anew. Here a function
made by the same line of code goes by the first one that was met; the numbers that differ become data.
"""

import types
from typing import Any

import equinox as eqx
import jax

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import _Plain
from jaxwhisker._model.scene import Scene


class _Lifted(eqx.Module):
    """A function whose numbers are data."""

    function: types.FunctionType = eqx.field(static=True)  # the first one met
    numbers: tuple[Any, ...]  # by cell of its closure; None where it is no number

    def __call__(self, x):
        first: Any = self.function
        cells = tuple(
            cell if number is None else types.CellType(number)
            for cell, number in zip(first.__closure__ or (), self.numbers, strict=True)
        )
        made = types.FunctionType(first.__code__, first.__globals__, first.__name__, first.__defaults__, cells)
        made.__kwdefaults__ = first.__kwdefaults__
        return made(x)


class Lifting:
    """Remembers the first function of every line of code."""

    def __init__(self):
        self._first: dict[types.CodeType, types.FunctionType] = {}

    def __call__(self, scene: Scene) -> Scene:
        """The scene with its plain functions replaced."""
        return jax.tree.map(self._of, scene, is_leaf=lambda leaf: isinstance(leaf, _Plain))

    def _of(self, leaf: Any) -> Any:
        if not isinstance(leaf, _Plain) or not isinstance(leaf.function, types.FunctionType):
            return leaf
        function = leaf.function
        first = self._first.setdefault(function.__code__, function)
        contents, known = (_contents(f) for f in (function, first))
        numbers = tuple(value if checks.is_numeric(value) else None for value in contents)
        alike = function.__globals__ is first.__globals__ and all(
            a is b or number is not None for a, b, number in zip(contents, known, numbers, strict=True)
        )
        defaults = function.__defaults__ == first.__defaults__ and function.__kwdefaults__ == first.__kwdefaults__
        return _Lifted(first, numbers) if alike and defaults else leaf


def _contents(function: types.FunctionType) -> tuple[Any, ...]:
    return tuple(cell.cell_contents for cell in function.__closure__ or ())
