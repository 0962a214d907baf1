"""Rows of contacts: of all whiskers one after the other, with the same number of places for each.

The contacts of a whisker are ordered from the tip to the base, and places that are not used follow.
"""

from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

RowsOfContacts = Float[Array, "*batch rows numbers"]  # three numbers in the plane, eleven in space
Tree = TypeVar("Tree")


def any_of_whisker(rows: Bool[Array, "*batch rows"], contacts: int) -> Bool[Array, "*batch whiskers"]:
    """Whether something holds for any contact of each whisker."""
    return jnp.any(jnp.reshape(rows, (*rows.shape[:-1], -1, contacts)), axis=-1)


def with_row(tree: Tree, row: Int[Array, ""], own: Tree, contacts: int) -> Tree:
    """The rows with a new one; those of its whisker that follow it move on by one place."""

    def put(leaf, own):
        index = jnp.arange(leaf.shape[0])
        moves = (index > row) & (index // contacts == row // contacts)
        here = index == row
        return jnp.where(here[:, None] if leaf.ndim > 1 else here, own, leaf[jnp.where(moves, index - 1, index)])

    return jax.tree.map(put, tree, own)


def without_row(tree: Tree, rows: Bool[Array, " rows"], empty: Tree, contacts: int) -> Tree:
    """The rows without one of these; those of its whisker that follow it move back by one place.

    `empty` is what places hold that are not used, in all rows or in one.
    """
    index, gone = jnp.arange(rows.shape[0]), jnp.any(rows)
    row = jnp.argmax(rows)
    moves = gone & (index >= row) & (index // contacts == row // contacts)
    at_end = index % contacts == contacts - 1
    source, ends = jnp.where(moves & ~at_end, index + 1, index), moves & at_end

    def taken(leaf, nothing):
        return jnp.where(ends[:, None] if leaf.ndim > 1 else ends, nothing, leaf[source])

    return jax.tree.map(taken, tree, empty)
