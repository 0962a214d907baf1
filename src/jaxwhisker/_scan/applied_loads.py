"""Given loads at points of a whisker in the plane, in the form in which `deflect` walks past them."""

from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.loads import LineLoad, PointForce, PointMoment
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._rod.walk import pressed

Given: TypeAlias = tuple[PointForce | PointMoment | LineLoad, ...]


class Loads(eqx.Module):
    """Forces and moments in one form, sorted from the tip to the base; dimensionless."""

    force: Float[Array, "*loads"]
    direction: Float[Array, "*loads"]
    follower: Float[Array, "*loads"]
    moment: Float[Array, "*loads"]
    position: Float[Array, "*loads"]


def sorted_loads(whisker: Whisker, loads: Given) -> Loads:
    """Dimensionless loads at points, in the units of the whisker; one of zero at the tip if there are no others."""
    length, stiffness = whisker.length, whisker.base_stiffness
    rows = []
    for load in loads:
        if isinstance(load, LineLoad):
            continue
        position = 1.0 if load.position is None else load.position / length
        if isinstance(load, PointForce):
            size = load.force * length**2 / stiffness
            rows.append((size, load.direction, float(load.follower), 0.0, position))
        else:
            rows.append((0.0, 0.0, 0.0, load.moment * length / stiffness, position))
    columns = jnp.array(rows or [(0.0, 0.0, 0.0, 0.0, 1.0)], dtype=float).T
    return Loads(*columns[:, jnp.argsort(-columns[-1])])


def with_load(total: rod.Load, load: Loads, state: rod.RodState, factor: Scalar) -> rod.Load:
    """The load on the rod between `factor` times this load, which acts at this state, and the next one."""
    x, y, cos, sin = state
    dead_x, dead_y = jnp.cos(load.direction), jnp.sin(load.direction)
    follower = load.follower > 0
    force = factor * load.force
    # A follower is turned by phi - pi/2, like the whisker.
    fx = force * jnp.where(follower, dead_y * cos + dead_x * sin, dead_x)
    fy = force * jnp.where(follower, dead_y * sin - dead_x * cos, dead_y)
    return jax.tree.map(jnp.add, total, pressed((x, y), fx, fy, factor * load.moment))
