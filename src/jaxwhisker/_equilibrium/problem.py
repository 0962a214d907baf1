"""The dimensionless problem: the form of a scene that enters the equations and that programs are compiled for.

Lengths are in the length L of the first whisker, forces in EI/L^2, moments in EI/L and spring stiffnesses in EI/L^3,
with EI its bending stiffness at the base. Scenes with the same problem shape (number of whiskers; kinds of rods,
profile and motion; coordinates of the bases) share their compiled programs, no matter which springs couple the bases.

There are two kinds of problems, which differ in the coordinates of the bases. In `AlongX` the bases stay upright at
height 0, and their only coordinate is x. In `InPlane` a base has three coordinates, x, y and angle, in its own frame:
the pose that its mount on the drive gives it. Springs on shafts need all three. Everything that depends on the
coordinates is a method of these two classes.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import touch
from jaxwhisker._equilibrium.bent import free_contact, outline_of
from jaxwhisker._equilibrium.contact import Base, Phase, Sprung, WhiskerAtObject, of_each
from jaxwhisker._equilibrium.couplings import Couplings, given_by, incidence_of
from jaxwhisker._equilibrium.shaft_springs import Attachments, Laws
from jaxwhisker._equilibrium.stance import Contacts, PerObject, PerWhisker, Poses, ScenePose, Stance
from jaxwhisker._equilibrium.touch import Outline, TouchAlongX
from jaxwhisker._model.motion import AbstractMotion, Frame, Pose, frame_and_rate, mounted
from jaxwhisker._model.network import Flexibility
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Units
from jaxwhisker._rod.elastica import AbstractRod
from jaxwhisker._rod.rod import Section

AT_ORIGIN = Pose(0.0, 0.0, 0.0)


class Attached(NamedTuple):
    """Springs on the shafts of all whiskers, and the whiskers before any contact."""

    held_by: Attachments  # fields (whiskers, springs) and (whiskers,)
    laws: Laws
    held: Float[Array, "whiskers axes axes"]  # see contact.Sprung
    contact: Contacts  # of unloaded whiskers
    pose: Poses  # of their bases, from `Problem.rest`
    couplings: Couplings | None = None  # None without springs between two shafts


class Problem(eqx.Module):
    """A dimensionless scene. Whiskers are stacked along the first axis."""

    length: PerWhisker
    bending_stiffness: PerWhisker  # at the base
    section: Section | tuple[Section, ...] | None  # see contact.WhiskerAtObject
    profile: AbstractProfile
    rod: AbstractRod
    motion: AbstractMotion  # its poses only
    onwards: Int[Array, ""]  # +1 if the control increases during a scan, else -1
    ends: tuple[Scalar, Scalar] | None  # controls at which a bounded motion begins and ends
    flexibility: Flexibility
    # First touches of unloaded whiskers from the right and from the left, with the drive at control 0; of each object
    # if there are several.
    touch_right: TouchAlongX
    touch_left: TouchAlongX
    valid: Bool[Array, ""]
    unit: Units
    friction_angle: Scalar | None  # arctan of the friction coefficient; None without friction
    attached: Attached | None = eqx.field(default=None, kw_only=True)  # None without springs on any shaft

    axes: eqx.AbstractClassVar[int]  # number of coordinates of a base
    stance_is_known: eqx.AbstractClassVar[bool]  # whether nothing is to be computed for a stance
    frames_move: eqx.AbstractClassVar[bool]  # whether these refer to a frame that moves with the control

    @abc.abstractmethod
    def frames(self, u: Scalar) -> tuple[Frame | None, Frame | None]:
        """Frames of all bases at a control, and their derivatives with respect to it; None in the scene's frame."""

    @abc.abstractmethod
    def rest(self, u: Scalar) -> Poses:
        """Coordinates of the unloaded bases."""

    @abc.abstractmethod
    def rest_rate(self, du: Scalar) -> Scalar:
        """Change of the x coordinate of an unloaded base when the control changes by `du`."""

    @abc.abstractmethod
    def in_scene(self, u: Scalar, pose: Poses) -> ScenePose:
        """Poses of bases in the scene."""

    @abc.abstractmethod
    def stance(self, u: Scalar, pose: Poses, z: Contacts | None = None) -> Stance:
        """Stance of whiskers whose bases have these coordinates.

        With springs between two shafts, the loads of these in the contacts z are needed, too.
        """

    @abc.abstractmethod
    def shift(self, u: Scalar, distance: PerWhisker) -> Poses:
        """Change of the coordinates of bases that move a distance along the scene's x axis."""

    @abc.abstractmethod
    def touch_rate(self, side: PerObject, pose_rate: Poses) -> PerObject:
        """Rate at which free whiskers recede from their first touch, or zero if it is not known."""

    @abc.abstractmethod
    def updated_side(self, free: Bool[Array, " whiskers"], side: PerObject, at: Stance) -> PerObject:
        """Sides of whiskers; free ones may have passed below the object, out of its reach."""

    @abc.abstractmethod
    def across(self, pose: Poses) -> Float[Array, "whiskers 2"] | None:
        """Coordinates across the branches of the whiskers (y and angle); None if they are fixed."""

    @abc.abstractmethod
    def not_destabilising(self, slope: Float[Array, "whiskers axes axes"]) -> Float[Array, "whiskers axes axes"]:
        """Slopes d load / d pose without the part that can destabilise the bases."""

    @abc.abstractmethod
    def further_residuals(self, base: Base, pose: ScenePose) -> list[PerWhisker]:
        """Residuals of touching whiskers that their coordinates alone do not show."""

    @abc.abstractmethod
    def if_defined(self, residual: Scalar, pose: ScenePose) -> Scalar:
        """The residual, or infinity if the motion of the drive is not defined here (its pose is not finite)."""

    def bodies(self, u: Scalar, z: Contacts, piece: Int[Array, " whiskers"] | None = None) -> WhiskerAtObject:
        """All whiskers, stacked, at a control, with the loads of springs in their contacts z.

        `piece` is that of the profile at each contact.
        """
        del z
        angle = None if self.friction_angle is None else jnp.full_like(self.length, self.friction_angle)
        return WhiskerAtObject(
            self.length, self.bending_stiffness, self.profile, self.rod, self.section, *self.frames(u), angle, piece
        )

    def solved(self, phase: Int[Array, " whiskers"]) -> Bool[Array, " whiskers"]:
        """The whiskers whose equations are solved; free ones are known unless springs on their shafts bend them."""
        return phase != Phase.free

    def bends_from(self, phase: Int[Array, " whiskers"], side: PerWhisker) -> PerWhisker:
        """Sides that decide the direction of the whiskers' branches; for free whiskers, it is that of the right."""
        del phase
        return side

    @property
    def placeholder_parameter(self) -> PerWhisker:
        """Any parameter of the profile's first piece, for free whiskers."""
        touch = jax.lax.stop_gradient(self.touch_right.parameter)
        touch = touch[0] if len(self.profile.objects) > 1 else touch
        return jnp.where(jnp.isfinite(touch), touch, 0.0)

    def unloaded(self, u: Scalar) -> tuple[Contacts, Poses]:
        """Contacts (see contact.py) and base coordinates of whiskers before any contact."""
        rest = self.rest(u)
        return jnp.zeros((rest.shape[0], 3)), rest

    def numbers(self) -> "Problem":
        """The numbers that equilibria depend on, and None for everything else."""
        numbers = eqx.filter(self, eqx.is_inexact_array)
        return eqx.tree_at(self._decisive, numbers, replace_fn=lambda _: None, is_leaf=lambda leaf: leaf is None)

    def _decisive(self, tree: Any) -> list:
        """Fields of a tree like this that enter decisions and first guesses only."""
        return [tree.touch_right, tree.touch_left, tree.flexibility.root, tree.ends]

    @property
    def offset(self) -> Poses:
        """Displacement of the unloaded bases due to the rest lengths of the springs."""
        return jnp.reshape(self.flexibility.offset, (self.length.shape[0], self.axes))

    def displacement(self, load: Poses) -> Poses:
        """Displacement of the bases under loads: flexibility @ load."""
        return jnp.reshape(jnp.sum(self.flexibility.matrix * jnp.ravel(load), axis=-1), load.shape)


