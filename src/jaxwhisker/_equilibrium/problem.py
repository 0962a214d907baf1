"""The dimensionless problem: the form of a scene that enters the equations and that programs are compiled for.

Lengths are in the length L of the first whisker, forces in EI/L^2, moments in EI/L and spring stiffnesses in EI/L^3,
with EI its bending stiffness at the base. Scenes with the same problem shape (number of whiskers; kinds of rods,
profile and motion; coordinates of the bases) share their compiled programs, no matter which springs couple the bases.

There are two kinds of problems, which differ in the coordinates of the bases. In `AlongX` the bases stay upright at
height 0, and their only coordinate is x. In `InPlane` a base has three coordinates, x, y and angle, in its own frame:
the pose that its mount on the drive gives it. Everything that depends on the coordinates is a method of these two
classes.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import safe_placeholder
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import touch
from jaxwhisker._equilibrium.contact import Base, Body
from jaxwhisker._equilibrium.touch import Outline, Touch
from jaxwhisker._model.motion import AbstractMotion, Frame, Pose, frame_and_rate
from jaxwhisker._model.network import Flexibility
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, Units, moves_along_x, units
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import AbstractRod
from jaxwhisker._rod.rod import Section

PerWhisker = Float[Array, " whiskers"]
Poses = Float[Array, "whiskers axes"]


class ScenePose(NamedTuple):
    """Poses of bases in the scene, dimensionless; angles to the upright, rad, positive counter-clockwise."""

    x: PerWhisker
    y: PerWhisker
    angle: PerWhisker


class Stance(NamedTuple):
    """Positions of bases in the scene, and the first touches of their unloaded whiskers if the bases moved along x."""

    x: PerWhisker
    right: Touch  # in an approach from the right
    left: Touch

    def first(self, side: PerWhisker) -> Touch:
        """First touches of whiskers that approach from these sides (+1 right, -1 left)."""
        return jax.tree.map(lambda right, left: jnp.where(side > 0, right, left), self.right, self.left)

    @property
    def clear(self) -> Bool[Array, " whiskers"]:
        """Whether unloaded whiskers stand clear of the object."""
        return ~self.right.reaches | (self.x > self.right.x) | (self.x < self.left.x)

    @property
    def side(self) -> PerWhisker:
        """The side of the object on which a whisker stands, or the nearer side: +1 right, -1 left."""
        return jnp.where(self.x - self.right.x >= self.left.x - self.x, 1.0, -1.0)


class Problem(eqx.Module):
    """A dimensionless scene. Whiskers are stacked along the first axis."""

    length: PerWhisker
    bending_stiffness: PerWhisker  # at the base
    section: Section | tuple[Section, ...] | None  # see contact.Body
    profile: AbstractProfile
    rod: AbstractRod
    motion: AbstractMotion
    flexibility: Flexibility | None
    touch_right: Touch  # first touches of unloaded whiskers from the right, with the drive at control 0
    touch_left: Touch
    valid: Bool[Array, ""]
    unit: Units
    friction_angle: Scalar | None  # arctan of the friction coefficient; None without friction
    detect: tuple[str, ...] = eqx.field(static=True)  # of `Scene.detects`, what can happen

    axes: eqx.AbstractClassVar[int]  # number of coordinates of a base
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
    def stance(self, u: Scalar, pose: Poses) -> Stance:
        """Stance of whiskers whose bases have these coordinates."""

    @abc.abstractmethod
    def stances(self, *at: tuple[Scalar, Poses]) -> list[Stance]:
        """Stances at several pairs of control and coordinates."""

    @abc.abstractmethod
    def shift(self, u: Scalar, distance: PerWhisker) -> Poses:
        """Change of the coordinates of bases that move a distance along the scene's x axis."""

    @abc.abstractmethod
    def touch_rate(self, side: PerWhisker, pose_rate: Poses) -> PerWhisker:
        """Rate at which free whiskers recede from their first touch, or zero if it is not known."""

    @abc.abstractmethod
    def updated_side(self, free: Bool[Array, " whiskers"], side: PerWhisker, at: Stance) -> PerWhisker:
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

    def bodies(self, u: Scalar, piece: Int[Array, " whiskers"] | None = None) -> Body:
        """All whiskers, stacked, at a control; `piece` is that of the profile at each contact."""
        angle = None if self.friction_angle is None else jnp.full_like(self.length, self.friction_angle)
        return Body(
            self.length, self.bending_stiffness, self.profile, self.rod, self.section, *self.frames(u), angle, piece
        )

    def numbers(self) -> "Problem":
        """The numbers that equilibria depend on, and None for everything else."""
        numbers = eqx.filter(self, eqx.is_inexact_array)
        return eqx.tree_at(self._decisive, numbers, replace_fn=lambda _: None, is_leaf=lambda leaf: leaf is None)

    def _decisive(self, tree: Any) -> list:
        """Fields of a tree like this that enter decisions and first guesses only."""
        return [tree.touch_right, tree.touch_left, *([] if self.flexibility is None else [tree.flexibility.root])]

    @property
    def offset(self) -> Poses:
        """Displacement of the unloaded bases due to the rest lengths of the springs."""
        none = jnp.zeros((self.length.shape[0], self.axes))
        return none if self.flexibility is None else jnp.reshape(self.flexibility.offset, none.shape)

    def displacement(self, load: Poses) -> Poses:
        """Displacement of the bases under loads: flexibility @ load; zero for a clamped whisker."""
        if self.flexibility is None:
            return jnp.zeros_like(load)
        return jnp.reshape(jnp.sum(self.flexibility.matrix * jnp.ravel(load), axis=-1), load.shape)


