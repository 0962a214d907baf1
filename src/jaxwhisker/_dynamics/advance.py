"""One time step of moving whiskers: an energy-momentum method with contact at position level.

The nodes of a whisker (base, Gauss points, tip) have positions r(q) and velocities v of their own (Betsch and Leyendecker
2006). A step from q0 to q1 solves

    D(q0, q1)^T m a + K (q0 + q1) / 2 = f c + base reaction,     a = (v1 - v0) / h,     (v0 + v1) / 2 = (r1 - r0) / h,

with the difference quotient D of the positions, D (q1 - q0) = r1 - r0: the change of (cos phi, sin phi) is
(-sin, cos)(mean angle) sinc(half the change) times the change of the angle. Multiplying by q1 - q0 shows that kinetic
plus elastic energy change by exactly the work of contact and base. The method has order 2 and is stable for any step.

At the end of the step the gap g and the contact force f satisfy 0 <= g, 0 <= f, g f = 0; the direction c of the contact
force is the mean of the gap's gradients at both ends. Where f > 0, an impulse then removes the velocity along the
normal: impacts have no restitution. This is also what keeps lasting contacts free of oscillations (as in RATTLE).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.gap import MOST, gap_at
from jaxwhisker._dynamics.moving import System

CLOSE = 1e-7  # change of the unknowns at which a last iteration makes them exact to rounding
MOST_ITERATIONS = 15

PerWhisker = Float[Array, " whiskers"]


class Touching(NamedTuple):
    """The closest points of whiskers and object, and the contact."""

    arc: PerWhisker  # fraction of the length
    parameter: PerWhisker  # of the object
    force: PerWhisker  # mean over the last step
    gap: PerWhisker
    at_tip: PerWhisker  # positive if the tip is closest
    normal: Float[Array, "whiskers 2"]
    across: Float[Array, "whiskers points"]
    touches: Bool[Array, " whiskers"]


class Ledger(NamedTuple):
    """Work and losses since the start."""

    work: Scalar  # of the drive
    damping: Scalar
    impact: Scalar
    friction: Scalar
    contact: Scalar  # work of contact forces along the normal, an error of the method: the object rests


class Moving(NamedTuple):
    """Whiskers in motion, at one time."""

    q: Float[Array, "whiskers n"]
    z: Float[Array, " free"]
    base: Float[Array, "whiskers 3"]  # pose
    angle: Float[Array, "whiskers points"]
    at: Float[Array, "whiskers 2 nodes"]
    velocity: Float[Array, "whiskers 2 nodes"]
    spin: PerWhisker  # angular velocity of the base
    drive: Float[Array, "3"]
    touching: Touching | None
    change: Float[Array, " unknowns"]  # of the last step
    ledger: Ledger
    solved: Bool[Array, ""]


class Forces(NamedTuple):
    """Mean forces of a step."""

    reaction: Float[Array, "whiskers 3"]  # support on whisker, in the scene: fx, fy, mz
    contact: PerWhisker


def angles_of(system: System, q: Float[Array, "whiskers n"], base: Float[Array, "whiskers 3"]) -> Array:
    """Angles of all whiskers from +x at their Gauss points."""
    return jnp.pi / 2 + base[:, 2:] + system.rods.rest + q @ system.basis.angles.T


def nodes_of(system: System, base: Float[Array, "whiskers 3"], angle: Float[Array, "whiskers points"]) -> Array:
    """Positions of all nodes."""
    turned = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
    return base[:, :2, None] + system.rods.length[:, None, None] * (turned @ system.basis.reach.T)


class Unknowns(NamedTuple):
    """What a step solves for."""

    q: Float[Array, "whiskers n"]
    contact: Float[Array, "whiskers 3"] | None  # arc, parameter, force
    z: Float[Array, " free"]

    def flat(self) -> Float[Array, " unknowns"]:
        """All unknowns in one array."""
        return jnp.concatenate([jnp.ravel(part) for part in self if part is not None])


def _unknowns(system: System, flat: Float[Array, " unknowns"]) -> Unknowns:
    whiskers, n = system.rods.length.shape[0], system.n
    split = whiskers * n
    touch = None if system.profile is None else flat[split : split + 3 * whiskers].reshape(whiskers, 3)
    return Unknowns(flat[:split].reshape(whiskers, n), touch, flat[flat.size - len(system.free) :])


class _End(NamedTuple):
    """The end of a step for trial values of the unknowns."""

    base: Array
    angle: Array
    at: Array
    gaps: Any
    reaction: Array
    load: Array  # on the springs, in the frame of the drive
    rows: Array  # residuals of the whiskers
    network: Array  # residuals of the springs


def _end_of_step(system: System, old: Moving, drive: Array, h: Scalar, x: Unknowns) -> _End:
    rods, shapes = system.rods, system.basis
    base = system.bases(x.z, drive)
    angle = angles_of(system, x.q, base)
    at = nodes_of(system, base, angle)
    mean = (at - old.at) / h
    force = rods.mass[:, None] * (2 / h * (mean - old.velocity) + system.mass_damping * mean)
    half, turned = (angle - old.angle) / 2, (angle + old.angle) / 2
    size = rods.length[:, None] * jnp.sinc(half / jnp.pi)
    moments = force @ shapes.reach
    torque = size * (jnp.cos(turned) * moments[:, 1] - jnp.sin(turned) * moments[:, 0])
    push = jnp.sum(force, axis=-1)
    gaps = None
    if system.profile is not None and x.contact is not None:
        assert old.touching is not None
        arc, parameter, pressure = x.contact.T

        def one(length, base, angle, arc, parameter):
            return gap_at(shapes, system.profile, length, base, angle, arc, parameter)

        gaps = jax.vmap(one)(rods.length, base[:, :2], angle, arc, parameter)
        torque -= pressure[:, None] * (old.touching.across + gaps.across) / 2
        push -= pressure[:, None] * (old.touching.normal + gaps.normal) / 2
    rate = (x.q - old.q) / h
    bending = (old.q + x.q) / 2 + system.stiffness_damping * rate
    rows = torque @ shapes.angles + jnp.sum(rods.stiffness * bending[:, None, :], axis=-1)
    twist = jnp.sum(torque, axis=-1) + rods.inertia * 2 / h * ((base[:, 2] - old.base[:, 2]) / h - old.spin)
    reaction = jnp.concatenate([push, twist[:, None]], axis=-1)
    load, network = _springs(system, old, drive, h, x.z, reaction)
    return _End(base, angle, at, gaps, reaction, load, rows, network)


def _springs(system: System, old: Moving, drive: Array, h: Scalar, z: Array, reaction: Array) -> tuple[Array, Array]:
    """Load on the free coordinates of the bases, and the residuals of the springs."""
    if system.network is None:
        return jnp.zeros(0), jnp.zeros(0)
    cos, sin = ((turn(old.drive[2]) + turn(drive[2])) / 2 for turn in (jnp.cos, jnp.sin))
    fx, fy, mz = reaction.T
    load = -jnp.stack([cos * fx + sin * fy, cos * fy - sin * fx, mz], axis=-1)
    load = jnp.ravel(load)[jnp.array(system.free)]
    rate = (z - old.z) / h
    strain = system.strain((old.z + z) / 2) + system.stiffness_damping * rate
    damped = load - system.network.damping @ rate
    return load, strain - system.network.compliance @ damped


def _residual(
    system: System, old: Moving, drive: Array, h: Scalar, touches: Array | None, flat: Float[Array, " unknowns"]
) -> Float[Array, " unknowns"]:
    x = _unknowns(system, flat)
    end = _end_of_step(system, old, drive, h, x)
    if x.contact is None:
        return jnp.concatenate([jnp.ravel(end.rows), end.network])
    force = x.contact[:, 2]
    contact = jnp.stack([end.gaps.end, end.gaps.foot, jnp.where(touches, end.gaps.gap, force)], axis=-1)
    return jnp.concatenate([jnp.ravel(end.rows), jnp.ravel(contact), end.network])


def _touches(system: System, old: Moving, drive: Array, flat: Float[Array, " unknowns"]) -> Array | None:
    """Whether whiskers touch the object at the end of the step, by the signs of trial gaps and forces."""
    x = _unknowns(system, flat)
    if x.contact is None:
        return None
    base = system.bases(x.z, drive)
    angle = angles_of(system, x.q, base)

    def gap(length, base, angle, contact):
        return gap_at(system.basis, system.profile, length, base, angle, contact[0], contact[1]).gap

    gaps = jax.vmap(gap)(system.rods.length, base[:, :2], angle, x.contact)
    del old
    return x.contact[:, 2] > gaps


def advance(system: System, old: Moving, drive: Array, rate: Array, h: Scalar) -> tuple[Moving, Forces]:
    """The state one time step later, with the drive at this pose and moving at this rate."""
    guess = _flat(system, old) + old.change
    flat, touches, solved = _solve(*jax.lax.stop_gradient((system, old, drive, h, guess)))
    value, slope = _linearised(system, old, drive, h, touches, flat)
    # The last iteration carries the derivatives: the residual vanishes, so that only its own derivatives matter.
    flat = flat - jnp.linalg.solve(jax.lax.stop_gradient(slope), value)
    x = _unknowns(system, flat)
    end = _end_of_step(system, old, drive, h, x)
    velocity = 2 / h * (end.at - old.at) - old.velocity
    spin = 2 / h * (end.base[:, 2] - old.base[:, 2]) - old.spin
    touching, pressure = None, jnp.zeros_like(spin)
    if x.contact is not None:
        gaps, pressure = end.gaps, x.contact[:, 2]
        arc, parameter, _ = x.contact.T
        touching = Touching(arc, parameter, pressure, gaps.gap, gaps.at_tip, gaps.normal, gaps.across, touches)
    new = old._replace(
        q=x.q,
        z=x.z,
        base=end.base,
        angle=end.angle,
        at=end.at,
        velocity=velocity,
        spin=spin,
        drive=drive,
        touching=touching,
        change=(flat - _flat(system, old)).at[_forces(system)].set(0.0),
        ledger=_booked(system, old, end, x, h),
        solved=old.solved & solved,
    )
    reaction = end.reaction
    if touching is not None:
        new, impulse, kick = _stopped(system, new, rate)
        reaction, pressure = reaction + kick / h, pressure + impulse / h
    return new, Forces(reaction, pressure)


def _flat(system: System, at: Moving) -> Float[Array, " unknowns"]:
    touching = at.touching
    contact = None if touching is None else jnp.stack([touching.arc, touching.parameter, touching.force], axis=-1)
    return Unknowns(at.q, contact, at.z).flat()


def _forces(system: System) -> Array:
    """Indices of the contact forces among the unknowns; they are not extrapolated."""
    whiskers, n = system.rods.length.shape[0], system.n
    count = 0 if system.profile is None else whiskers
    return whiskers * n + 3 * jnp.arange(count) + 2


def _linearised(system, old, drive, h, touches, flat) -> tuple[Array, Array]:
    value, along = jax.linearize(lambda flat: _residual(system, old, drive, h, touches, flat), flat)
    return value, jax.vmap(along)(jnp.eye(flat.size)).T


def _solve(system: System, old: Moving, drive: Array, h: Scalar, guess: Array) -> tuple[Array, Array | None, Array]:
    """Newton's method with an active set: the unknowns, which whiskers touch, and whether it has converged."""
    whiskers, n = system.rods.length.shape[0], system.n
    places = whiskers * n + jnp.arange(3 * whiskers if system.profile is not None else 0)
    limit = jnp.full(guess.size, jnp.inf).at[places].set(jnp.tile(jnp.array([MOST, MOST, jnp.inf]), places.size // 3))
    counted = jnp.ones(guess.size).at[_forces(system)].set(0.0)

    def improve(carry):
        flat, touches, _, k = carry
        value, slope = _linearised(system, old, drive, h, touches, flat)
        change = jnp.clip(jnp.linalg.solve(slope, value), -limit, limit)
        flat = flat - change
        now = _touches(system, old, drive, flat)
        same = jnp.asarray(True) if touches is None else jnp.all(now == touches)
        size = jnp.max(jnp.abs(change) * counted)
        return flat, now, jnp.where(same, size, jnp.maximum(size, 2 * CLOSE)), k + 1

    def goes_on(carry):
        _, _, size, k = carry
        return (size > CLOSE) & (k < MOST_ITERATIONS)  # NaN ends it, too

    start = guess, _touches(system, old, drive, guess), jnp.asarray(jnp.inf), 0
    flat, touches, size, _ = jax.lax.while_loop(goes_on, improve, start)
    return flat, touches, size <= CLOSE


def _booked(system: System, old: Moving, end: _End, x: Unknowns, h: Scalar) -> Ledger:
    """Work and losses of a step, without impulses."""
    ledger, moved = old.ledger, end.at - old.at
    bent, slid = x.q - old.q, x.z - old.z
    lost = system.mass_damping / h * jnp.sum(system.rods.mass[:, None] * moved**2)
    lost += system.stiffness_damping / h * jnp.sum(bent[:, :, None] * system.rods.stiffness * bent[:, None, :])
    work = jnp.sum(end.reaction * (end.base - old.base))
    if system.network is not None:
        stored = jnp.sum(slid * _solve_springs(system, system.strain((old.z + x.z) / 2)))
        spent = jnp.sum(slid * end.load) - stored
        lost, work = lost + spent, work + jnp.sum(slid * end.load)
    contact = jnp.zeros(())
    if x.contact is not None:
        assert old.touching is not None
        across, normal = (old.touching.across + end.gaps.across) / 2, (old.touching.normal + end.gaps.normal) / 2
        closed = jnp.sum(across * (end.angle - old.angle), axis=-1)
        closed += jnp.sum(normal * (end.base - old.base)[:, :2], axis=-1)
        contact = jnp.sum(x.contact[:, 2] * closed)
    return ledger._replace(work=ledger.work + work, damping=ledger.damping + lost, contact=ledger.contact + contact)


def _solve_springs(system: System, strain: Float[Array, " free"]) -> Float[Array, " free"]:
    """Elastic forces of the springs."""
    assert system.network is not None
    return jnp.linalg.solve(system.network.compliance, strain)


def _stopped(system: System, new: Moving, rate: Array) -> tuple[Moving, PerWhisker, Float[Array, "whiskers 3"]]:
    """The state after impulses that stop the motion along the normal, these impulses, and those of the supports."""
    _, carried = jax.jvp(lambda drive: system.bases(new.z, drive), (new.drive,), (rate,))
    whiskers = new.spin.shape[0]
    free = jnp.zeros(3 * whiskers, bool).at[jnp.array(system.free, int)].set(True).reshape(whiskers, 3)
    cos, sin = jnp.cos(new.drive[2]), jnp.sin(new.drive[2])
    frame = jnp.array([[1.0, 0.0], [0.0, 1.0]]) * cos + jnp.array([[0.0, -1.0], [1.0, 0.0]]) * sin

    def one(length, mass, inertia, angle, at, base, velocity, spin, touching, carried, free):
        shapes = system.basis
        turning = jnp.stack([-jnp.sin(angle), jnp.cos(angle)])  # (2, points)
        apart = at - base[:2, None]
        about = jnp.stack([-apart[1], apart[0]])
        bends = length * jnp.einsum("ij,cj,jk->cik", shapes.reach, turning, shapes.angles)
        shifts = jnp.broadcast_to(frame[:, None, :], (2, mass.size, 2))
        moves = jnp.concatenate([bends, shifts, about[:, :, None]], axis=-1)
        moves = moves.at[:, :, system.n :].multiply(free)
        size = moves.shape[-1]
        heavy = mass[:, None] * moves
        total = jnp.einsum("cik,cil->kl", moves, heavy)
        total = total.at[-1, -1].add(jnp.where(free[2], inertia, 0.0))
        total += jnp.diag(jnp.where(jnp.arange(size) < system.n, 0.0, 1.0 - jnp.pad(free, (system.n, 0))))
        turn = jnp.sum(touching.across)
        gradient = [touching.across @ shapes.angles, (touching.normal @ frame) * free[:2], (turn * free[2])[None]]
        gradient = jnp.concatenate(gradient)
        own = velocity - carried[:2, None] - carried[2] * about
        momentum = jnp.einsum("cik,ci->k", heavy, own)
        momentum = momentum.at[-1].add(jnp.where(free[2], inertia * (spin - carried[2]), 0.0))
        speed, answer = jnp.linalg.solve(total, jnp.stack([momentum, gradient], axis=-1)).T
        closing = gradient @ speed + touching.normal @ carried[:2] + turn * carried[2]
        ease = gradient @ answer
        impulse = jnp.where(touching.touches, -closing / ease, 0.0)
        change = moves @ (impulse * answer)
        spun = impulse * answer[-1] * free[2]
        pushed = jnp.sum(mass * change, axis=-1) - impulse * touching.normal
        twisted = jnp.sum(mass * about * change) + inertia * spun - impulse * turn
        loss = jnp.where(touching.touches, closing**2 / (2 * ease), 0.0)
        return velocity + change, spin + spun, impulse, jnp.append(pushed, twisted), loss, carried @ jnp.append(pushed, twisted)

    given = (*(system.rods.length, system.rods.mass, system.rods.inertia), new.angle, new.at, new.base, new.velocity)
    velocity, spin, impulse, kick, loss, work = jax.vmap(one)(*given, new.spin, new.touching, carried, free)
    ledger = new.ledger
    ledger = ledger._replace(impact=ledger.impact + jnp.sum(loss), work=ledger.work + jnp.sum(work))
    return new._replace(velocity=velocity, spin=spin, ledger=ledger), impulse, kick