class AlongX(Problem):
    """A problem whose bases stay upright at height 0 and move along x only."""

    axes: ClassVar[int] = 1
    stance_is_known: ClassVar[bool] = True
    frames_move: ClassVar[bool] = False

    def frames(self, u):
        del u
        return None, None

    def rest(self, u):
        return u + self.offset

    def rest_rate(self, du):
        return du

    def in_scene(self, u, pose):
        del u
        return ScenePose(pose[:, 0], jnp.zeros_like(pose[:, 0]), jnp.zeros_like(pose[:, 0]))

    def stance(self, u, pose, z=None):
        del u, z
        return Stance(pose[:, 0], self.touch_right, self.touch_left)

    def shift(self, u, distance):
        del u
        return distance[:, None]

    def touch_rate(self, side, pose_rate):
        return side * pose_rate[:, 0]

    def updated_side(self, free, side, at):
        del free, at
        return side

    def across(self, pose):
        del pose

    def not_destabilising(self, slope):
        return slope.at[:, 0, 0].set(jnp.minimum(slope[:, 0, 0], 0.0))

    def further_residuals(self, base, pose):
        del pose
        return [jnp.where(base.sin > 0, 0.0, jnp.inf)]  # `turn` is a sine, which does not distinguish up from down

    def if_defined(self, residual, pose):
        del pose
        return residual


