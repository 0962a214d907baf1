"""The dimensionless problem: what the equations see of a scene, and what programs are compiled for.

Lengths are in the length L of the first whisker, forces in EI/L^2, moments in EI/L, spring stiffnesses in EI/L^3, with
EI its bending stiffness at the base. Scenes with the same problem shape (number of whiskers, kinds of rods, profile and
motion, and whether bases move along x only) share their compiled programs, whatever network of springs couples them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import harmless
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import touch
from jaxwhisker._equilibrium.contact import Body
from jaxwhisker._equilibrium.touch import Outline, Touch
from jaxwhisker._model.motion import AbstractMotion, Frame, Pose, frame_and_rate
from jaxwhisker._model.network import Flexibility
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, Units, moves_along_x, units
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import AbstractRod
from jaxwhisker._rod.rod import Section


class Problem(NamedTuple):
    """A scene without dimensions: what the equations see. Whiskers are stacked along the first axis."""

    length: Float[Array, " whiskers"]
    bending_stiffness: Float[Array, " whiskers"]  # at the base
    section: Section | tuple[Section, ...] | None  # see contact.Body
    profile: AbstractProfile
    rod: AbstractRod
    motion: AbstractMotion
    flexibility: Flexibility | None
    mount: Pose | None  # of every whisker; None where bases stay upright at height 0 and move along x only
    outline: Outline | None  # of the unloaded whiskers, where they have a mount
    touch_right: Touch  # first contact coming from the right: of whiskers with a mount, at their poses for control 0
    touch_left: Touch
    valid: Bool[Array, ""]
    unit: Units

    @property
    def axes(self) -> int:
        """Of a base's pose: x, or x, y and angle."""
        return 1 if self.mount is None else 3

    def bodies(self, u: Scalar) -> Body:
        """All whiskers, stacked, at a control."""
        frame, rate = (None, None) if self.mount is None else self.frames(u)
        return Body(self.length, self.bending_stiffness, self.profile, self.rod, self.section, frame, rate)

    def frames(self, u: Scalar) -> tuple[Frame, Frame]:
        """Where bases with a mount would be without load, and the derivative by the control."""
        assert self.mount is not None
        return frame_and_rate(self.drive, self.mount, u)

    def drive(self, u: Scalar) -> Pose:
        """The pose of the drive's frame."""
        x, y, angle = self.motion.pose(u * self.unit.control)
        return Pose(x / self.unit.length, y / self.unit.length, angle)


def problem_of(scene: Scene) -> Problem:
    """The scene's dimensionless equations. Derivatives flow through all of it."""
    valid = _valid(scene)
    scene = harmless(scene, valid)
    unit = units(scene)
    length = jnp.stack([jnp.asarray(w.length, dtype=float) for w in scene.whiskers]) / unit.length
    stiffness = jnp.stack([jnp.asarray(w.base_stiffness, dtype=float) for w in scene.whiskers])
    stiffness = stiffness / (unit.moment * unit.length)
    section = sections(scene.whiskers, unit.length, unit.moment * unit.length)
    profile = scene.profile.in_unit(unit.length)
    flexibility = scene.support.flexibility()
    if flexibility is not None:
        valid &= flexibility.consistent
    mount, outline, height, angle = None, None, jnp.zeros_like(length), jnp.zeros_like(length)
    if moves_along_x(scene):
        flexibility = None if flexibility is None else flexibility.in_unit(unit.length, unit.force)
    else:
        x, y, angle = (jnp.stack([jnp.asarray(v, dtype=float) for v in vs]) for vs in zip(*_mounts(scene), strict=True))
        mount = Pose(x / unit.length, y / unit.length, angle)
        flexibility = None if flexibility is None else flexibility.in_frames(angle, unit.length, unit.force)
        height = mount.y
    if mount is None and all(whisker.intrinsic_curvature is None for whisker in scene.whiskers):
        right, left = (jax.vmap(lambda h, s=s: touch.of_straight(profile, h, s))(length) for s in (1.0, -1.0))
    else:
        outline = outlines(scene.whiskers, length, section)
        right, left = jax.vmap(lambda *own: touch.of_both(profile, *own))(length, outline, height, angle)
        if any(whisker.intrinsic_curvature is not None for whisker in scene.whiskers):
            twice = jax.vmap(lambda *own: touch.in_two_places(profile, *own))(outline, height, angle)
            valid &= ~jnp.any(twice)
    return Problem(
        length, stiffness, section, profile, scene.rod, scene.motion, flexibility, mount, outline, right, left, valid,
        unit,
    )  # fmt: skip


def _mounts(scene: Scene) -> list[tuple[Scalar, Scalar, Scalar]]:
    return [(mount.x, mount.y, mount.angle) for mount in scene.support.mounts]


def outlines(
    whiskers: tuple[Whisker, ...], length: Float[Array, " whiskers"], section: Section | tuple[Section, ...] | None
) -> Outline:
    """Outlines of all whiskers, stacked."""
    if isinstance(section, tuple):
        each = [touch.outline(length[k], own) for k, own in enumerate(section)]
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
    straight = all(whisker.intrinsic_curvature is None for whisker in whiskers)
    if section is None or straight:
        return jax.vmap(lambda length: touch.outline(length, None))(length)
    return jax.vmap(touch.outline)(length, section)


def sections(
    whiskers: tuple[Whisker, ...], length_unit: Scalar, stiffness_unit: Scalar
) -> Section | tuple[Section, ...] | None:
    """What changes along whiskers: stacked if they differ by numbers only, None if all are uniform."""
    if all(whisker.uniform for whisker in whiskers):
        return None
    whiskers = jax.tree.map(checks.as_float, whiskers)
    units = (jnp.asarray(unit, dtype=float) for unit in (length_unit, stiffness_unit))
    length, stiffness = units
    each = tuple(whisker.section(length, stiffness) for whisker in whiskers)
    kinds = [(jax.tree.structure(section), [leaf.shape for leaf in jax.tree.leaves(section)]) for section in each]
    if any(kind != kinds[0] for kind in kinds):
        return each
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)


def _valid(scene: Scene) -> Bool[Array, ""]:
    # Whether traced parameters lie where the constructors would have let them.
    whiskers = jnp.all(jnp.stack([whisker.valid() for whisker in scene.whiskers]))
    return scene.profile.valid() & scene.support.valid() & scene.motion.valid() & whiskers
