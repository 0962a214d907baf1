"""The line of a whisker in equilibrium: its direction, and the force in it, at the Gauss points of its elements."""

from typing import NamedTuple, TypeVar

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

Tree = TypeVar("Tree")
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
    contact: Scalar  # number of the element that ends at the contact


class Ends(NamedTuple):
    """Arc lengths at which the elements of a whisker end, and the numbers of elements that end at certain places."""

    arcs: Float[Array, " elements"]
    contact: Scalar  # number of the element that ends at the contact
    loads: Int[Array | np.ndarray, " loads"]  # at loads, or at springs on the shaft

    def at_loads(self, tree: Tree) -> Tree:
        """What is known at the loads or springs, as fields of all elements; zero for the others."""
        nothing = [(0, self.arcs.size - self.loads.size)]
        return jax.tree.map(lambda leaf: jnp.zeros_like(jnp.pad(leaf, nothing)).at[self.loads].set(leaf), tree)


def ends_of(body: Body, at: Equilibrium, loads: DeadLoads | None, breaks: rod.Along | None) -> Ends:
    """Where elements end: at loads, at springs on the shaft, at the contact, at the tip and at breaks.

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
    arcs = jnp.concatenate([places, jnp.stack(stops)])
    contact, number = places.size + len(stops) // 2 - 1, np.arange(places.size)
    if breaks is None:
        return Ends(arcs, jnp.asarray(contact), number)
    # Breaks come last where places coincide: a break at the tip would take its place.
    arcs = jnp.append(arcs, breaks)
    order = jnp.argsort(arcs)
    rank = jnp.argsort(order)
    return Ends(arcs[order], rank[contact], rank[number])


def _middle(body: Body, start: Scalar, stop: Scalar) -> Scalar:
    """Where to split a stretch: for a cone, the ratio of thicknesses is the same on both sides."""
    if body.section is None:
        return (start + stop) / 2
    assert isinstance(body.section, rod.Section)  # of one whisker
    stiffness = body.section.stiffness
    return start + (stop - start) * rod.graded(jnp.asarray(0.5), stiffness(start), stiffness(stop))


def line_of(body: Body, at: Equilibrium, ends: Ends, loads: DeadLoads | None) -> Line:
    """The line of a whisker, from its base to its tip."""
    material, (lengths, arcs) = material_of(body), node_arcs(ends.arcs)
    start = (at.base_x, at.base_y, -jnp.sin(at.base_angle), jnp.cos(at.base_angle))
    load = rod.Load(-at.fx, -at.fy, -at.mz - at.base_x * at.fy + at.base_y * at.fx)
    unloads = (jnp.arange(ends.arcs.size) == ends.contact) & (at.phase == Phase.tangential)
    dead, springs = None, None
    if loads is not None:
        dead = ends.at_loads(loads)
    elif body.sprung is not None:
        springs = ends.at_loads(jax.tree.map(lambda leaf: leaf[::-1], body.sprung.held_by.springs))
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
    each = ends.arcs - lengths, lengths, unloads, dead, springs
    _, (cos, sin, force_x, force_y, states) = jax.lax.scan(element, start, each)
    if isinstance(material, rod.Section):
        stiffness = jax.vmap(jax.vmap(material.stiffness))(arcs)
    else:
        stiffness = jnp.full(arcs.shape, body.bending_stiffness)
    return Line(lengths, cos, sin, force_x, force_y, stiffness, states, springs, ends.contact)


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
