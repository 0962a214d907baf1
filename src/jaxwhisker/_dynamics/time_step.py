"""One time step of moving whiskers: an energy-momentum method with contact at position level.

The nodes of a whisker (base, Gauss points, tip) have positions r(q) and velocities v of their own (Betsch and
Leyendecker 2006). A step from q0 to q1 solves

    D(q0, q1)^T m a + K q* = f c + base reaction,     a = (v1 - v0) / h,     v* = (r1 - r0) / h,

with q* = (q0 + q1) / 2, likewise v*, and the difference quotient D of the positions, D (q1 - q0) = r1 - r0: the change
of (cos phi, sin phi) is (-sin, cos)(mean angle) sinc(half the change) times the change of the angle. Multiplying by
q1 - q0 shows that kinetic plus elastic energy change by exactly the work of contact and base. The method has order 2
and is stable for any step. It does not damp vibrations that are faster than the step, though, which impacts excite:
the step after a contact begins is therefore implicit, with q* = q1 and v* = v1 (Rannacher 1984).

At the end of the step the gap g and the contact force f satisfy 0 <= g, 0 <= f, g f = 0. Where another contact has let
a whisker into the object, g does not return to 0 at once, because f would do work. The direction c of the contact force
is the mean of the gap's gradients at both ends, or that at the end if the contact begins. Where f > 0, an impulse then
removes the velocity along the normal: impacts have no restitution. This is also what keeps lasting contacts free of
oscillations (as in RATTLE).

Coulomb friction holds for the mean tangential force t and the slip d of the material point in contact: d = 0 and
abs(t) <= mu f, or t = -mu f sign(d). The impulses obey the same law.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.features import gap_on, stretches_of, wedged
from jaxwhisker._dynamics.gap import Gap, gap_at
from jaxwhisker._dynamics.held import Pulls, ends_of, pulls_of
from jaxwhisker._dynamics.legendre import sinc
from jaxwhisker._dynamics.motion_state import Moving, Rod, Touching, posed
from jaxwhisker._dynamics.moving import Rods, System
from jaxwhisker._dynamics.outline import ObjectChain
from jaxwhisker._model.profile import AbstractProfile

FADES_IN_TIME, FADES_ON_WAY = 1.0, 3.0  # rates at which penetrations fade, per time and per travel of the drive
SAME_PLACE = 1e-3  # of the length: contacts that are closer to each other are one
SLIPS_IN = 5e-3  # penetration, in lengths, that is accepted in the step in which a contact slips off an edge

PerContact = Float[Array, "*contacts"]  # of all whiskers


class Imposed(NamedTuple):
    """What is imposed on contacts for which Newton's method does not find a mode."""

    free: Bool[Array, "*contacts"]  # no force
    held: Bool[Array, "*contacts"]  # at its old point of the whisker or with the old normal of an edge; no friction


class ContactMode(NamedTuple):
    """Which equations contacts satisfy at the end of a step."""

    touches: Bool[Array, "*contacts"]
    slip: Int[Array, "*contacts"]  # +1 or -1 along the object; 0 if the contact sticks or is held
    imposed: Imposed
    wedged: Bool[Array, "*contacts"] | None = None  # in an inner corner, without friction; of several contacts only

    @property
    def acts(self) -> Bool[Array, "*contacts"]:
        """Whether the gap is closed; otherwise there is no force."""
        return self.touches & ~self.imposed.free

    @property
    def sticks(self) -> Bool[Array, "*contacts"]:
        """Whether the contact sticks to the object."""
        sticks = self.acts & (self.slip == 0) & ~self.imposed.held
        return sticks if self.wedged is None else sticks & ~self.wedged


class Forces(NamedTuple):
    """Mean forces of a step."""

    reaction: Float[Array, "whiskers 3"]  # support on whisker, in the scene: fx, fy, mz
    normal: PerContact
    drag: PerContact


class StepTrial(NamedTuple):
    """The end of a step of one whisker for trial values of its unknowns, and what follows from it."""

    angle: Array
    gap: Gap | None
    mode: ContactMode


