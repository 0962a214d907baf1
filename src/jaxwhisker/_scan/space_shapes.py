"""Shapes in space: the whiskers' centre lines at steps of a scan."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.quaternions import Vector
from jaxwhisker._base.rotation import quaternion_of
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.space import SpaceLoad, points
from jaxwhisker._scan.space_result import SpaceState
from jaxwhisker._space.section import space_section

PADDING = 64  # states are padded to a multiple of this, because figures and films then share a compiled program


class SpaceShapes(eqx.Module):
    """Centre lines of whiskers in space: along the last axis, points from base to contact, then to the tip.

    Two thirds of the points lie between base and contact, and the others beyond; both parts are equidistant. All points
    of a free whisker are. Steps that failed are NaN.
    """

    x: Float[Array, "*at whiskers points"]  # a length
    y: Float[Array, "*at whiskers points"]
    z: Float[Array, "*at whiskers points"]


def space_state_of(state: SpaceState) -> SpaceState:
    """The fields of a state in space, without what a result holds besides."""
    fields = {name: getattr(state, name) for name in SpaceState.__dataclass_fields__}
    return SpaceState(**jax.tree.map(jnp.asarray, fields))


def shapes_in_space(scene: SpaceScene, state: SpaceState, *, count: int) -> SpaceShapes:
    """Centre lines of whiskers in a state, or in several states of this scene, with `count` points each.

    They have derivatives with respect to the states and the whiskers.
    """
    whiskers, one = jax.tree.map(checks.as_float, scene.whiskers), jnp.ndim(state.phase) == 1
    if checks.is_traced((state, whiskers)):
        states = jax.tree.map(lambda leaf: leaf[None], space_state_of(state)) if one else space_state_of(state)
        return jax.tree.map(lambda line: line[0] if one else line, _shapes(states, whiskers, count=count))
    states = jax.tree.map(lambda leaf: np.asarray(leaf)[None] if one else np.asarray(leaf), space_state_of(state))
    steps = states.phase.shape[0]
    room = (0, -steps % PADDING)
    padded = jax.tree.map(lambda leaf: jnp.asarray(np.pad(leaf, [room, *[(0, 0)] * (leaf.ndim - 1)])), states)
    lines = _shapes(padded, whiskers, count=count)
    return jax.tree.map(lambda line: np.asarray(line)[0 if one else slice(steps)], lines)


@Program
def _shapes(states: SpaceState, whiskers: tuple[Whisker, ...], *, count: int) -> SpaceShapes:
    def lines(state: SpaceState) -> Float[Array, "whiskers points 3"]:
        each = [jax.tree.map(lambda field, k=k: field[k], state) for k in range(len(whiskers))]
        return jnp.stack([_line(whisker, at, count) for whisker, at in zip(whiskers, each, strict=True)])

    return SpaceShapes(*jnp.moveaxis(jax.vmap(lines)(states), -1, 0))


def _line(whisker: Whisker, at: Any, count: int) -> Float[Array, "points 3"]:
    """Points of one whisker, integrated from its base: the reaction there is opposite to the force of the object."""
    section, zero = space_section(whisker, 1.0, 1.0), jnp.zeros_like(at.base_x)
    free: Bool[Array, ""] = at.phase == Phase.free
    contact = jnp.stack([at.contact_x, at.contact_y, at.contact_z])
    base = jnp.stack([at.base_x, at.base_y, at.base_z])
    w, x, y, z = quaternion_of(at.base_rotation)
    loaded = count - count // 3
    arc = jnp.where(free, whisker.length * (loaded - 1) / (count - 1), at.contact_arc)

    def onwards(start: Any, length: Scalar, force: Vector, intervals: int, from_base: Scalar) -> Any:
        places = np.linspace(0.0, 1.0, intervals + 1)
        return points(start, -length, SpaceLoad(force), section, at=jnp.asarray(places), from_base=from_base)

    # Positions are relative to the contact, about which the force has no moment.
    start = tuple(base - contact), (w, x, y, z)
    first = onwards(start, arc, (-at.fx, -at.fy, -at.fz), loaded - 1, zero)
    end = jax.tree.map(lambda leaf: leaf[-1], first)
    rest = onwards(end, whisker.length - arc, (zero, zero, zero), count - loaded, arc)
    return contact + jnp.concatenate([jnp.stack(first[0], axis=-1), jnp.stack(rest[0], axis=-1)[1:]])
