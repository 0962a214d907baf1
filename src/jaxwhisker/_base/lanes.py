"""Lanes of a batch that mean nothing: computed all the same, beside others that do."""

from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxwhisker._base import checks

Tree = TypeVar("Tree")


def harmless(tree: Tree, valid: Bool[Array, ""]) -> Tree:
    """The tree; where it is not valid, with numbers in (0, 1] in place of its own.

    Every derivative in an invalid lane has to be finite, although its result is thrown away: zero weight times NaN is
    NaN for every parameter that lanes share.
    """

    def one(leaf):
        if not checks.is_numeric(leaf):
            return leaf
        some = jnp.where(jnp.isfinite(leaf) & (leaf > 0), jnp.minimum(leaf, 1.0), 1.0)
        return jnp.where(valid, leaf, jax.lax.stop_gradient(some))

    return jax.tree.map(one, tree)
