"""Contact of one whisker with a surface, and the pose of its base that follows.

The unknowns of a contact are eleven numbers: the contact force f, the roll of the whisker about its own axis there, the
slack w, the contact point p, the direction d in which the whisker runs along the surface, towards its tip, and the
traction, the force along the surface: in this direction, and across. Without friction, there is a traction only while
contacts slide after a loss of stability. With friction, the traction is in units of mu f, the largest that friction can
hold, except after such a loss. The point and the direction are vectors of space, which have no poles; three equations
keep them on the surface:

    G(p) = 0,    d.n = 0,    d.d = 1.

The slack w tells the phase. In tip contact, w <= 0 and the tip points into the object at the angle chi = -w. In
tangential contact, w >= 0 is the arc length from the contact to the tip. The rod is integrated from the contact to the
base. Its end in the frame of the contact depends on force, angle, roll and arc length only.

Straight round rods stay in the plane of their tangent and the force, whatever their torsional stiffness: they are
computed as rods in that plane, and their roll is zero.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.rotation import left_jacobian, matrix_of, rotation_vector
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.drives import Placement
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._rod.elastica import AbstractRod, Shooting, rod_end, uneven_rod_end
from jaxwhisker._rod.rod import Section
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, SpaceState, curvature
from jaxwhisker._rod.space_end import contact_rotation, space_rod_end
from jaxwhisker._rod.space_line import integrate_under
from jaxwhisker._space.weight import SpaceWeight

FORCE, ROLL, SLACK = 0, 1, 2
POINT, AHEAD, TRACTION = slice(3, 6), slice(6, 9), slice(9, 11)
UNKNOWNS = 11
LIGHT = 1e-4  # EI/L^2: the direction of smaller forces is not resolved
STEPS_BEYOND = 8  # of the part beyond a contact, for the curvature there
GRAZING = 1e-3  # angle between a tip and the surface below which it is nearly tangential

Vector = Float[Array, "3"]
Contact = Float[Array, "11"]


class SpaceWhisker(NamedTuple):
    """A whisker, as the equations see it."""

    length: Scalar
    bending_stiffness: Scalar  # at the base
    section: Section | SpaceSection | None  # None: uniform, straight and without torsion
    mount: Placement  # in the frame of the drive
    weight: SpaceWeight | None = None  # None without gravity


class SpaceBase(NamedTuple):
    """The base that belongs to a contact, in the frame of the scene."""

    position: Vector
    tangent: Vector  # of the whisker, there
    rotation: Float[Array, "3 3"] | None  # of the body frame; None for a straight round rod
    force: Vector  # of the object on the whisker, and its weight
    moment: Vector  # of these about the base
    push: Vector | None = None  # of the object on the whisker; None if this is all of the force


class Traction(NamedTuple):
    """What the tractions of contacts mean."""

    friction: Scalar | None  # the coefficient mu; None without friction
    flows: Bool[Array, ""]  # whether contacts slide after a loss of stability: tractions are forces


class InDrive(NamedTuple):
    """Coordinates of a base in the frame of the drive, relative to its mount, and the load along each of them.

    The coordinates are a displacement and a rotation vector. For a straight round whisker, whose base cannot turn, the
    last three are the deviation of its tangent and its roll at the contact, all of which vanish.
    """

    pose: Float[Array, "6"]
    load: Float[Array, "6"]
    upright: Bool[Array, ""]  # whether the tangent points the way that the mount gives it


def angle_and_arc(body: SpaceWhisker, z: Contact, phase: Int[Array, ""]) -> tuple[Scalar, Scalar]:
    """Angle between whisker and surface at the contact, and arc length from the base to the contact."""
    tip, slack = phase == Phase.tip, z[SLACK]
    return jnp.where(tip, -slack, 0.0), jnp.where(tip, body.length, body.length - slack)


def frame_of(surface: AbstractSurface, z: Contact) -> Float[Array, "3 3"]:
    """The frame of the contact: along the surface towards the tip, across, and outwards; as columns."""
    out = surface.normal(z[POINT])
    ahead = z[AHEAD] - jnp.sum(z[AHEAD] * out) * out
    ahead = ahead / jnp.sqrt(jnp.sum(ahead**2))
    return jnp.stack([ahead, jnp.cross(out, ahead), out], axis=1)


def base_of(
    body: SpaceWhisker,
    surface: AbstractSurface,
    method: AbstractRod,
    z: Contact,
    phase: Int[Array, ""],
    traction: Traction | None,
    rates: AbstractRod | None = None,
) -> SpaceBase:
    """The base of a whisker in contact.

    Args:
        body: the whisker.
        surface: the object.
        method: computes the rod.
        z: the contact.
        phase: its phase.
        traction: what its traction means; None if there is none.
        rates: computes derivatives of the rod. Default: as `method`.
    """
    rates = method if rates is None else rates
    frame, force, chi, roll, arc = loaded(body, surface, z, phase, traction)
    ahead, _, out = frame.T
    rotation = None
    if body.weight is not None:
        assert isinstance(method, Shooting)  # checked by SpaceScene
        (r, q), carried = _walked(body, body.weight.seen_in(frame), force, chi, roll, arc, method.steps)
        rotation = _product(frame, matrix_of(q))
        total, moment = (_turned(frame, jnp.stack(part)) for part in (carried.force, carried.moment_at(r)))
        return SpaceBase(z[POINT] + _turned(frame, jnp.stack(r)), rotation[:, 2], rotation, total, moment, force * out)
    if isinstance(body.section, SpaceSection):
        assert isinstance(method, Shooting) and isinstance(rates, Shooting)  # checked by SpaceScene
        twice = 1 if body.section.uniform else 2
        end = space_rod_end(force, arc, chi, roll, body.section, twice * method.steps, twice * rates.steps)
        from_contact = _turned(frame, end[:3])
        rotation = _product(frame, matrix_of(end[3:]))
        tangent = rotation[:, 2]
    else:
        if body.section is None:
            x, y, cos, sin = rod_end(force / body.bending_stiffness, arc, chi, method, rates)
        else:
            x, y, cos, sin = uneven_rod_end(force, arc, chi, body.section, method, rates)
        from_contact, tangent = x * ahead - y * out, cos * ahead - sin * out
    push = force * out
    return SpaceBase(z[POINT] + from_contact, tangent, rotation, push, jnp.cross(-from_contact, push))


def _walked(
    body: SpaceWhisker, weight: SpaceWeight, force: Scalar, chi: Scalar, roll: Scalar, arc: Scalar, steps: int
) -> tuple[SpaceState, SpaceLoad]:
    """State of a whisker with a weight at its base, and the load on it there, in the frame of its contact."""
    assert isinstance(body.section, SpaceSection)
    start, load = pressed_start(body, weight, force, chi, roll, arc, steps)
    density = weight.density(body.section)
    return integrate_under(start, load, arc, body.section, density, steps=2 * steps, from_base=arc)


def pressed_start(
    body: SpaceWhisker, weight: SpaceWeight, force: Scalar, chi: Scalar, roll: Scalar, arc: Scalar, steps: int
) -> tuple[SpaceState, SpaceLoad]:
    """State of a whisker with a weight at its contact, and the load on it there, in the frame of the contact."""
    assert isinstance(body.section, SpaceSection)
    zero = jnp.zeros(())
    start = (zero, zero, zero), contact_rotation(chi, roll)
    own = weight.beyond(start, arc, body.length, body.section, steps=steps)
    fx, fy, fz = own.force
    return start, SpaceLoad((fx, fy, fz + force), own.moment)


class Loaded(NamedTuple):
    """A whisker in contact, as its rod sees it: the force acts along the last axis of the frame."""

    frame: Float[Array, "3 3"]
    force: Scalar
    chi: Scalar  # angle between the rod and the first axis, positive against the last one
    roll: Scalar
    arc: Scalar  # from the base to the contact


def loaded(
    body: SpaceWhisker, surface: AbstractSurface, z: Contact, phase: Int[Array, ""], traction: Traction | None
) -> Loaded:
    """How a contact loads its rod."""
    chi, arc = angle_and_arc(body, z, phase)
    at = frame_of(surface, z), z[FORCE], chi, z[ROLL]
    return Loaded(*(at if traction is None else _frame_of_force(*at, z[TRACTION], traction)), arc)


def _frame_of_force(frame, force, chi, roll, along, traction: Traction):
    """Frame, force, angle and roll of the same contact with a surface that is normal to the force."""
    ahead, across, out = frame.T
    light = (jnp.abs(force) < LIGHT) & (jnp.sum(along**2) < LIGHT**2)
    normal, unit = jnp.where(light, LIGHT, force), jnp.where(light, force / LIGHT, 1.0)
    if traction.friction is not None:
        along = jnp.where(traction.flows, along, traction.friction * along)
        normal, unit = jnp.where(traction.flows, normal, 1.0), jnp.where(traction.flows, unit, force)
    leaning = normal * out + along[0] * ahead + along[1] * across
    size = jnp.sqrt(jnp.sum(leaning**2))
    outwards, tangent = leaning / size, jnp.cos(chi) * ahead - jnp.sin(chi) * out
    sine = jnp.sum(tangent * outwards)
    beside = tangent - sine * outwards
    flat = jnp.sqrt(jnp.sum(beside**2))
    forwards = beside / flat
    sideways = jnp.cross(outwards, forwards)
    # The first director is the same in both frames.
    first = jnp.cos(roll) * jnp.cross(across, tangent) + jnp.sin(roll) * across
    roll = jnp.arctan2(jnp.sum(first * sideways), jnp.sum(first * jnp.cross(sideways, tangent)))
    return jnp.stack([forwards, sideways, outwards], axis=1), unit * size, jnp.arctan2(-sine, flat), roll


def in_drive(base: SpaceBase, drive: Placement, mount: Placement, roll: Scalar) -> InDrive:
    """Coordinates of a base and load on it, in the frame of the drive."""
    back = drive.rotation.T
    at = _turned(back, base.position - drive.position) - mount.position
    force, moment = _turned(back, base.force), _turned(back, base.moment)
    across = _turned(mount.rotation.T, _turned(back, base.tangent))
    if base.rotation is None:
        turn = jnp.stack([across[0], across[1], roll])
    else:
        turn = rotation_vector(_product(_product(back, base.rotation), mount.rotation.T))
        moment = _turned(left_jacobian(turn).T, moment)
    return InDrive(jnp.concatenate([at, turn]), jnp.concatenate([force, moment]), across[2] > 0)


def on_surface(surface: AbstractSurface, z: Contact) -> Vector:
    """Residuals of the equations that keep the contact point and the direction on the surface."""
    ahead = z[AHEAD]
    return jnp.stack([
        surface.off(z[POINT]),
        jnp.sum(ahead * surface.normal(z[POINT])),
        (jnp.sum(ahead**2) - 1) / 2,
    ])  # fmt: skip


def spread(body: SpaceWhisker, surface: AbstractSurface, z: Contact, phase: Int[Array, ""]) -> Scalar:
    """How fast whisker and surface part on both sides of a tangential contact: g_ss, a curvature.

    Where it is negative, the shaft curves more than the object, and one contact point becomes two. It is zero where a
    straight whisker lies on a flat object beyond its contact, without a force. A tip that hardly points into the object
    is nearly a tangential contact: its shaft would enter the object beside the tip. For other tips it is infinite.
    """
    ahead = frame_of(surface, z)[:, 0]
    own: Scalar = 0.0
    if isinstance(body.section, SpaceSection):
        chi, arc = angle_and_arc(body, z, phase)
        if body.weight is None:
            first, second, _ = (0.0 if part is None else part for part in body.section.intrinsic(arc))
        else:  # the part beyond bends it, too
            weight = body.weight.seen_in(frame_of(surface, z))
            start, load = pressed_start(body, weight, jnp.zeros(()), chi, z[ROLL], arc, STEPS_BEYOND)
            first, second, _ = curvature(start, load, body.section, arc)
        own = -second * jnp.cos(z[ROLL]) - first * jnp.sin(z[ROLL])  # n.d1 = -cos, n.d2 = sin: see rod/space_end.py
    curved = jnp.sum(ahead * _turned(surface.curvature(z[POINT]), ahead))
    return jnp.where(z[SLACK] > -GRAZING, own + curved, jnp.inf)


def _turned(matrix: Float[Array, "3 3"], vector: Vector) -> Vector:
    # Sums: XLA compiles small products of matrices in batches to slow loops.
    return jnp.sum(matrix * vector, axis=1)


def _product(a: Float[Array, "3 3"], b: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    return jnp.sum(a[:, :, None] * b, axis=1)
