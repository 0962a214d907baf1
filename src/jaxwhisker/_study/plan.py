"""How a study is cut into blocks: by its size and the memory given."""

from collections.abc import Iterable

import numpy as np

from jaxwhisker._study.fields import Field
from jaxwhisker._study.parameters import Blocks, split

LANES = 128  # points of a block at most: more make nothing faster, and a killed study loses more
PARTS, FEW = 16, 8  # a smaller study is cut into that many blocks, so that every processor has some, or into fewer of 8
BASE = 1.2e9  # bytes of a process that has compiled a study but holds no block
COPIES = 3  # of what a block gives: computed, as its variables, on its way to the store
PATH, STEP = 160e3, 60.0  # bytes a whisker that a point takes besides: for its path, and for each of its steps


def blocks_of(
    shape: tuple[int, ...], sizes: dict[str, int], fields: Iterable[Field], memory: float, workers: int
) -> Blocks:
    """Cut points into blocks, of which `workers` are in memory at a time.

    The machine only matters where memory is short: the same study gives the same blocks elsewhere.
    """
    bytes_each = sum(
        COPIES * np.dtype(f.dtype).itemsize * int(np.prod([sizes[dim] for dim in f.dims], initial=1)) for f in fields
    ) + sizes["whisker"] * (PATH + STEP * sizes["control"])
    room = int(max(0.0, memory - BASE) / (workers * bytes_each))
    total = int(np.prod(shape))
    wanted = LANES if total >= PARTS * LANES else max(FEW, -(-total // PARTS))
    return split(shape, max(1, min(room, wanted, total)))
