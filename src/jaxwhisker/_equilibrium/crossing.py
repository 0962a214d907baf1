"""Crossings of two shafts: their cubics cross.

The pair of chords that cross deepest is the first guess for Newton's method.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.shaft import Shaft, cells_of

CROSSING_STEPS = 4
CROSSING_ERROR = 1e-9  # distance of two shafts where they cross
OUTSIDE = 0.25  # of a cell: how far a crossing may lie outside the cells whose chords cross


def _cross(a: Float[Array, "... 2"], b: Float[Array, "... 2"]) -> Float[Array, "..."]:
    """The sine of the angle from one vector to another, times their lengths."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def cross(one: Shaft, other: Shaft) -> Bool[Array, ""]:
    """Whether two shafts cross."""
    first, second = cells_of(one), cells_of(other)
    along, across = (first.end - first.start)[:, None], second.end - second.start
    apart = second.start - first.start[:, None]
    sine = _cross(along, across)
    t, r = _cross(apart, across) / sine, _cross(apart, along) / sine
    off_middle = jnp.maximum(jnp.abs(t - 0.5), jnp.abs(r - 0.5))
    deepest = jnp.argmin(jnp.where(jnp.isfinite(off_middle), off_middle, jnp.inf))
    a, b = jnp.unravel_index(deepest, off_middle.shape)
    one_cell, other_cell = jax.tree.map(lambda leaf: leaf[a], first), jax.tree.map(lambda leaf: leaf[b], second)

    def newton(_, at):
        (p, v), (q, w) = ((cell.value(t), cell.rate(t)) for cell, t in zip((one_cell, other_cell), at, strict=True))
        step = jnp.stack([_cross(q - p, w), _cross(q - p, v)]) / _cross(v, w)
        return at + jnp.where(jnp.isfinite(step), step, 0.0)

    at = jax.lax.fori_loop(0, CROSSING_STEPS, newton, jnp.stack([t[a, b], r[a, b]]))
    miss = one_cell.value(at[0]) - other_cell.value(at[1])
    inside = _inside(at[0], a, first) & _inside(at[1], b, second)
    return inside & (jnp.sum(miss**2) < CROSSING_ERROR**2)


def _inside(t: Scalar, cell: Scalar, cells: Cubic) -> Bool[Array, ""]:
    """Whether a place is on the shaft, at most `OUTSIDE` away from its cell."""
    # The cells beyond a contact at the tip have no length: the last cell need not be the one that ends at the tip.
    size = jnp.sqrt(jnp.sum(cells.leaving**2, axis=-1))
    place = jnp.sum(jnp.where(jnp.arange(size.size) < cell, size, 0.0)) + t * size[cell]
    return (jnp.abs(t - 0.5) <= 0.5 + OUTSIDE) & (place >= 0) & (place <= jnp.sum(size))
