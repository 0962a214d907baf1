"""Valleys of the gap between a shaft and a smooth object: its minima along the shaft, away from contacts.

Between two samples the gap is a cubic with the right values and rates. A valley is noticed although a crest lies within
the same cell, and if waves of the object are at least as long as two cells.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.shaft import WholeShaft, cell_of
from jaxwhisker._model.profile import AbstractProfile

WITHIN = 6  # samples within a cell of the shaft: its longest cells are 0.13 of its length, waves may be 0.05
OWN = 0.01  # share of a cell from a contact within which the minimum is that of the contact itself


OfSegments = Bool[Array, " segments"]


class GapAlong(NamedTuple):
    """The gap along a shaft, at all of its points and at a number of places between each two of them."""

    gap: Float[Array, "segments samples"]
    rate: Float[Array, "segments samples"]  # by the arc length towards the base
    beyond: Float[Array, "segments samples"]  # arc length of the whisker beyond the sample


class Valley(NamedTuple):
    """The lowest minimum of a gap along a shaft."""

    some: Bool[Array, ""]  # whether there is one
    segment: Int[Array, ""]
    index: Int[Array, ""]  # of the cell of the shaft
    share: Scalar  # of this cell
    width: Scalar  # share of this cell between two samples


def gap_facing(one: AbstractProfile, shaft: WholeShaft) -> GapAlong | None:
    """The gap to the points of an object that face a shaft; None if these have to be searched for."""
    if one.facing(jnp.zeros(()), jnp.zeros(())) is None:
        return None
    segments, points = shaft.x.shape

    def off(x, y):
        parameter = one.facing(x, y)
        assert parameter is not None
        return one.point(parameter).off(x, y)

    def at(segment, k, t):
        cell = cell_of(shaft, segment, k)
        gap, rate = jax.jvp(off, tuple(cell.point(t)), tuple(cell.direction(t) / cell.length))
        return gap, rate, cell.beyond + t * cell.length

    sample = np.arange((points - 1) * WITHIN + 1)
    k = np.minimum(sample // WITHIN, points - 2)
    along = jax.vmap(jax.vmap(at, (None, 0, 0)), (0, None, None))
    return GapAlong(*along(jnp.arange(segments), jnp.asarray(k), jnp.asarray(sample / WITHIN - k)))


def lowest_valley(along: GapAlong, cells: int, starts: OfSegments, ends: OfSegments) -> Valley:
    """The lowest minimum of the gap to an object along a shaft, besides those at contacts with it.

    `cells` is the number of cells of a segment; `starts` and `ends` tell which segments start and end at such contacts.
    """
    gap, rate, beyond = along
    lengths = beyond[:, 1:] - beyond[:, :-1]
    cubic = Cubic(gap[:, :-1], gap[:, 1:], lengths * rate[:, :-1], lengths * rate[:, 1:])
    share = cubic.minimum()
    number = np.arange(share.shape[1])
    starts, ends = starts[:, None] & (number == 0), ends[:, None] & (number == number[-1])
    own = (starts & (share < OWN)) | (ends & (share > 1 - OWN))
    valleys = jnp.where((share >= 0) & (share <= 1) & ~own, cubic.value(share), jnp.inf)
    k = jnp.argmin(valleys)
    within = share.shape[1] // cells
    segment, sample = k // number.size, k % number.size
    in_cell = (sample % within + jnp.ravel(share)[k]) / within
    return Valley(jnp.isfinite(jnp.min(valleys)), segment, sample // within, in_cell, jnp.asarray(1 / within))
