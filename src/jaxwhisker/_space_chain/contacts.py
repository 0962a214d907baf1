"""One whisker in space and its contacts: a chain of rod segments, each from one contact towards the base to the next.

A contact has the eleven numbers of a whisker with a single one (see contact.py of space): force, roll, slack, contact
point, direction along the surface, and traction. They determine where the whisker is there, and how it is turned.
Contacts are ordered from the tip to the base, and places that are not used follow. Only the outermost contact may be at
the tip; the slack of all others is the arc length of the whisker beyond them.

Each segment is integrated from its contact, under the forces of this contact and of all beyond. At its other end, it
must meet the next contact, with the same position and rotation, or it ends at the base. These are six equations for
each contact; three more keep its point and direction on the surface, and two are the law of its traction. Between
contacts a straight round rod carries no twisting moment, but it does not stay in one plane: all rods have a roll here.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.rotation import matrix_of, rotation_vector
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._rod.elastica import AbstractRod, Shooting
from jaxwhisker._rod.space import SpaceSection
from jaxwhisker._rod.space_end import contact_rotation
from jaxwhisker._rod.space_segment import segment_end
from jaxwhisker._space.contact import FORCE, POINT, ROLL, SLACK, TRACTION, SpaceBase, SpaceWhisker, frame_of
from jaxwhisker._space.free import contact_at

Rows = Float[Array, "contacts 11"]
Vectors = Float[Array, "contacts 3"]
Matrices = Float[Array, "contacts 3 3"]
PhaseRows = Int[Array, " contacts"]


class SegmentsInSpace(NamedTuple):
    """A whisker from its contacts on, in the frame of the scene."""

    position: Vectors  # of the contacts
    frame: Matrices  # along the surface towards the tip, across, and outwards; as columns
    rotation: Matrices  # of the whisker there
    force: Vectors  # of this contact and all beyond
    moment: Vectors  # of these forces about the contact
    beyond: Float[Array, " contacts"]  # arc length of the whisker beyond the contact; all of it for unused places
    arc: Float[Array, " contacts"]  # length of the segment


def last_used(touches: Bool[Array, " contacts"]) -> Bool[Array, " contacts"]:
    """One-hot: the contact that is nearest to the base; none of a free whisker."""
    return touches & ~jnp.append(touches[1:], False)


def at_rest(surface: AbstractSurface, point: Float[Array, "3"]) -> Float[Array, "11"]:
    """Numbers of a place that is not used, at a point outside of all objects."""
    out = surface.normal(point)
    return jax.lax.stop_gradient(contact_at(point, out, out, None, jnp.zeros(())))


def chain_of(
    body: SpaceWhisker, surface: AbstractSurface, z: Rows, phase: PhaseRows, unused: Float[Array, "11"]
) -> SegmentsInSpace:
    """The segments of a whisker with these contacts; `unused` are numbers of places that are not used."""
    touches, tip = phase != Phase.free, phase == Phase.tip
    z = jnp.where(touches[:, None], z, unused)
    frame = jax.vmap(lambda z: frame_of(surface, z))(z)
    angle = jnp.where(tip, -z[:, SLACK], 0.0)
    own = jax.vmap(lambda angle, roll: matrix_of(contact_rotation(angle, roll)))(angle, z[:, ROLL])
    pushes = jnp.stack([z[:, TRACTION.start], z[:, TRACTION.start + 1], z[:, FORCE]], axis=1)
    force = jnp.where(touches[:, None], jnp.sum(frame * pushes[:, None, :], axis=2), 0.0)
    position = z[:, POINT]
    about = jnp.cumsum(jnp.cross(position, force), axis=0)
    total = jnp.cumsum(force, axis=0)
    beyond = jnp.where(touches, jnp.where(tip, 0.0, z[:, SLACK]), body.length)
    return SegmentsInSpace(
        position,
        frame,
        _products(frame, own),
        total,
        about - jnp.cross(position, total),
        beyond,
        jnp.append(beyond[1:], body.length) - beyond,
    )


def step_count(body: SpaceWhisker, method: AbstractRod) -> int:
    """Number of integration steps of a segment."""
    assert isinstance(method, Shooting) and isinstance(body.section, SpaceSection)  # checked by SpaceScene
    return method.steps if body.section.uniform else 2 * method.steps


def at_ends(
    body: SpaceWhisker, method: AbstractRod, chain: SegmentsInSpace, rates: AbstractRod
) -> tuple[Vectors, Matrices]:
    """Positions and rotations at the ends of all segments."""
    steps, more = step_count(body, method), step_count(body, rates)

    def one(position, rotation, force, moment, beyond, arc):
        back = rotation.T
        load = jnp.concatenate([_turned(back, force), _turned(back, moment)])
        end = segment_end(load, arc, body.length - beyond, body.section, steps, more)
        return position + _turned(rotation, end[:3]), _product(rotation, matrix_of(end[3:]))

    return jax.vmap(one)(chain.position, chain.rotation, chain.force, chain.moment, chain.beyond, chain.arc)


class ChainAtBase(NamedTuple):
    """Where a chain of segments ends."""

    meets: Float[Array, "contacts 6"]  # by how much the end of each segment misses the next contact
    base: SpaceBase
    backwards: Bool[Array, ""]  # whether a segment has a negative length, or turns the wrong way round at a contact
    chain: SegmentsInSpace


def base_of_chain(
    body: SpaceWhisker,
    surface: AbstractSurface,
    method: AbstractRod,
    z: Rows,
    phase: PhaseRows,
    unused: Float[Array, "11"],
    rates: AbstractRod | None = None,
) -> ChainAtBase:
    """The base of a whisker with these contacts; of a free one, anything.

    Args:
        body: the whisker.
        surface: the objects.
        method: computes the rod.
        z: the contacts.
        phase: their phases.
        unused: numbers of places that are not used.
        rates: computes derivatives of the rod. Default: as `method`.
    """
    chain = chain_of(body, surface, z, phase, unused)
    position, rotation = at_ends(body, method, chain, method if rates is None else rates)
    touches, last = phase != Phase.free, last_used(phase != Phase.free)
    inner = touches & ~last
    off = position - jnp.roll(chain.position, -1, axis=0)
    turns = jax.vmap(lambda one, other: _product(one.T, other))(jnp.roll(chain.rotation, -1, axis=0), rotation)
    turns = jnp.where(inner[:, None, None], turns, jnp.eye(3))
    meets = jnp.concatenate([off, jax.vmap(rotation_vector)(turns)], axis=1)

    def of_last(values: Array) -> Array:
        return jnp.sum(jnp.where(last.reshape(-1, *[1] * (values.ndim - 1)), values, 0.0), axis=0)

    force, base = of_last(chain.force), of_last(position)
    moment = of_last(chain.moment) + jnp.cross(of_last(chain.position) - base, force)
    turned_by = jnp.where(jnp.any(last), of_last(rotation), jnp.eye(3))
    wrong = inner & ((turns[:, 2, 2] <= 0) | (chain.arc <= 0))
    wrong |= last & (chain.arc <= 0)
    return ChainAtBase(meets, SpaceBase(base, turned_by[:, 2], turned_by, force, moment), jnp.any(wrong), chain)


def _turned(matrix: Float[Array, "3 3"], vector: Float[Array, "3"]) -> Float[Array, "3"]:
    # Sums: XLA compiles small products of matrices in batches to slow loops.
    return jnp.sum(matrix * vector, axis=1)


def _product(a: Float[Array, "3 3"], b: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    return jnp.sum(a[:, :, None] * b, axis=1)


def _products(a: Matrices, b: Matrices) -> Matrices:
    return jnp.sum(a[:, :, :, None] * b[:, None], axis=2)
