"""The line of a whisker in equilibrium: its direction, and the force in it, at the Gauss points of its elements."""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.elements import POINTS, node_arcs
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject, material_of
from jaxwhisker._equilibrium.shaft_springs import ShaftSprings, past, to_next
from jaxwhisker._rod import rod
from jaxwhisker._scan.applied_loads import ScaledLineLoad, density_of

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
    """Forces and moments that keep their directions, at the ends of elements, and those per length."""

    position: Float[Array, "*batch loads"]
    force_x: Float[Array, "*batch loads"]
    force_y: Float[Array, "*batch loads"]
    moment: Float[Array, "*batch loads"]
    lines: tuple[ScaledLineLoad, ...]


class Centreline(NamedTuple):
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


class ElementEnds(NamedTuple):
    """Arc lengths at which the elements of a whisker end, and the numbers of elements that end at certain places."""

    arcs: Float[Array, " elements"]
    contact: Scalar  # number of the element that ends at the contact
    loads: Int[Array | np.ndarray, " loads"]  # at loads and at the ends of line loads
    springs: Int[Array | np.ndarray, " springs"]  # at springs on the shaft

    def spread(self, tree: Tree, elements: Int[Array | np.ndarray, " places"]) -> Tree:
        """What is known at the ends of some elements, as fields of all elements; zero for the others."""
        return jax.tree.map(lambda leaf: jnp.zeros(self.arcs.size, leaf.dtype).at[elements].set(leaf), tree)


def ends_of(body: WhiskerAtObject, at: Equilibrium, loads: DeadLoads | None, breaks: rod.Along | None) -> ElementEnds:
    """Where elements end: at loads, at springs on the shaft, at the contact, at the tip and at breaks.

    A whisker without tangential contact is split anywhere instead. Whiskers that are not uniform are split twice more:
    the closer to the tip of a cone, the shorter its elements must be.
    """
    at_loads = jnp.zeros(0)
    if loads is not None:
        ends = [end for line in loads.lines for end in (line.start, line.stop)]
        at_loads = jnp.concatenate([loads.position, *(jnp.reshape(end, 1) for end in ends)])
    at_springs = jnp.zeros(0) if body.sprung is None else jnp.maximum(body.sprung.held_by.springs.at, 0.0)
    places = jnp.concatenate([at_loads, at_springs])
    top = jnp.max(places, initial=0.0)
    split = jnp.where(at.phase == Phase.tangential, at.contact_arc, _middle(body, top, body.length))
    stops = [split, body.length]
    if body.section is not None:
        stops = [_middle(body, top, split), split, _middle(body, split, body.length), body.length]
    contact, number = places.size + len(stops) // 2 - 1, np.arange(places.size)
    # Breaks come last where places coincide: a break at the tip would take its place.
    arcs = jnp.concatenate([places, jnp.stack(stops), *([] if breaks is None else [breaks])])
    order = jnp.argsort(arcs)
    rank = jnp.argsort(order)
    of_loads, of_springs = jnp.split(rank[number], [at_loads.size])
    return ElementEnds(arcs[order], rank[contact], of_loads, of_springs)


def _middle(body: WhiskerAtObject, start: Scalar, stop: Scalar) -> Scalar:
    """Where to split a stretch: for a cone, the ratio of thicknesses is the same on both sides."""
    if body.section is None:
        return (start + stop) / 2
    assert isinstance(body.section, rod.Section)  # of one whisker
    stiffness = body.section.stiffness
    return start + (stop - start) * rod.graded(jnp.asarray(0.5), stiffness(start), stiffness(stop))


def line_of(body: WhiskerAtObject, at: Equilibrium, ends: ElementEnds, loads: DeadLoads | None) -> Centreline:
    """The line of a whisker, from its base to its tip."""
    material, (lengths, arcs) = material_of(body), node_arcs(ends.arcs)
    start = (at.base_x, at.base_y, -jnp.sin(at.base_angle), jnp.cos(at.base_angle))
    load = rod.Load(-at.fx, -at.fy, -at.mz - at.base_x * at.fy + at.base_y * at.fx)
    unloads = (jnp.arange(ends.arcs.size) == ends.contact) & (at.phase == Phase.tangential)
    dead, springs = None, None
    if loads is not None:
        at_places = loads._replace(lines=())
        dead = ends.spread(
            jax.tree.map(lambda leaf: jnp.append(leaf, jnp.zeros(2 * len(loads.lines))), at_places), ends.loads
        )
    if body.sprung is not None:
        springs = ends.spread(body.sprung.held_by.springs, ends.springs)
        # The reaction is that of everything at the base and below.
        springs = springs._replace(share=jnp.where(springs.at > 0, springs.share, 0.0))

    lines = () if loads is None else loads.lines

    def element(carry, here):
        (state, load), (first, length, unloaded, dead, spring) = carry, here
        states, inside = _through(body, lines, state, load, first, length, material)
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
    return Centreline(lengths, cos, sin, force_x, force_y, stiffness, states, springs, ends.contact)


def _through(
    body: WhiskerAtObject,
    lines: tuple[ScaledLineLoad, ...],
    state: rod.RodState,
    load: rod.Load,
    first: Scalar,
    length: Scalar,
    material: rod.Material,
) -> tuple[rod.RodStates, rod.Load]:
    """States and loads at the start of an element, at its Gauss points and at its end."""
    sprung = body.sprung
    tissue = None if sprung is None else sprung.held_by.tissue
    if tissue is None and not lines:
        # A negative arc integrates away from the base.
        states = rod.points(state, -length, load, material, at=jnp.asarray(AT), from_base=first)
        return states, jax.tree.map(lambda part: jnp.full(AT.shape, part), load)

    drive, given = None if sprung is None else sprung.drive, density_of(lines, first, first + length)

    def step(carry, ends):
        (state, load), (start, stop) = carry, first + length * ends
        carry = to_next(state, load, start, stop, material, tissue, drive, steps=1, given=given)
        return carry, carry

    _, later = jax.lax.scan(step, (state, load), jnp.stack([AT[:-1], AT[1:]], axis=1))
    return jax.tree.map(lambda start, rest: jnp.concatenate([start[None], rest]), (state, load), later)
