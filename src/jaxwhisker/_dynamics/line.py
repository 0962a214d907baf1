"""The line of a whisker in equilibrium: its direction, and the force in it, at the Gauss points of its elements."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.elements import POINTS, node_arcs
from jaxwhisker._equilibrium.contact import Body, Phase, material_of
from jaxwhisker._equilibrium.shaft_springs import ShaftSprings, past
from jaxwhisker._rod import rod
from jaxwhisker._rod.foundation import integrate_on

AT = np.concatenate([[0.0], POINTS, [1.0]])


class Equilibrium(NamedTuple):
    """A whisker in equilibrium, dimensionless; or all whiskers, stacked. Contact fields are those of a State."""

    base_x: Float[Array, "*batch"]
    base_y: Float[Array, "*batch"]
    base_angle: Float[Array, "*batch"]
    fx: Float[Array, "*batch"]
    fy: Float[Array, "*batch"]
    mz: Float[Array, "*batch"]
    contact_force: Float[Array, "*batch"]  # along the normal
    contact_slope: Float[Array, "*batch"]
    contact_arc: Float[Array, "*batch"]
    contact_x: Float[Array, "*batch"]
    contact_y: Float[Array, "*batch"]
    phase: Int[Array, "*batch"]
    contact_object: Int[Array, "*batch"] | None = None  # None with a single object


class DeadLoads(NamedTuple):
    """Forces and moments that keep their directions, from the base to the tip, at the ends of elements."""

    position: Float[Array, "*batch loads"]
    force_x: Float[Array, "*batch loads"]
    force_y: Float[Array, "*batch loads"]
    moment: Float[Array, "*batch loads"]


class Line(NamedTuple):
    """The line of a whisker on its elements."""

    lengths: Float[Array, " elements"]
    cos: Float[Array, "elements points"]  # of its direction
    sin: Float[Array, "elements points"]
    force_x: Float[Array, "elements points"]  # of everything beyond on the whisker
    force_y: Float[Array, "elements points"]
    stiffness: Float[Array, "elements points"]
    ends: rod.RodStates  # states at the ends of the elements
    springs: ShaftSprings | None  # at these ends; those at the base and below have no share


def beyond(body: Body) -> int:
    """Number of elements beyond the contact, which end the list of elements."""
    return 1 if body.section is None else 2


def ends_of(body: Body, at: Equilibrium, loads: DeadLoads | None) -> Float[Array, " elements"]:
    """Arc lengths at which elements end: at loads, at springs on the shaft, at the contact and at the tip.

    A whisker without tangential contact is split anywhere instead. Whiskers that are not uniform are split twice more:
    the closer to the tip of a cone, the shorter its elements must be.
    """
    places = jnp.zeros(0)
    if loads is not None:
        places = loads.position
    elif body.sprung is not None:
        places = jnp.maximum(body.sprung.held_by.springs.at[::-1], 0.0)
    top = places[-1] if places.size else jnp.zeros(())
    split = jnp.where(at.phase == Phase.tangential, at.contact_arc, _middle(body, top, body.length))
    stops = [split, body.length]
    if body.section is not None:
        stops = [_middle(body, top, split), split, _middle(body, split, body.length), body.length]
    return jnp.concatenate([places, jnp.stack(stops)])


def _middle(body: Body, start: Scalar, stop: Scalar) -> Scalar:
    """Where to split a stretch: for a cone, the ratio of thicknesses is the same on both sides."""
    if body.section is None:
        return (start + stop) / 2
    assert isinstance(body.section, rod.Section)  # of one whisker
    stiffness = body.section.stiffness
    return start + (stop - start) * rod.graded(jnp.asarray(0.5), stiffness(start), stiffness(stop))


def line_of(body: Body, at: Equilibrium, ends: Float[Array, " elements"], loads: DeadLoads | None) -> Line:
    """The line of a whisker, from its base to its tip."""
    material, (lengths, arcs) = material_of(body), node_arcs(ends)
    start = (at.base_x, at.base_y, -jnp.sin(at.base_angle), jnp.cos(at.base_angle))
    load = rod.Load(-at.fx, -at.fy, -at.mz - at.base_x * at.fy + at.base_y * at.fx)
    unloads = (jnp.arange(ends.size) == ends.size - 1 - beyond(body)) & (at.phase == Phase.tangential)
    dead, springs = None, None
    if loads is not None:
        dead = jax.tree.map(lambda leaf: jnp.pad(leaf, (0, ends.size - leaf.size)), loads)
    elif body.sprung is not None:
        springs = body.sprung.held_by.springs
        springs = jax.tree.map(lambda leaf: jnp.pad(leaf[::-1], (0, ends.size - leaf.size)), springs)
        # The reaction is that of everything at the base and below.
        springs = springs._replace(share=jnp.where(springs.at > 0, springs.share, 0.0))

    def element(carry, here):
        (state, load), (first, length, unloaded, dead, spring) = carry, here
        states, inside = _through(body, state, load, first, length, material)
        end, load = jax.tree.map(lambda values: values[-1], (states, inside))
        if dead is not None:
            about = dead.moment + end[0] * dead.force_y - end[1] * dead.force_x
            load = rod.Load(load.force_x - dead.force_x, load.force_y - dead.force_y, load.moment - about)
        if spring is not None:
            assert body.sprung is not None
            load = past(load, spring, body.laws, end, body.sprung.drive, -1.0)
        load = jax.tree.map(lambda part: jnp.where(unloaded, 0.0, part), load)
        _, _, cos, sin = states
        forces = jnp.asarray(inside.force_x), jnp.asarray(inside.force_y)
        return (end, load), (*(values[1:-1] for values in (cos, sin, *forces)), end)

    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float), (start, load))
    each = ends - lengths, lengths, unloads, dead, springs
    _, (cos, sin, force_x, force_y, states) = jax.lax.scan(element, start, each)
    if isinstance(material, rod.Section):
        stiffness = jax.vmap(jax.vmap(material.stiffness))(arcs)
    else:
        stiffness = jnp.full(arcs.shape, body.bending_stiffness)
    return Line(lengths, cos, sin, force_x, force_y, stiffness, states, springs)


def _through(
    body: Body, state: rod.RodState, load: rod.Load, first: Scalar, length: Scalar, material: rod.Material
) -> tuple[rod.RodStates, rod.Load]:
    """States and loads at the start of an element, at its Gauss points and at its end."""
    tissue = None if body.sprung is None else body.sprung.held_by.tissue
    if tissue is None:
        # A negative arc integrates away from the base.
        states = rod.points(state, -length, load, material, at=jnp.asarray(AT), from_base=first)
        return states, jax.tree.map(lambda part: jnp.full(AT.shape, part), load)
    assert body.sprung is not None
    drive, on = body.sprung.drive, tissue._replace(stiffness=tissue.share(first + length / 2) * tissue.stiffness)

    def step(carry, ends):
        (state, load), (start, stop) = carry, first + length * ends
        carry = integrate_on(
            state, load, start - stop, material, lambda *at: on.density(drive, *at), steps=1, from_base=start
        )
        return carry, carry

    _, later = jax.lax.scan(step, (state, load), jnp.stack([AT[:-1], AT[1:]], axis=1))
    return jax.tree.map(lambda start, rest: jnp.concatenate([start[None], rest]), (state, load), later)
