"""One time step of moving whiskers: an energy-momentum method with contact at position level.

The nodes of a whisker (base, Gauss points, tip) have positions r(q) and velocities v of their own (Betsch and
Leyendecker 2006). A step from q0 to q1 solves

    D(q0, q1)^T m a + K (q0 + q1) / 2 = f c + base reaction,     a = (v1 - v0) / h,     (v0 + v1) / 2 = (r1 - r0) / h,

with the difference quotient D of the positions, D (q1 - q0) = r1 - r0: the change of (cos phi, sin phi) is
(-sin, cos)(mean angle) sinc(half the change) times the change of the angle. Multiplying by q1 - q0 shows that kinetic
plus elastic energy change by exactly the work of contact and base. The method has order 2 and is stable for any step.

At the end of the step the gap g and the contact force f satisfy 0 <= g, 0 <= f, g f = 0; the direction c of the contact
force is the mean of the gap's gradients at both ends. Where f > 0, an impulse then removes the velocity along the
normal: impacts have no restitution. This is also what keeps lasting contacts free of oscillations (as in RATTLE).

Coulomb friction holds for the mean tangential force t and the slip d of the material point in contact: d = 0 and
abs(t) <= mu f, or t = -mu f sign(d). The impulses obey the same law.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import UNROLLED, inverse, solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.gap import CLOSEST, MOST, Gap, closest, gap_at
from jaxwhisker._dynamics.ledger import booked
from jaxwhisker._dynamics.motion_state import Moving, Rod, Touching
from jaxwhisker._dynamics.moving import Rods, System
from jaxwhisker._dynamics.stop import stopped

CLOSE = 1e-6  # change of the unknowns at which Newton's method stops; the error is about its square
RESTART = 12  # iteration that starts again from the last state, without extrapolation
MOST_ITERATIONS = 30
MOST_BENT = 2.0  # largest change of a coefficient of the curvature in one iteration

PerWhisker = Float[Array, " whiskers"]


class Mode(NamedTuple):
    """Which equations contacts satisfy at the end of a step."""

    touches: Bool[Array, "*whiskers"]
    slip: Int[Array, "*whiskers"]  # +1 or -1 along the object; 0 if the contact sticks


class Forces(NamedTuple):
    """Mean forces of a step."""

    reaction: Float[Array, "whiskers 3"]  # support on whisker, in the scene: fx, fy, mz
    normal: PerWhisker
    drag: PerWhisker


class Trial(NamedTuple):
    """The end of a step of one whisker for trial values of its unknowns, and what follows from it."""

    angle: Array
    at: Array
    gap: Gap | None
    mode: Mode


class _Whisker(NamedTuple):
    """What the equations of one whisker depend on; or of all whiskers, stacked."""

    rods: Rods
    old: Rod


class _Rows(NamedTuple):
    """Residuals of one whisker for trial values, and the reaction of its support."""

    bending: Float[Array, " n"]
    contact: Float[Array, " contact"]  # see `_contact_rows`
    reaction: Float[Array, "3"]

    def flat(self) -> Array:
        """All of them in one array."""
        return jnp.concatenate(self)


def _rows(
    system: System, own: _Whisker, h: Scalar, mode: Mode | None, q: Array, contact: Array, base: Array
) -> tuple[_Rows, Trial]:
    """Residuals of one whisker in a mode, or in that which the trial values suggest."""
    rods, old = own
    shapes = system.basis
    angle = jnp.pi / 2 + base[2] + rods.rest + shapes.angles @ q
    turned = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    at = base[:2, None] + rods.length * (turned @ shapes.reach.T)
    mean = (at - old.at) / h
    force = rods.mass * (2 / h * (mean - old.velocity) + system.mass_damping * mean)
    half, middle = (angle - old.angle) / 2, (angle + old.angle) / 2
    moments = force @ shapes.reach
    torque = rods.length * _sinc(half) * (jnp.cos(middle) * moments[1] - jnp.sin(middle) * moments[0])
    push = jnp.sum(force, axis=-1)
    gap, rows = None, jnp.zeros(0)
    if system.profile is not None:
        assert old.touching is not None
        gap = gap_at(shapes, system.profile, rods.length, base[:2], angle, contact[0], contact[1])
        torque -= contact[2] * (old.touching.across + gap.across) / 2
        push -= contact[2] * (old.touching.normal + gap.normal) / 2
        along, tangent = (old.touching.along + gap.along) / 2, (old.touching.tangent + gap.tangent) / 2
        slipped = along @ (angle - old.angle) + tangent @ (base - old.base)[:2]
        mode = _mode(system, contact, gap.gap, slipped) if mode is None else mode
        closed = jnp.where(mode.touches, gap.gap, contact[2])
        rows = jnp.stack([gap.end, gap.foot, closed])
        if system.friction is not None:
            torque -= contact[3] * along
            push -= contact[3] * tangent
            dragged = contact[3] + system.friction * mode.slip * contact[2]
            rows = jnp.append(rows, jnp.where(mode.touches & (mode.slip == 0), slipped, dragged))
    mode = Mode(jnp.asarray(False), jnp.asarray(0)) if mode is None else mode
    bending = (old.q + q) / 2 + system.stiffness_damping / h * (q - old.q)
    bent = torque @ shapes.angles + jnp.sum(rods.stiffness * bending, axis=-1)
    twist = jnp.sum(torque) + rods.inertia * 2 / h * ((base[2] - old.base[2]) / h - old.spin)
    return _Rows(bent, rows, jnp.append(push, twist)), Trial(angle, at, gap, mode)


def _mode(system: System, contact: Array, gap: Scalar, slipped: Scalar) -> Mode:
    """Whether a whisker touches and slips, by the signs of trial gaps, forces and slips."""
    touches = contact[2] > gap
    if system.friction is None:
        return Mode(touches, jnp.asarray(0))
    drag, limit = contact[3] - slipped, system.friction * jnp.maximum(contact[2], 0.0)
    return Mode(touches, jnp.where(jnp.abs(drag) < limit, 0, -jnp.sign(drag)).astype(int))


def _sinc(x: Array) -> Array:
    """sin(x) / x; angles change by less than a radian in a step, and jnp.sinc compiles to a polynomial of its own."""
    square = x * x
    small = 1 - square / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72)))
    large = jnp.abs(x) > 0.1
    return jnp.where(large, jnp.sin(x) / jnp.where(large, x, 1.0), small)


class Unknowns(NamedTuple):
    """What a step solves for."""

    q: Float[Array, "whiskers n"]
    contact: Float[Array, "whiskers contact"]  # arc, parameter, normal force, with friction also drag
    z: Float[Array, " free"]

    def flat(self) -> Float[Array, " unknowns"]:
        """All unknowns in one array."""
        return jnp.concatenate([jnp.ravel(part) for part in self])


def _unknowns(system: System, flat: Float[Array, " unknowns"]) -> Unknowns:
    whiskers, n, c = system.rods.length.shape[0], system.n, system.contact_unknowns
    q, contact, z = jnp.split(flat, [whiskers * n, whiskers * (n + c)])
    return Unknowns(q.reshape(whiskers, n), contact.reshape(whiskers, c), z)


def _at(moving: Moving, system: System) -> Unknowns:
    """The unknowns of a state."""
    at, c = moving.rod.touching, system.contact_unknowns
    if at is None:
        return Unknowns(moving.rod.q, jnp.zeros((moving.rod.q.shape[0], 0)), moving.z)
    return Unknowns(moving.rod.q, jnp.stack([at.arc, at.parameter, at.force, at.drag][:c], axis=-1), moving.z)


def _every(system: System, old: Moving, drive: Array, h: Scalar, mode: Mode, x: Unknowns) -> tuple[_Rows, Trial]:
    """Residuals and reactions of all whiskers."""

    def one(own, mode, q, contact, base):
        return _rows(system, own, h, mode, q, contact, base)

    return jax.vmap(one)(_Whisker(system.rods, old.rod), mode, x.q, x.contact, system.bases(x.z, drive))


def _load(system: System, old: Moving, drive: Array, reaction: Array) -> Float[Array, " free"]:
    """Load on the free coordinates of the bases, in the mean frame of the drive."""
    cos, sin = ((turn(old.drive[2]) + turn(drive[2])) / 2 for turn in (jnp.cos, jnp.sin))
    fx, fy, mz = reaction.T
    load = -jnp.stack([cos * fx + sin * fy, cos * fy - sin * fx, mz], axis=-1)
    return jnp.ravel(load)[jnp.array(system.free, int)]


def _spring_rows(system: System, old: Moving, h: Scalar, z: Array, load: Array) -> Float[Array, " free"]:
    """Residuals of the springs."""
    if system.network is None:
        return jnp.zeros(0)
    rate = (z - old.z) / h
    strain = system.strain((old.z + z) / 2) + system.stiffness_damping * rate
    return strain - system.network.compliance @ (load - system.network.damping @ rate)


def _residual(system: System, old: Moving, drive: Array, h: Scalar, mode: Mode, flat: Array) -> Array:
    x = _unknowns(system, flat)
    rows, _ = _every(system, old, drive, h, mode, x)
    springs = _spring_rows(system, old, h, x.z, _load(system, old, drive, rows.reaction))
    return Unknowns(rows.bending, rows.contact, springs).flat()


def _newton(system: System, old: Moving, drive: Array, h: Scalar, x: Unknowns) -> tuple[Unknowns, Mode]:
    """The change of the unknowns in one iteration of Newton's method, and the mode in which it was computed.

    The inner coordinates of each whisker are eliminated first; contacts and bases remain.
    """
    n, c, free = system.n, system.contact_unknowns, system.free

    def one(own, q, contact, base):
        def rows(unknowns):
            q, contact, moved = jnp.split(unknowns, [n, n + c])
            rows, trial = _rows(system, own, h, None, q, contact, base + moved if free else base)
            return rows.flat(), (rows.flat(), trial.mode)

        start = jnp.concatenate([q, contact, jnp.zeros(3 if free else 0)])
        slope, (value, mode) = jax.jacfwd(rows, has_aux=True)(start)
        right = jnp.concatenate([slope[:, n:], value[:, None]], axis=1)
        inner = _eliminated(jnp.concatenate([slope[:n, :n], right[:n]], axis=1))
        outer = right[n:] - jnp.sum(slope[n:, :n, None] * inner, axis=1)
        return inner, outer, mode

    inner, outer, mode = jax.vmap(one)(_Whisker(system.rods, old.rod), x.q, x.contact, system.bases(x.z, drive))
    if not free:
        contact = -solved_each(outer[:, :c, :c], outer[:, :c, -1])
        q = -inner[..., -1] - jnp.sum(inner[..., :-1] * contact[:, None], axis=-1)
        return Unknowns(q, contact, x.z[:0]), mode
    assert system.network is not None
    whiskers = x.q.shape[0]
    moves = jax.jacfwd(lambda z: system.bases(z, drive))(x.z)  # (whiskers, 3, free)

    def loads(reaction):
        return _load(system, old, drive, reaction)

    size = whiskers * c
    touching = (jnp.eye(whiskers)[:, None, :, None] * outer[:, :c, None, :c]).reshape(size, size)
    by_base = jnp.einsum("wcb,wbf->wcf", outer[:, :c, c:-1], moves).reshape(size, -1)
    pushes = jnp.eye(whiskers)[:, None, :, None] * jnp.swapaxes(outer[:, c:, :c], 1, 2)[:, :, None]
    by_contact = jax.vmap(loads)(pushes.reshape(size, whiskers, 3))
    by_move = jax.vmap(loads, in_axes=2, out_axes=1)(jnp.einsum("wbk,wkf->wbf", outer[:, c:, c:-1], moves))
    network = system.network
    own = jnp.eye(len(free)) * (1 / 2 + system.stiffness_damping / h)
    own += network.compliance @ (network.damping / h - by_move)
    matrix = jnp.block([[touching, by_base], [-network.compliance @ by_contact.T, own]])
    springs = _spring_rows(system, old, h, x.z, loads(outer[:, c:, -1]))
    right = jnp.append(jnp.ravel(outer[:, :c, -1]), springs)
    change = -(inverse(matrix) @ right if right.size > UNROLLED else solve(matrix, right[:, None])[:, 0])
    contact, z = change[:size].reshape(whiskers, c), change[size:]
    outside = jnp.concatenate([contact, moves @ z], axis=1)
    q = -inner[..., -1] - jnp.sum(inner[..., :-1] * outside[:, None], axis=-1)
    return Unknowns(q, contact, z), mode


def solved_each(matrix: Float[Array, "whiskers c c"], right: Float[Array, "whiskers c"]) -> Float[Array, "whiskers c"]:
    """Solutions of small systems, one per whisker."""
    if right.shape[-1] == 0:
        return right
    return jax.vmap(lambda matrix, right: solve(matrix, right[:, None])[:, 0])(matrix, right)


def _eliminated(rows: Float[Array, "n columns"]) -> Float[Array, "n rest"]:
    """The inverse of the leading square block times the other columns.

    The block is the sum of a mass matrix, which dominates in small steps, and a positive definite stiffness:
    elimination needs no pivoting.
    """
    n = rows.shape[0]

    for i in range(n):
        pivot = rows[i] / rows[i, i]
        rows = jnp.where(jnp.arange(n)[:, None] == i, pivot, rows - rows[:, i, None] * pivot)
    return rows[:, n:]


def _iterate(system: System, old: Moving, drive: Array, h: Scalar, guess: Array) -> tuple[Array, Mode, Bool[Array, ""]]:
    """Newton's method with an active set: the unknowns, the mode of all contacts, and whether it has converged."""
    c = system.contact_unknowns
    before = _at(old, system).flat()
    limit = jnp.array([MOST, MOST, jnp.inf, jnp.inf][:c])
    counted = jnp.array([1.0, 1.0, 0.0, 0.0][:c])

    def improve(carry):
        flat, _, _, k = carry
        flat = jnp.where(k == RESTART, before, flat)
        x = _unknowns(system, flat)
        change, mode = _newton(system, old, drive, h, x)
        contact = jnp.clip(change.contact, -limit, limit)
        # The closest points of whiskers that do not touch need not converge: they are found again after the step.
        moved = contact * counted * mode.touches[:, None]
        size = jnp.max(jnp.abs(Unknowns(change.q, moved, change.z).flat()))
        share = jnp.minimum(1.0, MOST_BENT / jnp.maximum(jnp.max(jnp.abs(change.q)), MOST_BENT))
        x = Unknowns(x.q + share * change.q, x.contact + share * contact, x.z + share * change.z)
        if c > 0:  # forces are not counted, but their signs are
            pulls = jnp.any(mode.touches & (x.contact[:, 2] < 0))
            size = jnp.where(pulls, jnp.maximum(size, 2 * CLOSE), size)
        return x.flat(), mode, size, k + 1

    def goes_on(carry):
        _, _, size, k = carry
        return (size > CLOSE) & (k < MOST_ITERATIONS)  # NaN ends it, too

    none = jnp.zeros(system.rods.length.shape[0], int)
    start = guess, Mode(none > 0, none), jnp.asarray(jnp.inf), 0
    flat, mode, size, _ = jax.lax.while_loop(goes_on, improve, start)
    return flat, mode, size <= CLOSE


