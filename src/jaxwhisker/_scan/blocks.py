"""Blocks of steps of a scan, or of other rows, which let one program serve every number of them."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import checks

BLOCK = 512  # steps computed by one call; a control is padded to a multiple


def in_blocks(function: Callable, arrays: Any, size: int) -> Any:
    """Results of a function of arrays whose first axis runs over the steps of a scan, or over other rows.

    All blocks have one size, which lets one program serve scans of every length. The last row is repeated as padding.
    """
    count = jax.tree.leaves(arrays)[0].shape[0]

    def split(values):
        values, pad = (values, jnp.pad) if checks.is_traced(values) else (np.asarray(values), np.pad)
        padding = [(0, -count % size)] + [(0, 0)] * (values.ndim - 1)
        return pad(values, padding, mode="edge").reshape(-1, size, *values.shape[1:])

    blocks = jax.vmap(function)(*jax.tree.map(split, arrays))
    if checks.is_traced(blocks):
        return _joined(blocks, count)
    # NumPy joins them without compiling anything.
    return jax.tree.map(jax.device_put, _first_steps(jax.tree.map(np.asarray, blocks), count))


def _first_steps(blocks, count: int):
    """The first steps of arrays whose two leading axes run over blocks and their steps."""
    return jax.tree.map(lambda leaf: leaf.reshape(leaf.shape[0] * leaf.shape[1], *leaf.shape[2:])[:count], blocks)


_joined = jax.jit(_first_steps, static_argnums=1)
