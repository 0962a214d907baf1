"""Second variation of the energy of a rod in space under dead loads, which tells whether the rod is stable.

For a field w of rotations, with the stiffness D in the fixed frame, the internal moment m, the force F and the tangent
t, it is the integral of

    w'.D w' - m.(w x w') - (F.w)(t.w) + (F.t) w.w

(Antman, Nonlinear Problems of Elasticity, 2005, chapter 8). It is evaluated on fields that are products of functions of
the arc length and of axes.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.rod import Along


class BentRod(NamedTuple):
    """A rod in equilibrium, at points along it."""

    stiffness: Along  # B against bending
    torsion_ratio: Scalar  # C/B
    tangent: Float[Array, "points 3"]
    force: Float[Array, "points 3"]  # of everything beyond
    moment: Float[Array, "points 3"]


def second_variation(
    rod: BentRod,
    fields: Float[Array, "functions points"],
    slopes: Float[Array, "functions points"],
    weights: Along,
    *,
    axes: int = 3,
) -> Float[Array, "n n"]:
    """The quadratic form of rotations about the axes x, y and z: the coefficients of each function for all axes.

    Args:
        rod: the rod.
        fields: functions of the arc length at the points.
        slopes: their derivatives.
        weights: integrate along the rod.
        axes: of rotation: the first ones of x, y and z.
    """
    force, tangent = rod.force, rod.tangent
    bending, along = rod.stiffness[:, None, None], tangent[:, :, None] * tangent[:, None, :]
    stiffness = bending * (jnp.eye(3) - (1 - rod.torsion_ratio) * along)
    turning = jnp.cross(rod.moment[:, None, :], jnp.eye(3)[None])  # m.(a x b) of the axes a and b
    tension = jnp.sum(force * tangent, axis=-1)[:, None, None]
    loading = tension * jnp.eye(3) - force[:, :, None] * tangent[:, None, :]

    def form(a, matrix, b):
        return jnp.einsum("p,ip,pab,jp->iajb", weights, a, matrix[:, :axes, :axes], b)

    total = form(slopes, stiffness, slopes) - form(fields, turning, slopes) + form(fields, loading, fields)
    matrix = jnp.reshape(total, (axes * fields.shape[0],) * 2)
    return (matrix + matrix.T) / 2
