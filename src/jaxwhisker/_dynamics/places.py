"""Places where a moving whisker that may have several contacts is close to objects.

Along the shaft, the gap to an object has a minimum at each contact. All other minima, and the tip, are candidates for
new contacts, as in scans. At the end of every step they are looked for anew: the places of a whisker are its contacts
and, as far as there is room, the candidates with the smallest gaps. In a step, each place follows its minimum; where
the gap closes, it becomes a contact.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.gaps import gaps_of
from jaxwhisker._chain.shaft import WholeShaft
from jaxwhisker._dynamics.features import gap_on, next_piece, slips_off, with_tips_at_faces
from jaxwhisker._dynamics.gap import Gap
from jaxwhisker._dynamics.legendre import Basis, weights_at
from jaxwhisker._dynamics.motion_state import Moving, Touching, posed
from jaxwhisker._dynamics.moving import System
from jaxwhisker._dynamics.outline import ObjectChain
from jaxwhisker._dynamics.time_step import unknowns_of
from jaxwhisker._equilibrium.contact import PARAMETER, SLACK, Phase

NEAR = 0.05  # lengths: places with a larger gap are not followed in a step
DIGITS = 9  # of the length: contacts with the same ones are in one place
MATCHES = 0.01  # lengths, of gaps and along the whisker: places this close to given contacts are these
STEPS = 20  # cells of the shaft between two contacts
FRACTIONS = (1 - np.cos(np.pi * np.arange(STEPS + 1) / STEPS)) / 2


class Places(NamedTuple):
    """Places of one whisker that may become contacts, and contacts; or those of all whiskers, stacked."""

    arc: Float[Array, "*whiskers contacts"]  # fraction of the length
    parameter: Float[Array, "*whiskers contacts"]  # of the outline
    piece: Int[Array, "*whiskers contacts"]
    away: Bool[Array, "*whiskers contacts"]  # neither close to an object nor a contact
    distance: Float[Array, "*whiskers"]  # of the whisker from all objects, in lengths of the first one
    without: Float[Array, "*whiskers"]  # least gap where there is no room for another place


class Touched(NamedTuple):
    """Contacts of one whisker."""

    arc: Float[Array, " contacts"]
    parameter: Float[Array, " contacts"]
    piece: Int[Array, " contacts"]
    touches: Bool[Array, " contacts"]
    at_tip: Bool[Array, " contacts"]


def places_of(system: System, length: Scalar, base: Array, angle: Array, contacts: Touched) -> Places:
    """The places of one whisker with these contacts, without derivatives."""
    profile, touches = system.profile, contacts.touches
    assert isinstance(profile, ObjectChain) and profile.placeholder_parameter is not None
    shaft = _shaft(system.basis, length, base, angle, contacts)
    found = gaps_of(profile, shaft, length)
    new = found.candidates
    if profile.has_edges:
        new = with_tips_at_faces(profile, new, shaft)
    shift = jnp.stack([jnp.asarray(shift) for shift in profile.shift])
    number = profile.object_of(new.piece)
    assert number is not None
    arc = jnp.where(new.phase == Phase.tip, 1.0, 1 - new.numbers[:, SLACK] / length)
    parameter = new.numbers[:, PARAMETER] + shift[number]
    # A shaft that is just inside a face may be deep behind the next corner, which it does not touch.
    gaps = jnp.where(new.gap > -NEAR, new.gap, jnp.inf)
    order = jnp.argsort(gaps)
    least = jnp.append(gaps[order], jnp.full(touches.size + 1, jnp.inf))
    order = jnp.append(order, jnp.zeros(touches.size, int))
    rank = jnp.cumsum(~touches) - 1  # of places that are free
    near = ~touches & (least[rank] < NEAR)
    placeholder = profile.placeholder_parameter[0] + shift[0]
    outside = jnp.where(touches, jnp.inf, least[rank])
    return Places(
        arc=jnp.where(touches, contacts.arc, jnp.where(near, arc[order[rank]], 1.0)),
        parameter=jnp.where(touches, contacts.parameter, jnp.where(near, parameter[order[rank]], placeholder)),
        piece=jnp.where(touches, contacts.piece, jnp.where(near, new.piece[order[rank]], 0)),
        away=~touches & ~near,
        distance=jnp.minimum(found.distance, jnp.min(outside)),
        without=least[jnp.sum(~touches)],
    )


def _shaft(basis: Basis, length: Scalar, base: Array, angle: Array, contacts: Touched) -> WholeShaft:
    """Points of a whisker, from the tip to the base, in segments between its contacts."""
    from_tip = jnp.where(contacts.touches, jnp.where(contacts.at_tip, 0.0, 1 - contacts.arc), 1.0)
    order = jnp.argsort(from_tip)
    piece = jnp.where(contacts.touches, contacts.piece, -1)[order]
    starts, ends = jnp.append(0.0, from_tip[order]), jnp.append(from_tip[order], 1.0)
    beyond = starts[:, None] + FRACTIONS * (ends - starts)[:, None]
    turned = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)

    def at(beyond):
        def line(arc):
            return weights_at(basis, arc) @ turned

        arc = 1 - beyond
        (direction, way), (bend, _) = jax.jvp(line, (arc,), (jnp.ones_like(arc),))
        x, y = base[:2] + length * way
        cos, sin = direction / jnp.linalg.norm(direction)
        return x, y, cos, sin, (cos * bend[1] - sin * bend[0]) / length

    x, y, cos, sin, curvature = jax.vmap(jax.vmap(at))(beyond)
    return WholeShaft(length * beyond, x, y, cos, sin, curvature, jnp.append(-1, piece), jnp.append(piece, -1))


def with_places(system: System, moving: Moving) -> Moving:
    """The state with the places of all whiskers, at the end of a step."""
    rod, at = moving.rod, moving.rod.touching
    assert at is not None
    assert isinstance(system.profile, ObjectChain) and at.piece is not None
    piece = at.piece
    if system.profile.has_edges:
        # A contact that slips off lasts until the end of the step, in which its force does no work.
        off = slips_off(system.profile, piece, at.arc, at.parameter)
        force, drag = (jnp.where(off, 0.0, values) for values in (at.force, at.drag))
        at = at._replace(touches=at.touches & ~off, force=force, drag=drag)
        piece = next_piece(system.profile, piece, at.parameter)
    contacts = Touched(at.arc, at.parameter, piece, at.touches, at.gap.at_tip > 0)
    fixed, *known = jax.lax.stop_gradient((system, system.rods.length, rod.base, rod.angle, contacts))
    found = jax.vmap(lambda *own: places_of(fixed, *own))(*known)
    # Contacts keep their derivatives. Places without contact have none.
    arc, parameter = (
        jnp.where(at.touches, own, place) for own, place in ((at.arc, found.arc), (at.parameter, found.parameter))
    )
    last = unknowns_of(system, moving.change[0])
    change = jnp.where(at.touches[..., None], system.by_contact(last.contact), 0.0)
    last = last._replace(contact=change.reshape(last.contact.shape))
    touching = at._replace(
        arc=arc,
        parameter=parameter,
        gap=gaps_at(system, rod.base, rod.angle, found.piece, arc, parameter),
        piece=found.piece,
        deepest=found.without,
        away=found.away,
        distance=found.distance,
    )
    return moving._replace(rod=rod._replace(touching=touching), change=moving.change.at[0].set(last.flat()))


def gaps_at(system: System, base: Array, angle: Array, piece: Array, arc: Array, parameter: Array) -> Gap:
    """Gaps of all whiskers at their places."""

    def one(length, base, angle, *places):
        here = posed(system, length, base, angle)
        return jax.vmap(lambda *place: gap_on(here, *place))(*places)

    return jax.vmap(one)(system.rods.length, base, angle, piece, arc, parameter)


def places_at(
    system: System, base: Array, angle: Array, given: tuple[Float[Array, "*contacts"], Bool[Array, "*contacts"]] | None
) -> Touching:
    """The places of whiskers at rest. Those near given contacts, which are fractions of the length, touch."""
    fixed, *poses = jax.lax.stop_gradient((system, system.rods.length, base, angle))
    none = jnp.zeros(system.contact_shape)
    contacts = Touched(none, none, none.astype(int), none > 0, none > 0)

    def find(contacts):
        return jax.vmap(lambda *own: places_of(fixed, *own))(*poses, contacts)

    def known(_, contacts):
        # Of each object the closest place beside its contacts is found: one after the other.
        found = find(contacts)
        assert given is not None
        arc, touches = given
        near = jnp.any((jnp.abs(found.arc[:, :, None] - arc[:, None]) < MATCHES) & touches[:, None], axis=-1)
        gap = gaps_at(fixed, base, angle, found.piece, found.arc, found.parameter)
        near &= ~found.away & (jnp.abs(gap.distance) < MATCHES)
        return Touched(found.arc, found.parameter, found.piece, near, near & (gap.at_tip > 0))

    if given is not None:
        contacts = jax.lax.fori_loop(0, system.contacts, known, contacts)
    found = find(contacts)
    gap = gaps_at(system, base, angle, found.piece, found.arc, found.parameter)
    beside = {"piece": found.piece, "away": found.away, "distance": found.distance}
    still = none, none, contacts.touches, none.astype(int), contacts.touches
    return Touching(found.arc, found.parameter, gap, *still, found.without, **beside)


def from_the_tip(touching: Touching, fields: dict[str, Array]) -> dict[str, Array]:
    """Fields (samples, whiskers, contacts) of places, ordered from the tip to the base; zero without contact."""
    arc, parameter = jax.lax.stop_gradient((touching.arc, touching.parameter))
    # A tip in an inner corner has two contacts: in the order of the outline.
    order = jnp.lexsort((parameter, jnp.where(touching.touches, -jnp.round(arc, DIGITS), 1.0)), axis=-1)

    def ordered(values):
        return jnp.take_along_axis(jnp.where(touching.touches, values, jnp.zeros_like(values)), order, axis=-1)

    return {name: ordered(values) for name, values in fields.items()}
