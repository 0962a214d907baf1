"""Whiskers in motion at one time, dimensionless."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.gap import Gap, Posed
from jaxwhisker._dynamics.moving import System

LEAP = 0.05  # fraction of the length beyond which a contact does not move in a step, but begins elsewhere

PerWhisker = Float[Array, "*whiskers"]
PerContact = Float[Array, "*contacts"]  # (*whiskers, contacts), or as PerWhisker if a whisker has one at most


class Touching(NamedTuple):
    """The closest points of whisker and object, and the contact; or several places where they are close, and contacts.

    Those of several places have a last axis of contacts.
    """

    arc: PerContact  # fraction of the length
    parameter: PerContact  # of the object
    gap: Gap
    force: PerContact  # along the normal, mean over the last step
    drag: PerContact  # along the tangent, likewise
    touches: Bool[Array, "*contacts"]
    slip: Int[Array, "*contacts"]  # direction along the tangent; 0 if the contact sticks
    began: Bool[Array, "*contacts"]  # in the last step
    deepest: PerWhisker  # least gap where the whisker is inside the object beside its contacts, otherwise infinite
    others: PerWhisker | None = None  # least distance that other objects may have; None without any
    # Of whiskers that may have several contacts; None of others.
    piece: Int[Array, "*contacts"] | None = None  # of the object
    away: Bool[Array, "*contacts"] | None = None  # places without contact in the next step
    distance: PerWhisker | None = None  # from all objects

    def lasts(self, arc: PerContact) -> Bool[Array, "*contacts"]:
        """Whether a contact at this point of the whisker, one step later, continues this one."""
        return self.touches & (jnp.abs(arc - self.arc) < LEAP)

    def directions(self, gap: Gap, arc: PerContact) -> tuple[Array, Array, Array, Array]:
        """Directions of the contact forces of a step that starts here and ends with this gap at this point.

        They are means over the step. A contact that begins acts at its end: before, other points were closest.
        """
        lasts = self.lasts(arc)[..., None]
        first, last = ((at.across, at.normal, at.along, at.tangent) for at in (self.gap, gap))
        across, normal, along, tangent = (jnp.where(lasts, (a + b) / 2, b) for a, b in zip(first, last, strict=True))
        return across, normal, along, tangent


class Rod(NamedTuple):
    """One whisker; or all of them, stacked."""

    q: Float[Array, "*whiskers n"]
    base: Float[Array, "*whiskers 3"]  # pose
    angle: Float[Array, "*whiskers points"]  # from +x
    at: Float[Array, "*whiskers 2 nodes"]
    velocity: Float[Array, "*whiskers 2 nodes"]
    spin: PerWhisker  # angular velocity of the base
    touching: Touching | None


class Ledger(NamedTuple):
    """Work and losses since the start."""

    work: Scalar  # of the drive
    damping: Scalar
    impact: Scalar
    friction: Scalar
    contact: Scalar  # work of contact forces along the normal, an error of the method: the object rests


class Moving(NamedTuple):
    """Whiskers and springs in motion."""

    rod: Rod
    z: Float[Array, " free"]
    drive: Float[Array, "3"]
    change: Float[Array, "2 unknowns"]  # in the last two steps
    ledger: Ledger
    solved: Bool[Array, ""]

    @property
    def ahead(self) -> Scalar:
        """Fraction of the next step at which forces and velocities have their means: 1/2, or 1 if a contact begins."""
        touching = self.rod.touching
        return jnp.where(jnp.any(touching.began), 1.0, 0.5) if touching is not None else jnp.asarray(0.5)


def posed(system: System, length: Scalar, base: Float[Array, "3"], angle: Float[Array, " points"]) -> Posed:
    """One whisker and the object."""
    assert system.profile is not None
    return Posed(system.basis, system.profile, length, base[:2], angle)


def angles_of(system: System, q: Float[Array, "whiskers n"], base: Float[Array, "whiskers 3"]) -> Array:
    """Angles of all whiskers from +x at their Gauss points."""
    return jnp.pi / 2 + base[:, 2:] + system.rods.rest + q @ system.basis.angles.T


def nodes_of(system: System, base: Float[Array, "whiskers 3"], angle: Float[Array, "whiskers points"]) -> Array:
    """Positions of all nodes."""
    turned = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
    return base[:, :2, None] + system.rods.length[:, None, None] * (turned @ system.basis.reach.T)
