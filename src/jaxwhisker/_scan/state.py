"""The state of the whiskers in equilibrium, and points on their centre lines in that state."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.attach import OnShafts, attached
from jaxwhisker._equilibrium.dimensionless import sections
from jaxwhisker._equilibrium.shaft_springs import Attachments, Laws, ShaftSprings, end_of, stretched, walk
from jaxwhisker._model.motion import AbstractMotion, Frame, Pose, mounted
from jaxwhisker._model.scene import Scene, Units
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod

WALK_STEPS = 16  # of the rod from one spring on its shaft to the next


class State(eqx.Module):
    """Whiskers in equilibrium, in the scene's units; every field has shape (whiskers,), in a Result (steps, whiskers).

    The reactions and all contact fields of a free whisker are zero.
    """

    base_x: Float[Array, "*steps whiskers"]  # position of the base, a length
    base_y: Float[Array, "*steps whiskers"]
    base_angle: Float[Array, "*steps whiskers"]  # angle of the base to the upright, rad, counter-clockwise positive
    fx: Float[Array, "*steps whiskers"]  # support reaction on the whisker: force along +x
    fy: Float[Array, "*steps whiskers"]  # force along +y
    mz: Float[Array, "*steps whiskers"]  # moment, counter-clockwise positive
    contact_force: Float[Array, "*steps whiskers"]  # f >= 0, a force
    contact_slope: Float[Array, "*steps whiskers"]  # slope angle alpha of the object, rad, positive: rises towards +x
    contact_arc: Float[Array, "*steps whiskers"]  # arc length from base to contact
    contact_x: Float[Array, "*steps whiskers"]  # contact point, a length
    contact_y: Float[Array, "*steps whiskers"]
    phase: Int[Array, "*steps whiskers"]  # Phase.free, .tip, .tangential
    # The following fields are None without friction: the direction of slip along the object (+1 towards +x, -1 towards
    # -x, 0 if the contact sticks), and the parts of the contact force along the normal (>= 0) and, positive towards +x,
    # along the object.
    slip: Int[Array, "*steps whiskers"] | None = eqx.field(default=None, kw_only=True)
    normal_force: Float[Array, "*steps whiskers"] | None = eqx.field(default=None, kw_only=True)
    friction_force: Float[Array, "*steps whiskers"] | None = eqx.field(default=None, kw_only=True)


FRICTION = ("slip", "normal_force", "friction_force")  # fields that are None without friction


def state_of(state: State) -> State:
    """The fields of a state, without what a Result holds besides."""
    fields = {name: getattr(state, name) for name in State.__dataclass_fields__}
    return State(**jax.tree.map(jnp.asarray, fields))


def base_of(state: State) -> Pose:
    """The poses of the bases."""
    return Pose(state.base_x, state.base_y, state.base_angle)


PerWhisker = Float[Array, " whiskers"]
Reaction = tuple[Scalar, ...]  # fx, fy, mz


class Holds(eqx.Module):
    """What holds whiskers by springs on their shafts: support and motion of a scene; shared by all of its states."""

    support: Support
    motion: AbstractMotion


class Held(NamedTuple):
    """The springs on the shaft of one whisker, and the frame of the drive, in the scene's units."""

    held_by: Attachments
    laws: Laws
    drive: Frame


def holds(scene: Scene) -> Holds | None:
    """What holds the whiskers of a scene by springs on their shafts; None without such springs."""
    return Holds(scene.support, scene.motion) if scene.support.on_shafts else None


def held(by: Holds, whiskers: tuple[Whisker, ...], control: Scalar) -> tuple[list[Held], OnShafts]:
    """The springs on the shafts of all whiskers at a control."""
    # Without units, everything is in those of the scene.
    ones = [jnp.ones(()) for _ in Units._fields]
    springs = attached(by.support, sections(whiskers, 1.0, 1.0), Units(*ones))
    assert springs is not None
    drive = mounted(Pose(*(jnp.asarray(part, dtype=float) for part in by.motion.pose(control))), Pose(0.0, 0.0, 0.0))
    each = [jax.tree.map(lambda leaf, k=k: leaf[k], springs.held_by) for k in range(len(whiskers))]
    return [Held(own, springs.laws, drive) for own in each], springs


