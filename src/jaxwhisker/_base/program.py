"""Programs: functions that are compiled once for each shape of their arguments, and kept for later processes.

Where the arguments of a program have values, the program runs on its own: it is compiled without what surrounds it, and
everything that runs outside a caller's jit shares it. That includes vmap, jvp, grad and any nesting of them, because
JAX hands such transformations down to values (see primitive.py). Inside a caller's jit, the function becomes
part of the caller's program.

A program decides how it is differentiated. `frozen` programs have no derivatives: those of the path and of solved
points are attached to what is computed from them. A program with a `tangent` rule has its tangents computed by that
rule, usually by another program. All others are differentiated by JAX.
"""

import functools
import gc
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jaxlib.version import __version_info__ as version

from jaxwhisker._base import checks, store
from jaxwhisker._base.announce import announced
from jaxwhisker._base.aside import aside, interruptible
from jaxwhisker._base.primitive import PRIMITIVE
from jaxwhisker._base.settings import device, with_own_settings

# Up to version 0.10, jaxlib has two emitters of CPU kernels. The one that is not the default compiles in half the
# time, and its kernels run equally fast.
COMPILER_OPTIONS: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False} if version < (0, 11) else {}
# XLA shares out products of matrices among its threads and waits for them in one of these: on two processors, several
# such products at once may wait for each other forever.
COMPILER_OPTIONS["xla_cpu_multi_thread_eigen"] = False

ARRAYS = (np.ndarray, np.generic, jax.Array, jax.ShapeDtypeStruct)
MOST_SINGLE = 32  # smaller batches run one by one: most lanes of a block would be padding
# Lanes of larger batches that run one by one before a block of them is compiled. Alone, a scan takes 1.3 to 2.3 times
# as long, so that the block saves what its compilation takes after 2,000 to 6,000 scans: neither choice costs much more
# than twice what the better one would.
MOST_ALONE = 2048
MOST_KEPT = 128  # executables of a program in a process; the oldest ones are dropped


class Shape(NamedTuple):
    """What a program is compiled for: everything about its arguments but the numbers in their arrays."""

    structure: Any
    leaves: tuple  # ... stands for an array
    kinds: tuple[type, ...]  # of the leaves: 1, 1.0 and True are equal, but lead to different programs
    arrays: tuple[tuple[tuple[int, ...], np.dtype], ...]  # shapes and types

    def arguments(self, arrays: Any) -> tuple[tuple, dict[str, Any]]:
        """The positional and named arguments with these arrays."""
        return _tree(self.structure, self.leaves, arrays)


class Results(NamedTuple):
    """Everything about the results of a program but the numbers in their arrays."""

    structure: Any
    leaves: tuple  # ... stands for an array
    arrays: tuple[jax.ShapeDtypeStruct, ...]

    def tree(self, arrays: Any) -> Any:
        """The results with these arrays."""
        return _tree(self.structure, self.leaves, arrays)


