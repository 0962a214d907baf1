"""The route of the drive: its positions, the distance travelled, and the turning points."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._path.march import STOPS
from jaxwhisker._path.path import Status


class Route(NamedTuple):
    """Drive positions of a scan, in the unit of the control."""

    control: Float[Array, " steps"] | Float[np.ndarray, " steps"]
    travel: Float[Array, " steps"] | Float[np.ndarray, " steps"]  # distance travelled since the first position
    stops: Float[Array, " stops"] | Float[np.ndarray, " stops"]  # first position, turning points, last one; padded
    last: Int[Array, ""] | int  # index of the last stop


def route_of(control: Float[np.ndarray, " steps"]) -> Route:
    """The route through concrete positions."""
    index = stops_of(control)
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(control)))])
    return Route(control, travel, control[index], turns_of(control).size + 1)


def stops_of(control: Float[np.ndarray, " steps"]) -> Int[np.ndarray, " stops"]:
    """Indices of the first position, the turning points and the last position, which is repeated as padding."""
    turns, end = turns_of(control), control.size - 1
    room = 2 if turns.size == 0 else STOPS * int(np.ceil((turns.size + 2) / STOPS))
    return np.concatenate([[0], turns, np.full(room - 1 - turns.size, end)])


def turns_of(control: Float[np.ndarray, " steps"]) -> Int[np.ndarray, " turns"]:
    """Indices of the positions at which the drive turns back."""
    moves = np.flatnonzero(np.diff(control))
    signs = np.sign(np.diff(control)[moves])
    return moves[1:][signs[1:] != signs[:-1]]


def straight(control: Float[Array, " steps"]) -> Route:
    """The route through traced positions between which the drive does not turn."""
    return Route(control, _travel(control), control[jnp.array([0, -1])], jnp.asarray(1))


def traced_route(control: Float[Array, " steps"]) -> tuple[Route, Int[Array, ""]]:
    """The route through traced positions, and its status.

    The status is `invalid` if a position is not finite, `too_long` if there are too many turning points, or `ok`.
    """
    moves = jnp.sign(jnp.diff(control))
    # A move turns if its sign differs from that of the move before; while the drive stands still, the sign is kept.
    carried = jax.lax.associative_scan(lambda a, b: jnp.where(b == 0, a, b), moves)
    turns = jnp.concatenate([jnp.ones(1, bool), carried[1:] * carried[:-1] < 0, jnp.ones(1, bool)])
    turns = turns[-control.size :].at[0].set(True)
    index = jnp.nonzero(turns, size=min(2 * STOPS, control.size), fill_value=control.size - 1)[0]
    route = Route(control, _travel(control), control[index], jnp.minimum(jnp.sum(turns), index.size) - 1)
    status = jnp.where(jnp.sum(turns) <= index.size, Status.ok, Status.too_long)
    return route, jnp.where(jnp.all(jnp.isfinite(control)), status, Status.invalid)


def across() -> tuple[Float[np.ndarray, "2"], int]:
    """Stops (NaN, because they are not known yet) of a route right across the object, and the index of the last."""
    return np.full(2, np.nan), 1


def _travel(control: Float[Array, " steps"]) -> Float[Array, " steps"]:
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.abs(jnp.diff(control)))])
