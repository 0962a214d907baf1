"""The points of a study: every combination of its axes, or the rows of a table."""

import inspect
from collections.abc import Callable, Mapping
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

Region = tuple[slice, ...]  # of the points' dimensions
Index = tuple[int, ...]  # of a block along them


class Parameters(NamedTuple):
    """Named parameters and the points at which scenes are built from them."""

    values: dict[str, Float[np.ndarray, " values"]]
    paired: bool  # one point per row, rather than every combination

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the points."""
        return ("point",) if self.paired else tuple(self.values)

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes of the points' dimensions."""
        sizes = tuple(v.size for v in self.values.values())
        return sizes[:1] if self.paired else sizes

    def at(self, region: Region) -> dict[str, Float[np.ndarray, " points"]]:
        """The parameters of all points of a region, the last dimension running fastest."""
        if self.paired:
            return {name: column[region[0]] for name, column in self.values.items()}
        picked = [values[part] for values, part in zip(self.values.values(), region, strict=True)]
        return {n: v.ravel() for n, v in zip(self.values, np.meshgrid(*picked, indexing="ij"), strict=True)}

    def numbered(self, numbers: np.ndarray) -> dict[str, Float[np.ndarray, " points"]]:
        """The parameters of the points with those numbers, the last dimension running fastest."""
        where = np.unravel_index(numbers, self.shape)
        rows = where * len(self.values) if self.paired else where
        return {name: v[k] for (name, v), k in zip(self.values.items(), rows, strict=True)}

    def one(self, index: int) -> dict[str, float]:
        """The parameters of the point with that number, the last dimension running fastest."""
        return {name: float(v[0]) for name, v in self.numbered(np.array([index])).items()}


def padded(values: dict[str, np.ndarray], lanes: int) -> dict[str, np.ndarray]:
    """Points for a block of one fixed size; the last one is repeated."""
    return {n: np.concatenate([v, np.full(lanes - v.size, v[-1])]) for n, v in values.items()}


class Blocks(NamedTuple):
    """Rectangular parts of the points, all of one shape but the last along each dimension."""

    shape: tuple[int, ...]
    block: tuple[int, ...]

    @property
    def lanes(self) -> int:
        """Points of a whole block."""
        return int(np.prod(self.block))

    def indices(self) -> list[Index]:
        """All blocks, in order."""
        counts = [-(-n // b) for n, b in zip(self.shape, self.block, strict=True)]
        return list(product(*map(range, counts)))

    def region(self, index: Index) -> Region:
        """The points of a block."""
        return tuple(slice(k * b, min((k + 1) * b, n)) for k, b, n in zip(index, self.block, self.shape, strict=True))

    def numbers(self, index: Index) -> np.ndarray:
        """The numbers of a block's points among all."""
        inside = [np.arange(part.start, part.stop) for part in self.region(index)]
        return np.ravel_multi_index(np.meshgrid(*inside, indexing="ij"), self.shape).ravel()


def split(shape: tuple[int, ...], most: int) -> Blocks:
    """Cut points evenly into blocks of at most `most`, whole along the last dimensions if possible."""
    block: list[int] = []
    for n in reversed(shape):
        room = max(1, most // int(np.prod(block, initial=1)))
        block.insert(0, -(-n // -(-n // room)))
    return Blocks(shape, tuple(block))


def parameters_of(build: Any, points: Any, axes: Mapping[str, Any], options: tuple[str, ...]) -> Parameters:
    """The points that the user asks for; `options` are the names that a study takes for itself.

    Raises:
        ValueError: if they do not fit what `build` takes, or are not columns of numbers.
    """
    if not callable(build):
        raise ValueError(f"`build` must be a function that returns a Scene, but is {build!r}.")
    if points is not None and axes:
        raise ValueError(f"`points` must be left out where axes are given, but there are both ({', '.join(axes)}).")
    if points is None and not axes:
        raise ValueError("`axes` must be at least one parameter of `build` with its values, but there is none.")
    given = axes if points is None else _columns(points)
    _check_names(build, given, options if points is None else ())
    values = {str(name): _values(name, given[name]) for name in given}
    if points is not None:
        sizes = {name: column.size for name, column in values.items()}
        if len(set(sizes.values())) > 1:
            raise ValueError(f"`points` must be columns of one length, but their lengths are {sizes}.")
    return Parameters(values, points is not None)


def _columns(points: Any) -> Mapping[str, Any]:
    # A DataFrame is no Mapping, but has columns that are indexed alike.
    names = list(points.columns) if hasattr(points, "columns") else list(points) if isinstance(points, Mapping) else []
    if not names or not all(isinstance(name, str) for name in names):
        raise ValueError(f"`points` must be a table of named columns, but is {points!r}.")
    return {name: points[name] for name in names}


def _check_names(build: Callable, given: Mapping[str, Any], options: tuple[str, ...]) -> None:
    try:
        parameters = inspect.signature(build).parameters.values()
    except (TypeError, ValueError):  # a callable that does not tell
        return
    named = {p.name: p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)}
    anything = any(p.kind is p.VAR_KEYWORD for p in parameters)
    for p in parameters:
        if p.kind is p.POSITIONAL_ONLY and p.default is p.empty:
            raise ValueError(f"`build` must take its parameters by name, but `{p.name}` is positional only.")
    for name, p in named.items():
        if name in options and p.default is p.empty:
            raise ValueError(
                f"`build` must not name a parameter `{name}`: that is an option of `study`. Rename it or give `points`."
            )
    unknown = [name for name in given if name not in named]
    if unknown and not anything:
        allowed = ", ".join(named) or "none"
        raise ValueError(f"`{unknown[0]}` must be a parameter of `build` to be an axis, but `build` takes {allowed}.")
    for name, p in named.items():
        if p.default is p.empty and name not in given:
            raise ValueError(
                f"`{name}` must be given as an axis: `build` needs it, but only {', '.join(given)} is there."
            )


def _values(name: str, values: Any) -> Float[np.ndarray, " values"]:
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):
        array = np.asarray(None)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"`{name}` must be an array of real numbers, but is {values!r}.")
    if array.ndim != 1:
        raise ValueError(f"`{name}` must be one-dimensional to be an axis, but is of shape {array.shape}.")
    if array.size == 0:
        raise ValueError(f"`{name}` must hold at least one value, but is empty.")
    return np.array(array, dtype=float)
