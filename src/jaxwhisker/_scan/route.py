"""The route of the drive: its positions, the distance travelled, and the turning points."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.announce import warn
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Control
from jaxwhisker._model.scene import Units
from jaxwhisker._path.march import STOPS, TRACED_STOPS
from jaxwhisker._path.path import Status

STEP = 0.001  # of the default control, dimensionless: in lengths of the first whisker if the drive moves along x
MOST_STEPS = 1_000_000  # of the default control
TRACED_STEPS = 2048  # of the default control of a traced scene, whose length must not depend on values


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
    # Programs depend on the room: powers of two keep their number small.
    room = 2 if turns.size == 0 else STOPS * 2 ** math.ceil(math.log2(max((turns.size + 2) / STOPS, 1)))
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
    index = jnp.nonzero(turns, size=min(TRACED_STOPS, control.size), fill_value=control.size - 1)[0]
    route = Route(control, _travel(control), control[index], jnp.minimum(jnp.sum(turns), index.size) - 1)
    status = jnp.where(jnp.sum(turns) <= index.size, Status.ok, Status.too_long)
    return route, jnp.where(jnp.all(jnp.isfinite(control)), status, Status.invalid)


def across() -> tuple[Float[np.ndarray, "2"], int]:
    """Stops (NaN, because they are not known yet) of a route right across the object, and the index of the last."""
    return np.full(2, np.nan), 1


def _travel(control: Float[Array, " steps"]) -> Float[Array, " steps"]:
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.abs(jnp.diff(control)))])


def route_through(control: Control) -> tuple[Route, Int[Array, ""] | None]:
    """The route through positions of the drive, and its status; None if the positions are concrete."""
    if not checks.is_traced(control):
        return route_of(np.asarray(control, dtype=float)), None
    still = jax.lax.stop_gradient(control)
    if checks.is_traced(still):
        return traced_route_now(jnp.asarray(control, dtype=float))
    control, still = jnp.asarray(control), np.asarray(still, dtype=float)
    return route_of(still)._replace(control=control, stops=control[stops_of(still)]), None


def check_extent(start: Float[Array, ""]) -> None:
    """Raise an error if the default control, which has this start, is not known."""
    if not checks.is_traced(start) and math.isnan(float(start)):
        raise ValueError(
            "`control` must be given for this scene: however far the drive moves back, whiskers are not known to be "
            "clear of the object."
        )


def default_positions(start: float, stop: float, unit: Units) -> np.ndarray:
    """The positions of the default control from `start` to `stop`, in the unit of the control."""
    check_extent(jnp.asarray(start))
    step = STEP * float(unit.control)
    count = max(2, int(np.ceil(abs(stop - start) / step)) + 1)
    if count > MOST_STEPS:
        raise ValueError(
            f"Springs this soft need an explicit `control`: the default, from {start:g} to {stop:g}, would have "
            f"{count:,} steps, and at most {MOST_STEPS:,} are allowed."
        )
    return start + math.copysign(step, stop - start) * np.arange(count)


def warn_of_no_touch(phases: Array, status: Array, thing: object) -> None:
    """Warn if no whisker touches the object at any node of a path right across it; `phases` has shape (nodes, ...)."""
    if not checks.is_traced((phases, status)) and int(status) == Status.ok and not np.any(np.asarray(phases)):
        warn(f"The scan touches nothing: right across the object, no whisker meets it ({thing}).")


def evenly(start: Float[Array, ""], stop: Float[Array, ""], steps: int) -> Route:
    """The route through equidistant positions."""
    start, stop = jax.lax.stop_gradient((start, stop))  # derivatives are taken at fixed positions
    return straight(start + (stop - start) * jnp.linspace(0.0, 1.0, steps))


traced_route_now, evenly_now = Program(traced_route), Program(evenly, frozen=True)
