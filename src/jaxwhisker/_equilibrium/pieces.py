"""Contacts on the pieces of a profile: how far a contact is from the ends of its piece, and the piece it passes to.

A profile without edges has one piece. With a single such object, contacts have the piece None, and nothing is computed.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import PARAMETER
from jaxwhisker._model.profile import AbstractProfile

Pieces = Int[Array, " whiskers"]
Contacts = Float[Array, "whiskers numbers"]
ON_PIECE = 1e-12  # distance of a parameter from its piece that is no more than rounding
IN_CONE = 1e-9  # rad: a shaft this close to the tangents at a corner touches it
CELL_STEPS = 3  # of Newton's method for the height of a corner, from linear interpolation


def ends_of(
    profile: AbstractProfile, piece: Int[Array, "*batch"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Parameters at which these pieces begin and end; infinite for the outer ends of an object."""
    return profile.ends_on(piece)


def break_between(profile: AbstractProfile, before: Pieces, after: Pieces) -> Float[Array, " whiskers"]:
    """Parameters at which neighbouring pieces meet."""
    if len(profile.objects) > 1:
        start, _ = ends_of(profile, jnp.maximum(before, after))
        return jnp.where(jnp.isfinite(start), start, 0.0)  # where they are no neighbours
    breaks = profile.breaks()
    return breaks[jnp.clip(jnp.maximum(before, after) - 1, 0, breaks.size - 1)]


def after_step(
    profile: AbstractProfile, piece: Pieces, previous: Contacts, z: Contacts, moved: Bool[Array, " whiskers"]
) -> tuple[Pieces, Contacts]:
    """The pieces and contacts after a step; contacts that have moved past an end of their piece stop there."""
    low, high = ends_of(profile, piece)
    p, before = z[:, PARAMETER], previous[:, PARAMETER]
    # Exactly at a break, a contact stays on its piece.
    below, above = moved & (p < low - ON_PIECE), moved & (p > high + ON_PIECE)
    end, passes = jnp.where(below, low, high), below | above
    way = jnp.where(passes & (p != before), p - before, 1.0)
    share = jnp.where(passes, jnp.clip((end - before) / way, 0.0, 1.0), 1.0)
    z = previous + share[:, None] * (z - previous)
    return piece + above - below, z.at[:, PARAMETER].set(jnp.where(passes, end, z[:, PARAMETER]))


def where_touching(piece: Int[Array, "*batch"] | None, touches: Bool[Array, "*batch"]) -> Int[Array, "*batch"] | None:
    """The pieces of contacts; free whiskers have the first piece, on which any parameter yields a finite point."""
    return None if piece is None else jnp.where(touches, piece, 0)


class CornerTouch(NamedTuple):
    """The corner that a whisker's shaft touches first in an approach along x, if it touches any."""

    ahead: Float[Array, ""]  # side times position of the base at the touch; -inf if the shaft touches no corner
    cell: Float[Array, ""]  # place on the whisker, in cells from the base
    parameter: Float[Array, ""]  # of the profile
    piece: Int[Array, ""]


def first_corner(
    profile: AbstractProfile, whisker: Callable, heights: Float[Array, " points"], side: Scalar
) -> CornerTouch:
    """The first touch of a whisker's shaft with a corner.

    Args:
        profile: the object, which has edges.
        whisker: position and direction at a number of cells from the base, with the base at x = 0.
        heights: of the points between its cells.
        side: side from which the whisker approaches.
    """
    edges = 2 * jnp.arange((profile.breaks().size + 2) // 2)
    low, high = ends_of(profile, edges)
    # Repetitions of a polygon's last corner have infinite parameters.
    edges = jnp.where(jnp.isfinite(low) | jnp.isfinite(high), edges, 0)
    low, high = ends_of(profile, edges)
    end = jnp.where(jnp.isfinite(high), high, low)
    corner = jax.vmap(profile.point_on)(edges, end)
    rise = heights[1:] - heights[:-1]

    def crossing(at, end, low, high, cell):
        """Where a cell of the whisker crosses the height of a corner."""
        share = (at.y - heights[cell]) / jnp.where(rise[cell] == 0, 1.0, rise[cell])
        crosses = (share >= 0) & (share <= 1) & (rise[cell] != 0)
        place = cell + jnp.clip(share, 0.0, 1.0)
        for _ in range(CELL_STEPS):
            (_, y), (_, up) = whisker(place)
            place = jnp.clip(place - (y - at.y) / jnp.where(up == 0, 1.0, up), cell, cell + 1.0)
        (x, _), (cos, sin) = whisker(place)
        # The direction of the shaft up to a half turn: the object's normal points towards the whisker.
        slope = jnp.mod(jnp.arctan2(sin, cos), half) - jnp.where(side < 0, half, 0.0)
        parameter = end + jnp.mod(slope - jnp.arctan2(at.sin, at.cos) + half, 2 * half) - half
        within = (parameter > low - IN_CONE) & (parameter < high + IN_CONE)
        return jnp.where(crosses & within, side * (at.x - x), -jnp.inf), place, jnp.clip(parameter, low, high)

    half = 2 * checks.RIGHT_ANGLE
    cells = jnp.arange(rise.size)
    each = jax.vmap(jax.vmap(crossing, in_axes=(None, None, None, None, 0)), in_axes=(0, 0, 0, 0, None))
    ahead, place, parameter = (jnp.ravel(values) for values in each(corner, end, low, high, cells))
    first = jnp.argmax(ahead)
    return CornerTouch(ahead[first], place[first], parameter[first], edges[first // rise.size])