@eqx.filter_custom_jvp
def _differentiable(flat: Array, known: tuple, mode: Mode) -> Array:
    """The unknowns with their derivatives by the implicit function theorem."""
    del known, mode
    return flat


@_differentiable.def_jvp
def _(primals, tangents):
    flat, known, mode = primals
    _, known_dot, _ = tangents
    here = _differentiable(flat, known, mode)

    def residual(known, flat):
        system, old, drive, h = known
        return _residual(system, old, drive, h, mode, flat)

    slope = jax.jacfwd(lambda flat: residual(known, flat))(here)
    _, change = eqx.filter_jvp(lambda known: residual(known, here), (known,), (known_dot,))
    return here, -inverse(slope) @ change


def advance(system: System, old: Moving, drive: Array, rate: Array, h: Scalar) -> tuple[Moving, Forces]:
    """The state one time step later, with the drive at this pose and moving at this rate."""
    before = _at(old, system).flat()
    guess = before + 2 * old.change[0] - old.change[1]
    known = system, old, drive, h
    flat, mode, solved = _iterate(*jax.lax.stop_gradient((*known, guess)))
    flat = _differentiable(flat, known, mode)
    x = _unknowns(system, flat)
    rows, trial = _every(system, old, drive, h, mode, x)
    base, c = system.bases(x.z, drive), system.contact_unknowns
    touching, none = None, jnp.zeros(base.shape[0])
    normal, drag = (x.contact[:, k] if c > k else none for k in (2, 3))
    change = flat - before
    if trial.gap is not None:
        arc, parameter, gap, lost = _closest(system, base, trial.angle, x.contact, trial.gap, mode)
        shape = (gap.gap, gap.at_tip, gap.normal, gap.across, gap.tangent, gap.along)
        touching = Touching(arc, parameter, normal, drag, *shape, *mode)
        parts = _unknowns(system, change)
        change = Unknowns(parts.q, jnp.where(lost[:, None], 0.0, parts.contact), parts.z).flat()
    velocity = 2 / h * (trial.at - old.rod.at) - old.rod.velocity
    spin = 2 / h * (base[:, 2] - old.rod.base[:, 2]) - old.rod.spin
    new = Moving(
        rod=Rod(x.q, base, trial.angle, trial.at, velocity, spin, touching),
        z=x.z,
        drive=drive,
        change=jnp.stack([_extrapolated(system, change), old.change[0]]),
        ledger=old.ledger,
        solved=old.solved & solved,
    )
    reaction = rows.reaction
    new = new._replace(ledger=booked(system, old, new, reaction, _load(system, old, drive, reaction), h))
    if touching is not None:
        new, impulse = stopped(system, new, rate)
        reaction, normal, drag = reaction + impulse.reaction / h, normal + impulse.normal / h, drag + impulse.drag / h
    return new, Forces(reaction, normal, drag)


