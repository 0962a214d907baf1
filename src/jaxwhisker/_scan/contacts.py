"""Whiskers with several contacts in a state: their fields, and their centre lines past all contacts.

A contact exerts the force f (sin alpha, -cos alpha) on the whisker. Beyond it, towards the tip, the load on the whisker
is smaller by this force and its moment. Beyond the outermost contact it is zero. Places that are not used have the arc
length 0 and no force, and change nothing.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._rod.walk import in_order, pressed, walk
from jaxwhisker._scan.quantities import is_of_contacts
from jaxwhisker._scan.springs import at_base
from jaxwhisker._scan.state import FRICTION, State, base_of, material


def has_several(state: Any) -> bool:
    """Whether whiskers may have several contacts: whether contact fields have a last axis for them."""
    return np.ndim(state.phase) > np.ndim(state.fx)


def check_one_contact(name: str, value: Any) -> None:
    """Check that the whiskers of a scene, a state, a result or its Dataset have at most one contact each.

    Raises:
        ValueError: if they may have several; it names the argument.
    """
    contacts = getattr(value, "contacts", getattr(value, "sizes", {}).get("contact", 1))
    if isinstance(value, State) and has_several(value):
        contacts = np.shape(value.phase)[-1]
    if contacts > 1:
        checks.fail(name, "one whose whiskers have at most one contact each", f"one with contacts={contacts}")


def of_whisker(state: State, whisker: int) -> State:
    """The fields of one whisker, counted from 0."""
    at = (*[slice(None)] * (state.fx.ndim - 1), whisker)
    return jax.tree.map(lambda leaf: leaf[at], state)


def with_axis_of_contacts(state: State) -> State:
    """A state of whiskers that have one contact each, as one of those that may have several."""
    fields = {name: getattr(state, name) for name in State.__dataclass_fields__}
    own = {name: field[..., None] for name, field in fields.items() if is_of_contacts(name) and field is not None}
    return State(**fields | own)


def past_contacts(
    whisker: Whisker, at: State, s: Float[Array, " points"]
) -> tuple[rod.RodStates, Float[Array, " points"]]:
    """States of the rod at arc lengths in any order, and the internal moments there.

    Args:
        whisker: the whisker.
        at: its state: numbers, and fields of contacts of shape (contacts,).
        s: arc lengths from the base.
    """
    start, load = at_base(base_of(at), (at.fx, at.fy, at.mz))
    cos, sin = jnp.cos(at.contact_slope), jnp.sin(at.contact_slope)
    force_x, force_y = at.contact_force * sin, -at.contact_force * cos
    _, normal, along = (getattr(at, name) for name in FRICTION)
    if normal is not None:
        force_x, force_y = normal * sin + along * cos, along * sin - normal * cos
    touches = (jnp.arange(at.contact_arc.size) == 0) & (at.contact_arc[0] > 0)
    own = touches, pressed((at.contact_x, at.contact_y), force_x, force_y)
    # Steps end at all points and at all contacts.
    order = in_order(s, at.contact_arc, outwards=True)

    def onwards(state, load, s, stop):
        # A negative arc integrates away from the base.
        state = rod.integrate(state, s - stop, load, material(whisker), steps=1, from_base=s)
        return state, load, jnp.asarray(rod.moment(*state[:2], load))

    def past(load, state, contact):
        outermost, push = contact
        # Exactly zero: a pointed tip has no stiffness.
        return jax.tree.map(lambda a, b: jnp.where(outermost, 0.0, a - b), load, push)

    walked = walk(onwards, past, start, load, order.at, order.spread(1, own), s=jnp.zeros(()))
    return jax.tree.map(lambda leaf: leaf[order.ranks[0]], (walked.passed, walked.ways))
