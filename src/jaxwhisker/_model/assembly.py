"""Whiskers on a support: what scenes in the plane, sensors and scenes in space share."""

import abc
from typing import Any

import equinox as eqx

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text, name_of, text_unless
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.along import LinearTaper, RoundSection
from jaxwhisker._model.motion import Mount, Translation
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import AbstractRod, Shooting

MOST_CONTACTS = 8  # of a whisker


class AbstractScene(eqx.Module):
    """Whiskers on a support that a drive moves past an object, in the plane or in space."""

    whisker: eqx.AbstractVar[Whisker | tuple[Whisker, ...]]
    in_space = False
    gravity = None  # of scenes that have none
    contacts = 1  # of a whisker, at most; scenes may have room for more

    # Type checkers would take variables for fields before the object.
    @property
    @abc.abstractmethod
    def support(self) -> Support:
        """The support of the whiskers."""

    @property
    @abc.abstractmethod
    def motion(self) -> Any:
        """The motion of the drive."""

    @property
    @abc.abstractmethod
    def objects(self) -> tuple[Any, ...]:
        """The objects, in the order in which results number them."""

    @property
    @abc.abstractmethod
    def friction(self) -> Scalar | None:
        """The coefficient of friction between whiskers and object; None without friction."""

    @property
    def whiskers(self) -> tuple[Whisker, ...]:
        """One Whisker per base."""
        return each_whisker(self.whisker, self.support)


def check_whiskers(whisker: Any, support: Any) -> tuple[Whisker, ...]:
    """Check the types of whisker and support and that their numbers agree; return one whisker per base."""
    whiskers = whisker if isinstance(whisker, tuple) else (whisker,)
    if not whiskers or not all(isinstance(w, Whisker) for w in whiskers):
        checks.fail("whisker", "a Whisker or a tuple of them", repr(whisker))
    checks.instance("support", support, Support, "a Support")
    if isinstance(whisker, tuple) and len(whiskers) != support.whiskers:
        allowed = f"one Whisker or one per base ({support.whiskers} in {support.name})"
        checks.fail("whisker", allowed, f"a tuple of {len(whiskers)}")
    return each_whisker(whisker, support)


def check_weights(whiskers: tuple[Whisker, ...], rod: AbstractRod) -> None:
    """Check that whiskers under gravity have masses, and that their rods can be computed."""
    if any(whisker.mass_per_length is None for whisker in whiskers):
        checks.fail("mass_per_length", "given for whiskers with a weight", "None")
    if not isinstance(rod, Shooting):
        checks.fail("rod", "Shooting() for whiskers with a weight", f"{type(rod).__name__}()")


def in_row(whisker: Any, support: Any) -> Any:
    """The support with the rest lengths that follow from the first whisker; wrong types are rejected later."""
    first = whisker[0] if isinstance(whisker, tuple) and whisker else whisker
    return support.in_row(first.length) if isinstance(support, Support) and isinstance(first, Whisker) else support


def each_whisker(whisker: Whisker | tuple[Whisker, ...], support: Support) -> tuple[Whisker, ...]:
    """One whisker per base."""
    return whisker if isinstance(whisker, tuple) else (whisker,) * support.whiskers


def support_text(support: Support) -> str:
    """Text of a support, its whiskers and springs."""
    n, springs = support.whiskers, len(support.springs)
    counted = [f"{n} whisker" + "s" * (n > 1), *[f"{springs} spring" + "s" * (springs > 1)] * (springs > 0)]
    mount = str(support.mounts[0]) if n == 1 else str(Mount())
    return f"{support.name}: {', '.join(counted)}" + f", mount {mount}" * (mount != str(Mount()))


def motion_text(motion: Any) -> str:
    """Text of a motion that is not the default."""
    return "" if isinstance(motion, Translation) and motion.onwards < 0 else f", {motion}"


def gravity_text(gravity: tuple[Scalar, ...] | None) -> str:
    """Text of a gravity; nothing without one."""
    return "" if gravity is None else f", gravity ({', '.join(map(as_text, gravity))})"


def whisker_text(whisker: Whisker) -> str:
    """Text of what differs from the default whisker."""
    text = text_unless(1.0, ", L = ", whisker.length)
    stiffness = whisker.bending_stiffness
    taper = stiffness.diameter if isinstance(stiffness, RoundSection) else None
    if isinstance(taper, LinearTaper):
        text += f", conical, d = {as_text(taper.base)} to {as_text(taper.tip)}"
    elif callable(whisker.bending_stiffness):
        text += f", EI = {name_of(whisker.bending_stiffness)}(s)"
    else:
        text += text_unless(1.0, ", EI = ", whisker.bending_stiffness)
    if callable(whisker.intrinsic_curvature):
        text += f", kappa0 = {name_of(whisker.intrinsic_curvature)}(s)"
    elif whisker.intrinsic_curvature is not None:
        text += f", kappa0 = {as_text(whisker.intrinsic_curvature)}"
    if whisker.breaks is not None:
        text += f", {len(whisker.breaks)} break" + "s" * (len(whisker.breaks) > 1)
    return text
