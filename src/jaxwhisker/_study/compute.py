"""Computation of a study: blocks of points, computed by threads or by a dask cluster."""

import hashlib
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from itertools import product
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from jaxwhisker._base.primitive import threads
from jaxwhisker._base.settings import as_here
from jaxwhisker._model.scene import AbstractScene
from jaxwhisker._plane.approach import MARGIN
from jaxwhisker._scan.channels import columns_of
from jaxwhisker._scan.dataset import VARIABLES, first_failure
from jaxwhisker._scan.result import AbstractResult, arrays_of
from jaxwhisker._scan.route import STEP
from jaxwhisker._scan.scan import range_of, scan
from jaxwhisker._study.layout import POINT_STATUS, channel_quantities
from jaxwhisker._study.parameters import BlockIndex, Blocks, Parameters, lanes_for
from jaxwhisker._study.structure import channels_of, fingerprint, sampled
from jaxwhisker._study.summary import derivative_name, summarise

Arrays = dict[str, np.ndarray]
Write = Callable[[BlockIndex, Arrays], None]  # stores the variables of a block
ChannelsFunction = Callable[[AbstractResult], Mapping[str, Any]]

MOST_POSITIONS = 100_000  # largest number of positions of the default control
BLOCKS_AHEAD = 2  # blocks submitted for each thread of a cluster: one is computed, one waits
RETRIES = 3  # of a block whose computation fails; blocks of a worker that dies are submitted again anyway


@dataclass(frozen=True, eq=False)
class Job:
    """What a study computes at each of its points; it is sent to the workers of a cluster."""

    build: Callable[..., Any]  # returns a scene
    names: tuple[str, ...]  # of the parameters
    control: Float[np.ndarray, " steps"]
    outputs: tuple[str, ...]  # quantities that are computed
    derivatives: tuple[str, ...]  # parameters
    summary: bool  # summarise the signals
    kept: tuple[str, ...]  # variables of the study
    channels: ChannelsFunction | None = None  # computes further quantities
    channel_names: tuple[str, ...] = ()
    key: str = ""  # identifies the job in a worker


class Kernel:
    """Computes the blocks of a job; several threads may call it at once."""

    def __init__(self, job: Job):
        self.job = job
        self._names = tuple(dict.fromkeys((*job.outputs, "status")))
        self._quantities = {name: VARIABLES[name] for name in self._names} | channel_quantities(job.channel_names)
        self._smooth = [name for name, quantity in self._quantities.items() if quantity.dtype == "float64"]

    def _outputs(self, varied: dict, values: dict) -> tuple[dict, dict]:
        """The smooth outputs at one point, which have derivatives, and all outputs."""
        result = scan(self.job.build(**values | varied), self.job.control)
        arrays = arrays_of(result, self._names)
        if self.job.channels is not None:
            arrays |= columns_of(self.job.channels(result), self.job.control.size)
        return {name: arrays[name] for name in self._smooth}, arrays

    def _slopes(self, values: dict) -> tuple[dict, dict]:
        """Derivatives of the smooth outputs at one point by parameter, and all outputs."""
        varied = {name: values[name] for name in self.job.derivatives}
        return jax.jacfwd(self._outputs, has_aux=True)(varied, values)

    def __call__(self, values: Arrays) -> Arrays:
        """Compute the variables of some points; their first axis runs over the points."""
        job, point = self.job, self._slopes if self.job.derivatives else partial(self._outputs, {})
        slopes, arrays = jax.tree.map(np.asarray, jax.vmap(point)(values))
        found = {name: array.astype(self._quantities[name].dtype) for name, array in arrays.items()}
        for name, parameter in product(self._smooth, job.derivatives):
            slope = np.where(np.isnan(found[name]), np.nan, slopes[name][parameter])
            found[derivative_name(name, parameter)] = slope
        found[POINT_STATUS] = first_failure(found["status"])
        if job.summary:
            found |= summarise(found, job.control, job.derivatives)
        return {name: found[name] for name in job.kept}


def compute_here(
    kernel: Kernel, parameters: Parameters, blocks: Blocks, todo: Sequence[BlockIndex], write: Write
) -> Generator[BlockIndex, None, None]:
    """Compute and store blocks, one per processor at a time: XLA alone keeps only one processor busy."""

    def compute(index: BlockIndex) -> BlockIndex:
        write(index, kernel(parameters.at(blocks.region(index))))
        return index

    pool = ThreadPoolExecutor(threads(), thread_name_prefix="study")
    try:
        for future in as_completed([pool.submit(as_here(compute), index) for index in todo]):
            yield future.result()
    finally:
        # After an error or an interrupt, running blocks are finished and waiting ones are dropped.
        pool.shutdown(wait=True, cancel_futures=True)


