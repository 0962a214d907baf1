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
    """States of the rod at increasing arc lengths, and the internal moments there.

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
    own = jnp.stack([force_x, force_y, at.contact_x * force_y - at.contact_y * force_x])
    # Steps end at all points and at all contacts.
    ends = jnp.append(s, at.contact_arc)
    order = jnp.argsort(jax.lax.stop_gradient(ends))
    ends = ends[order]
    begins = jnp.append(0.0, ends[:-1])
    passed = jnp.append(jnp.zeros((3, s.size)), own, axis=1)[:, order]
    passed = jnp.cumsum(passed, axis=1) - passed
    touches = (jnp.arange(ends.size) == s.size)[order] & (at.contact_arc[0] > 0)
    unloaded = jnp.cumsum(touches) - touches > 0  # exactly: a pointed tip has no stiffness
    whole = jnp.stack([jnp.asarray(part) for part in (load.force_x, load.force_y, load.moment)])
    rest = jnp.where(unloaded, 0.0, whole[:, None] - passed)

    def step(state: rod.RodState, over):
        begin, end, load = over
        # A negative arc integrates away from the base.
        state = rod.integrate(state, begin - end, rod.Load(*load), material(whisker), steps=1, from_base=begin)
        return state, (state, jnp.asarray(rod.moment(*state[:2], rod.Load(*load))))

    _, found = jax.lax.scan(step, jax.tree.map(jnp.asarray, start), (begins, ends, rest.T))
    return jax.tree.map(lambda leaf: leaf[jnp.argsort(order)[: s.size]], found)
