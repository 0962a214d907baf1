"""Blocks computed by threads of this process."""

import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from typing import NamedTuple

import numpy as np

from jaxwhisker._study.kernel import Kernel
from jaxwhisker._study.parameters import Blocks, Index, Parameters


class Computed(NamedTuple):
    """A block that is computed and written."""

    index: Index
    worst: np.ndarray  # status of each of its points


Write = Callable[[Index, dict[str, np.ndarray], np.ndarray], None]  # a block, its variables, its points' status


def threads() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def computed_here(
    kernel: Kernel, parameters: Parameters, blocks: Blocks, todo: Sequence[Index], write: Write
) -> Generator[Computed, None, None]:
    """Compute and write blocks, one a processor at a time: XLA alone keeps one processor busy, not two."""

    def compute(index: Index) -> Computed:
        arrays, worst = kernel(parameters.at(blocks.region(index)))
        write(index, arrays, worst)
        return Computed(index, worst)

    kernel.compiled()
    pool = ThreadPoolExecutor(threads(), thread_name_prefix="study")
    try:
        waiting = {pool.submit(compute, index) for index in todo}
        while waiting:
            finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in finished:
                yield future.result()
    finally:
        # After an error or an interrupt: what runs is finished, what waits is not begun.
        pool.shutdown(wait=True, cancel_futures=True)