class TimeStep(NamedTuple):
    """What the equations of a step depend on."""

    system: System
    old: Moving
    drive: Float[Array, "3"]  # its pose at the end
    h: Scalar


class Rows(NamedTuple):
    """Residuals of one whisker for trial values, and the reaction of its support."""

    bending: Float[Array, " n"]
    contact: Float[Array, " contact"]  # as the unknowns: end, foot, gap or force, slip or drag
    reaction: Float[Array, "3"]

    def flat(self) -> Array:
        """All of them in one array."""
        return jnp.concatenate(self)


def rows_of(
    step: TimeStep, rods: Rods, old: Rod, mode: ContactMode | Imposed, q: Array, contact: Array, base: Array
) -> tuple[Rows, StepTrial]:
    """Residuals of one whisker in a mode; or in that which trial values suggest, but for what is imposed."""
    system, h, ahead = step.system, step.h, step.old.ahead
    shapes = system.basis
    angle = jnp.pi / 2 + base[2] + rods.rest + shapes.angles @ q
    turned = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    # Inertial forces are m (rate at - known); only their sum and their moments about the base count.
    rate = (1 / (ahead * h) + system.mass_damping) / h
    known = rods.mass * (rate * old.at + old.velocity / (ahead * h))
    moments = rate * (rods.length * (turned @ rods.second) + base[:2, None] * rods.first) - known @ shapes.reach
    push = rate * (rods.length * (turned @ rods.first) + base[:2] * jnp.sum(rods.mass)) - jnp.sum(known, axis=-1)
    pulls = pulls_on(step, rods, old, q, base, angle)
    if pulls is not None and rods.held is not None:
        moments -= pulls.load[:, :2].T @ rods.held.reach
        push -= jnp.sum(pulls.load[:, :2], axis=0)
    half, middle = (angle - old.angle) / 2, (angle + old.angle) / 2
    torque = rods.length * sinc(half) * (jnp.cos(middle) * moments[1] - jnp.sin(middle) * moments[0])
    gap, rows = None, jnp.zeros(0)
    if system.profile is not None:
        gap, mode, rows, loads = _contacts_of(step, rods, old, mode, contact, base, angle)
        for turns, pushes in loads:
            torque -= turns
            push -= pushes
    mode = mode if isinstance(mode, ContactMode) else ContactMode(jnp.asarray(False), jnp.asarray(0), mode)
    bending = old.q + (ahead + system.stiffness_damping / h) * (q - old.q)
    bent = torque @ shapes.angles + jnp.sum(rods.stiffness * bending, axis=-1)
    twist = jnp.sum(torque) + rods.inertia / (ahead * h) * ((base[2] - old.base[2]) / h - old.spin)
    if pulls is not None and rods.held is not None:
        bent -= pulls.load[:, 2] @ rods.held.bends
        twist -= jnp.sum(pulls.about_base[:, 2])
    return Rows(bent, rows, jnp.append(push, twist)), StepTrial(angle, gap, mode)


Loads = list[tuple[Array, Array]]  # torques at the Gauss points, and forces


