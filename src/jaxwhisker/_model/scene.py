"""The scene: whiskers, object and support, and the one place where conventions stand.

Frame: x along the scan, y up. The base of whisker i is at (x_i, 0), clamped along +y; the object lies above its
profile, whose vertex has the height q (the object distance). Scanning moves the drive u towards -x. Without load base i
rests at u plus the rest lengths of the springs on its way from the drive: the drive leads, the whiskers trail.

Contact force: frictionless, f >= 0, on the whisker along the object's outward normal, f (sin alpha, -cos alpha).
Support reaction: what the support exerts on the whisker at its base,

    fx = -f sin(alpha),   fy = +f cos(alpha),   mz = -EI kappa(0)   (counter-clockwise positive).

Inside, everything is dimensionless in length L and bending stiffness EI of the first whisker: forces EI/L^2, moments
EI/L, spring stiffnesses EI/L^3.

Where the drive turns (motion.py), springs act along the axes of its frame; everything else is told in the scene's.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.functions import name_of
from jaxwhisker._base.lanes import harmless
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import touch
from jaxwhisker._equilibrium.contact import Body
from jaxwhisker._equilibrium.touch import Outline, Touch
from jaxwhisker._model.motion import AbstractMotion, Frame, Pose, Translation, frame_and_rate
from jaxwhisker._model.network import Flexibility
from jaxwhisker._model.profile import AbstractProfile, differs, show
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Section, Whisker
from jaxwhisker._rod.elastica import AbstractRod, ClosedForm, Shooting


class Scene(eqx.Module):
    """Whiskers on a support, scanned past an object.

    Args:
        whisker: one Whisker for all bases, or a tuple with one per base.
        profile: the object.
        support: the springs between drive and bases; clamped by default.
        rod: how rods are computed: Shooting(), or ClosedForm(), which is faster and exact to rounding.
        motion: of the drive: Translation(), Rotation(), or a Motion of one's own.

    Raises:
        ValueError: if an argument is not of that kind, or their numbers of whiskers differ.
    """

    whisker: Whisker | tuple[Whisker, ...]
    profile: AbstractProfile
    support: Support = Support()
    rod: AbstractRod = Shooting()
    motion: AbstractMotion = Translation()

    def __check_init__(self):
        if not isinstance(self.profile, AbstractProfile):
            raise ValueError(
                f"`profile` must be a Parabola, Circle, Ellipse, Graph, Contour or Tilted, but is {self.profile!r}."
            )
        check_sensor(self.whisker, self.support, self.motion)
        if not isinstance(self.rod, AbstractRod):
            raise ValueError(f"`rod` must be Shooting() or ClosedForm(), but is {self.rod!r}.")
        if isinstance(self.rod, ClosedForm) and not all(w.uniform for w in self.whiskers):
            raise ValueError(
                "`rod` must be Shooting() for whiskers that are curved or not uniform, but is ClosedForm(): elliptic "
                "functions solve uniform straight whiskers only."
            )

    @property
    def whiskers(self) -> tuple[Whisker, ...]:
        """One Whisker per base."""
        return each_whisker(self.whisker, self.support)

    def __str__(self) -> str:
        n, springs = self.support.whiskers, len(self.support.springs)
        counted = [f"{n} whisker" + "s" * (n > 1), *[f"{springs} spring" + "s" * (springs > 1)] * (springs > 0)]
        first = self.whiskers[0]
        material = differs(", L = ", first.length, 1.0)
        if callable(first.bending_stiffness):
            material += f", EI = {name_of(first.bending_stiffness)}(s)"
        else:
            material += differs(", EI = ", first.bending_stiffness, 1.0)
        if callable(first.intrinsic_curvature):
            material += f", kappa0 = {name_of(first.intrinsic_curvature)}(s)"
        elif first.intrinsic_curvature is not None:
            material += f", kappa0 = {show(first.intrinsic_curvature)}"
        rods = "" if self.rod == Shooting() else f", {self.rod}"
        motion = "" if isinstance(self.motion, Translation) and self.motion.onwards < 0 else f", {self.motion}"
        return f"{self.support.name}: {', '.join(counted)}, {self.profile}{material}{rods}{motion}"

    __repr__ = __str__


def check_sensor(whisker: Any, support: Any, motion: Any) -> None:
    """Check what a scene has but its object.

    Raises:
        ValueError: if an argument is not of its kind, or their numbers of whiskers differ.
    """
    whiskers = whisker if isinstance(whisker, tuple) else (whisker,)
    if not whiskers or not all(isinstance(w, Whisker) for w in whiskers):
        raise ValueError(f"`whisker` must be a Whisker or a tuple of them, but is {whisker!r}.")
    if not isinstance(support, Support):
        raise ValueError(f"`support` must be a Support, but is {support!r}.")
    if not isinstance(motion, AbstractMotion):
        raise ValueError(f"`motion` must be a Translation, Rotation or Motion, but is {motion!r}.")
    if isinstance(whisker, tuple) and len(whiskers) != support.whiskers:
        raise ValueError(
            f"`whisker` must be one Whisker or one per base ({support.whiskers} in {support.name}), "
            f"but is a tuple of {len(whiskers)}."
        )


def each_whisker(whisker: Whisker | tuple[Whisker, ...], support: Support) -> tuple[Whisker, ...]:
    """One Whisker per base."""
    return whisker if isinstance(whisker, tuple) else (whisker,) * support.whiskers


class Units(NamedTuple):
    """Sizes of the dimensionless problem's units in the scene's own."""

    length: Scalar
    force: Scalar
    moment: Scalar
    control: Scalar


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


def units(scene: Scene) -> Units:
    """Units in which the scene's problem is dimensionless."""
    return units_of(scene.whiskers[0], scene.motion)


def units_of(first: Whisker, motion: AbstractMotion) -> Units:
    """L, EI/L^2, EI/L of the first whisker's base, and the motion's own."""
    length, stiffness = first.length, first.base_stiffness
    return Units(length, stiffness / length**2, stiffness / length, motion.unit(length))


def moves_along_x(scene: Scene) -> bool:
    """Whether all bases stay upright at height 0 and move along x only: the rest is then left out."""
    along_x = isinstance(scene.motion, Translation) and scene.support.axes in ((), ("x",))
    return along_x and scene.support.mount is None


def problem(scene: Scene) -> Problem:
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
    units = (jnp.asarray(unit, dtype=float) for unit in (length_unit, stiffness_unit, 1.0))
    length, stiffness, one = units
    each = tuple(Section(whisker, length, stiffness, one) for whisker in whiskers)
    kinds = [(jax.tree.structure(section), [leaf.shape for leaf in jax.tree.leaves(section)]) for section in each]
    if any(kind != kinds[0] for kind in kinds):
        return each
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)


def _valid(scene: Scene) -> Bool[Array, ""]:
    # Whether traced parameters lie where the constructors would have let them.
    whiskers = jnp.all(jnp.stack([whisker.valid() for whisker in scene.whiskers]))
    return scene.profile.valid() & scene.support.valid() & scene.motion.valid() & whiskers
