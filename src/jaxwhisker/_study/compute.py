"""Computation of a study: one compiled function for blocks of points, called by threads or by a dask cluster."""

import hashlib
import os
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._base.program import COMPILER_OPTIONS
from jaxwhisker._equilibrium.problem import problem_of
from jaxwhisker._model.scene import Scene, units
from jaxwhisker._path.approach import MARGIN
from jaxwhisker._scan.dataset import VARIABLES, first_failure
from jaxwhisker._scan.result import arrays_of
from jaxwhisker._scan.route import route_of
from jaxwhisker._scan.scan import STEP, contact_range, scan_route
from jaxwhisker._study.layout import POINT_STATUS, derivative_name
from jaxwhisker._study.parameters import BlockIndex, Blocks, Parameters, padded
from jaxwhisker._study.structure import fingerprint, sampled
from jaxwhisker._study.summary import summarise

Arrays = dict[str, np.ndarray]
Write = Callable[[BlockIndex, Arrays], None]  # stores the variables of a block

MOST_POSITIONS = 100_000  # largest number of positions of the default control
RANGE_LANES = 64  # points whose range of contact is computed at once
BLOCKS_AHEAD = 2  # blocks submitted for each thread of a cluster: one is computed, one waits
RETRIES = 3  # of a block whose computation fails; blocks of a worker that dies are submitted again anyway


@dataclass(frozen=True, eq=False)
class Job:
    """What a study computes at each of its points; it is sent to the workers of a cluster."""

    build: Callable[..., Scene]
    names: tuple[str, ...]  # of the parameters
    control: Float[np.ndarray, " steps"]
    outputs: tuple[str, ...]  # quantities that are computed
    derivatives: tuple[str, ...]  # parameters
    summary: bool  # summarise the signals
    kept: tuple[str, ...]  # variables of the study
    lanes: int  # points of a block
    key: str = ""  # identifies the job in a worker


def _outputs_at(job: Job) -> Callable[[dict], dict]:
    """A function that computes the outputs at one point from its parameters."""
    route = route_of(job.control)
    names = tuple(dict.fromkeys((*job.outputs, "status")))
    smooth = [name for name in names if VARIABLES[name].dtype == "float64"]

    def outputs(varied, values):
        arrays = arrays_of(scan_route(job.build(**values | varied), route))
        found = {name: arrays[name].astype(VARIABLES[name].dtype) for name in names}
        return {name: found[name] for name in smooth}, found

    def point(values):
        if not job.derivatives:
            return outputs({}, values)[1]
        # `jacfwd` computes the outputs themselves only once, for all derivatives.
        varied = {name: values[name] for name in job.derivatives}
        slopes, found = jax.jacfwd(outputs, has_aux=True)(varied, values)
        for name, parameter in product(smooth, job.derivatives):
            slope = jnp.where(jnp.isnan(found[name]), jnp.nan, slopes[name][parameter])
            found[derivative_name(name, parameter)] = slope
        return {name: value for name, value in found.items() if name in {*names, *job.kept}}

    return point


class Kernel:
    """A job that is traced, and compiled when it is first needed. Then several threads may call it at once."""

    def __init__(self, job: Job):
        shapes = {name: jax.ShapeDtypeStruct((job.lanes,), float) for name in job.names}
        self._lowered = jax.jit(jax.vmap(_outputs_at(job))).lower(shapes)
        self._compiled = None
        self.job = job

    @property
    def events(self) -> int:
        """Number of events that are stored per scan; 0 if no variable of events is computed."""
        infos = ((VARIABLES[name].axes, leaf) for name, leaf in self._lowered.out_info.items() if name in VARIABLES)
        return next((leaf.shape[1] for axes, leaf in infos if axes[:1] == ("event",)), 0)

    def compiled(self):
        """The compiled function; the first call waits for the compiler."""
        if self._compiled is None:
            self._compiled = self._lowered.compile(COMPILER_OPTIONS)
        return self._compiled

    def __call__(self, values: Arrays) -> Arrays:
        """Compute the variables of at most `lanes` points; their first axis runs over the points."""
        job, points = self.job, next(iter(values.values())).size
        found = jax.tree.map(lambda leaf: np.asarray(leaf)[:points], self.compiled()(padded(values, job.lanes)))
        found[POINT_STATUS] = first_failure(found["status"])
        if job.summary:
            found |= summarise(found, job.control)
        return {name: found[name] for name in job.kept}


def threads() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compute_here(
    kernel: Kernel, parameters: Parameters, blocks: Blocks, todo: Sequence[BlockIndex], write: Write
) -> Generator[BlockIndex, None, None]:
    """Compute and store blocks, one per processor at a time: XLA alone keeps only one processor busy."""

    def compute(index: BlockIndex) -> BlockIndex:
        write(index, kernel(parameters.at(blocks.region(index))))
        return index

    kernel.compiled()
    pool = ThreadPoolExecutor(threads(), thread_name_prefix="study")
    try:
        for future in as_completed([pool.submit(compute, index) for index in todo]):
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
            kernel = Kernel(job)
            kernel.compiled()
            _KERNELS[job.key] = kernel
    return _KERNELS[job.key](values)


def key_of(job: Job, samples: list[dict[str, float]]) -> str:
    """A hash of the job, of the versions that compute it, and of the scenes at some points."""
    parts = [version("jaxwhisker"), jax.__version__, fingerprint(job.build, samples), job.control.tobytes()]
    parts += [job.names, job.outputs, job.derivatives, job.summary, job.kept, job.lanes]
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def common_control(build: Callable[..., Scene], parameters: Parameters, onwards: int) -> Float[np.ndarray, " steps"]:
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


def _ranges(build: Callable[..., Scene], parameters: Parameters) -> Float[np.ndarray, "3 points"]:
    """First and last position of the default control of every point, and its step; NaN for invalid points."""

    def point(values):
        scene = build(**values)
        step = STEP * jnp.asarray(units(scene).control, dtype=float)
        return tuple(jnp.where(problem_of(scene).valid, x, jnp.nan) for x in (*contact_range(scene), step))

    total, lanes = parameters.total, min(parameters.total, RANGE_LANES)
    shapes = {name: jax.ShapeDtypeStruct((lanes,), float) for name in parameters.values}
    compiled = jax.jit(jax.vmap(point)).lower(shapes).compile(COMPILER_OPTIONS)

    def block(first: int) -> np.ndarray:
        values = parameters.numbered(np.arange(first, min(first + lanes, total)))
        return np.stack(compiled(padded(values, lanes)))

    with ThreadPoolExecutor(threads()) as pool:
        return np.concatenate(list(pool.map(block, range(0, total, lanes))), axis=1)[:, :total]
