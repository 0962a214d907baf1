"""Springs and centre lines in a state: walks along whiskers from their bases, lengths and energies of springs."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.slopes import along_each, are_few, direction_of, jacobian
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.attach import OnShafts, attached
from jaxwhisker._equilibrium.couplings import given_by, length_between
from jaxwhisker._equilibrium.dimensionless import sections
from jaxwhisker._equilibrium.shaft_springs import (
    Attachments,
    Laws,
    ShaftSprings,
    end_of,
    in_drive,
    stretched,
    walk,
)
from jaxwhisker._equilibrium.weight import Gravity, weights_of
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.motion import AbstractMotion, Frame, Mount, Pose, mounted, pose_of
from jaxwhisker._model.network import SpringEnds
from jaxwhisker._model.scene import Scene, Sensor, Units, moves_along_x
from jaxwhisker._model.spring import AXES, POINTS, WEIGHTS
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Section
from jaxwhisker._rod.walk import Walk, pressed
from jaxwhisker._scan.state import State, material

WALK_STEPS = 16  # of the rod from one spring on its shaft to the next
STEPS_TO_POINTS = 2  # of the rod from one of sixteen points of quadrature to the next

PerWhisker = Float[Array, " whiskers"]
# x, y, angle of bases; with springs on shafts, fx, fy, mz and `shaft_loads` too
Bases = tuple[Float[Array, "*steps whiskers"], ...]
Reaction = tuple[Scalar, ...]  # fx, fy, mz


class Holds(eqx.Module):
    """What acts on the shafts of whiskers, by springs and weights: parts of a scene that all of its states share."""

    support: Support
    motion: Any  # in the plane or in space
    gravity: Any = None  # a Gravity, or a Triple in space


class Suspension(NamedTuple):
    """The parts of a scene that the lengths of its springs depend on: scenes that share these share a program."""

    linear: SpringEnds  # and as many springs without ends as make up a common number
    motion: AbstractMotion
    mounts: tuple[Mount, ...] | None  # None if bases move along x only
    support: Support | None  # None without springs on shafts, as the whiskers and the gravity
    whiskers: tuple[Whisker, ...] | None
    gravity: Gravity | None = None


class Held(NamedTuple):
    """The springs on the shaft of one whisker, its weight, and the frame of the drive, in the scene's units."""

    held_by: Attachments
    laws: Laws
    drive: Frame
    section: Section | None = None  # of the whisker, if it has a weight


def holds(scene: AbstractScene | Sensor) -> Holds | None:
    """What acts on the shafts of a scene's or sensor's whiskers; None without springs on shafts and gravity."""
    acts = scene.support.on_shafts or scene.gravity is not None
    return Holds(scene.support, scene.motion, scene.gravity) if acts else None


def suspension(scene: Scene) -> Suspension:
    """The parts of a scene that the lengths of its springs depend on."""
    support, along_x = scene.support, moves_along_x(scene)
    ends = support.spring_ends(AXES[:1] if along_x else AXES)
    # As many springs as hold a row with feedback to all of its whiskers.
    row = (2 * support.whiskers - 1) * (1 if along_x else len(AXES))
    missing = -len(ends.first) % row if len(ends.first) else row
    ends = SpringEnds(*(np.pad(values, (0, missing)) for values in ends))
    mounts = None if along_x else jax.tree.map(checks.as_float, support.mounts)
    if not support.attached:
        return Suspension(ends, scene.motion.undirected(), mounts, None, None)
    gravity, whiskers = scene.gravity, scene.whiskers
    if gravity is None:
        whiskers = tuple(whisker.without_masses() for whisker in whiskers)
    return Suspension(ends, scene.motion.undirected(), mounts, support, whiskers, gravity)


def held(
    by: Holds, whiskers: tuple[Whisker, ...], control: Scalar, loads: tuple[PerWhisker, ...] | None
) -> tuple[list[Held], OnShafts]:
    """What acts on the shafts of all whiskers at a control, and with these `shaft_loads`."""
    # Without units, everything is in those of the scene.
    unit, heavy = Units(*[jnp.ones(()) for _ in Units._fields]), by.gravity is not None
    own = sections(whiskers, 1.0, 1.0, heavy=heavy)
    springs = attached(by.support, own, unit, weights_of(whiskers, by.gravity, unit))
    assert springs is not None
    drive = mounted(pose_of(by.motion, control), Pose(0.0, 0.0, 0.0))
    held_by = springs.held_by
    if springs.couplings is not None and loads:
        z = jnp.stack([*[jnp.zeros_like(loads[0])] * 3, *loads], axis=1)
        held_by = held_by._replace(given=given_by(springs.couplings, z, held_by))
    each = []
    for k in range(len(whiskers)):
        section = own[k] if isinstance(own, tuple) else jax.tree.map(lambda leaf, k=k: leaf[k], own)
        of_whisker = jax.tree.map(lambda leaf, k=k: leaf[k], held_by)
        each.append(Held(of_whisker, springs.laws, drive, section if heavy else None))
    return each, springs


