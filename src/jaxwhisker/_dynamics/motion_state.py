"""Whiskers in motion at one time, dimensionless."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.moving import System

PerWhisker = Float[Array, "*whiskers"]


class Touching(NamedTuple):
    """The closest points of whisker and object, and the contact."""

    arc: PerWhisker  # fraction of the length
    parameter: PerWhisker  # of the object
    force: PerWhisker  # along the normal, mean over the last step
    drag: PerWhisker  # along the tangent, likewise
    gap: PerWhisker
    at_tip: PerWhisker  # positive if the tip is closest
    normal: Float[Array, "*whiskers 2"]
    across: Float[Array, "*whiskers points"]  # derivative of the gap by the angles
    tangent: Float[Array, "*whiskers 2"]
    along: Float[Array, "*whiskers points"]
    touches: Bool[Array, "*whiskers"]
    slip: Int[Array, "*whiskers"]  # direction along the tangent; 0 if the contact sticks


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


def angles_of(system: System, q: Float[Array, "whiskers n"], base: Float[Array, "whiskers 3"]) -> Array:
    """Angles of all whiskers from +x at their Gauss points."""
    return jnp.pi / 2 + base[:, 2:] + system.rods.rest + q @ system.basis.angles.T


def nodes_of(system: System, base: Float[Array, "whiskers 3"], angle: Float[Array, "whiskers points"]) -> Array:
    """Positions of all nodes."""
    turned = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
    return base[:, :2, None] + system.rods.length[:, None, None] * (turned @ system.basis.reach.T)