class Program:
    """A function that runs as one compiled program. Arguments that are not arrays are static.

    Args:
        function: takes and returns trees of arrays; what else it returns must depend on its static arguments only.
        frozen: whether the function has no derivatives.
        tangent: a function of the arguments, their tangents (None where they are zero) and the results that returns the
            tangents of the results (None where they are zero or do not exist), or NotImplemented to leave them to JAX.
        quick: whether to compile in half the time; programs of many small kernels run no slower.
        together: number of lanes of a large batch that run together; 0 if lanes run one by one.
    """

    def __init__(
        self,
        function: Callable,
        *,
        frozen: bool = False,
        tangent: Callable | None = None,
        quick: bool = False,
        together: int = 0,
    ):
        functools.update_wrapper(self, function)
        self.function, self._frozen, self._tangent = function, frozen, tangent
        self._options: dict[str, Any] = COMPILER_OPTIONS | ({"xla_backend_optimization_level": 0} if quick else {})
        self.together = together
        self._lock = threading.RLock()  # a program may need another shape of itself while it is traced
        self._results: dict[Shape, Results] = {}
        self._executables: dict[tuple[Shape, int, Any], Future] = {}
        self._alone: Counter[Shape] = Counter()  # lanes of large batches that ran one by one
        _PROGRAMS.append(self)

    @with_own_settings
    def __call__(self, *args, **kwargs):
        shape, arrays = _split(args, kwargs)
        if any(isinstance(leaf, Tracer) for leaf in arrays):
            if checks.is_staged(arrays):
                return self.function(*args, **kwargs)
            if self._frozen:
                arrays = [jax.lax.stop_gradient(leaf) if isinstance(leaf, Tracer) else leaf for leaf in arrays]
            arrays = PRIMITIVE.bind(*arrays, program=self, shape=shape, levels=())
        else:
            arrays = self.run(shape, arrays)
        return self._results[shape].tree(arrays)

    def run(self, shape: Shape, arrays: Sequence) -> list:
        """The arrays of the results, computed where the arguments are."""
        try:
            return self.compiled(shape)(*arrays)
        except ValueError:
            if not _are_elsewhere(arrays):
                raise
            return self._jitted(shape)(*arrays)

    @property
    def compilations(self) -> int:
        """Number of executables of this program in this process."""
        return len(self._executables)

    def is_ready(self, *args) -> bool:
        """Whether the program for arguments of these shapes is compiled, or being compiled."""
        shape, arrays = _split(args)
        return self._is_known(shape, self.lanes_together(shape, checks.lanes_of(arrays)))

    def _is_known(self, shape: Shape, lanes: int) -> bool:
        return (shape, lanes, device()) in self._executables

    def lanes_together(self, shape: Shape, count: int) -> int:
        """Lanes of the executable that runs a batch of this many; 0 if each of them runs alone."""
        if not self.together or count <= MOST_SINGLE:
            return 0
        pays = self._alone[shape] + count > MOST_ALONE or self._is_known(shape, self.together)
        return self.together if pays else 0

    def count_alone(self, shape: Shape, count: int) -> None:
        """Note that a batch of this many has run one by one."""
        if count > MOST_SINGLE:
            with self._lock:
                self._alone[shape] += count

    def executable(self, *args) -> Any:
        """The executable for arguments of these shapes."""
        return self.compiled(_split(args)[0])

    def prepare(self, pool: Executor, *args) -> Any:
        """Trace for arguments of these shapes and compile in a thread of the pool. Return the shapes of the results."""
        shape, arrays = _split(args)
        self._executable(shape, self.lanes_together(shape, checks.lanes_of(arrays)), pool)
        return self._results[shape].tree(self._results[shape].arrays)

    def compiled(self, shape: Shape, lanes: int = 0) -> Callable[..., list]:
        """The compiled function from the arguments' arrays to the results'; with `lanes`, of that many of each."""
        future = self._executable(shape, lanes)
        try:
            with interruptible():
                return future.result()
        except Exception:  # the next call compiles again
            with self._lock:
                self._executables.pop((shape, lanes, device()), None)
            raise

    def results(self, shape: Shape) -> Results:
        """What the function returns for arguments of this shape."""
        if shape not in self._results:
            self._executable(shape, 0)
        return self._results[shape]

    def flat(self, shape: Shape) -> Callable[..., list]:
        """The function from the arguments' arrays to the results' arrays."""

        def function(*arrays):
            args, kwargs = shape.arguments(arrays)
            leaves, structure = jax.tree.flatten(self.function(*args, **kwargs))
            kept = [leaf for leaf in leaves if is_array(leaf)]
            described = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in kept)
            self._results[shape] = Results(structure, tuple(_if_array(leaf, leaf) for leaf in leaves), described)
            return kept

        function.__name__ = getattr(self, "__name__", "program")  # in the logs and profiles of JAX
        return function

    def tangents(self, shape: Shape, arrays: Sequence, dots: Sequence, found: Sequence) -> list:
        """Tangents of the arrays of the results `found`, for those of the arguments' arrays; None where zero."""
        results = self.results(shape)
        if self._frozen:
            return [None] * len(results.arrays)
        args, _ = shape.arguments(arrays)
        args_dot, _ = _tree(shape.structure, [_if_array(leaf) for leaf in shape.leaves], dots)
        tree = NotImplemented if self._tangent is None else self._tangent(args, args_dot, results.tree(found))
        if tree is NotImplemented:
            return _differentiated(self._jitted(shape), arrays, dots)
        every = results.structure.flatten_up_to(tree)
        return [dot for dot, leaf in zip(every, results.leaves, strict=True) if leaf is ...]

    def along(self, args: tuple, args_dot: tuple) -> Any:
        """Tangents of the results by JAX, for a rule of another program that computes the same; the program is not run.

        Tangents are None where they are zero or do not exist.
        """
        shape, arrays = _split(args)
        every = shape.structure.flatten_up_to((args_dot, {}))
        dots = [dot for dot, leaf in zip(every, shape.leaves, strict=True) if leaf is ...]
        found = iter(_differentiated(self._jitted(shape), arrays, dots))
        results = self._results[shape]
        return jax.tree.unflatten(
            results.structure, [next(found, None) if leaf is ... else None for leaf in results.leaves]
        )

    @functools.lru_cache(maxsize=64)  # noqa: B019, programs live as long as the process
    def _jitted(self, shape: Shape) -> Callable[..., list]:
        return jax.jit(self.flat(shape))

    def clear(self) -> None:
        """Forget everything that was compiled in this process."""
        with self._lock:
            self._executables.clear()
            self._alone.clear()

    def _executable(self, shape: Shape, lanes: int, pool: Executor | None = None) -> Future:
        name = shape, lanes, device()
        with self._lock:
            known = self._executables.get(name)
            if known is None or known.cancelled():  # by an interrupt
                key = self._key(shape, lanes)
                with announced(kept=_is_kept(key)):
                    future = self._load(shape, lanes, key, pool) or self._compile(shape, lanes, key, pool)
                self._executables[name] = future
                while len(self._executables) > MOST_KEPT:  # users may pass a new function in every call
                    del self._executables[next(iter(self._executables))]
            return self._executables[name]

    def _key(self, shape: Shape, lanes: int) -> str | None:
        """The program's name on disk; None if it is not kept there."""
        if store.folder() is None:
            return None
        arguments = store.describe([self.function, shape.arguments([...] * len(shape.arrays))])
        return arguments and store.key_of(f"{arguments} {shape.arrays} {lanes} {self._options}")

    def _load(self, shape: Shape, lanes: int, key: str | None, pool: Executor | None) -> Future | None:
        stored = None if key is None else store.with_key(key)
        if stored is None:
            return None
        tree, arrays, code = stored
        leaves, structure = jax.tree.flatten(tree)
        self._results[shape] = Results(structure, tuple(leaves), arrays)

        def loaded():
            return store.executable(code) or self._compile(shape, lanes, key, None).result()

        return aside(loaded, pool) if pool else _done(loaded())

    def _compile(self, shape: Shape, lanes: int, key: str | None, pool: Executor | None) -> Future:
        function, ahead = self.flat(shape), (lanes,) if lanes else ()
        arguments = [jax.ShapeDtypeStruct((*ahead, *size), kind) for size, kind in shape.arrays]
        with _without_garbage_collection():
            # Without unused arguments, programs that use different arguments could have the same code.
            lowered = jax.jit(jax.vmap(function) if lanes else function, keep_unused=True).lower(*arguments)
        results = self._results[shape]

        def compiled():
            with announced(kept=_is_kept(key)), store.silent():
                if key is None:
                    return lowered.compile(self._options)
                name = store.name_of(key, lowered, self._options)
                *_, code = store.with_same_code(name) or [None]
                executable = code and store.executable(code)
                if executable is None:
                    executable, code = store.compiled(lowered, self._options)
            if code is not None:
                store.save(name, (results.tree([...] * len(results.arrays)), results.arrays, code))
            return executable

        return aside(compiled, pool)


