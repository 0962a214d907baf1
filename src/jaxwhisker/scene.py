"""The scene: whiskers, object and support, and the one place where conventions stand.

Frame: x along the scan, y up. The base of whisker i is at (x_i, 0), clamped along +y; the object lies above its
profile, whose vertex has the height q (the object distance). Scanning moves the drive u towards -x. Without load base i
rests at u plus the rest lengths of the springs on its way from the drive: the drive leads, the whiskers trail.

Contact force: frictionless, f >= 0, on the whisker along the object's outward normal, f (sin alpha, -cos alpha).
Support reaction: what the support exerts on the whisker at its base,

    fx = -f sin(alpha),   fy = +f cos(alpha),   mz = -EI kappa(0)   (counter-clockwise positive).

Inside, everything is dimensionless in length L and bending stiffness EI of the first whisker: forces EI/L^2, moments
EI/L, spring stiffnesses EI/L^3.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker import _checks, contact, touch
from jaxwhisker._functions import name_of
from jaxwhisker._lanes import harmless
from jaxwhisker._types import Scalar
from jaxwhisker.contact import Body
from jaxwhisker.elastica import AbstractRod, ClosedForm, Shooting
from jaxwhisker.profile import AbstractProfile, differs, show
from jaxwhisker.support import Flexibility, Support
from jaxwhisker.touch import Touch
from jaxwhisker.whisker import Section, Whisker


class Scene(eqx.Module):
    """Whiskers on a support, scanned past an object.

    Args:
        whisker: one Whisker for all bases, or a tuple with one per base.
        profile: the object.
        support: the springs between drive and bases; clamped by default.
        rod: how rods are computed: Shooting(), or ClosedForm(), which is faster and exact to rounding.

    Raises:
        ValueError: if an argument is not of that kind, or their numbers of whiskers differ.
    """

    whisker: Whisker | tuple[Whisker, ...]
    profile: AbstractProfile
    support: Support = Support()
    rod: AbstractRod = Shooting()

    def __check_init__(self):
        whiskers = self.whisker if isinstance(self.whisker, tuple) else (self.whisker,)
        if not whiskers or not all(isinstance(w, Whisker) for w in whiskers):
            raise ValueError(f"`whisker` must be a Whisker or a tuple of them, but is {self.whisker!r}.")
        if not isinstance(self.profile, AbstractProfile):
            raise ValueError(f"`profile` must be a Parabola, Circle, Ellipse or Graph, but is {self.profile!r}.")
        if not isinstance(self.support, Support):
            raise ValueError(f"`support` must be a Support, but is {self.support!r}.")
        if not isinstance(self.rod, AbstractRod):
            raise ValueError(f"`rod` must be Shooting() or ClosedForm(), but is {self.rod!r}.")
        if isinstance(self.whisker, tuple) and len(whiskers) != self.support.whiskers:
            raise ValueError(
                f"`whisker` must be one Whisker or one per base ({self.support.whiskers} in {self.support.name}), "
                f"but is a tuple of {len(whiskers)}."
            )
        if isinstance(self.rod, ClosedForm) and not all(w.uniform for w in whiskers):
            raise ValueError(
                "`rod` must be Shooting() for whiskers that are curved or not uniform, but is ClosedForm(): elliptic "
                "functions solve uniform straight whiskers only."
            )

    @property
    def whiskers(self) -> tuple[Whisker, ...]:
        """One Whisker per base."""
        return self.whisker if isinstance(self.whisker, tuple) else (self.whisker,) * self.support.whiskers

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
        return f"{self.support.name}: {', '.join(counted)}, {self.profile}{material}{rods}"

    __repr__ = __str__


class Units(NamedTuple):
    """Sizes of the dimensionless problem's units in the scene's own."""

    length: Scalar
    force: Scalar
    moment: Scalar


class Problem(NamedTuple):
    """A scene without dimensions: what the equations see. Whiskers are stacked along the first axis."""

    length: Float[Array, " whiskers"]
    bending_stiffness: Float[Array, " whiskers"]  # at the base
    section: Section | tuple[Section, ...] | None  # see contact.Body
    profile: AbstractProfile
    rod: AbstractRod
    flexibility: Flexibility | None
    touch_right: Touch  # first contact coming from the right
    touch_left: Touch
    reaches: Bool[Array, " whiskers"]  # whether the whisker is long enough to meet the object at all
    valid: Bool[Array, ""]
    unit: Units

    @property
    def bodies(self) -> Body:
        """All whiskers, stacked."""
        return Body(self.length, self.bending_stiffness, self.profile, self.rod, self.section)


def units(scene: Scene) -> Units:
    """Units in which the scene's problem is dimensionless: L, EI/L^2, EI/L of the first whisker's base."""
    length, stiffness = scene.whiskers[0].length, scene.whiskers[0].base_stiffness
    return Units(length, stiffness / length**2, stiffness / length)


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
        spring = unit.force / unit.length
        flexibility = Flexibility(
            flexibility.matrix * spring,
            flexibility.root * jnp.sqrt(jax.lax.stop_gradient(jnp.asarray(spring))),
            flexibility.offset / unit.length,
            flexibility.consistent,
        )
        valid &= flexibility.consistent
    if all(whisker.intrinsic_curvature is None for whisker in scene.whiskers):
        right, left = (jax.vmap(lambda h, s=s: touch.of_straight(profile, h, s))(length) for s in (1.0, -1.0))
        height = length
    else:
        bodies = Body(length, stiffness, profile, scene.rod, section)
        right, left, height = contact.of_each(bodies, _touches)
    reaches = height > profile.vertex()[1]
    return Problem(length, stiffness, section, profile, scene.rod, flexibility, right, left, reaches, valid, unit)


def _touches(body: Body) -> tuple[Touch, Touch, Scalar]:
    """First touches of a curved whisker from the right and from the left, and the height that it reaches."""
    return touch.of_curved(body, 1.0), touch.of_curved(body, -1.0), touch.height(body)


def sections(
    whiskers: tuple[Whisker, ...], length_unit: Scalar, stiffness_unit: Scalar
) -> Section | tuple[Section, ...] | None:
    """What changes along whiskers: stacked if they differ by numbers only, None if all are uniform."""
    if all(whisker.uniform for whisker in whiskers):
        return None
    whiskers = jax.tree.map(_checks.as_float, whiskers)
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
    return scene.profile.valid() & scene.support.valid() & whiskers
