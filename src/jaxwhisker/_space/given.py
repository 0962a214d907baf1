"""Given forces and moments at points of a whisker in space, in the form in which `deflect` walks past them."""

from typing import TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.quaternions import (
    Quaternion,
    Vector,
    cross,
    inverse_rotation,
    plus,
    product,
    times,
    turned,
)
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.loads import LineLoad, PointForce, PointMoment, SpaceForce, SpaceMoment
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.space import SpaceLoad, SpaceState

GivenInSpace: TypeAlias = tuple[PointForce | PointMoment | LineLoad | SpaceForce | SpaceMoment, ...]

HALF = float(np.sqrt(0.5))
CLAMP: Quaternion = (HALF, -HALF, 0.0, 0.0)  # d1 = x, d2 = -z, d3 = y


class LoadsInSpace(eqx.Module):
    """Forces and moments in one form, sorted from the tip to the base; dimensionless."""

    force: Float[Array, "*loads 3"]  # that of a follower before the whisker bends
    moment: Float[Array, "*loads 3"]
    follower: Float[Array, "*loads"]
    position: Float[Array, "*loads"]

    def acting(self, rotation: Quaternion, factor: Scalar) -> tuple[Vector, Vector]:
        """Force and moment of `factor` times one load at a cross-section with this rotation."""
        # A follower is turned like its cross-section, from an upright one.
        by = product(rotation, inverse_rotation(CLAMP))

        def of(parts: Float[Array, "3"]) -> Vector:
            dead: Vector = (parts[0], parts[1], parts[2])
            x, y, z = (jnp.where(self.follower > 0, a, b) for a, b in zip(turned(by, dead), dead, strict=True))
            return times(factor, (x, y, z))

        return of(self.force), of(self.moment)

    def added(self, load: SpaceLoad, state: SpaceState, factor: Scalar) -> SpaceLoad:
        """The load on the rod between `factor` times one load, which acts at this state, and the next one."""
        force, moment = self.acting(state[1], factor)
        return SpaceLoad(plus(load.force, force), plus(load.moment, moment, cross(state[0], force)))


def sorted_in_space(whisker: Whisker, loads: GivenInSpace) -> LoadsInSpace:
    """Dimensionless loads at points, in the units of the whisker; one of zero at the tip if there are no others."""
    length, stiffness = whisker.length, whisker.base_stiffness
    none, rows = [0.0] * 3, []
    for load in loads:
        if isinstance(load, LineLoad):
            continue
        force, moment, follower = none, none, False
        if isinstance(load, PointForce):
            force = [load.force * jnp.cos(load.direction), load.force * jnp.sin(load.direction), 0.0]
        elif isinstance(load, SpaceForce):
            force = [load.fx, load.fy, load.fz]
        elif isinstance(load, SpaceMoment):
            moment = [load.mx, load.my, load.mz]
        else:
            moment = [0.0, 0.0, load.moment]
        if not isinstance(load, PointMoment):
            follower = load.follower
        position = 1.0 if load.position is None else load.position / length
        force = [part * length**2 / stiffness for part in force]
        moment = [part * length / stiffness for part in moment]
        rows.append(jnp.array([*force, *moment, float(follower), position], dtype=float))
    table = jnp.stack(rows or [jnp.array([*none, *none, 0.0, 1.0])])
    table = table[jnp.argsort(-table[:, -1])]
    return LoadsInSpace(table[:, :3], table[:, 3:6], table[:, 6], table[:, 7])