def compute_on_cluster(
    client: Any, job: Job, parameters: Parameters, blocks: Blocks, todo: Sequence[BlockIndex], write: Write
) -> Generator[BlockIndex, None, None]:
    """Compute blocks on the workers of a dask cluster, and store them in this process."""
    from distributed import as_completed as completed_there

    ahead = BLOCKS_AHEAD * max(1, sum(client.nthreads().values()))
    samples = sampled(parameters)
    job = replace(job, key=key_of(job, samples))
    rest = iter(todo)
    index_of: dict[Any, BlockIndex] = {}

    def submit_next(count: int) -> Iterator[Any]:
        for _, index in zip(range(count), rest, strict=False):
            values = parameters.at(blocks.region(index))
            future = client.submit(compute_in_worker, job, samples, values, retries=RETRIES, pure=False)
            index_of[future] = index
            yield future

    queue = completed_there(list(submit_next(ahead)))
    try:
        for future in queue:
            arrays = future.result()
            index = index_of.pop(future)
            write(index, arrays)
            for following in submit_next(1):
                queue.add(following)
            yield index
    finally:
        client.cancel(list(index_of))


_KERNELS: dict[str, Kernel] = {}
_COMPILING = threading.Lock()


def compute_in_worker(job: Job, samples: list[dict[str, float]], values: Arrays) -> Arrays:
    """Compute a block in a worker, which compiles each job once.

    Raises:
        RuntimeError: if versions or scenes differ between this process and the one that sent the job.
    """
    jax.config.update("jax_enable_x64", True)
    with _COMPILING:
        if job.key not in _KERNELS:
            if job.key != key_of(job, samples):
                raise RuntimeError("The versions of jax, jaxwhisker or what `build` uses differ between the processes.")
            _KERNELS[job.key] = Kernel(job)
    return _KERNELS[job.key](values)


def key_of(job: Job, samples: list[dict[str, float]]) -> str:
    """A hash of the job, of the versions that compute it, and of the scenes at some points."""
    parts = [version("jaxwhisker"), jax.__version__, fingerprint(job.build, samples), job.control.tobytes()]
    parts += [job.names, job.outputs, job.derivatives, job.summary, job.kept]
    if job.channels is not None:
        parts.append(channels_of(job.channels, job.build, samples))
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def common_control(
    build: Callable[..., AbstractScene], parameters: Parameters, onwards: int
) -> Float[np.ndarray, " steps"]:
    """The default control of all points: from the earliest start to the latest end of the default controls of `scan`.

    Args:
        build: makes a scene from named parameters.
        parameters: the points.
        onwards: +1 if the control grows during a scan, else -1.

    Raises:
        ValueError: if it would have more than `MOST_POSITIONS` positions.
    """
    ranges = _ranges(build, parameters)
    known = np.flatnonzero(np.isfinite(ranges).all(axis=0))
    if known.size == 0:  # every point is invalid, which its status will show
        return onwards * np.array([-MARGIN, MARGIN])
    start, stop, step = ranges[:, known]
    first, last, step = (onwards * start).min(), (onwards * stop).max(), step.max()
    steps = int(np.ceil((last - first) / step)) + 1
    if steps > MOST_POSITIONS:
        longest = parameters.one(int(known[np.argmax(onwards * (stop - start))]))
        raise ValueError(
            f"`control` must be given if the default would have more than {MOST_POSITIONS:,} positions, got {steps:,}, "
            f"from {onwards * first:.6g} to {onwards * last:.6g} in steps of {step:.6g}. The longest scan is that of "
            f"{', '.join(f'{name} = {value:g}' for name, value in longest.items())}."
        )
    return onwards * (first + step * np.arange(max(2, steps)))


def _ranges(build: Callable[..., AbstractScene], parameters: Parameters) -> Float[np.ndarray, "3 points"]:
    """First and last position of the default control of every point, and its step; NaN for invalid points."""

    def point(values):
        return range_of(build(**values))

    total, lanes = parameters.total, lanes_for(parameters.total)
    blocks = [np.arange(first, min(first + lanes, total)) for first in range(0, total, lanes)]
    with ThreadPoolExecutor(threads()) as pool:
        found = list(pool.map(as_here(lambda numbers: jax.vmap(point)(parameters.numbered(numbers))), blocks))
    valid, start, stop, unit = (np.concatenate(each) for each in zip(*found, strict=True))
    return np.where(valid, [start, stop, STEP * unit], np.nan)