class InPlane(Problem):
    """A problem whose bases move and turn in the plane, or whose drive does not just move along x."""

    mount: Pose  # of every whisker on the drive
    outline: Outline  # of the unloaded whiskers, if no spring bends them

    axes: ClassVar[int] = 3
    stance_is_known: ClassVar[bool] = False
    frames_move: ClassVar[bool] = True

    def _decisive(self, tree):
        unloaded = [] if self.attached is None else [tree.attached.contact, tree.attached.pose]
        return [*super()._decisive(tree), tree.outline, *unloaded]

    def drive(self, u: Scalar) -> Pose:
        """The pose of the drive's frame."""
        x, y, angle = self.motion.pose(u * self.unit.control)
        return Pose(x / self.unit.length, y / self.unit.length, angle)

    def frames(self, u):
        return frame_and_rate(self.drive, self.mount, u)

    def bodies(self, u, z, piece=None):
        if self.attached is not None and piece is None and self.profile.has_pieces:
            piece = jnp.zeros(self.length.shape, int)  # free whiskers may have any
        bodies = super().bodies(u, z, piece)
        if self.attached is None:
            return bodies

        def drive(u):
            return jax.tree.map(lambda part: jnp.full_like(self.length, part), mounted(self.drive(u), AT_ORIGIN))

        frame, rate = jax.jvp(drive, (u,), (jnp.ones_like(u),))
        held_by, laws, couplings, incidence = self.attached.held_by, self.attached.laws, self.attached.couplings, None
        if couplings is not None:
            incidence = incidence_of(couplings, held_by)
            held_by = held_by._replace(given=given_by(couplings, z, held_by))
        sprung = Sprung(held_by, frame, rate, self.attached.held, self.offset, self.placeholder_parameter, incidence)
        return bodies._replace(sprung=sprung, laws=laws)

    def solved(self, phase):
        return super().solved(phase) if self.attached is None else jnp.ones_like(phase, bool)

    def bends_from(self, phase, side):
        return side if self.attached is None else jnp.where(phase == Phase.free, 1.0, side)

    def unloaded(self, u):
        if self.attached is None:
            return super().unloaded(u)
        return self.attached.contact, self.rest(u) + self.attached.pose

    def rest(self, u):
        del u
        return self.offset

    def rest_rate(self, du):
        del du
        return 0.0  # the frames move with the control

    def in_scene(self, u, pose):
        frame, _ = self.frames(u)
        x, y, turn = pose.T
        return ScenePose(
            frame.x + x * frame.cos - y * frame.sin,
            frame.y + x * frame.sin + y * frame.cos,
            jnp.arctan2(frame.sin, frame.cos) + turn,
        )

    def stance(self, u, pose, z=None):
        at, outline, free, loads = self.in_scene(u, pose), self.outline, None, None
        if self.attached is not None:
            unloaded, start = self.unloaded(u)
            bodies = self.bodies(u, unloaded if z is None else z)
            free = of_each(bodies, free_contact, unloaded[:, :3], pose - start, pose)
            outline = of_each(bodies, outline_of, free)
            if self.attached.couplings is not None and z is not None:
                loads = z[:, 3:]
                free = jnp.concatenate([free, loads], axis=1)

        def both(profile):
            each = jax.vmap(lambda *own: touch.first_touches(profile, *own))
            return each(self.length, outline, at.y, at.angle)

        return Stance(at.x, *touch.of_objects(self.profile, both), free, loads)

    def shift(self, u, distance):
        frame, _ = self.frames(u)
        return distance[:, None] * jnp.stack([frame.cos, -frame.sin, jnp.zeros_like(frame.cos)], axis=1)

    def touch_rate(self, side, pose_rate):
        del pose_rate
        return jnp.zeros_like(side)

    def updated_side(self, free, side, at):
        return jnp.where(free & ~at.right.reaches & ~at.left.reaches, at.side, side)

    def across(self, pose):
        return pose[:, 1:]

    def not_destabilising(self, slope):
        return jnp.zeros_like(slope)

    def further_residuals(self, base, pose):
        del base, pose
        return []

    def if_defined(self, residual, pose):
        # Free whiskers contribute no residual, so the pose itself is checked.
        return jnp.where(jnp.all(jnp.isfinite(jnp.stack(pose))), residual, jnp.inf)
