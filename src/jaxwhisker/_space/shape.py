"""Shape of whiskers in contact and in a state of a scan, and how they are bent there."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxwhisker._base.quaternions import Vector, inverse_rotation, turned
from jaxwhisker._base.rotation import matrix_of, quaternion_of
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, points
from jaxwhisker._rod.space_end import contact_rotation
from jaxwhisker._rod.walk import in_order
from jaxwhisker._space.contact import POINT, Contact, SpaceWhisker, Traction, loaded
from jaxwhisker._space.free import CentreLine
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space.section import space_section

LOADED, UNLOADED = 16, 8  # intervals between base and contact, and between contact and tip


def shape(problem: SpaceProblem, body: SpaceWhisker, z: Contact, phase: Int[Array, ""]) -> CentreLine:
    """A whisker in contact, in the scene; its contact is point number `LOADED`."""
    traction = None if problem.friction is None else Traction(problem.friction, jnp.asarray(False))
    frame, force, chi, roll, arc = loaded(body, problem.surface, z, phase, traction)
    section, zero = body.section, jnp.zeros_like(arc)

    def along(length, force, intervals):
        """Positions and tangents, relative to the contact and in its frame, from there on."""
        at = jnp.linspace(0.0, 1.0, intervals + 1)
        if isinstance(section, SpaceSection):
            start = (zero, zero, zero), contact_rotation(chi, roll)
            r, q = points(start, length, SpaceLoad((zero, zero, force)), section, at=at, from_base=arc)
            return jnp.stack(r, axis=-1), jax.vmap(matrix_of)(jnp.stack(q, axis=-1))[..., 2]
        start = zero, zero, jnp.cos(chi), jnp.sin(chi)
        material = body.bending_stiffness if section is None else section
        x, y, c, s = rod.points(start, length, rod.Load(None, -force, None), material, at=at, from_base=arc)
        return jnp.stack([x, jnp.zeros_like(x), -y], axis=-1), jnp.stack([c, jnp.zeros_like(c), -s], axis=-1)

    parts = zip(along(arc, force, LOADED), along(arc - body.length, zero, UNLOADED), strict=True)
    position, tangent = (jnp.concatenate([inner[::-1], outer[1:]]) for inner, outer in parts)
    position, tangent = (jnp.sum(frame * both[:, None, :], axis=-1) for both in (position, tangent))
    spacing = jnp.repeat(jnp.stack([arc / LOADED, (body.length - arc) / UNLOADED]), np.array([LOADED, UNLOADED]))
    return CentreLine(z[POINT] + position, tangent, spacing)


def centre_line(whisker: Whisker, count: int, at: Any) -> tuple[Array, ...]:
    """x, y and z of one whisker in a state, integrated from its base under the reaction there.

    Two thirds of the points lie between base and contact, and the others beyond; all points of a free whisker are
    equidistant.
    """
    section, zero = space_section(whisker, 1.0, 1.0), jnp.zeros_like(at.base_x)
    contact = jnp.stack([at.contact_x, at.contact_y, at.contact_z])
    base = jnp.stack([at.base_x, at.base_y, at.base_z])
    w, x, y, z = quaternion_of(at.base_rotation)
    loaded = count - count // 3
    arc = jnp.where(at.phase == Phase.free, whisker.length * (loaded - 1) / (count - 1), at.contact_arc)

    def onwards(start: Any, length: Scalar, force: Vector, intervals: int, from_base: Scalar) -> Any:
        places = np.linspace(0.0, 1.0, intervals + 1)
        return points(start, -length, SpaceLoad(force), section, at=jnp.asarray(places), from_base=from_base)

    # Positions are relative to the contact, about which the force has no moment.
    start = tuple(base - contact), (w, x, y, z)
    first = onwards(start, arc, (-at.fx, -at.fy, -at.fz), loaded - 1, zero)
    end = jax.tree.map(lambda leaf: leaf[-1], first)
    rest = onwards(end, whisker.length - arc, (zero, zero, zero), count - loaded, arc)
    line = contact + jnp.concatenate([jnp.stack(first[0], axis=-1), jnp.stack(rest[0], axis=-1)[1:]])
    return tuple(line.T)


def bending_of(whisker: Whisker, at: Any, s: rod.Along, intervals: int) -> tuple[Array, Array]:
    """Internal moments of one whisker in a state about d1, d2 and d3 at these arc lengths, and changes of curvature.

    Both are zero beyond the contact. Integration steps end at the places, and between so many intervals.
    """
    section = space_section(whisker, 1.0, 1.0)
    arc = jnp.where(at.phase == Phase.free, 0.0, at.contact_arc)
    touches = arc > 0
    ends = rod.step_ends(-arc, section.in_plane, steps=intervals, from_base=jnp.zeros_like(arc))
    places = jnp.clip(s / jnp.where(touches, arc, 1.0), 0.0, 1.0)
    order = in_order(ends, places, outwards=True)
    w, x, y, z = quaternion_of(at.base_rotation)
    contact = jnp.stack([at.contact_x, at.contact_y, at.contact_z])
    start = tuple(jnp.stack([at.base_x, at.base_y, at.base_z]) - contact), (w, x, y, z)
    load = SpaceLoad((-at.fx, -at.fy, -at.fz))
    r, q = points(start, -arc, load, section, at=order.at, from_base=jnp.zeros_like(arc))
    r, q = jax.tree.map(lambda leaf: leaf[order.ranks[1]], (r, q))
    moment = jnp.stack(turned(inverse_rotation(q), load.moment_at(r)), axis=-1)
    moment = jnp.where((touches & (s < arc))[:, None], moment, 0.0)
    about_tangent = 1.0 if section.excess is None else 1 + section.excess
    sideways = 1.0 if section.lateral_ratio is None else 1 / section.lateral_ratio
    compliance = jax.vmap(section.compliance)(s)[:, None] * jnp.stack([sideways, 1.0, about_tangent])
    return moment, compliance * moment
