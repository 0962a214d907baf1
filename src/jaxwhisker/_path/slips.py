"""Slips: which contacts slip and which stick, where a path leaves an event.

Along the path, contacts that slip must not turn back, and the lean of those that stick must not grow beyond its limit.
Contacts that break this are changed one after the other until none does; the first of them is changed first, which
cannot run in circles if the motion is unique (Murty, Linear Complementarity, Linear and Nonlinear Programming, 1988,
chapter 5).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import FORCE
from jaxwhisker._equilibrium.friction import LIGHT, Friction
from jaxwhisker._equilibrium.point import Contacts, Point
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.path import NO_EVENT, EventKind, Node, select

RATE_NOISE = 1e-9  # rate, per length of the path, that rounding may cause
LEAN_NOISE = 1e-6  # largest error of the lean of a contact that sticks with hardly any force

PerContact = Float[Array, " contacts"]
Truths = Bool[Array, " contacts"]


class LeavingContacts(NamedTuple):
    """How contacts are, and how they move along the path that leaves an event."""

    slip: Int[Array, " contacts"]
    force: PerContact
    lean: PerContact
    lean_rate: PerContact  # of contacts that stick
    slip_rate: PerContact  # in the direction of slip; infinite for others
    sticks: Truths
    slips_either_way: Truths  # whether a contact may slip either way: not a tip in an inner corner
    light: Truths  # whether a contact sticks with too small a force for its lean to be known


def corrected_slips(
    contacts: LeavingContacts, limit: Scalar, falls: Bool[Array, ""], tried: Int[Array, ""], rests: Truths
) -> tuple[Bool[Array, ""], Int[Array, " contacts"]]:
    """Whether a contact breaks a law of friction, and the slips after the first such contact is changed.

    Args:
        contacts: all contacts.
        limit: the angle of friction.
        falls: whether the path cannot go on without a snap.
        tried: how often slips have been changed at this event.
        rests: whether the slip of a contact has come to rest here, so that its lean does not change at first.
    """
    slip, leans = contacts.slip, contacts.lean
    # A contact that has just begun may slip either way or, if neither presses on, stick.
    unloaded = (slip != 0) & (contacts.force <= LIGHT)
    backwards = (contacts.slip_rate < -RATE_NOISE) | (contacts.slips_either_way & unloaded & falls & (limit > 0))
    exceeds = (jnp.abs(leans) > limit - RATE_NOISE) & (jnp.sign(leans) * contacts.lean_rate > RATE_NOISE)
    # A contact that sticks from its first touch may have a lean that no friction allows.
    beyond = jnp.abs(leans) >= limit + LEAN_NOISE
    exceeds = contacts.sticks & ~rests & (exceeds | (beyond & contacts.light))
    can_stick = (~unloaded | (tried > 0)) & (limit > 0)
    changed = jnp.where(exceeds, jnp.sign(leans).astype(int), jnp.where(can_stick, 0, -slip))
    wrong = backwards | exceeds
    first = wrong & (jnp.cumsum(wrong) == 1)
    return jnp.any(wrong), jnp.where(first, changed, slip)


def first_leans(
    by_contact: Contacts, slip: Int[Array, " contacts"], limit: Scalar, direction: Scalar, tangent: Point, other: Point
) -> tuple[Truths, PerContact]:
    """Leans of contacts that stick from their first touch, where neither slip is possible; and whether they are known.

    At vanishing force the equations are linear. The path with a contact that sticks is therefore that combination of
    the paths with slips in both directions in which the contact does not slip.

    Args:
        by_contact: derivatives of the distances slipped by the numbers of contacts.
        slip: the present slips.
        limit: the angle of friction.
        direction: of the drive.
        tangent: of the path with the present slips.
        other: of the path with the slips tried before.
    """
    rate, other_rate = (jnp.sum(by_contact * one.z, axis=-1) for one in (tangent, other))
    force, other_force = other_rate * tangent.z[:, FORCE], -rate * other.z[:, FORCE]
    onwards = jnp.where(direction * (other_rate * tangent.u - rate * other.u) < 0, -1.0, 1.0)
    across = slip * jnp.sin(limit) * (force - other_force)
    along = jnp.cos(limit) * (force + other_force)
    return onwards * along > 0, jnp.arctan2(onwards * across, onwards * along)


def leaving_with(
    march: Any, node: Node, z: Contacts, friction: Friction, arriving: Point, *, rest: bool
) -> tuple[Any, Truths]:
    """The state at a node, before the direction in which the path leaves with this friction is determined.

    Args:
        march: the state of the march, at the node.
        node: the node, with the slips before.
        z: the numbers of contacts with the new slips.
        friction: the new slips.
        arriving: direction of the path before.
        rest: whether the slips that change have come to rest, so that the path goes on without a corner.

    Returns:
        The state, and which slips have changed.
    """
    before, fresh = march.state.friction, march.slips_tried == 0
    # Slips at an event are changed after the event itself.
    z_before = jnp.where(fresh, node.point.z, march.pending.z_before)
    friction_before = select(fresh, before, march.pending.before.friction)
    sticking, differ = friction.slip == 0, friction.slip != friction_before.slip
    sticks, begins = differ & sticking, differ & (friction_before.slip == 0)
    kind = jnp.where(jnp.any(sticks), EventKind.stick, jnp.where(jnp.any(begins), EventKind.slip, NO_EVENT))
    pending = node._replace(
        point=node.point._replace(z=z),
        z_before=z_before,
        arriving=arriving,
        state=node.state._replace(friction=friction),
        before=march.state._replace(friction=friction_before),
        kind=kind,
        whiskers=sticks | begins,
        corner=jnp.asarray(True),
    )
    changes = friction.slip != before.slip
    return march.replace(
        task=jnp.asarray(int(Task.arrive)),
        state=march.state._replace(friction=friction),
        point=pending.point,
        pending=pending,
        slips_tried=march.slips_tried + 1,
        rests=changes & sticking if rest else march.rests,
    ), changes


def lead_of(
    march: Any,
    changes: Truths,
    before: Int[Array, " contacts"],
    light: Truths,
    of_lean: Bool[Array, "contacts 3"],
    by_contact: Contacts,
    *,
    rest: bool,
) -> Point:
    """Derivatives of what must grow where the path leaves with changed slips.

    Args:
        march: the state with these slips.
        changes: which slips have changed.
        before: the slips before.
        light: whether a contact sticks with too small a force for its lean to be known.
        of_lean: which number of a contact that sticks is its lean.
        by_contact: derivatives of the distances slipped by the numbers of contacts.
        rest: whether the slips that change have come to rest.
    """
    slip, arriving = march.state.friction.slip, march.pending.arriving
    if rest:
        # A lean does not change at first; all else goes on as before.
        return Point(jnp.where(changes[:, None] & of_lean, 0.0, arriving.z), arriving.u)
    inwards = jnp.where(light[:, None], jnp.arange(3) == FORCE, -before[:, None] * of_lean)
    each = jnp.where((slip == 0)[:, None], inwards, slip[:, None] * by_contact)
    return Point(jnp.where(changes[:, None], each, 0.0), jnp.asarray(0.0))
