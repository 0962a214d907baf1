"""Contacts on the pieces of a profile: how far a contact is from the ends of its piece, and the piece it passes to.

Profiles without edges have one piece. Their contacts have the piece None, and nothing is computed.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._model.profile import AbstractProfile

Pieces = Int[Array, " whiskers"]
ON_PIECE = 1e-12  # distance of a parameter from its piece that is no more than rounding


def ends_of(profile: AbstractProfile, piece: Pieces) -> tuple[Float[Array, " whiskers"], Float[Array, " whiskers"]]:
    """Parameters at which these pieces begin and end; infinite for the outer ends of the first and the last piece."""
    far = jnp.full(1, jnp.inf)
    breaks = jnp.concatenate([-far, profile.breaks(), far])
    return breaks[piece], breaks[piece + 1]


def break_between(profile: AbstractProfile, before: Pieces, after: Pieces) -> Float[Array, " whiskers"]:
    """Parameters at which neighbouring pieces meet."""
    breaks = profile.breaks()
    return breaks[jnp.clip(jnp.maximum(before, after) - 1, 0, breaks.size - 1)]


def after_step(
    profile: AbstractProfile, piece: Pieces | None, parameter: Float[Array, " whiskers"], free: Bool[Array, " whiskers"]
) -> Pieces | None:
    """The pieces after contacts have moved to these parameters, perhaps past an end of their piece."""
    if piece is None:
        return None
    low, high = ends_of(profile, piece)
    # Exactly at a break, a contact stays on its piece.
    left = (parameter < low - ON_PIECE) | (parameter > high + ON_PIECE)
    return jnp.where(left & ~free, jax.vmap(profile.piece_at)(parameter), piece)


def where_touching(piece: Pieces | None, touches: Bool[Array, "*batch"]) -> Pieces | None:
    """The pieces of contacts; free whiskers have the first piece, on which any parameter yields a finite point."""
    return None if piece is None else jnp.where(touches, piece, 0)