_PROGRAMS: list[Program] = []


def compilations() -> int:
    """Number of executables of all programs in this process."""
    return sum(program.compilations for program in _PROGRAMS)


def clear() -> None:
    """Forget all programs that were compiled in this process; those on disk are loaded again when needed."""
    for program in _PROGRAMS:
        program.clear()


def _is_kept(key: str | None) -> bool:
    """Whether a program with this name on disk will be there for later processes."""
    where = store.folder()
    return key is not None and where is not None and store.obstacle(where) is None


def _are_elsewhere(arrays: Sequence) -> bool:
    """Whether arrays are on another device than that for which programs are compiled."""
    return any(isinstance(leaf, jax.Array) and leaf.devices() != {device()} for leaf in arrays)


def is_array(leaf: Any) -> bool:
    """Whether a leaf is an array, traced or not, or describes one; other leaves are static."""
    return isinstance(leaf, ARRAYS)


def _split(args: tuple, kwargs: dict[str, Any] | None = None) -> tuple[Shape, list]:
    leaves, structure = jax.tree.flatten((args, kwargs or {}))
    arrays, static, kinds, shapes = [], [], [], []
    for leaf in leaves:  # one plain loop, because every call of a program runs it
        if isinstance(leaf, ARRAYS):
            arrays.append(leaf)
            shapes.append((tuple(leaf.shape), leaf.dtype))
            leaf = ...
        static.append(leaf)
        kinds.append(type(leaf))
    return Shape(structure, tuple(static), tuple(kinds), tuple(shapes)), arrays


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Pause the garbage collector, which would spend a quarter of the time of tracing on objects that stay."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _if_array(leaf: Any, otherwise: Any = None) -> Any:
    return ... if leaf is ... or is_array(leaf) else otherwise


def _tree(structure: Any, leaves: Sequence, arrays: Any) -> Any:
    rest = iter(arrays)
    return jax.tree.unflatten(structure, [next(rest) if leaf is ... else leaf for leaf in leaves])


def _done(value: Any) -> Future:
    future = Future()
    future.set_result(value)
    return future


def _differentiated(function: Callable[..., list], arrays: Sequence, dots: Sequence) -> list:
    """Tangents by JAX."""
    active = [k for k, dot in enumerate(dots) if dot is not None]

    def smooth(*some):
        every = list(arrays)
        for k, leaf in zip(active, some, strict=True):
            every[k] = leaf
        return {k: leaf for k, leaf in enumerate(function(*every)) if eqx.is_inexact_array(leaf)}

    found: dict = {}
    results = jax.jvp(smooth, tuple(arrays[k] for k in active), tuple(dots[k] for k in active))[1]
    found.update(results)
    return [found.get(k) for k in range(1 + max(found, default=-1))]
