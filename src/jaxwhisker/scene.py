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

from jaxwhisker._lanes import harmless
from jaxwhisker._types import Scalar
from jaxwhisker.elastica import AbstractRod, Shooting
from jaxwhisker.profile import AbstractProfile, FirstTouch, differs
from jaxwhisker.support import Flexibility, Support
from jaxwhisker.whisker import Whisker


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

    @property
    def whiskers(self) -> tuple[Whisker, ...]:
        """One Whisker per base."""
        return self.whisker if isinstance(self.whisker, tuple) else (self.whisker,) * self.support.whiskers

    def __str__(self) -> str:
        n, springs = self.support.whiskers, len(self.support.springs)
        counted = [f"{n} whisker" + "s" * (n > 1), *[f"{springs} spring" + "s" * (springs > 1)] * (springs > 0)]
        first = self.whiskers[0]
        material = differs(", L = ", first.length, 1.0) + differs(", EI = ", first.bending_stiffness, 1.0)
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
    bending_stiffness: Float[Array, " whiskers"]
    profile: AbstractProfile
    rod: AbstractRod
    flexibility: Flexibility | None
    touch_right: FirstTouch  # (whiskers,) each: first contact coming from the right
    touch_left: FirstTouch
    reaches: Bool[Array, " whiskers"]  # whether the whisker is long enough to meet the object at all
    valid: Bool[Array, ""]
    unit: Units


def units(scene: Scene) -> Units:
    """Units in which the scene's problem is dimensionless: L, EI/L^2, EI/L of the first whisker."""
    length, stiffness = scene.whiskers[0].length, scene.whiskers[0].bending_stiffness
    return Units(length, stiffness / length**2, stiffness / length)


def problem(scene: Scene) -> Problem:
    """The scene's dimensionless equations. Derivatives flow through all of it."""
    valid = _valid(scene)
    scene = harmless(scene, valid)
    unit = units(scene)
    length = jnp.stack([jnp.asarray(w.length, dtype=float) for w in scene.whiskers]) / unit.length
    stiffness = jnp.stack([jnp.asarray(w.bending_stiffness, dtype=float) for w in scene.whiskers])
    stiffness = stiffness / (unit.moment * unit.length)
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
    touch_right = jax.vmap(lambda height: profile.first_touch(height, 1.0))(length)
    touch_left = jax.vmap(lambda height: profile.first_touch(height, -1.0))(length)
    reaches = length > profile.vertex()[1]
    return Problem(length, stiffness, profile, scene.rod, flexibility, touch_right, touch_left, reaches, valid, unit)


def _valid(scene: Scene) -> Bool[Array, ""]:
    # Whether traced parameters lie where the constructors would have let them.
    own = [jnp.asarray(value) for w in scene.whiskers for value in (w.length, w.bending_stiffness)]
    positive = jnp.all(jnp.stack([jnp.isfinite(value) & (value > 0) for value in own]))
    return scene.profile.valid() & scene.support.valid() & positive
