"""Shapes: the whiskers' centre lines at steps of a scan."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker import _checks, rod
from jaxwhisker._types import Control
from jaxwhisker.contact import Phase
from jaxwhisker.result import Result, State


class Shapes(eqx.Module):
    """Centre lines: the last axis runs from base to contact in equal arcs; its last point is the tip."""

    x: Float[Array, "*at whiskers points"]
    y: Float[Array, "*at whiskers points"]


def shapes(result: Result, at: Control | None = None, *, points: int = 64) -> Shapes:
    """Centre lines of all whiskers at the scan steps nearest to the controls `at` (default: at every step).

    They are integrated from the bases outwards with the scan's reactions.

    Args:
        result: a scan.
        at: drive positions, a length each; where the drive came by more than once, its first time.
        points: points a whisker, at least 3.

    Raises:
        ValueError: if `at` is not a one-dimensional array of finite numbers, or `points` is below 3.
    """
    if not isinstance(result, Result):
        raise ValueError(f"`result` must be the Result of a scan, but is {result!r}.")
    if not isinstance(points, int) or points < 3:
        raise ValueError(f"`points` must be an int of at least 3, but is {points!r}.")
    index = np.arange(result.control.shape[0])
    if at is not None:
        _checks.vector("at", at)
        index = np.argmin(np.abs(np.asarray(result.control)[:, None] - np.asarray(at)), axis=0)
    fields = {name: getattr(result, name)[index] for name in State.__dataclass_fields__}
    whiskers = result.scene.whiskers
    length = jnp.stack([jnp.asarray(w.length, dtype=float) for w in whiskers])
    stiffness = jnp.stack([jnp.asarray(w.bending_stiffness, dtype=float) for w in whiskers])
    return shapes_of(State(**fields), length, stiffness, points=points)


@eqx.filter_jit
def shapes_of(
    state: State, length: Float[Array, " whiskers"], bending_stiffness: Float[Array, " whiskers"], *, points: int
) -> Shapes:
    """Centre lines of whiskers in the given state(s)."""

    def one(base_x, fx, fy, mz, arc, length, stiffness):
        # Outwards is towards the base with a negative arc. The load is what the reaction balances.
        load = rod.Load(-fx, -fy, -mz - base_x * fy)
        up = (base_x, jnp.zeros_like(base_x), jnp.zeros_like(base_x), jnp.ones_like(base_x))
        x, y, cos, sin = rod.points(up, -arc, load, stiffness, count=points - 1)
        beyond = length - arc
        return jnp.append(x, x[-1] + beyond * cos[-1]), jnp.append(y, y[-1] + beyond * sin[-1])

    free = state.phase == Phase.free
    arc = jnp.where(free, length, state.contact_arc)
    line = jax.vmap(one)
    for _ in range(state.base_x.ndim - 1):
        line = jax.vmap(line, in_axes=(0, 0, 0, 0, 0, None, None))
    x, y = line(state.base_x, state.fx, state.fy, state.mz, arc, length, bending_stiffness)
    return Shapes(x, y)
