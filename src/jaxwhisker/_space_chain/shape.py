"""Shape of whiskers in space with several contacts in a state of a scan, and how they are bent there."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxwhisker._base.quaternions import inverse_rotation, turned
from jaxwhisker._base.rotation import quaternion_of
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._rod.space import SpaceLoad, points
from jaxwhisker._rod.walk import in_order
from jaxwhisker._space.section import space_section
from jaxwhisker._space.shape import with_change

STEPS = 16  # of each segment, besides those that end at the points of the line


def pushes_of(surface: AbstractSurface, at: Any) -> tuple[Array, Array]:
    """Points and forces of the contacts of a whisker in a state, shape (contacts, 3); no force at unused places."""
    contact = jnp.stack([at.contact_x, at.contact_y, at.contact_z], axis=-1)
    touches = (at.phase != Phase.free)[:, None]
    normal = jax.vmap(surface.normal)(contact)
    return contact, at.contact_force[:, None] * jnp.where(touches, normal, 0.0)


def line_past_contacts(whisker: Whisker, surface: AbstractSurface, count: int, at: Any) -> tuple[Array, ...]:
    """x, y and z of one whisker in a state at equidistant points from base to tip."""
    position, _ = _past_contacts(whisker, surface, at, jnp.linspace(0.0, 1.0, count) * whisker.length, STEPS)
    return tuple(position.T)


def bending_past_contacts(
    whisker: Whisker, surface: AbstractSurface, at: Any, s: rod.Along, intervals: int
) -> tuple[Array, Array]:
    """Internal moments of one whisker in a state about d1, d2 and d3 at these arc lengths, and changes of curvature.

    Both are zero beyond the outermost contact. Integration steps end at the places, and between so many intervals of
    each segment.
    """
    _, moment = _past_contacts(whisker, surface, at, s, intervals)
    return with_change(space_section(whisker, 1.0, 1.0), s, moment)


def _past_contacts(
    whisker: Whisker, surface: AbstractSurface, at: Any, places: rod.Along, steps: int
) -> tuple[Array, Array]:
    """Positions and internal moments (places, 3), integrated from the base under the reaction there.

    At each contact, the load on what is beyond becomes smaller by the contact force. Places that are not used are at
    the base, and change nothing.
    """
    section, reaction = space_section(whisker, 1.0, 1.0), jnp.stack([at.fx, at.fy, at.fz])
    base = jnp.stack([at.base_x, at.base_y, at.base_z])
    contact, pushes = pushes_of(surface, at)
    state = tuple(base), tuple(quaternion_of(at.base_rotation))
    force, moment = -reaction, -jnp.stack([at.mx, at.my, at.mz]) - jnp.cross(base, reaction)
    position = inner = jnp.zeros((places.size, 3))
    start = jnp.zeros(())
    for k in (*reversed(range(at.phase.size)), None):
        end = jnp.asarray(whisker.length if k is None else at.contact_arc[k])
        if k is None:  # exactly zero: a pointed tip has no stiffness
            force, moment = jnp.zeros(3), jnp.zeros(3)
        size = end - start
        share = jnp.clip((places - start) / jnp.where(size > 0, size, 1.0), 0.0, 1.0)
        order = in_order(rod.step_ends(-size, section.in_plane, steps=steps, from_base=start), share, outwards=True)
        load = SpaceLoad(tuple(force), tuple(moment))
        r, q = points(state, -size, load, section, at=order.at, from_base=start)
        own, turn = jax.tree.map(lambda leaf, order=order: leaf[order.ranks[1]], (r, q))
        about = turned(inverse_rotation(turn), load.moment_at(own))
        beyond = (places >= start)[:, None]
        position, inner = (
            jnp.where(beyond, jnp.stack(there, axis=-1), here) for there, here in ((own, position), (about, inner))
        )
        state, start = jax.tree.map(lambda leaf: leaf[-1], (r, q)), end
        if k is not None:
            force, moment = force - pushes[k], moment - jnp.cross(contact[k], pushes[k])
    return position, inner