def outwards(
    whisker: Whisker, base: Pose, reaction: Reaction, arc: Scalar, held: Held | None = None, *, count: int
) -> rod.RodStates:
    """States of the rod at `count` equidistant points from the base up to `arc`, under the reaction at the base."""
    start, load, zero = *at_base(base, reaction), jnp.zeros_like(arc)
    if held is None:
        # A negative arc integrates away from the base.
        return rod.points(start, -arc, load, material(whisker), count=count, from_base=zero)
    (x, y, cos, sin), _ = _at_places(whisker, base, reaction, arc * jnp.linspace(1.0, 0.0, count), held, steps=1)
    return x[::-1], y[::-1], cos[::-1], sin[::-1]


def at_arcs(
    whisker: Whisker, base: Pose, reaction: Reaction, s: Float[Array, " points"]
) -> tuple[Float[Array, " points"], Float[Array, " points"]]:
    """Positions of points of the whisker at increasing arc lengths, under the reaction at the base."""
    start, load, arc = *at_base(base, reaction), s[-1]
    fractions = jnp.append(0.0, s / jnp.where(arc > 0, arc, 1.0))
    x, y, _, _ = rod.points(start, -arc, load, material(whisker), at=fractions, from_base=jnp.zeros_like(arc))
    return x[1:], y[1:]


def at_base(base: Pose, reaction: Reaction) -> tuple[rod.RodState, rod.Load]:
    """State of the rod at its base, and the load there, which balances the reaction."""
    fx, fy, mz = reaction
    start = (base.x, base.y, -jnp.sin(base.angle), jnp.cos(base.angle))
    return start, pressed((base.x, base.y), -fx, -fy, -mz)


def hanging(
    whisker: Whisker, base: Pose, reaction: Reaction, arc: Scalar, s: Float[Array, " points"], held: Held
) -> tuple[rod.RodStates, rod.Load]:
    """States of a whisker with a weight, and loads on it, at increasing arc lengths beyond its contact at `arc`."""
    weight, section = held.held_by.weight, held.section
    assert weight is not None and section is not None
    passed, loads = _at_places(whisker, base, reaction, jnp.reshape(arc, 1), held, steps=WALK_STEPS)
    (x, y, cos, sin), load = jax.tree.map(lambda leaf: leaf[0], (passed, loads))
    # The contact takes up all of the force but the weight beyond, and no moment.
    force_x, force_y = weight.between(section, arc, jnp.asarray(whisker.length))
    force_x, force_y = force_x + weight.tip_mass * weight.x, force_y + weight.tip_mass * weight.y
    own = pressed((x, y), force_x, force_y, jnp.asarray(rod.moment(x, y, load)))
    found = weight.line((x, y, cos, sin), own, jnp.append(arc, s), section)
    return jax.tree.map(lambda leaf: leaf[1:], found)


def walk_outwards(material: rod.Material, start: rod.RodState, load: rod.Load, held: Held, *, steps: int) -> Walk:
    """A walk from the base past all springs; `passed` and `loads` are ordered from the tip to the base."""
    material = material if held.section is None else held.section
    above = held.held_by.above
    springs, given = jax.tree.map(lambda leaf: leaf[::-1], (above.springs, above.given))
    held_by, zero = above._replace(springs=springs, given=given), jnp.zeros_like(springs.at[0])
    walked = walk(start, load, zero, material, held_by, held.laws, held.drive, steps=steps, sign=-1.0)
    passed, loads = jax.tree.map(lambda leaf: leaf[::-1], (walked.passed, walked.loads))
    return walked._replace(passed=passed, loads=loads)


def load_beyond(whisker: Whisker, base: Pose, reaction: Reaction, held: Held) -> rod.Load:
    """The load on a whisker above all of its springs: that of the object, and the weight there."""
    return walk_outwards(material(whisker), *at_base(base, reaction), held, steps=WALK_STEPS).load


