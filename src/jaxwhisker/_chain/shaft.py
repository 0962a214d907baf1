"""The whole shaft of a whisker, from the tip to the base, at the ends of all integration steps."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import (
    ChainState,
    PerContact,
    Points,
    Segments,
    chain_of,
    fractions,
    segments,
    step_count,
)
from jaxwhisker._equilibrium.contact import WhiskerAtObject, material_of
from jaxwhisker._rod.rod import Load, RodStates, Section, graded, moment


class WholeShaft(NamedTuple):
    """Points of a shaft. The first segment lies beyond all contacts, each other one begins at a contact."""

    beyond: Points  # arc length of the whisker beyond a point
    x: Points
    y: Points
    cos: Points  # direction from base to tip
    sin: Points
    curvature: Points
    starts: Int[Array, " segments"]  # piece of the contact at which a segment begins, towards the base; -1 without one
    ends: Int[Array, " segments"]  # the same where it ends


class BaseAt(NamedTuple):
    """Where a base is in the scene, and its direction."""

    x: Scalar
    y: Scalar
    cos: Scalar
    sin: Scalar


class Pieces(NamedTuple):
    """All segments of a whisker: first the one beyond its contacts, from there outwards, then one from each contact."""

    start: RodStates  # fields (segments,)
    load: Load
    arc: Float[Array, " segments"]  # towards the base; negative outwards
    from_base: Float[Array, " segments"]  # arc length at the start


def pieces_of(body: WhiskerAtObject, chain: Segments, state: ChainState, base: BaseAt) -> Pieces:
    """All segments of a whisker with these contacts; a free one is integrated from its base on."""
    free, zero = ~state.touches[0], jnp.zeros(1)
    from_base = jnp.where(free, 0.0, body.length - chain.beyond[0])
    # Places that are not used are at the base.

    def with_first(at: Scalar, there: PerContact) -> Array:
        own = jnp.where(state.touches, there, at)
        return jnp.append(own[0], own)

    x, y, cos, sin = chain.start
    start = with_first(base.x, x), with_first(base.y, y), with_first(base.cos, cos), with_first(base.sin, sin)
    load = Load(
        *(jnp.append(zero, jnp.asarray(part)) for part in (chain.load.force_x, chain.load.force_y, chain.load.moment))
    )
    arc = jnp.append(from_base - body.length, chain.arc)
    return Pieces(start, load, arc, jnp.append(from_base, body.length - chain.beyond))


def shaft_of(body: WhiskerAtObject, chain: Segments, state: ChainState, base: BaseAt) -> WholeShaft:
    """The shaft of a whisker with these contacts."""
    starts, loads, arcs, from_base = pieces_of(body, chain, state, base)
    x, y, cos, sin = segments(body, starts, loads, arcs, from_base)
    beyond = body.length - (from_base[:, None] - _times(body, arcs, from_base) * arcs[:, None])
    bent = jnp.asarray(jax.vmap(moment)(x, y, loads))
    material = material_of(body)
    if isinstance(material, Section):
        curvature = jnp.asarray(jax.vmap(jax.vmap(material.total_curvature))(bent, body.length - beyond))
    else:
        curvature = bent / jnp.asarray(material)
    # The part beyond all contacts has been integrated outwards.
    points = WholeShaft(beyond, x, y, cos, sin, curvature, jnp.zeros(()), jnp.zeros(()))
    points = jax.tree.map(lambda leaf: leaf.at[0].set(leaf[0, ::-1]) if leaf.ndim else leaf, points)
    at_contact = jnp.where(state.touches, state.piece, -1)
    return points._replace(starts=jnp.append(-1, at_contact), ends=jnp.append(at_contact, -1))


def point_at(
    body: WhiskerAtObject, z: Float[Array, "contacts 3"], state: ChainState, base: BaseAt, beyond: Scalar
) -> Float[Array, "2"]:
    """The position of the point that has this arc length of the whisker beyond it."""
    pieces = pieces_of(body, chain_of(body, z, state), state, base)
    before = state.touches & (body.length - pieces.from_base[1:] <= beyond)
    own = jax.tree.map(lambda leaf: leaf[jnp.sum(before)][None], pieces)
    arc = own.from_base - (body.length - beyond)
    x, y, _, _ = segments(body, own.start, own.load, arc, own.from_base)
    return jnp.stack([x[0, -1], y[0, -1]])


def _times(body: WhiskerAtObject, arcs: Array, from_base: Array) -> Points:
    times, material = jnp.asarray(fractions(step_count(body))), material_of(body)
    if not isinstance(material, Section):
        return jnp.broadcast_to(times, (arcs.size, times.size))
    return jax.vmap(lambda arc, s: graded(times, material.stiffness(s), material.stiffness(s - arc)))(arcs, from_base)


class Cell(NamedTuple):
    """The shaft between two neighbouring points, as polynomials of degree 5 in t from 0 to 1, towards the base."""

    beyond: Scalar
    length: Scalar
    coefficients: Float[Array, "6 axes"]

    def point(self, t: Scalar) -> Float[Array, " axes"]:
        """Position at t."""
        value = self.coefficients[5]
        for k in range(4, -1, -1):
            value = value * t + self.coefficients[k]
        return value

    def direction(self, t: Scalar) -> Float[Array, " axes"]:
        """Derivative of the position by t: towards the base."""
        rate = 5 * self.coefficients[5]
        for k in range(4, 0, -1):
            rate = rate * t + k * self.coefficients[k]
        return rate


def cell_of(shaft: WholeShaft, segment: Int[Array, ""], k: Int[Array, ""]) -> Cell:
    """The cell between the points k and k + 1 of a segment."""
    here, there = (jax.tree.map(lambda leaf, j=j: leaf[segment, j], shaft[:6]) for j in (k, k + 1))
    h = there[0] - here[0]

    def jet(at):
        _, x, y, cos, sin, kappa = at
        bend = kappa * h**2
        return jnp.stack([x, y]), -h * jnp.stack([cos, sin]), bend * jnp.stack([-sin, cos])

    return cell_between(here[0], h, jet(here), jet(there))


Jet = tuple[Float[Array, " axes"], Float[Array, " axes"], Float[Array, " axes"]]  # position, and two derivatives by t


def cell_between(beyond: Scalar, length: Scalar, start: Jet, end: Jet) -> Cell:
    """The cell between two points."""
    (p, v, a), (q, w, b) = start, end
    d = q - p - v - a / 2
    e, f = w - v - a, b - a
    coefficients = [p, v, a / 2, 10 * d - 4 * e + f / 2, -15 * d + 7 * e - f, 6 * d - 3 * e + f / 2]
    return Cell(beyond, length, jnp.stack(coefficients))