def outwards(
    whisker: Whisker, base: Pose, reaction: Reaction, arc: Scalar, held: Held | None = None, *, count: int
) -> rod.RodStates:
    """States of the rod at `count` equidistant points from the base up to `arc`, under the reaction at the base."""
    start, load, zero = *_at_base(base, reaction), jnp.zeros_like(arc)
    if held is None:
        # A negative arc integrates away from the base.
        return rod.points(start, -arc, load, material(whisker), count=count, from_base=zero)
    springs, points = held.held_by.with_places(arc * jnp.linspace(1.0, 0.0, count))
    passed = _walk(whisker, start, load, held._replace(held_by=springs), steps=1)
    x, y, cos, sin = (values[points[::-1]] for values in passed)
    return x, y, cos, sin


def _at_base(base: Pose, reaction: Reaction) -> tuple[rod.RodState, rod.Load]:
    """State of the rod at its base, and the load there, which balances the reaction."""
    fx, fy, mz = reaction
    start = (base.x, base.y, -jnp.sin(base.angle), jnp.cos(base.angle))
    return start, rod.Load(-fx, -fy, -mz - base.x * fy + base.y * fx)


def _walk(whisker: Whisker, start: rod.RodState, load: rod.Load, held: Held, *, steps: int) -> rod.RodStates:
    """States of the rod at all springs, from the tip to the base, on a walk from the base."""
    springs = jax.tree.map(lambda leaf: leaf[::-1], held.held_by.springs)
    # The reaction is that of everything at the base and below.
    springs = springs._replace(share=jnp.where(springs.at > 0, springs.share, 0.0))
    backwards, zero = held.held_by._replace(springs=springs), jnp.zeros_like(springs.at[0])
    given = start, load, zero, material(whisker), backwards, held.laws, held.drive
    return jax.tree.map(lambda leaf: leaf[::-1], walk(*given, steps=steps, sign=-1.0).passed)


class Stretched(NamedTuple):
    """A spring on a shaft in one state: its length or angle, and its ends on the drive and on the whisker."""

    length: Scalar
    anchor_x: Scalar
    anchor_y: Scalar
    x: Scalar
    y: Scalar


def on_shafts(
    by: Holds, whiskers: tuple[Whisker, ...], bases: Pose, reactions: tuple[PerWhisker, ...], control: Scalar
) -> list[Stretched]:
    """The springs on shafts, in the order of the support, in one state; fields have shape (whiskers,)."""
    each, springs = held(by, whiskers, control)
    every = []
    for k, (whisker, own) in enumerate(zip(whiskers, each, strict=True)):
        base, reaction = jax.tree.map(lambda leaf, k=k: leaf[k], (bases, reactions))
        passed = _walk(whisker, *_at_base(base, reaction), own, steps=WALK_STEPS)
        every.append(jax.vmap(partial(_stretched, own.drive))(own.held_by.springs, passed))
    counted, ordered = [0] * len(whiskers), []
    for spring in by.support.attached:
        k = spring.between[1] - 1
        rank = springs.ranks[k, counted[k]]
        ordered.append(jax.tree.map(lambda leaf, rank=rank: leaf[rank], every[k]))
        counted[k] += 1
    return ordered


def _stretched(drive: Frame, spring: ShaftSprings, state: rod.RodState) -> Stretched:
    return Stretched(
        stretched(spring, state, drive)[0],
        drive.x + spring.anchor_x * drive.cos - spring.anchor_y * drive.sin,
        drive.y + spring.anchor_x * drive.sin + spring.anchor_y * drive.cos,
        *end_of(spring, state),
    )


def material(whisker: Whisker) -> rod.Material:
    """The rod's material, in the whisker's own units."""
    return whisker.base_stiffness if whisker.uniform else whisker.section(1.0, 1.0)