class AlongX(Problem):
    """A problem whose bases stay upright at height 0 and move along x only."""

    axes: ClassVar[int] = 1
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

    def stance(self, u, pose):
        del u
        return Stance(pose[:, 0], self.touch_right, self.touch_left)

    def stances(self, *at):
        return [self.stance(*one) for one in at]

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
    outline: Outline  # of the unloaded whiskers

    axes: ClassVar[int] = 3
    frames_move: ClassVar[bool] = True

    def _decisive(self, tree):
        return [*super()._decisive(tree), tree.outline]

    def drive(self, u: Scalar) -> Pose:
        """The pose of the drive's frame."""
        x, y, angle = self.motion.pose(u * self.unit.control)
        return Pose(x / self.unit.length, y / self.unit.length, angle)

    def frames(self, u):
        return frame_and_rate(self.drive, self.mount, u)

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

    def stance(self, u, pose):
        at = self.in_scene(u, pose)

        def both(*own):
            return touch.first_touches(self.profile, *own)

        return Stance(at.x, *jax.vmap(both)(self.length, self.outline, at.y, at.angle))

    def stances(self, *at):
        # As one batch, the search for a touch is compiled only once.
        batch = jax.vmap(self.stance)(*map(jnp.stack, zip(*at, strict=True)))
        return [jax.tree.map(lambda leaf, k=k: leaf[k], batch) for k in range(len(at))]

    def shift(self, u, distance):
        frame, _ = self.frames(u)
        return distance[:, None] * jnp.stack([frame.cos, -frame.sin, jnp.zeros_like(frame.cos)], axis=1)

    def touch_rate(self, side, pose_rate):
        del side
        return jnp.zeros_like(pose_rate[:, 0])

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