def _contacts_of(
    step: TimeStep, rods: Rods, old: Rod, mode: ContactMode | Imposed, contact: Array, base: Array, angle: Array
) -> tuple[Gap, ContactMode, Array, Loads]:
    """Gaps, modes, residuals and loads of the contacts of one whisker."""
    system, h = step.system, step.h
    here = posed(system, rods.length, base, angle)
    turned, shifted = angle - old.angle, (base - old.base)[:2]

    def one(old: Touching, mode: ContactMode | Imposed, contact: Array, barred: Array | None, wedged: Array | None):
        assert system.profile is not None
        arc, parameter = contact[0], contact[1]
        gap = gap_at(here, arc, parameter) if old.piece is None else gap_on(here, old.piece, arc, parameter)
        across, normal, along, tangent = old.directions(gap, contact[0])
        closed = across @ turned + normal @ shifted
        before = jnp.where(old.lasts(contact[0]), old.gap.distance, gap.distance - closed)
        faded = FADES_IN_TIME * h + FADES_ON_WAY * jnp.sum(jnp.abs(step.drive - step.old.drive))
        above = gap.distance - jnp.minimum(0.0, jnp.exp(-faded) * before)
        loads = [(contact[2] * across, contact[2] * normal)]
        slipped = along @ turned + tangent @ shifted
        mode = mode if isinstance(mode, ContactMode) else _mode(system, contact, above, slipped, mode, barred, wedged)
        end = jnp.where(mode.imposed.held, _held(system.profile, contact, old), gap.end)
        rows = jnp.stack([end, gap.foot, jnp.where(mode.acts, above, contact[2])])
        if old.away is not None:
            rows = jnp.where(old.away, contact[:3] - jnp.stack([old.arc, old.parameter, 0.0]), rows)
        if system.friction is not None:
            loads.append((contact[3] * along, contact[3] * tangent))
            dragged = contact[3] + system.friction * mode.slip * contact[2]
            rows = jnp.append(rows, jnp.where(mode.sticks, slipped, dragged))
        return gap, mode, rows, loads

    assert old.touching is not None
    if system.contacts == 1:
        return one(old.touching, mode, contact, None, None)
    contacts, in_corner = system.by_contact(contact), None
    if system.may_wedge:
        assert isinstance(system.profile, ObjectChain) and old.touching.piece is not None
        in_corner = wedged(system.profile, old.touching.piece, contacts[:, 0], contacts[:, 2] > 0)
    each = old.touching._replace(deepest=None, others=None, distance=None)  # of whiskers
    gap, mode, rows, loads = jax.vmap(one)(each, mode, contacts, barred(system, old.touching, contacts), in_corner)
    return gap, mode, jnp.ravel(rows), jax.tree.map(lambda load: jnp.sum(load, axis=0), loads)


def barred(system: System, old: Touching, contacts: Float[Array, "contacts contact"]) -> Bool[Array, " contacts"]:
    """Which of several contacts of a whisker may not be: they are away from the object, or where another one is."""
    profile = system.profile
    assert isinstance(profile, ObjectChain) and old.away is not None and old.piece is not None
    arc, stretch = contacts[:, 0], stretches_of(profile)[old.piece]
    same = (jnp.abs(arc[:, None] - arc) < SAME_PLACE) & (stretch[:, None] == stretch)
    place = jnp.arange(arc.size)
    earlier = jnp.where(old.touches[:, None] == old.touches, place[:, None] > place, old.touches)
    return old.away | jnp.any(same & earlier & ~old.away, axis=1)


def _held(profile: AbstractProfile, contact: Array, old: Touching) -> Scalar:
    """What vanishes for a held contact. On an edge the whisker may slide, while the normal stays."""
    arc = contact[0] - old.arc
    piece = profile.piece_at(old.parameter) if old.piece is None else None
    return arc if piece is None else jnp.where(piece % 2 == 0, contact[1] - old.parameter, arc)


def pulls_on(step: TimeStep, rods: Rods, old: Rod, q: Array, base: Array, angle: Array) -> Pulls | None:
    """What the springs on the shaft of one whisker do in a step with this end; None without any."""
    if rods.held is None:
        return None
    own = rods.held, rods.length
    first = ends_of(*own, old.q, old.base, old.angle, step.old.drive)
    last = ends_of(*own, q, base, angle, step.drive)
    turns = jnp.stack([step.old.drive[2], step.drive[2]]), jnp.stack([old.base[2], base[2]])
    lag = step.system.stiffness_damping / step.h
    return pulls_of(rods.held, step.system.laws, first, last, turns, step.old.ahead, lag)


