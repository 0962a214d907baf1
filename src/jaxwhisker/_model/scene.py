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

from jaxwhisker._base.functions import name_of
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.motion import AbstractMotion, Translation
from jaxwhisker._model.profile import AbstractProfile, differs, show
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
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


class Sensor(eqx.Module):
    """Whiskers on a support: a Scene without its object.

    Args:
        whisker: one Whisker for all bases, or a tuple with one per base.
        support: the springs between drive and bases; clamped by default.
        motion: of the drive: Translation(), Rotation(), or a Motion of one's own.

    Raises:
        ValueError: if an argument is not of that kind, or their numbers of whiskers differ.
    """

    whisker: Whisker | tuple[Whisker, ...]
    support: Support = Support()
    motion: AbstractMotion = Translation()

    def __check_init__(self):
        check_sensor(self.whisker, self.support, self.motion)

    @classmethod
    def of(cls, scene: Scene) -> "Sensor":
        """The sensor of a scene."""
        return cls(scene.whisker, scene.support, scene.motion)

    def before(self, profile: AbstractProfile) -> Scene:
        """The scene with that object."""
        return Scene(self.whisker, profile, self.support, motion=self.motion)

    @property
    def whiskers(self) -> tuple[Whisker, ...]:
        """One Whisker per base."""
        return each_whisker(self.whisker, self.support)


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
