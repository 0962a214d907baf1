"""Derivatives of programs: all slopes by one further program, which every transformation outside a jit shares.

Tangents are linear combinations of slopes, so jvp, grad and their batches have nothing else to compile.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxwhisker._base.program import Program

MOST_NUMBERS = 64  # a function of more numbers is differentiated in the directions that are asked for


def jacobian(function: Callable, numbers: Any) -> Any:
    """Slopes of a function's real values: the last axis runs over the numbers, a tree of arrays."""
    flat, rebuilt = ravel_pytree(numbers)

    def towards(direction):
        return jax.jvp(lambda flat: eqx.filter(function(rebuilt(flat)), eqx.is_inexact_array), (flat,), (direction,))[1]

    return jax.vmap(towards, out_axes=-1)(jnp.eye(flat.size))


def are_few(numbers: Any, most: int = MOST_NUMBERS) -> bool:
    """Whether slopes with respect to these numbers are worth computing."""
    return sum(leaf.size for leaf in jax.tree.leaves(numbers)) <= most


def direction_of(numbers: Any, dots: Any) -> list:
    """Tangents of the numbers, with zeros where they are None."""
    leaves, structure = jax.tree.flatten(numbers)
    given = structure.flatten_up_to(dots)
    return [jnp.zeros(leaf.shape) if dot is None else dot for leaf, dot in zip(leaves, given, strict=True)]


@jax.jit
def along(slopes: Any, direction: list[Float[Array, "..."]]) -> Any:
    """Tangents in a direction of the numbers."""
    flat = jnp.concatenate([jnp.zeros(0), *(jnp.ravel(leaf) for leaf in direction)])
    return jax.tree.map(lambda slope: slope @ flat, slopes)


@jax.jit
def along_each(slopes, direction: list, own: list):
    """Tangents in a direction of the numbers that all steps share, then of those of each step."""
    shared = jnp.concatenate([jnp.zeros(0), *(jnp.ravel(leaf) for leaf in direction)])
    steps = own[0].shape[0]
    each = jnp.concatenate([jnp.reshape(leaf, (steps, -1)) for leaf in own], axis=1)

    def along(slope):
        here, own = jnp.expand_dims(each, tuple(range(1, slope.ndim - 1))), slope[..., shared.size :]
        # What a step does not depend on may have no tangent.
        return slope[..., : shared.size] @ shared + jnp.sum(jnp.where(own == 0, 0.0, own * here), axis=-1)

    return jax.tree.map(along, slopes)


def by_slopes(function: Callable) -> Callable:
    """A tangent rule for a program of this function."""
    slopes = Program(partial(_slopes, function))

    def tangent(args, args_dot, _):
        numbers = eqx.filter(args, eqx.is_inexact_array)
        return along(slopes(*args), direction_of(numbers, args_dot)) if are_few(numbers) else NotImplemented

    return tangent


def _slopes(function: Callable, *args) -> Any:
    return jacobian(lambda numbers: function(*eqx.combine(numbers, args)), eqx.filter(args, eqx.is_inexact_array))
