"""Programs below vmap, jvp and grad, outside a caller's jit.

There, a program is a primitive, and JAX hands all transformations down to calls with values. `levels` says which arrays
have an axis for each vmap, from the outermost one inwards; these axes come first, in the same order.
"""

import functools
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxwhisker._base.settings import as_here, with_own_settings

LANES = 64  # of a batch in the plane that run together


def threads() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


PRIMITIVE = Primitive("jaxwhisker_program")
PRIMITIVE.multiple_results = True


@PRIMITIVE.def_impl
@with_own_settings
def _run(*arrays, program: Any, shape: Any, levels: tuple[tuple[bool, ...], ...]) -> list:
    if not levels:
        return program.run(shape, arrays)
    values = [np.asarray(leaf) for leaf in arrays]
    sizes = [_size(values, levels, number) for number in range(len(levels))]
    indices = list(np.ndindex(*sizes))
    together = program.lanes_together(shape, len(indices))
    run = program.compiled(shape, together)
    if not together:
        program.count_alone(shape, len(indices))

    def lane(index: tuple[int, ...]) -> list:
        each = zip(values, zip(*levels, strict=True), strict=True)
        return [leaf[tuple(k for k, own in zip(index, mapped, strict=True) if own)] for leaf, mapped in each]

    def single(index) -> list:
        return [np.asarray(leaf) for leaf in run(*lane(index))]

    def block(first: int) -> list:
        some = indices[first : first + together]
        lanes = [lane(index) for index in [*some, *[some[-1]] * (together - len(some))]]
        results = run(*(np.stack(each) for each in zip(*lanes, strict=True)))
        return [np.asarray(leaf)[: len(some)] for leaf in results]

    with ThreadPoolExecutor(threads()) as pool:  # XLA alone keeps one processor busy
        if together:
            parts = list(pool.map(as_here(block), range(0, len(indices), together)))
            joined = [np.concatenate(each) for each in zip(*parts, strict=True)]
        else:
            parts = list(pool.map(as_here(single), indices))
            joined = [np.stack(each) for each in zip(*parts, strict=True)]
    if not indices:
        joined = [np.zeros((0, *info.shape), info.dtype) for info in program.results(shape).arrays]
    # Unlike jnp.asarray, device_put compiles nothing for each new shape.
    return [jax.device_put(leaf.reshape(*sizes, *leaf.shape[1:])) for leaf in joined]


def _size(values: list[np.ndarray], levels: tuple[tuple[bool, ...], ...], number: int) -> int:
    """Size of the axis of a vmap."""
    which = levels[number].index(True)
    return values[which].shape[sum(level[which] for level in levels[:number])]


def _batch(arrays, axes, *, program: Any, shape: Any, levels):
    mapped = tuple(axis is not None for axis in axes)
    arrays = [jnp.moveaxis(leaf, axis, 0) if axis else leaf for leaf, axis in zip(arrays, axes, strict=True)]
    results = PRIMITIVE.bind(*arrays, program=program, shape=shape, levels=(mapped, *levels))
    return results, [0] * len(results)


def _jvp(arrays, dots, *, program: Any, shape: Any, levels):
    results = PRIMITIVE.bind(*arrays, program=program, shape=shape, levels=levels)
    some = [not isinstance(dot, ad.Zero) for dot in dots]
    kept: list[int] = []

    def tangents(arrays, given, found):
        rest = iter(given)
        every = program.tangents(shape, arrays, [next(rest) if one else None for one in some], found)
        kept[:] = [k for k, dot in enumerate(every) if dot is not None]
        return [every[k] for k in kept]

    for level in reversed(levels):
        axes = [0 if mapped else None for mapped in level]
        given_axes = [axis for axis, one in zip(axes, some, strict=True) if one]
        tangents = jax.vmap(tangents, in_axes=(axes, given_axes, 0))
    given = [ad.instantiate_zeros(dot) for dot, one in zip(dots, some, strict=True) if one]
    found = tangents(list(arrays), given, results)
    out: list = [ad.Zero(jax.typeof(result).to_tangent_aval()) for result in results]
    for k, dot in zip(kept, found, strict=True):
        out[k] = dot
    return results, out


def _staged(*arrays, program: Any, shape: Any, levels) -> list:
    """The results where a caller's jit surrounds transformations that know their values."""
    function = program.flat(shape)
    for level in reversed(levels):
        function = jax.vmap(function, in_axes=[0 if mapped else None for mapped in level])
    return function(*arrays)


batching.primitive_batchers[PRIMITIVE] = _batch
ad.primitive_jvps[PRIMITIVE] = _jvp
PRIMITIVE.def_abstract_eval(
    lambda *avals, **params: [
        ShapedArray(info.shape, info.dtype) for info in jax.eval_shape(functools.partial(_staged, **params), *avals)
    ]
)
mlir.register_lowering(PRIMITIVE, mlir.lower_fun(_staged, multiple_results=True))