def problem_of(scene: Scene) -> Problem:
    """The dimensionless problem of a scene, differentiable with respect to all numbers of the scene."""
    valid = _valid(scene)
    scene = safe_placeholder(scene, valid)
    unit = jax.tree.map(checks.as_float, units(scene))
    length = jnp.stack([jnp.asarray(w.length, dtype=float) for w in scene.whiskers]) / unit.length
    stiffness = jnp.stack([jnp.asarray(w.base_stiffness, dtype=float) for w in scene.whiskers])
    section = sections(scene.whiskers, unit.length, unit.moment * unit.length)
    flexibility = scene.support.flexibility()
    if flexibility is not None:
        valid &= flexibility.consistent
    common: dict[str, Any] = {
        "length": length,
        "bending_stiffness": stiffness / (unit.moment * unit.length),
        "section": section,
        "profile": scene.profile.in_unit(unit.length),
        "rod": scene.rod,
        "motion": scene.motion,
        "unit": unit,
        "friction_angle": None if scene.friction is None else jnp.arctan(jnp.asarray(scene.friction, dtype=float)),
        "detect": _detectable(scene),
    }
    curved = any(whisker.intrinsic_curvature is not None for whisker in scene.whiskers)
    if moves_along_x(scene):
        flexibility = None if flexibility is None else flexibility.in_unit(unit.length, unit.force)
        if curved:
            upright = jnp.zeros_like(length)
            outline = outlines(scene.whiskers, length, section)
            touches, single = _first_touches(common["profile"], outline, length, upright, upright, curved)
        else:
            touches, single = _first_touches_upright(common["profile"], length), True
        return AlongX(**common, **touches, flexibility=flexibility, valid=valid & single)
    mounts = zip(*((mount.x, mount.y, mount.angle) for mount in scene.support.mounts), strict=True)
    x, y, angle = (jnp.stack([jnp.asarray(v, dtype=float) for v in vs]) for vs in mounts)
    mount = Pose(x / unit.length, y / unit.length, angle)
    flexibility = None if flexibility is None else flexibility.in_frames(angle, unit.length, unit.force)
    outline = outlines(scene.whiskers, length, section)
    touches, single = _first_touches(common["profile"], outline, length, y / unit.length, angle, curved)
    return InPlane(**common, **touches, flexibility=flexibility, valid=valid & single, mount=mount, outline=outline)


def _detectable(scene: Scene) -> tuple[str, ...]:
    """What a scene is to detect, without what cannot happen.

    Without friction, a uniform straight whisker stays on the outer side of the object's tangent at its contact, which a
    convex object does not cross. Let theta be the angle from the tangent to the whisker, theta1 its value at the
    contact: EI theta'^2 / 2 = f (sin theta - sin theta1), therefore sin theta >= sin theta1 >= 0 along the shaft.
    """
    possible = {
        "second_contact": scene.friction is not None or not all(whisker.uniform for whisker in scene.whiskers),
        "crossing": len(scene.whiskers) > 1,
    }
    return tuple(name for name in scene.detects if possible[name])


def _first_touches_upright(profile: AbstractProfile, length: PerWhisker) -> dict[str, Any]:
    """First touches of straight whiskers that stand upright at height 0."""
    right, left = (jax.vmap(lambda h, s=s: touch.first_touch_upright(profile, h, s))(length) for s in (1.0, -1.0))
    return {"touch_right": right, "touch_left": left}


def _first_touches(
    profile: AbstractProfile, outline: Outline, length: PerWhisker, height: PerWhisker, angle: PerWhisker, curved: bool
) -> tuple[dict[str, Any], Bool[Array, ""] | bool]:
    """First touches of whiskers with these outlines, and whether each touches the object in one place only."""
    right, left = jax.vmap(lambda *own: touch.first_touches(profile, *own))(length, outline, height, angle)
    touches = {"touch_right": right, "touch_left": left}
    if not curved:
        return touches, True
    return touches, ~jnp.any(jax.vmap(lambda *own: touch.in_two_places(profile, *own))(outline, height, angle))


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
    whiskers: tuple[Whisker, ...], length_unit: Scalar, stiffness_unit: Scalar
) -> Section | tuple[Section, ...] | None:
    """Sections of all whiskers: None if all are uniform, stacked if they differ in numbers only, otherwise a tuple."""
    if all(whisker.uniform for whisker in whiskers):
        return None
    whiskers = jax.tree.map(checks.as_float, whiskers)
    length, stiffness = (jnp.asarray(unit, dtype=float) for unit in (length_unit, stiffness_unit))
    each = tuple(whisker.section(length, stiffness) for whisker in whiskers)
    kinds = [(jax.tree.structure(section), [leaf.shape for leaf in jax.tree.leaves(section)]) for section in each]
    if any(kind != kinds[0] for kind in kinds):
        return each
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)


def _valid(scene: Scene) -> Bool[Array, ""]:
    """Whether traced parameters are in the domains that the constructors check for concrete ones."""
    whiskers = jnp.all(jnp.stack([whisker.valid() for whisker in scene.whiskers]))
    valid = scene.profile.valid() & scene.support.valid() & scene.motion.valid() & whiskers
    if scene.friction is None:
        return valid
    return valid & (scene.friction >= 0) & jnp.isfinite(scene.friction)
