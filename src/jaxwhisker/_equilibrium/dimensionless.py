"""From a scene to its dimensionless problem."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import safe_placeholder
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import touch
from jaxwhisker._equilibrium.attach import attached, with_unloaded
from jaxwhisker._equilibrium.problem import AlongX, InPlane, Problem
from jaxwhisker._equilibrium.stance import PerWhisker
from jaxwhisker._equilibrium.touch import Outline, TouchAlongX
from jaxwhisker._equilibrium.weight import valid_gravity, weights_of
from jaxwhisker._model.canonical import CanonicalScene, canonical
from jaxwhisker._model.motion import Pose, Translation
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, units_of
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker, with_equal_breaks
from jaxwhisker._rod.rod import Section


def problem_of(scene: Scene | CanonicalScene) -> Problem:
    """The dimensionless problem of a scene, differentiable with respect to all numbers of the scene."""
    if isinstance(scene, Scene):
        scene = canonical(scene)
    valid = is_valid(scene)
    scene = safe_placeholder(scene, valid)
    unit = jax.tree.map(checks.as_float, units_of(scene.whiskers[0], scene.motion))
    length = jnp.stack([jnp.asarray(w.length, dtype=float) for w in scene.whiskers]) / unit.length
    stiffness = jnp.stack([jnp.asarray(w.base_stiffness, dtype=float) for w in scene.whiskers])
    heavy = scene.gravity is not None
    section = sections(scene.whiskers, unit.length, unit.moment * unit.length, heavy=heavy)
    spring, torsion = unit.force / unit.length, unit.moment
    hold = scene.support.hold(spring, torsion) if isinstance(scene.support, Support) else None
    flexibility = scene.support.flexibility(hold)
    valid &= flexibility.consistent
    common: dict[str, Any] = {
        "length": length,
        "bending_stiffness": stiffness / (unit.moment * unit.length),
        "section": section,
        "profile": scene.profile.in_unit(unit.length),
        "rod": scene.rod,
        "motion": scene.motion,
        "onwards": jnp.asarray(scene.onwards),
        "ends": jax.tree.map(lambda end: jnp.asarray(end, dtype=float) / unit.control, scene.ends),
        "unit": unit,
        "friction_angle": None if scene.friction is None else jnp.arctan(jnp.asarray(scene.friction, dtype=float)),
    }
    curved = any(whisker.intrinsic_curvature is not None for whisker in scene.whiskers)
    if scene.along_x:
        flexibility = flexibility.in_unit(unit.length, unit.force)
        if curved:
            upright = jnp.zeros_like(length)
            own = outlines(scene.whiskers, length, section), upright, upright
            right, left = _first_touches(common["profile"], length, *own)
            valid &= _touches_once(common["profile"], *own)
        else:
            right, left = _first_touches_upright(common["profile"], length)
        return AlongX(**common, touch_right=right, touch_left=left, flexibility=flexibility, valid=valid)
    mounts = zip(*((mount.x, mount.y, mount.angle) for mount in scene.support.mounts), strict=True)
    x, y, angle = (jnp.stack([jnp.asarray(v, dtype=float) for v in vs]) for vs in mounts)
    height = y / unit.length
    mount = Pose(x / unit.length, height, angle)
    flexibility = flexibility.in_frames(angle, unit.length, unit.force)
    outline = outlines(scene.whiskers, length, section)
    if curved:
        valid &= _touches_once(common["profile"], outline, height, angle)
    none = jnp.zeros_like(length)

    def somewhere(one):
        no_touch = TouchAlongX(none + sum(one.ends()) / 2, none, none, none, none > 0)
        return no_touch, no_touch

    right, left = touch.of_objects(common["profile"], somewhere)
    common |= {"flexibility": flexibility, "valid": valid, "touch_right": right, "touch_left": left}
    problem = InPlane(**common, mount=mount, outline=outline)
    weight = weights_of(scene.whiskers, scene.gravity, unit)
    springs = attached(scene.support, section, unit, weight) if isinstance(scene.support, Support) else None
    if springs is not None:
        hold = jnp.zeros((length.size, 3)) if hold is None else hold
        held = jax.vmap(_turned)(angle, hold / jnp.stack([spring, spring, torsion]))
        problem, found = with_unloaded(problem, springs, held)
        problem = eqx.tree_at(lambda p: p.valid, problem, problem.valid & found)
    if isinstance(scene.motion, Translation):
        zero = jnp.zeros(())
        z, pose = problem.unloaded(zero)
        stance = problem.stance(zero, pose, z)
        right, left = stance.right, stance.left
    else:  # on its way, whiskers touch in other places
        right, left = _first_touches(common["profile"], length, outline, height, angle)
    return eqx.tree_at(lambda p: (p.touch_right, p.touch_left), problem, (right, left))


def _turned(angle: Scalar, stiffness: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Stiffnesses along the drive's axes, in a frame at this angle to it."""
    cos, sin, zero = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)
    turn = jnp.stack([cos, sin, zero, -sin, cos, zero, zero, zero, zero + 1.0]).reshape(3, 3)
    return jnp.sum(turn[:, None, :] * stiffness * turn[None, :, :], axis=-1)