def _closest(
    system: System, base: Array, angle: Array, contact: Array, gap: Gap, mode: Mode
) -> tuple[PerWhisker, PerWhisker, Gap, Bool[Array, " whiskers"]]:
    """Closest points and gaps, and which of them Newton's method has lost and a search has found again."""
    lost = ~mode.touches & ~(jnp.abs(gap.end) + jnp.abs(gap.foot) < CLOSEST)
    assert system.profile is not None
    profile, shapes = system.profile, system.basis

    def search(length, base, angle):
        arc, parameter = closest(shapes, profile, length, base[:2], angle)
        return arc, parameter, gap_at(shapes, profile, length, base[:2], angle, arc, parameter)

    known = contact[:, 0], contact[:, 1], gap
    found = jax.lax.cond(jnp.any(lost), lambda: jax.vmap(search)(system.rods.length, base, angle), lambda: known)

    def select(found, known):
        return jnp.where(lost.reshape(-1, *[1] * (known.ndim - 1)), found, known)

    return (*jax.tree.map(select, found, known), lost)


def _extrapolated(system: System, change: Array) -> Array:
    """The change without that of the contact forces, which are not extrapolated."""
    x = _unknowns(system, change)
    return Unknowns(x.q, x.contact * jnp.array([1.0, 1.0, 0.0, 0.0][: x.contact.shape[1]]), x.z).flat()