def shaft_energy(whisker: Whisker, base: Pose, reaction: Reaction, arc: Scalar, held: Held) -> Float[Array, ""]:
    """Energy of a whisker and its foundation up to an arc length, by Gaussian quadrature between springs.

    With a weight, it is that of the whole whisker, and includes the potential energy, which is zero at the origin.
    """
    places = held.held_by.springs.at if whisker.breaks is None else jnp.append(held.held_by.springs.at, whisker.breaks)
    inside = jnp.clip(places, 0.0, arc)
    ends = jnp.concatenate([jnp.zeros(1), jnp.sort(inside), jnp.reshape(arc, 1)])
    s = jnp.ravel(ends[:-1, None] + jnp.diff(ends)[:, None] * POINTS)
    (x, y, _, _), load = _at_places(whisker, base, reaction, s, held)
    energy = _shaft_energy(whisker, ends, s, x, y, load, held)
    weight = held.held_by.weight
    if weight is None:
        return energy
    length = jnp.asarray(whisker.length)
    ends = jnp.clip(places, arc, length)
    ends = jnp.concatenate([jnp.reshape(arc, 1), jnp.sort(ends), jnp.reshape(length, 1)])
    s = jnp.ravel(ends[:-1, None] + jnp.diff(ends)[:, None] * POINTS)
    (x, y, _, _), load = hanging(whisker, base, reaction, arc, jnp.append(s, length), held)
    tip = weight.tip_mass * (weight.x * x[-1] + weight.y * y[-1])
    x, y, load = jax.tree.map(lambda leaf: leaf[:-1], (x, y, load))
    return energy + _shaft_energy(whisker, ends, s, x, y, load, held) - tip


def _shaft_energy(
    whisker: Whisker,
    ends: Float[Array, " ends"],
    s: Float[Array, " points"],
    x: Float[Array, " points"],
    y: Float[Array, " points"],
    load: rod.Load,
    held: Held,
) -> Float[Array, ""]:
    """Energy of a part of a whisker, from its states at Gauss points."""
    moment, stiffness = rod.moment(x, y, load), jax.vmap(whisker.stiffness_at)(s)
    # A pointed tip has no stiffness and carries no moment.
    density = jnp.where(stiffness > 0, moment**2 / (2 * jnp.where(stiffness > 0, stiffness, 1.0)), 0.0)
    if held.held_by.tissue is not None:
        density += jax.vmap(partial(held.held_by.tissue.energy, held.drive))(x, y, s)
    if held.held_by.weight is not None and held.section is not None:
        push = jax.vmap(held.held_by.weight.density(held.section))(s)
        density -= push[:, 0] * x + push[:, 1] * y
    return jnp.sum(jnp.ravel(jnp.diff(ends)[:, None] * WEIGHTS) * density)


def moment_at(
    whisker: Whisker, base: Pose, reaction: Reaction, s: Float[Array, " points"], held: Held
) -> Float[Array, " points"]:
    """Internal moments at these arc lengths, under the reaction at the base."""
    (x, y, _, _), load = _at_places(whisker, base, reaction, s, held)
    return jnp.asarray(rod.moment(x, y, load))


def _at_places(
    whisker: Whisker,
    base: Pose,
    reaction: Reaction,
    s: Float[Array, " points"],
    held: Held,
    *,
    steps: int = STEPS_TO_POINTS,
) -> tuple[rod.RodStates, rod.Load]:
    """States of the rod at these arc lengths, and the loads there."""
    held_by, places = held.held_by.with_places(s)
    walked = walk_outwards(material(whisker), *at_base(base, reaction), held._replace(held_by=held_by), steps=steps)
    return jax.tree.map(lambda leaf: leaf[places], (walked.passed, walked.loads))


class Stretched(NamedTuple):
    """A spring on a shaft in one state: its length or angle, and its first and its second end."""

    length: Scalar
    anchor_x: Scalar
    anchor_y: Scalar
    x: Scalar
    y: Scalar


def on_shafts(
    by: Holds, whiskers: tuple[Whisker, ...], bases: Pose, loads: tuple[PerWhisker, ...], control: Scalar
) -> list[Stretched]:
    """The springs on shafts, in the order of the support, in one state; fields have shape (whiskers,).

    The loads are fx, fy, mz and `shaft_loads`.
    """
    reactions = loads[:3]
    each, springs = held(by, whiskers, control, loads[3:])
    every, ends = [], []
    for k, (whisker, own) in enumerate(zip(whiskers, each, strict=True)):
        base, reaction = jax.tree.map(lambda leaf, k=k: leaf[k], (bases, reactions))
        passed = walk_outwards(material(whisker), *at_base(base, reaction), own, steps=WALK_STEPS).passed
        every.append(jax.vmap(partial(_stretched, own.drive))(own.held_by.springs, passed))
        ends.append(jax.vmap(partial(in_drive, drive=own.drive))(own.held_by.springs, passed))
    counted, ordered, couplings = [0] * len(whiskers), [], 0
    for spring in by.support.attached:
        own = []
        for whisker, _ in spring.ends:
            k = whisker - 1
            own.append(jax.tree.map(lambda leaf, at=springs.ranks[k, counted[k]]: leaf[at], every[k]))
            counted[k] += 1
        last = own[-1]
        if len(own) > 1 and springs.couplings is not None:
            length = length_between(springs.couplings, springs.held_by, jnp.stack(ends))[couplings]
            last = Stretched(length, own[0].x, own[0].y, last.x, last.y)
            couplings += 1
        ordered.append(last)
    return ordered