def _first_touches_upright(profile: AbstractProfile, length: PerWhisker) -> tuple[TouchAlongX, TouchAlongX]:
    """First touches of straight whiskers that stand upright at height 0, from the right and from the left."""

    def touches(one):
        right, left = (jax.vmap(lambda h, s=s: touch.first_touch_upright(one, h, s))(length) for s in (1.0, -1.0))
        return right, left

    return touch.of_objects(profile, touches)


def _first_touches(
    profile: AbstractProfile, length: PerWhisker, outline: Outline, height: PerWhisker, angle: PerWhisker
) -> tuple[TouchAlongX, TouchAlongX]:
    """First touches of whiskers with these outlines, from the right and from the left."""

    def touches(one):
        return jax.vmap(lambda *own: touch.first_touches(one, *own))(length, outline, height, angle)

    return touch.of_objects(profile, touches)


def _touches_once(profile: AbstractProfile, outline: Outline, height: PerWhisker, angle: PerWhisker) -> Bool[Array, ""]:
    """Whether each unloaded whisker touches the object in one place only."""
    twice = (jax.vmap(lambda *own, one=one: touch.in_two_places(one, *own)) for one in profile.objects)
    return ~jnp.any(jnp.stack([of_each(outline, height, angle) for of_each in twice]))


def outlines(
    whiskers: tuple[Whisker, ...], length: PerWhisker, section: Section | tuple[Section, ...] | None
) -> Outline:
    """Outlines of all unloaded whiskers, stacked."""
    if isinstance(section, tuple):
        each = [touch.outline(length[k], own) for k, own in enumerate(section)]
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
    straight = all(whisker.intrinsic_curvature is None for whisker in whiskers)
    if section is None or straight:
        return jax.vmap(lambda length: touch.outline(length, None))(length)
    return jax.vmap(touch.outline)(length, section)


def sections(
    whiskers: tuple[Whisker, ...], length_unit: Scalar, stiffness_unit: Scalar, *, heavy: bool = False
) -> Section | tuple[Section, ...] | None:
    """Sections of all whiskers: None if all are uniform, stacked if they differ in numbers only, otherwise a tuple.

    Those of `heavy` whiskers include their masses per length, also if they are uniform.
    """
    if all(whisker.uniform for whisker in whiskers) and not heavy:
        return None
    whiskers = with_equal_breaks(jax.tree.map(checks.as_float, whiskers))
    length, stiffness = (jnp.asarray(unit, dtype=float) for unit in (length_unit, stiffness_unit))
    return stacked_or_each([whisker.section(length, stiffness, heavy=heavy) for whisker in whiskers])


def stacked_or_each(each: list[Any]) -> Any:
    """Sections of all whiskers: stacked if they differ in numbers only, otherwise a tuple."""
    kinds = [(jax.tree.structure(section), [leaf.shape for leaf in jax.tree.leaves(section)]) for section in each]
    if any(kind != kinds[0] for kind in kinds):
        return tuple(each)
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)


def is_valid(scene: CanonicalScene) -> Bool[Array, ""]:
    """Whether traced parameters are in the domains that the constructors check for concrete ones."""
    whiskers = jnp.all(jnp.stack([whisker.valid() for whisker in scene.whiskers]))
    valid = scene.profile.valid() & scene.support.valid() & scene.motion.valid() & whiskers
    for _, whisker, place in scene.support.attachments():
        valid &= jnp.asarray(place) < scene.whiskers[whisker - 1].length
    if scene.gravity is not None:
        heavy = [whisker.valid_masses() for whisker in scene.whiskers]
        valid &= valid_gravity(scene.gravity) & jnp.all(jnp.stack(heavy))
    if scene.friction is None:
        return valid
    return valid & (scene.friction >= 0) & jnp.isfinite(scene.friction)
