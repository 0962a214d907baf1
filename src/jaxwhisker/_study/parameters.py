"""The points of a study: every combination of its axes, or the rows of a table."""

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxwhisker._base import checks
from jaxwhisker._base.primitive import LANES
from jaxwhisker._base.program import MOST_ALONE, MOST_SINGLE
from jaxwhisker._scan.quantities import Quantity

PointRegion = tuple[slice, ...]  # along the dimensions of the points
BlockIndex = tuple[int, ...]  # of a block along these dimensions

PARTS, FEW = 16, 8  # a smaller study has PARTS blocks or fewer of FEW points each
BASE = 1.2e9  # bytes that a process uses that has compiled a study and holds no block
COPIES = 3  # of the results of a block in memory: as computed, as variables, and while they are stored
PATH_BYTES, STEP_BYTES = 160e3, 60.0  # bytes per whisker and point: for the path, and for each step


class Parameters(NamedTuple):
    """Named parameters and the points at which scenes are built from them.

    Points are numbered in C order: the last dimension runs fastest.
    """

    values: dict[str, Float[np.ndarray, " values"]]
    paired: bool  # one point per row of a table instead of every combination

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the points."""
        return ("point",) if self.paired else tuple(self.values)

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes of the points' dimensions."""
        sizes = tuple(v.size for v in self.values.values())
        return sizes[:1] if self.paired else sizes

    def at(self, region: PointRegion) -> dict[str, Float[np.ndarray, " points"]]:
        """The parameters of all points of a region."""
        return self._where(np.mgrid[region].reshape(len(region), -1))

    def numbered(self, numbers: np.ndarray) -> dict[str, Float[np.ndarray, " points"]]:
        """The parameters of the points with these numbers."""
        return self._where(np.unravel_index(numbers, self.shape))

    def _where(self, where: Sequence[np.ndarray] | np.ndarray) -> dict[str, Float[np.ndarray, " points"]]:
        """The parameters of the points with these indices along each dimension."""
        rows = [*where] * len(self.values) if self.paired else where
        return {name: v[k] for (name, v), k in zip(self.values.items(), rows, strict=True)}

    def one(self, number: int) -> dict[str, float]:
        """The parameters of the point with this number."""
        return {name: float(v[0]) for name, v in self.numbered(np.array([number])).items()}

    @property
    def total(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    def spread(self, most: int) -> np.ndarray:
        """Numbers of at most `most` points spread over all, the first few of them far apart."""
        numbers = np.unique(np.linspace(0, self.total - 1, min(self.total, most)).astype(int))
        inwards = np.stack([numbers, numbers[::-1]], axis=1).ravel()  # from both ends
        return inwards[: numbers.size]


def lanes_for(total: int) -> int:
    """Points per block, if memory is no limit.

    Few points run one by one, and in blocks so small that all processors are busy. Many run `LANES` at a time, which
    needs a program of its own. More per block are not faster, and an interrupted study would lose more.
    """
    return LANES if total > MOST_ALONE else min(MOST_SINGLE, max(FEW, -(-total // PARTS)))


class Blocks(NamedTuple):
    """Rectangular blocks of points, equal in shape except for the last ones along each dimension."""

    shape: tuple[int, ...]
    block: tuple[int, ...]

    @property
    def lanes(self) -> int:
        """Number of points in a whole block."""
        return math.prod(self.block)

    def indices(self) -> list[BlockIndex]:
        """Indices of all blocks, in order."""
        counts = [-(-n // b) for n, b in zip(self.shape, self.block, strict=True)]
        return list(product(*map(range, counts)))

    def region(self, index: BlockIndex) -> PointRegion:
        """The points of a block."""
        return tuple(slice(k * b, min((k + 1) * b, n)) for k, b, n in zip(index, self.block, self.shape, strict=True))


def split(shape: tuple[int, ...], most: int) -> Blocks:
    """Split points evenly into blocks of at most `most` points, undivided along the last dimensions if possible."""
    block: list[int] = []
    for n in reversed(shape):
        room = max(1, most // math.prod(block))
        block.insert(0, -(-n // -(-n // room)))
    return Blocks(shape, tuple(block))


def blocks_of(
    shape: tuple[int, ...], sizes: Mapping[str, int], quantities: Iterable[Quantity], memory: float, workers: int
) -> Blocks:
    """Split points into blocks that fit into memory with `workers` of them at a time.

    Unless memory is short, the blocks do not depend on the machine.
    """
    results = sum(np.dtype(q.dtype).itemsize * math.prod(sizes[dim] for dim in q.axes) for q in quantities)
    bytes_each = COPIES * results + sizes["whisker"] * (PATH_BYTES + STEP_BYTES * sizes["control"])
    room = int(max(0.0, memory - BASE) / (workers * bytes_each))
    total = math.prod(shape)
    return split(shape, max(1, min(room, lanes_for(total), total)))


def parameters_of(build: Any, points: Any, axes: Mapping[str, Any], options: tuple[str, ...]) -> Parameters:
    """The points of a study.

    Args:
        build: makes a scene from named parameters.
        points: a table with one row per point, or None.
        axes: values of each parameter if there is no table.
        options: names of the arguments of `study`, which cannot be axes.

    Raises:
        ValueError: if the parameters do not match the arguments of `build`, or are not columns of numbers.
    """
    if not callable(build):
        raise ValueError(f"`build` must be a function that returns a Scene, got {build!r}.")
    if points is not None and axes:
        raise ValueError(f"`points` must be left out if axes are given, got axes {', '.join(axes)}.")
    if points is None and not axes:
        raise ValueError("`axes` must contain the values of at least one parameter of `build`, got none.")
    given = axes if points is None else _table_columns(points)
    _check_arguments(build, given, options if points is None else ())
    for name, column in given.items():
        checks.vector(name, column, finite=False)
    values = {str(name): np.array(checks.unmasked(column), dtype=float) for name, column in given.items()}
    sizes = {name: column.size for name, column in values.items()}
    if points is not None and len(set(sizes.values())) > 1:
        raise ValueError(f"`points` must have columns of equal length, got lengths {sizes}.")
    return Parameters(values, points is not None)


def _table_columns(points: Any) -> Mapping[str, Any]:
    # A DataFrame is not a Mapping, but its columns are indexed in the same way.
    names = list(points.columns) if hasattr(points, "columns") else list(points) if isinstance(points, Mapping) else []
    if not names or not all(isinstance(name, str) for name in names):
        raise ValueError(f"`points` must be a table of named columns, got {points!r}.")
    return {name: points[name] for name in names}


def _check_arguments(build: Callable, given: Mapping[str, Any], options: tuple[str, ...]) -> None:
    """Check that `build` can be called with these parameters by name."""
    try:
        signature = inspect.signature(build)
    except (TypeError, ValueError):  # some callables have no signature
        return
    for name in options:
        if name in signature.parameters and signature.parameters[name].default is inspect.Parameter.empty:
            raise ValueError(
                "`build` must not have a parameter with the name of an option of `study`, "
                f"got `{name}`: rename it, or use `points`."
            )
    try:
        signature.bind(**given)
    except TypeError as error:
        raise ValueError(
            f"The axes must be parameters of `build{signature}`, got {', '.join(given)}: {error}."
        ) from None