def _stretched(drive: Frame, spring: ShaftSprings, state: rod.RodState) -> Stretched:
    return Stretched(
        stretched(spring, state, drive)[0],
        drive.x + spring.anchor_x * drive.cos - spring.anchor_y * drive.sin,
        drive.y + spring.anchor_x * drive.sin + spring.anchor_y * drive.cos,
        *end_of(spring, state),
    )


def bases_of(scene: Scene, state: State) -> Bases:
    """The fields of states that spring lengths depend on: poses of bases and, with springs on shafts, reactions."""
    pose = state.base_x, state.base_y, state.base_angle
    return (*pose, *loads_of(state)) if scene.support.attached else pose


def loads_of(state: State) -> tuple[Float[Array, "*steps whiskers"], ...]:
    """The reactions, and the loads of springs between two shafts."""
    return state.fx, state.fy, state.mz, *(state.shaft_loads or ())


def spring_lengths(by: Suspension, bases: Bases, control: Float[Array, " steps"]) -> Float[Array, "steps springs"]:
    """Lengths of the springs, or angles of torsion springs, at all steps, and zeros for springs without ends."""
    return jax.vmap(partial(spring_length, by))(bases, control)


def spring_slopes(
    by: Suspension, bases: Bases, control: Float[Array, " steps"]
) -> Float[Array, "steps springs numbers"]:
    """Slopes of lengths by the numbers of the scene, then those of the step: x, y, angle of all bases, control."""

    def at(base, u):
        def function(numbers):
            numbers, base, u = numbers
            return spring_length(eqx.combine(numbers, by), base, u)

        return jacobian(function, (eqx.filter(by, eqx.is_inexact_array), base, u))

    return jax.vmap(at)(bases, control)


spring_slopes_now = Program(spring_slopes)


def spring_tangents(args, args_dot, _):
    """The tangent rule of `spring_lengths`."""
    (by, bases, control), (by_dot, bases_dot, control_dot) = args, args_dot
    numbers = eqx.filter(by, eqx.is_inexact_array)
    if not are_few(numbers):
        return NotImplemented
    own = direction_of([*bases, control], [*bases_dot, control_dot])
    return along_each(spring_slopes_now(by, bases, control), direction_of(numbers, by_dot), own)


def lengths_along_x(support: Support, x: np.ndarray, control: np.ndarray) -> np.ndarray:
    """Lengths of the springs at all steps, (steps, springs), if bases move along x only; nothing is compiled."""
    first, second, _ = support.spring_ends(AXES[:1])
    nodes = np.concatenate([control[:, None], x], axis=1)
    return nodes[:, second] - nodes[:, first]


def spring_length(by: Suspension, base: tuple[PerWhisker, ...], u: Scalar) -> Float[Array, " springs"]:
    """Length of each spring, in the drive's frame, in one state, and zeros for springs without ends."""
    linear = _linear_lengths(by, base[:3], u)
    if by.support is None or by.whiskers is None:
        return linear
    on = on_shafts(Holds(by.support, by.motion, by.gravity), by.whiskers, Pose(*base[:3]), base[3:], u)
    attached, network = (one.length for one in on), iter(linear)
    return jnp.stack([next(network if spring.linear else attached) for spring in by.support.springs])


def _linear_lengths(by: Suspension, base: tuple[PerWhisker, ...], u: Scalar) -> Float[Array, " springs"]:
    """Lengths of the springs that form the network of the bases."""
    x, y, angle = base
    if by.mounts is None:
        return by.linear.lengths((x - u)[:, None])
    drive_x, drive_y, drive_angle = by.motion.pose(u)
    cos, sin = jnp.cos(drive_angle), jnp.sin(drive_angle)
    right, up = x - drive_x, y - drive_y
    in_frame = jnp.stack([right * cos + up * sin, up * cos - right * sin, angle - drive_angle], axis=-1)
    mounts = [[jnp.asarray(v, dtype=float) for v in (m.x, m.y, m.angle)] for m in by.mounts]
    return by.linear.lengths(in_frame - jnp.stack([jnp.stack(mount) for mount in mounts]))
