"""The shaft: the centre line of a whisker in a state, from its base through the contact to its tip.

A shaft is known at points of two parts, from the contact to the base and from the contact to the tip. Between two
points, in a cell, it is the cubic with these ends and the directions there (Hermite). It is then off by 2e-6 L for
uniform whiskers, and by up to 1e-5 L for curved and conical ones (20:1).
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.interpolation import Cubic, between
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import contact
from jaxwhisker._equilibrium.contact import FORCE, LEAN, SLACK, Base, Phase, Sprung, WhiskerAtObject
from jaxwhisker._equilibrium.friction import Friction, lean
from jaxwhisker._equilibrium.shaft_springs import walk
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Along, Load, Section

CELLS = 16  # from contact to base
CELLS_BEYOND = 8  # from contact to tip; one if the whisker is straight there


class ShaftLine(NamedTuple):
    """Points and directions (towards the tip) of a part of a shaft, from the contact on."""

    x: Along
    y: Along
    cos: Along
    sin: Along
    cell: Float[Array, " cells"]  # arc length from each point to the next, negative towards the base


class Shaft(NamedTuple):
    """The shaft of a whisker in the scene."""

    to_base: ShaftLine
    to_tip: ShaftLine
    parameter: Scalar  # of the profile at the contact
    base: Base


def shaft(
    body: WhiskerAtObject,
    z: Float[Array, " numbers"],
    phase: Int[Array, ""],
    side: Scalar,
    friction: Friction | None = None,
) -> Shaft:
    """The shaft of a whisker with the contact z, which is the dummy contact, without force, of a free whisker."""
    if body.sprung is not None:
        return _sprung_shaft(body, body.sprung, z, phase, side, friction)
    p = contact.parameter(body.profile.on(body.piece), z, phase, side, friction)
    at, leans = body.profile.point_on(body.piece, p), lean(z[LEAN], friction, body.friction_angle)
    angle = jnp.where(phase == Phase.tip, -z[SLACK], 0.0) + (0.0 if leans is None else side * leans)
    start = (jnp.zeros_like(angle), jnp.zeros_like(angle), jnp.cos(angle), jnp.sin(angle))
    # With a step per cell, the error of this method is smaller than that of the cubics.
    material, solver, cells_beyond = body.bending_stiffness, rod.Splitting(6), 1
    if body.section is not None:
        assert isinstance(body.section, Section)  # of one whisker
        material, solver = dataclasses.replace(body.section, orientation=side), None
        cells_beyond = 1 if material.intrinsic_curvature is None else CELLS_BEYOND
    arc = contact.arc(body, z[SLACK], phase)

    def line(length: Scalar, force: Scalar, cells: int) -> tuple[Float[Array, "4 points"], Float[Array, " cells"]]:
        at = rod.step_ends(length, material, steps=cells, from_base=arc)
        at = rod.with_breaks(at, length, material, arc).times
        points = rod.points(start, length, Load(None, -force, None), material, at=at, solver=solver, from_base=arc)
        return jnp.stack(points), -length * jnp.diff(at)

    def in_scene(points: Float[Array, "4 points"], cell: Float[Array, " cells"]) -> ShaftLine:
        placed = contact.in_scene(at, leans, points, z[FORCE], side)
        return ShaftLine(placed.x, placed.y, placed.cos, placed.sin, cell)

    to_base, to_tip = line(arc, z[FORCE], CELLS), line(arc - body.length, jnp.zeros_like(z[FORCE]), cells_beyond)
    base = contact.in_scene(at, leans, to_base[0][:, -1], z[FORCE], side)
    return Shaft(in_scene(*to_base), in_scene(*to_tip), p, base)


def _sprung_shaft(
    body: WhiskerAtObject,
    sprung: Sprung,
    z: Float[Array, " numbers"],
    phase: Int[Array, ""],
    side: Scalar,
    friction: Friction | None,
) -> Shaft:
    """The shaft of a whisker that springs hold."""
    start, load, _ = contact.start_of(body, z, phase, side, friction)
    arc, material = contact.arc(body, z[SLACK], phase), contact.material_of(body)
    places, _ = sprung.held_by.with_places(arc * jnp.linspace(1.0, 0.0, CELLS + 1))
    walked = walk(start, load, arc, material, places, body.laws, sprung.drive, steps=1)
    weight = sprung.held_by.weight
    if weight is None:
        nothing = Load(None, jnp.zeros_like(arc), None)
        beyond = rod.points(start, arc - body.length, nothing, material, count=CELLS_BEYOND + 1, from_base=arc)
    else:
        assert isinstance(material, Section)
        s = arc + (body.length - arc) * jnp.linspace(0.0, 1.0, CELLS_BEYOND + 1)
        # The contact acts on the part below it.
        own = weight.beyond(start, arc, body.length, material, steps=CELLS_BEYOND)
        beyond, _ = weight.line(start, own, s, material)
    x, y, cos, sin = walked.passed
    to_base = ShaftLine(x, y, cos, sin, jnp.diff(jnp.maximum(places.springs.at, 0.0)))
    to_tip = ShaftLine(*beyond, jnp.full(CELLS_BEYOND, (body.length - arc) / CELLS_BEYOND))
    p = contact.parameter(body.profile.on(body.piece), z, phase, side, friction)
    p = jnp.where(phase == Phase.free, sprung.placeholder_parameter, p)
    return Shaft(to_base, to_tip, p, contact.base(body, z, phase, side, friction))


def moved(own: Shaft, x: Scalar, y: Scalar, angle: Scalar) -> Shaft:
    """The shaft as a rigid body, moved until its base has this pose; `angle` is that to the upright."""
    base = own.base
    cos, sin = -jnp.sin(angle), jnp.cos(angle)
    turn_cos, turn_sin = base.cos * cos + base.sin * sin, base.cos * sin - base.sin * cos

    def line(part: ShaftLine) -> ShaftLine:
        right, up = part.x - base.x, part.y - base.y
        return ShaftLine(
            x + right * turn_cos - up * turn_sin,
            y + right * turn_sin + up * turn_cos,
            part.cos * turn_cos - part.sin * turn_sin,
            part.sin * turn_cos + part.cos * turn_sin,
            part.cell,
        )

    return own._replace(to_base=line(own.to_base), to_tip=line(own.to_tip))


def cells_of(own: Shaft) -> Cubic:
    """Cells of a shaft from base to tip, (cells, 2)."""

    def part(line: ShaftLine, towards_tip: bool) -> Cubic:
        points, directions = jnp.stack([line.x, line.y], -1), jnp.stack([line.cos, line.sin], -1)
        size = jnp.abs(line.cell)[:, None]
        return between(points, directions, size) if towards_tip else between(points[::-1], directions[::-1], size[::-1])

    parts = part(own.to_base, False), part(own.to_tip, True)
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
