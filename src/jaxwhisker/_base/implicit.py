"""Implicit derivatives: a solution's derivatives follow from its equations, not from the iterations of a solver."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from jaxwhisker._base.leaves import Tree
from jaxwhisker._base.linear_algebra import inverse


def without_rule(point: Tree, known: PyTree, where: Bool[Array, ""] | bool = True) -> Tree:
    """The point, with NaN as its derivatives with respect to `known`: only a custom rule knows the true derivatives.

    Where a condition does not hold, the point has no derivatives by this.

    When a loop around a solved point (lax.scan, lax.map) is differentiated backwards and then once more, jax 0.10 drops
    the custom rule. Without the NaN, the derivatives would be zero: wrong, and unnoticed.
    """
    leaves = [jnp.ravel(leaf) for leaf in jax.tree.leaves(eqx.filter(known, eqx.is_inexact_array))]
    everything = jnp.concatenate(leaves)
    # The value is 0. The derivative is NaN, because the square root has no derivative at 0.
    zero = jnp.sum(jnp.where(jnp.isfinite(everything), 0.0 * everything, 0.0))
    nothing = 0.0 * jnp.sqrt(zero if where is True else jnp.where(where, zero, 1.0))
    return jax.tree.map(lambda leaf: leaf + nothing, point)


@eqx.filter_custom_jvp
def solution_of(equations: Callable, unknowns: Float[Array, " n"], known: PyTree) -> Float[Array, " n"]:
    """Solved unknowns, with their derivatives with respect to what is known.

    Args:
        equations: a function of unknowns and what is known, which returns n residuals; it must not close over traced
            values.
        unknowns: for which all residuals vanish.
        known: everything else that the residuals depend on.
    """
    del equations
    return without_rule(unknowns, known)


@solution_of.def_jvp
def _(primals, tangents):
    equations, unknowns, known = primals
    here = solution_of(equations, unknowns, known)
    slope = jax.jacfwd(lambda unknowns: equations(unknowns, known))(here)
    _, change = eqx.filter_jvp(lambda known: equations(here, known), (known,), (tangents[2],))
    change = jnp.zeros_like(here) if change is None else change  # of equations that do not depend on what changes
    # With the inverse, the change enters linearly, and JAX can transpose this.
    return here, -jnp.sum(inverse(slope) * change, axis=-1)
