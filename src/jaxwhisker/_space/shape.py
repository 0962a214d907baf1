"""Shape of whiskers in contact and in a state of a scan, and how they are bent there."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxwhisker._base.quaternions import Vector, cross, inverse_rotation, plus, turned
from jaxwhisker._base.rotation import matrix_of, quaternion_of
from jaxwhisker._base.types import Scalar, Triple
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, points
from jaxwhisker._rod.space_end import contact_rotation
from jaxwhisker._rod.walk import in_order
from jaxwhisker._space.contact import POINT, Contact, SpaceWhisker, Traction, loaded, pressed_start
from jaxwhisker._space.free import CentreLine
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space.section import space_section
from jaxwhisker._space.weight import weight_of_one

LOADED, UNLOADED = 16, 8  # intervals between base and contact, and between contact and tip


def shape(problem: SpaceProblem, body: SpaceWhisker, z: Contact, phase: Int[Array, ""]) -> CentreLine:
    """A whisker in contact, in the scene; its contact is point number `LOADED`."""
    traction = None if problem.friction is None else Traction(problem.friction, jnp.asarray(False))
    frame, force, chi, roll, arc = loaded(body, problem.surface, z, phase, traction)
    section, zero, weight = body.section, jnp.zeros_like(arc), body.weight

    def along(length, force, intervals):
        """Positions and tangents, relative to the contact and in its frame, from there on."""
        at = jnp.linspace(0.0, 1.0, intervals + 1)
        if weight is not None:
            assert isinstance(section, SpaceSection)
            own = weight.seen_in(frame)
            start, load = pressed_start(body, own, force, chi, roll, arc, UNLOADED)
            (r, q), _ = own.line(start, load, arc - length * at, section)
            return jnp.stack(r, axis=-1), jax.vmap(matrix_of)(jnp.stack(q, axis=-1))[..., 2]
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


def centre_line(whisker: Whisker, count: int, at: Any, gravity: Triple | None = None) -> tuple[Array, ...]:
    """x, y and z of one whisker in a state, integrated from its base under the reaction there.

    Two thirds of the points lie between base and contact, and the others beyond; all points of a free whisker are
    equidistant.
    """
    section, zero = space_section(whisker, 1.0, 1.0, heavy=gravity is not None), jnp.zeros_like(at.base_x)
    contact = jnp.stack([at.contact_x, at.contact_y, at.contact_z])
    base = jnp.stack([at.base_x, at.base_y, at.base_z])
    w, x, y, z = quaternion_of(at.base_rotation)
    loaded = count - count // 3
    arc = jnp.where(at.phase == Phase.free, whisker.length * (loaded - 1) / (count - 1), at.contact_arc)

    if gravity is not None:
        way, rest = (np.linspace(0.0, 1.0, points) for points in (loaded, count - loaded + 1))
        s = jnp.append(arc * way, arc + (whisker.length - arc) * rest[1:])
        (r, _), _ = _under_weight(whisker, section, gravity, at, s, arc, loaded)
        return tuple(contact[:, None] + jnp.stack(r))

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


def _under_weight(
    whisker: Whisker, section: SpaceSection, gravity: Triple, at: Any, s: rod.Along, arc: Scalar, inner: int
) -> tuple[Any, SpaceLoad]:
    """States of a whisker with a weight, and loads on it, at increasing arc lengths; `inner` of them lie up to `arc`.

    Positions are relative to the contact, which takes up all of the force but the weight beyond, and no moment.
    """
    weight = weight_of_one(whisker, gravity)
    w, x, y, z = quaternion_of(at.base_rotation)
    contact = jnp.stack([at.contact_x, at.contact_y, at.contact_z])
    base = tuple(jnp.stack([at.base_x, at.base_y, at.base_z]) - contact)
    force = -at.fx, -at.fy, -at.fz
    start = base, (w, x, y, z)
    load = SpaceLoad(force, plus((-at.mx, -at.my, -at.mz), cross(base, force)))
    first, loads = weight.line(start, load, s[:inner], section)
    end, last = jax.tree.map(lambda leaf: leaf[-1], (first, loads))
    # On a free whisker, positions are not relative to a place without a moment.
    moment = jnp.stack(last.moment_at(end[0]))
    own = tuple(weight.total(section, arc, jnp.asarray(whisker.length)))
    beyond = SpaceLoad(own, plus((moment[0], moment[1], moment[2]), cross(end[0], own)))
    rest, loads_beyond = weight.line(end, beyond, jnp.append(arc, s[inner:]), section)
    join = (first, loads), (rest, loads_beyond)
    return jax.tree.map(lambda one, other: jnp.append(one, other[1:]), *join)


def bending_of(
    whisker: Whisker, at: Any, s: rod.Along, intervals: int, gravity: Triple | None = None
) -> tuple[Array, Array]:
    """Internal moments of one whisker in a state about d1, d2 and d3 at these arc lengths, and changes of curvature.

    Both are zero beyond the contact, unless whiskers have a weight. Integration steps end at the places, and between so
    many intervals.
    """
    section = space_section(whisker, 1.0, 1.0, heavy=gravity is not None)
    if gravity is not None:
        return _bending_under_weight(whisker, section, gravity, at, s, intervals)
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
    return with_change(section, s, jnp.where((touches & (s < arc))[:, None], moment, 0.0))


def _bending_under_weight(
    whisker: Whisker, section: SpaceSection, gravity: Triple, at: Any, s: rod.Along, intervals: int
) -> tuple[Array, Array]:
    arc = jnp.where(at.phase == Phase.free, whisker.length, at.contact_arc)
    length, zero = jnp.asarray(whisker.length, dtype=float), jnp.zeros(())
    ends = length * rod.step_ends(-length, section.in_plane, steps=intervals, from_base=zero)
    every = jnp.concatenate([ends, jnp.clip(s, 0.0, length)])
    order = jnp.argsort(every)
    # All places twice, once up to the contact and once from there on: how many lie on each side is not known.
    places = jnp.concatenate([jnp.minimum(every[order], arc), arc[None], jnp.maximum(every[order], arc)])
    (r, q), load = _under_weight(whisker, section, gravity, at, places, arc, every.size + 1)
    moment = jnp.stack(turned(inverse_rotation(q), load.moment_at(r)), axis=-1)
    inner, outer = moment[: every.size], moment[every.size + 1 :]
    moment = jnp.where((every[order] < arc)[:, None], inner, outer)[jnp.argsort(order)]
    return with_change(section, s, moment[ends.size :])


def with_change(section: SpaceSection, s: rod.Along, moment: Array) -> tuple[Array, Array]:
    """Internal moments at places, and the changes of curvature by them."""
    about_tangent = 1.0 if section.excess is None else 1 + section.excess
    sideways = 1.0 if section.lateral_ratio is None else 1 / section.lateral_ratio
    compliance = jax.vmap(section.compliance)(s)[:, None] * jnp.stack([sideways, 1.0, about_tangent])
    return moment, compliance * moment
