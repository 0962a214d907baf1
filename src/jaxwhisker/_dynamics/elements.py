"""Elements: stretches of a whisker on which the change of its curvature is a polynomial of arc length.

The elements of a whisker end where its load is discontinuous: at its contact, at springs and at loads. On an element of
length l, with xi from 0 to 1, the change of the curvature is

    delta phi' = sum_j a_j p_j(xi) / sqrt(l),   p_j = sqrt(2 j + 1) P_j(2 xi - 1),

with the Legendre polynomials P_j. The bending energy is then of the same size for all coordinates a_j, no matter how
short an element is. Integrals are evaluated at the Gauss points of each element.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.quadrature import gauss, legendre, legendre_integrals

ORDER = 16  # polynomials per element
NODES = 20  # Gauss points per element

POINTS, WEIGHTS = gauss(NODES)
_SCALE = np.sqrt(2 * np.arange(NODES) + 1)
# The polynomials p_j at the Gauss points, and their integrals from 0.
VALUES, INTEGRALS = (_SCALE * np.stack(of(POINTS, NODES), axis=1) for of in (legendre, legendre_integrals))
TO_COEFFICIENTS = VALUES.T * WEIGHTS  # of a function that is known at the Gauss points
RUNNING = INTEGRALS @ TO_COEFFICIENTS  # integral from 0 to each Gauss point


class Fields(NamedTuple):
    """Changes of position and angle per coordinate (last axis): first those of the elements, then the base's x, y, phi.

    The middle axis of `at` holds x, y and phi at all Gauss points of all elements; that of `ends` at the ends of the
    elements.
    """

    at: Float[Array, "elements points 3 coordinates"]
    ends: Float[Array, "elements 3 coordinates"]


def fields(lengths: Float[Array, " elements"], cos: Float[Array, "elements points"], sin: Array) -> Fields:
    """Changes of position and angle of a whisker whose direction is known at the Gauss points."""
    count = lengths.shape[0]
    # An element without length moves nothing.
    size = jnp.sqrt(jnp.where(lengths > 0, lengths, 1e-30))
    own = jnp.eye(count)[:, None, :, None] * size[:, None, None, None] * INTEGRALS[:, None, :ORDER]
    whole = jnp.zeros(ORDER).at[0].set(1.0) * size[:, None]  # angle at the end of an element
    below = np.tril(np.ones((count, count)), -1)
    angle = own + (below[:, None, :, None] * whole[None, None])
    angle = jnp.reshape(angle, (count, NODES, count * ORDER))
    base = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), (count, NODES, 3))
    angle = jnp.concatenate([angle, base], axis=-1)
    turned = jnp.stack([-sin[..., None] * angle, cos[..., None] * angle], axis=2)
    total = lengths[:, None, None] * jnp.sum(WEIGHTS[:, None, None] * turned, axis=1)
    ends = jnp.cumsum(total, axis=0)
    within = lengths[:, None, None, None] * jnp.einsum("ij,ejck->eick", RUNNING, turned)
    still = jnp.eye(2, count * ORDER + 3, count * ORDER)
    moved = within + (ends - total)[:, None] + still
    end_angle = (below + np.eye(count))[:, :, None] * whole[None]
    end_angle = jnp.concatenate([jnp.reshape(end_angle, (count, -1)), base[:, 0]], axis=-1)
    at = jnp.concatenate([moved, angle[:, :, None]], axis=2)
    return Fields(at, jnp.concatenate([ends + still, end_angle[:, None]], axis=1))


def interpolated(
    values: Float[Array, "elements points k"], ends: Float[Array, " elements"], s: Float[Array, " places"]
) -> Float[Array, "places k"]:
    """Values at arc lengths s of functions that are known at the Gauss points of elements with these ends."""
    starts = jnp.concatenate([jnp.zeros(1), ends[:-1]])
    index = jnp.minimum(jnp.sum(s[:, None] > ends, axis=1), ends.size - 1)
    lengths = (ends - starts)[index]
    share = jnp.where(lengths > 0, (s - starts[index]) / jnp.where(lengths > 0, lengths, 1.0), 0.0)
    polynomials = jnp.stack(legendre(share, NODES), axis=1) * _SCALE
    coefficients = jnp.einsum("ji,eik->ejk", TO_COEFFICIENTS, values)
    return jnp.sum(polynomials[:, :, None] * coefficients[index], axis=1)


def quadratic(left: Float[Array, "elements points *k n"], weight: Array) -> Float[Array, "n n"]:
    """Sum over all points of the squares of fields, with weights: a quadratic form of the coordinates."""
    return jnp.einsum("...i,...,...j->ij", left, weight, left)


def bending(stiffness: Float[Array, "elements points"]) -> Float[Array, "n n"]:
    """The quadratic form of the bending energy, for the coordinates of the elements."""
    count = stiffness.shape[0]
    values = VALUES[:, :ORDER]
    blocks = jnp.einsum("ij,i,ei,ik->ejk", values, WEIGHTS, stiffness, values)
    return jnp.reshape(jnp.einsum("ef,ejk->ejfk", jnp.eye(count), blocks), (count * ORDER, count * ORDER))


def node_arcs(ends: Float[Array, " elements"]) -> tuple[Float[Array, " elements"], Float[Array, "elements points"]]:
    """Lengths of elements with these ends, and the arc lengths of their Gauss points."""
    starts = jnp.concatenate([jnp.zeros_like(ends[:1]), ends[:-1]])
    return ends - starts, starts[:, None] + (ends - starts)[:, None] * POINTS
