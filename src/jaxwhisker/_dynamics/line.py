"""The line of a whisker in equilibrium: its direction, and the force in it, at the Gauss points of its elements."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.elements import POINTS, node_arcs
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject, material_of
from jaxwhisker._equilibrium.line_loads import ScaledLineLoad, density_of, ends_of_lines
from jaxwhisker._equilibrium.shaft_springs import ShaftSprings, past, to_next
from jaxwhisker._model.motion import Pose
from jaxwhisker._rod import rod
from jaxwhisker._rod.walk import Order, in_order, pressed, walk
from jaxwhisker._scan.springs import at_base

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
    """Arc lengths at which the elements of a whisker end, from its base to its tip."""

    order: Order  # at loads, at the ends of line loads, at springs on the shaft, where the rest is split, and at breaks
    contact: Scalar  # number of the element that ends at the contact

    @property
    def arcs(self) -> Float[Array, "*batch elements"]:
        """The arc lengths."""
        return self.order.at


LOADS, SPRINGS, SPLITS = 0, 2, 3  # kinds of ends with fields: see `ElementEnds.order`


def ends_of(body: WhiskerAtObject, at: Equilibrium, loads: DeadLoads | None, breaks: rod.Along | None) -> ElementEnds:
    """Where elements end: at loads, at springs on the shaft, at the contact, at the tip and at breaks.

    A whisker without tangential contact is split anywhere instead. Whiskers that are not uniform are split twice more:
    the closer to the tip of a cone, the shorter its elements must be.
    """
    at_loads = of_lines = jnp.zeros(0)
    if loads is not None:
        at_loads, of_lines = loads.position, ends_of_lines(loads.lines)
    at_springs = jnp.zeros(0) if body.sprung is None else jnp.maximum(body.sprung.held_by.springs.at, 0.0)
    top = jnp.max(jnp.concatenate([at_loads, of_lines, at_springs]), initial=0.0)
    split = jnp.where(at.phase == Phase.tangential, at.contact_arc, _middle(body, top, body.length))
    stops = [split, body.length]
    if body.section is not None:
        stops = [_middle(body, top, split), split, _middle(body, split, body.length), body.length]
    # Breaks come last where places coincide: a break at the tip would take its place.
    breaks = jnp.zeros(0) if breaks is None else breaks
    order = in_order(at_loads, of_lines, at_springs, jnp.stack(stops), breaks, outwards=True)
    return ElementEnds(order, order.ranks[SPLITS][len(stops) // 2 - 1])


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
    start, load = at_base(Pose(at.base_x, at.base_y, at.base_angle), (at.fx, at.fy, at.mz))
    unloads = (jnp.arange(ends.arcs.size) == ends.contact) & (at.phase == Phase.tangential)
    lines, dead, springs = () if loads is None else loads.lines, None, None
    if loads is not None:
        dead = ends.order.spread(LOADS, loads._replace(lines=()))
    if body.sprung is not None:
        # The reaction is that of everything at the base and below.
        springs = ends.order.spread(SPRINGS, body.sprung.held_by.springs.above)

    def onwards(state, load, s, stop):
        states, inside = _through(body, lines, state, load, s, stop - s, material)
        end, load = jax.tree.map(lambda values: values[-1], (states, inside))
        _, _, cos, sin = states
        kept = cos, sin, jnp.asarray(inside.force_x), jnp.asarray(inside.force_y)
        return end, load, tuple(values[1:-1] for values in kept)

    def behind(load, state, place):
        unloaded, dead, spring = place
        if dead is not None:
            push = pressed(state[:2], dead.force_x, dead.force_y, dead.moment)
            load = jax.tree.map(jnp.subtract, load, push)
        if spring is not None:
            assert body.sprung is not None
            load = past(load, spring, body.laws, state, body.sprung.drive, -1.0)
        return jax.tree.map(lambda part: jnp.where(unloaded, 0.0, part), load)

    walked = walk(onwards, behind, start, load, ends.arcs, (unloads, dead, springs), s=jnp.zeros(()))
    cos, sin, force_x, force_y = walked.ways
    if isinstance(material, rod.Section):
        stiffness = jax.vmap(jax.vmap(material.stiffness))(arcs)
    else:
        stiffness = jnp.full(arcs.shape, body.bending_stiffness)
    return Centreline(lengths, cos, sin, force_x, force_y, stiffness, walked.passed, springs, ends.contact)


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
