"""Stiffness of a rod in space against small rotations, which tells whether the rod is stable.

For fields of rotations w and v that vanish at the base, with the stiffness D in the fixed frame, the internal moment m,
the force F and the tangent t, the virtual work of v by what a rotation by w changes is the integral of

    v'.D w' - m.(w x v') - (F.w)(t.v) + (F.t) v.w

under loads that keep their directions. With v = w it is the second variation of the energy under dead forces (Antman,
Nonlinear Problems of Elasticity, 2005, chapter 8). A follower turns with its cross-section, by w x F or w x M, which
works on the displacement or the rotation v there. The forms are evaluated on fields that are products of functions of
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
    # Of a strip: stiffness against bending about d1 divided by B, and d1.
    lateral: tuple[Scalar, Float[Array, "points 3"]] | None = None


class Followers(NamedTuple):
    """Forces and moments at places of the rod that turn with their cross-sections."""

    force: Float[Array, "places 3"]
    moment: Float[Array, "places 3"]
    before: Float[Array, "places points"]  # 1 at points of the rod between the base and the place, else 0
    fields: Float[Array, "functions places"]  # the functions at the places


def stiffness_of(
    rod: BentRod,
    fields: Float[Array, "functions points"],
    slopes: Float[Array, "functions points"],
    weights: Along,
    *,
    axes: int = 3,
) -> Float[Array, "n n"]:
    """Stiffness against rotations about the axes x, y and z under loads that keep their directions.

    Args:
        rod: the rod.
        fields: functions of the arc length at the points.
        slopes: their derivatives.
        weights: integrate along the rod.
        axes: of rotation: the first ones of x, y and z.

    Returns:
        Matrix that belongs to the coefficients of each function for all axes: of w in rows, and of v in columns.
    """
    force, tangent = rod.force, rod.tangent
    bending, along = rod.stiffness[:, None, None], tangent[:, :, None] * tangent[:, None, :]
    stiffness = bending * (jnp.eye(3) - (1 - rod.torsion_ratio) * along)
    if rod.lateral is not None:
        ratio, first = rod.lateral
        stiffness -= (1 - ratio) * bending * first[:, :, None] * first[:, None, :]
    tension = jnp.sum(force * tangent, axis=-1)[:, None, None]
    loading = tension * jnp.eye(3) - force[:, :, None] * tangent[:, None, :]

    def form(a, matrix, b):
        return jnp.einsum("p,ip,pab,jp->iajb", weights, a, matrix[:, :axes, :axes], b)

    total = form(slopes, stiffness, slopes) - form(fields, _turning(rod.moment), slopes) + form(fields, loading, fields)
    return jnp.reshape(total, (axes * fields.shape[0],) * 2)


def second_variation(
    rod: BentRod,
    fields: Float[Array, "functions points"],
    slopes: Float[Array, "functions points"],
    weights: Along,
    *,
    axes: int = 3,
) -> Float[Array, "n n"]:
    """The symmetric part of `stiffness_of`: a quadratic form."""
    matrix = stiffness_of(rod, fields, slopes, weights, axes=axes)
    return (matrix + matrix.T) / 2


def stiffness_by_followers(
    by: Followers, rod: BentRod, fields: Float[Array, "functions points"], weights: Along
) -> Float[Array, "n n"]:
    """What followers add to `stiffness_of`: they are part of the load on the rod there."""
    # Displacements of the places by rotations v are sums of v x t, and (w x F).(v x t) = (w.v)(F.t) - (w.t)(F.v).
    moved = jnp.einsum("p,kp,jp,pa->kja", weights, by.before, fields, rod.tangent)
    work = jnp.einsum("ka,kja->kj", by.force, moved)[:, None, :, None] * jnp.eye(3)[:, None, :]
    work -= jnp.einsum("kja,kb->kajb", moved, by.force)
    work -= _turning(by.moment)[:, :, None, :] * by.fields.T[:, None, :, None]
    total = -jnp.einsum("ik,kajb->iajb", by.fields, work)
    return jnp.reshape(total, (3 * fields.shape[0],) * 2)


def _turning(moment: Float[Array, "points 3"]) -> Float[Array, "points 3 3"]:
    """m.(a x b) of the axes a and b."""
    return jnp.cross(moment[:, None, :], jnp.eye(3)[None])
