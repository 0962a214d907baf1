"""The dimensionless problem of a scene whose whiskers may have several contacts each: what programs are compiled for.

Lengths are in the length L of the first whisker, forces in EI/L^2 and moments in EI/L, with EI its bending stiffness at
the base. Bases have three coordinates, x, y and angle, in their own frames: the poses that their mounts give them.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import safe_placeholder
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import WhiskerAtObject
from jaxwhisker._equilibrium.dimensionless import is_valid, sections
from jaxwhisker._equilibrium.stance import PerWhisker, ScenePose
from jaxwhisker._model.canonical import CanonicalScene
from jaxwhisker._model.motion import AbstractMotion, Frame, Pose, frame_and_rate
from jaxwhisker._model.network import Flexibility
from jaxwhisker._model.objects import Objects
from jaxwhisker._model.scene import Units, units_of
from jaxwhisker._rod.elastica import AbstractRod
from jaxwhisker._rod.rod import Section

BasePoses = Float[Array, "whiskers 3"]


class ChainProblem(eqx.Module):
    """A dimensionless scene with several contacts. Whiskers are stacked along the first axis."""

    length: PerWhisker
    bending_stiffness: PerWhisker  # at the base
    section: Section | tuple[Section, ...] | None  # see contact.WhiskerAtObject
    profile: Objects
    rod: AbstractRod
    motion: AbstractMotion  # its poses only
    mount: Pose  # of every whisker on the drive
    flexibility: Flexibility
    onwards: Int[Array, ""]  # +1 if the control increases during a scan, else -1
    ends: tuple[Scalar, Scalar] | None  # controls at which a bounded motion begins and ends
    valid: Bool[Array, ""]
    unit: Units
    friction_angle: Scalar | None  # arctan of the friction coefficient; None without friction
    contacts: int = eqx.field(static=True)  # the largest number of contacts of a whisker

    def numbers(self) -> "ChainProblem":
        """The numbers that equilibria depend on, and None for everything else."""
        numbers = eqx.filter(self, eqx.is_inexact_array)
        decisive = lambda tree: [tree.flexibility.root, tree.ends]  # noqa: E731
        return eqx.tree_at(decisive, numbers, replace_fn=lambda _: None, is_leaf=lambda leaf: leaf is None)

    @property
    def rows(self) -> int:
        """Number of contacts that there is room for, of all whiskers."""
        return self.length.shape[0] * self.contacts

    def drive(self, u: Scalar) -> Pose:
        """The pose of the drive's frame."""
        x, y, angle = self.motion.pose(u * self.unit.control)
        return Pose(x / self.unit.length, y / self.unit.length, angle)

    def frames(self, u: Scalar) -> tuple[Frame, Frame]:
        """Frames of all bases at a control, and their derivatives with respect to it."""
        return frame_and_rate(self.drive, self.mount, u)

    @property
    def rest(self) -> BasePoses:
        """Coordinates of the unloaded bases."""
        return jnp.reshape(self.flexibility.offset, (-1, 3))

    def displacement(self, load: BasePoses) -> BasePoses:
        """Displacement of the bases under loads: flexibility @ load."""
        return jnp.reshape(jnp.sum(self.flexibility.matrix * jnp.ravel(load), axis=-1), load.shape)

    def in_scene(self, u: Scalar, pose: BasePoses) -> ScenePose:
        """Poses of bases in the scene."""
        frame, _ = self.frames(u)
        x, y, turn = pose.T
        return ScenePose(
            frame.x + x * frame.cos - y * frame.sin,
            frame.y + x * frame.sin + y * frame.cos,
            jnp.arctan2(frame.sin, frame.cos) + turn,
        )

    def bodies(self, u: Scalar) -> WhiskerAtObject:
        """All whiskers, stacked, at a control."""
        whiskers = self.length, self.bending_stiffness, self.profile, self.rod, self.section
        angle = None if self.friction_angle is None else jnp.full_like(self.length, self.friction_angle)
        return WhiskerAtObject(*whiskers, *self.frames(u), angle)


def chain_problem(scene: CanonicalScene, contacts: int) -> ChainProblem:
    """The dimensionless problem of a scene, differentiable with respect to all numbers of the scene."""
    valid = is_valid(scene)
    scene = safe_placeholder(scene, valid)
    unit = jax.tree.map(checks.as_float, units_of(scene.whiskers[0], scene.motion))
    length = jnp.stack([jnp.asarray(w.length, dtype=float) for w in scene.whiskers]) / unit.length
    stiffness = jnp.stack([jnp.asarray(w.base_stiffness, dtype=float) for w in scene.whiskers])
    upright: Any = jnp.zeros_like(length)
    mounts = [upright, upright, upright]
    if not scene.along_x:
        own = zip(*((mount.x, mount.y, mount.angle) for mount in scene.support.mounts), strict=True)
        mounts = [jnp.stack([jnp.asarray(v, dtype=float) for v in vs]) for vs in own]
    x, y, angle = mounts
    flexibility = scene.support.flexibility(None)
    return ChainProblem(
        length=length,
        bending_stiffness=stiffness / (unit.moment * unit.length),
        section=sections(scene.whiskers, unit.length, unit.moment * unit.length),
        profile=Objects(scene.profile.objects).in_unit(unit.length),
        rod=scene.rod,
        motion=scene.motion,
        mount=Pose(x / unit.length, y / unit.length, angle),
        flexibility=flexibility.in_frames(angle, unit.length, unit.force),
        onwards=jnp.asarray(scene.onwards),
        ends=jax.tree.map(lambda end: jnp.asarray(end, dtype=float) / unit.control, scene.ends),
        valid=valid & flexibility.consistent,
        unit=unit,
        friction_angle=None if scene.friction is None else jnp.arctan(jnp.asarray(scene.friction, dtype=float)),
        contacts=contacts,
    )
