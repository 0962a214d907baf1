"""Blocks computed by threads of this process."""

import os
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from typing import NamedTuple, Protocol

import numpy as np

from jaxwhisker.study.kernel import Kernel
from jaxwhisker.study.parameters import Blocks, Index, Parameters


class Computed(NamedTuple):
    """A block that is computed and written."""

    index: Index
    worst: np.ndarray  # status of each of its points


class Target(Protocol):
    """Where blocks are written."""

    def write(self, index: Index, arrays: dict[str, np.ndarray], worst: np.ndarray) -> None: ...


def threads() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def computed_here(
    kernel: Kernel, parameters: Parameters, blocks: Blocks, todo: Sequence[Index], target: Target
) -> Generator[Computed, None, None]:
    """Compute and write blocks, one a processor at a time: XLA alone keeps one processor busy, not two."""

    def compute(index: Index) -> Computed:
        arrays, worst = kernel(parameters.at(blocks.region(index)))
        target.write(index, arrays, worst)
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