def _mode(
    system: System,
    contact: Array,
    gap: Scalar,
    slipped: Scalar,
    imposed: Imposed,
    barred: Bool[Array, ""] | None = None,
    wedged: Bool[Array, ""] | None = None,
) -> ContactMode:
    """Whether a whisker touches and slips, by the signs of trial gaps, forces and slips."""
    touches = contact[2] > gap + jnp.where(imposed.free, SLIPS_IN, 0.0)
    if barred is not None:
        touches &= ~barred
    if system.friction is None:
        return ContactMode(touches, jnp.asarray(0), imposed)
    drag, limit = contact[3] - slipped, system.friction * jnp.maximum(contact[2], 0.0)
    slips = (jnp.abs(drag) >= limit) & ~imposed.held
    if wedged is not None:
        slips &= ~wedged
    return ContactMode(touches, jnp.where(slips, -jnp.sign(drag), 0.0).astype(int), imposed, wedged)


class StepUnknowns(NamedTuple):
    """What a step solves for."""

    q: Float[Array, "whiskers n"]
    contact: Float[Array, "whiskers contact"]  # arc, parameter, normal force, with friction also drag, of each one
    z: Float[Array, " free"]

    def flat(self) -> Float[Array, " unknowns"]:
        """All unknowns in one array."""
        return jnp.concatenate([jnp.ravel(part) for part in self])


def unknowns_of(system: System, flat: Float[Array, " unknowns"]) -> StepUnknowns:
    """The unknowns in one array, by name."""
    whiskers, n, c = system.rods.length.shape[0], system.n, system.contact_unknowns
    q, contact, z = jnp.split(flat, [whiskers * n, whiskers * (n + c)])
    return StepUnknowns(q.reshape(whiskers, n), contact.reshape(whiskers, c), z)


def unknowns_at(moving: Moving, system: System) -> StepUnknowns:
    """The unknowns of a state."""
    at, c = moving.rod.touching, system.contact_unknowns
    if at is None:
        return StepUnknowns(moving.rod.q, jnp.zeros((moving.rod.q.shape[0], 0)), moving.z)
    contact = jnp.stack([at.arc, at.parameter, at.force, at.drag][: c // system.contacts], axis=-1)
    return StepUnknowns(moving.rod.q, contact if system.contacts == 1 else contact.reshape(-1, c), moving.z)


def every(step: TimeStep, mode: ContactMode, x: StepUnknowns) -> tuple[Rows, StepTrial]:
    """Residuals and reactions of all whiskers."""

    def one(rods, old, mode, q, contact, base):
        return rows_of(step, rods, old, mode, q, contact, base)

    bases = step.system.bases(x.z, step.drive)
    return jax.vmap(one)(step.system.rods, step.old.rod, mode, x.q, x.contact, bases)


def load_of(step: TimeStep, reaction: Array) -> Float[Array, " free"]:
    """Load on the free coordinates of the bases, in the mean frame of the drive."""
    return load_at(reaction, jnp.stack([step.old.drive[2], step.drive[2]]), step.system.free)


def load_at(reaction: Array, angles: Float[Array, " angles"], free: tuple[int, ...]) -> Float[Array, " free"]:
    """Load on the free coordinates of the bases, in the mean frame of a drive at these angles."""
    cos, sin = jnp.mean(jnp.cos(angles)), jnp.mean(jnp.sin(angles))
    fx, fy, mz = reaction.T
    load = -jnp.stack([cos * fx + sin * fy, cos * fy - sin * fx, mz], axis=-1)
    return jnp.ravel(load)[jnp.array(free, int)]


def spring_rows(step: TimeStep, z: Array, load: Array) -> Float[Array, " free"]:
    """Residuals of the springs between the bases."""
    system, old, h = step.system, step.old, step.h
    if system.network is None:
        return jnp.zeros(0)
    rate = (z - old.z) / h
    strain = system.strain(old.z + old.ahead * (z - old.z)) + system.stiffness_damping * rate
    if system.network.hold is not None:
        load += system.network.hold * strain
    return strain - system.network.compliance @ (load - system.network.damping @ rate)


def residual(step: TimeStep, mode: ContactMode, flat: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
    """All residuals of a step."""
    x = unknowns_of(step.system, flat)
    rows, _ = every(step, mode, x)
    springs = spring_rows(step, x.z, load_of(step, rows.reaction))
    return StepUnknowns(rows.bending, rows.contact, springs).flat()
