"""Shape of whiskers in space with several contacts in a state of a scan."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxwhisker._base.rotation import quaternion_of
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.space import SpaceLoad, points
from jaxwhisker._space.section import space_section

STEPS = 16  # of each segment, besides those that end at the points of the line


def line_past_contacts(whisker: Whisker, surface: AbstractSurface, count: int, at: Any) -> tuple[Array, ...]:
    """x, y and z of one whisker in a state at equidistant points, integrated from its base under the reaction there.

    At each contact, the load on what is beyond becomes smaller by the contact force. Places that are not used are at
    the base, and change nothing.
    """
    section, reaction = space_section(whisker, 1.0, 1.0), jnp.stack([at.fx, at.fy, at.fz])
    base, places = jnp.stack([at.base_x, at.base_y, at.base_z]), jnp.linspace(0.0, 1.0, count) * whisker.length
    contact = jnp.stack([at.contact_x, at.contact_y, at.contact_z], axis=-1)
    touches = (at.phase != Phase.free)[:, None]
    pushes = jnp.where(touches, at.contact_force[:, None] * jax.vmap(surface.normal)(contact), 0.0)
    moments = jnp.cross(contact, pushes)
    state = tuple(base), tuple(quaternion_of(at.base_rotation))
    force, moment = -reaction, -jnp.stack([at.mx, at.my, at.mz]) - jnp.cross(base, reaction)
    line, start = jnp.zeros((count, 3)), jnp.zeros(())
    for k in (*reversed(range(at.phase.size)), None):
        end = jnp.asarray(whisker.length if k is None else at.contact_arc[k])
        size = end - start
        share = jnp.clip((places - start) / jnp.where(size > 0, size, 1.0), 0.0, 1.0)
        all_shares = jnp.concatenate([jnp.asarray(np.linspace(0.0, 1.0, STEPS + 1)), share])
        order = jnp.argsort(all_shares)
        load = SpaceLoad(tuple(force), tuple(moment))
        r, q = points(state, -size, load, section, at=all_shares[order], from_base=start)
        at_places = jnp.stack(r, axis=-1)[jnp.argsort(order)[STEPS + 1 :]]
        line = jnp.where((places >= start)[:, None], at_places, line)
        state, start = jax.tree.map(lambda leaf: leaf[-1], (r, q)), end
        if k is not None:
            force, moment = force - pushes[k], moment - moments[k]
    return tuple(line.T)
