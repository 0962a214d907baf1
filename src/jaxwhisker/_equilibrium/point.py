"""Points of the path: the unknowns, and the equation that selects one point."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import FORCE
from jaxwhisker._equilibrium.stance import Contacts, PerWhisker


class Point(NamedTuple):
    """A point of the path, or a direction: contacts z (see contact.py), and control u; dimensionless."""

    z: Contacts
    u: Scalar | Float[Array, "*batch"]


class PathCondition(NamedTuple):
    """The equation that selects a point of the path, in addition to the equations of equilibrium.

    weight_z . (z - z0) + weight_u (u - u0) + vertex . sin(alpha) = 0

    A weighted sum covers all cases (a given control, an arc length, an event), which lets each element of a batch have
    its own.
    """

    weight_z: Contacts
    z0: Contacts
    weight_u: Scalar
    u0: Scalar
    vertex: PerWhisker

    def residual(self, point: Point, slope_sin: PerWhisker) -> Float[Array, ""]:
        """Residual of the equation."""
        along = jnp.sum(self.weight_z * (point.z - self.z0)) + self.weight_u * (point.u - self.u0)
        return along + jnp.sum(self.vertex * slope_sin)


def at_control(u: Scalar, like: Contacts) -> PathCondition:
    """The condition that the control has a given value."""
    none = jnp.zeros_like(like)
    return PathCondition(none, none, jnp.asarray(1.0), u, none[:, 0])


def at_force(whiskers: Bool[Array, " whiskers"], at: Contacts) -> PathCondition:
    """The condition that the forces of these whiskers have the sum that they have in `at`."""
    none = jnp.zeros_like(at)
    return PathCondition(none.at[:, FORCE].set(whiskers), at, jnp.asarray(0.0), jnp.asarray(0.0), none[:, 0])


def at_arc_length(point: Point, tangent: Point, distance: Scalar) -> PathCondition:
    """The condition of the plane normal to the tangent, at a distance ahead of the point (pseudo-arclength)."""
    scale = scale_of(point.z)
    ahead = along(point, tangent, distance)
    return PathCondition(tangent.z / scale**2, ahead.z, tangent.u, ahead.u, jnp.zeros_like(point.z[:, FORCE]))


def scale_of(z: Contacts) -> Contacts:
    """Scale in which changes of a contact are measured: 1 + |force| for forces, 1 for the others."""
    scale = jnp.ones_like(z).at[..., FORCE].add(jnp.abs(z[..., FORCE]))
    return scale if z.shape[-1] == 3 else scale.at[..., 3:].add(jnp.abs(z[..., 3:]))


def dot(a: Point, b: Point, scale: Contacts) -> Scalar:
    """Inner product of two directions, with contacts measured in `scale`."""
    return jnp.sum(a.z * b.z / scale**2) + a.u * b.u


def unit(direction: Point, z: Contacts) -> tuple[Point, Scalar]:
    """The direction with unit length in the scale of z, and its length."""
    scale = scale_of(z)
    length = jnp.sqrt(dot(direction, direction, scale))
    return Point(direction.z / length, direction.u / length), length


def along(start: Point, direction: Point, distance: Scalar, bend: Point | None = None) -> Point:
    """The point at a distance along a straight line, or along a parabola if `bend` is given."""
    half = 0.0 if bend is None else distance**2 / 2
    bend = direction if bend is None else bend
    return Point(start.z + distance * direction.z + half * bend.z, start.u + distance * direction.u + half * bend.u)
