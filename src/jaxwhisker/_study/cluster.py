"""Blocks computed by the workers of a dask cluster."""

from collections.abc import Generator, Sequence
from typing import Any

from jaxwhisker._study.kernel import Job, compute
from jaxwhisker._study.local import Computed, Write
from jaxwhisker._study.parameters import Blocks, Index, Parameters

AHEAD = 2  # blocks given out for each thread of the cluster: one to compute, one to go on with
RETRIES = 3  # of a block whose computation fails; one that a worker's death takes along is given out again anyway


def computed_there(
    client: Any, job: Job, parameters: Parameters, blocks: Blocks, todo: Sequence[Index], write: Write
) -> Generator[Computed, None, None]:
    """Have blocks computed by workers, and write them here."""
    from distributed import as_completed

    ahead = AHEAD * max(1, sum(client.nthreads().values()))
    rest = iter(todo)
    index_of: dict[Any, Index] = {}

    def give_out(index: Index):
        values = parameters.at(blocks.region(index))
        future = client.submit(compute, job, values, retries=RETRIES, pure=False)
        index_of[future] = index
        return future

    queue = as_completed([give_out(index) for _, index in zip(range(ahead), rest, strict=False)])
    try:
        for future in queue:
            arrays, worst = future.result()
            index = index_of.pop(future)
            write(index, arrays, worst)
            for following in rest:
                queue.add(give_out(following))
                break
            yield Computed(index, worst)
    finally:
        client.cancel(list(index_of))
