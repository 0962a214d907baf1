"""One time step of moving whiskers: the solution of its equations, and the state at its end."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.implicit import solution_of
from jaxwhisker._base.linear_algebra import UNROLLED, inverse, solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.gap import CLOSEST, MOST, closest, followed, gap_at, others_distance
from jaxwhisker._dynamics.inside import deepest
from jaxwhisker._dynamics.ledger import booked, with_pulls
from jaxwhisker._dynamics.motion_state import LEAP, Moving, Rod, Touching, nodes_of, posed
from jaxwhisker._dynamics.moving import System
from jaxwhisker._dynamics.places import with_places
from jaxwhisker._dynamics.stop import stopped
from jaxwhisker._dynamics.time_step import (
    ContactMode,
    Forces,
    Imposed,
    StepUnknowns,
    TimeStep,
    every,
    load_of,
    pulls_on,
    residual,
    rows_of,
    spring_rows,
    unknowns_at,
    unknowns_of,
)

CLOSE = 1e-6  # change of the unknowns at which Newton's method stops; the error is about its square
RESTART = 10  # iteration that starts again from the last state, without extrapolation
LET_GO = 20  # likewise, without the forces of contacts that have not converged: they may slip off an edge
HOLD = 30  # likewise, with contacts held at their old points of the whiskers; without edges, at once after LET_GO
MOST_ITERATIONS = 50
NEAR = 0.01  # distance of another object, beyond that of the closest one, at which it is measured in every step
CROSSES = 2e-3  # distance of a node beyond the tangent at the closest point at which the whole shaft is examined
MOST_BENT = 2.0  # largest change of a coefficient of the curvature in one iteration


def _newton(step: TimeStep, x: StepUnknowns, imposed: Imposed) -> tuple[StepUnknowns, ContactMode]:
    """The change of the unknowns in one iteration of Newton's method, and the mode in which it was computed.

    The inner coordinates of each whisker are eliminated first; contacts and bases remain.
    """
    system, old, drive, h = step
    n, c, free = system.n, system.contact_unknowns, system.free

    def one(rods, old, imposed, q, contact, base):
        def rows(unknowns):
            q, contact, moved = jnp.split(unknowns, [n, n + c])
            rows, trial = rows_of(step, rods, old, imposed, q, contact, base + moved if free else base)
            return rows.flat(), (rows.flat(), trial.mode)

        start = jnp.concatenate([q, contact, jnp.zeros(3 if free else 0)])
        slope, (value, mode) = jax.jacfwd(rows, has_aux=True)(start)
        right = jnp.concatenate([slope[:, n:], value[:, None]], axis=1)
        inner = _eliminated(jnp.concatenate([slope[:n, :n], right[:n]], axis=1))
        outer = right[n:] - jnp.sum(slope[n:, :n, None] * inner, axis=1)
        return inner, outer, mode

    inner, outer, mode = jax.vmap(one)(system.rods, old.rod, imposed, x.q, x.contact, system.bases(x.z, drive))
    if not free:
        contact = -solved_each(outer[:, :c, :c], outer[:, :c, -1])
        q = -inner[..., -1] - jnp.sum(inner[..., :-1] * contact[:, None], axis=-1)
        return StepUnknowns(q, contact, x.z[:0]), mode
    assert system.network is not None
    whiskers = x.q.shape[0]
    moves = jax.jacfwd(lambda z: system.bases(z, drive))(x.z)  # (whiskers, 3, free)

    def loads(reaction):
        return load_of(step, reaction)

    size = whiskers * c
    touching = (jnp.eye(whiskers)[:, None, :, None] * outer[:, :c, None, :c]).reshape(size, size)
    by_base = jnp.einsum("wcb,wbf->wcf", outer[:, :c, c:-1], moves).reshape(size, len(free))
    pushes = jnp.eye(whiskers)[:, None, :, None] * jnp.swapaxes(outer[:, c:, :c], 1, 2)[:, :, None]
    by_contact = jax.vmap(loads)(pushes.reshape(size, whiskers, 3))
    by_move = jax.vmap(loads, in_axes=2, out_axes=1)(jnp.einsum("wbk,wkf->wbf", outer[:, c:, c:-1], moves))
    network = system.network
    own = jnp.eye(len(free)) if network.hold is None else jnp.eye(len(free)) - network.compliance * network.hold
    own *= old.ahead + system.stiffness_damping / h
    own += network.compliance @ (network.damping / h - by_move)
    matrix = jnp.block([[touching, by_base], [-network.compliance @ by_contact.T, own]])
    springs = spring_rows(step, x.z, loads(outer[:, c:, -1]))
    right = jnp.append(jnp.ravel(outer[:, :c, -1]), springs)
    change = -(inverse(matrix) @ right if right.size > UNROLLED else solve(matrix, right[:, None])[:, 0])
    contact, z = change[:size].reshape(whiskers, c), change[size:]
    outside = jnp.concatenate([contact, moves @ z], axis=1)
    q = -inner[..., -1] - jnp.sum(inner[..., :-1] * outside[:, None], axis=-1)
    return StepUnknowns(q, contact, z), mode


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


def _iterate(step: TimeStep, guess: Array) -> tuple[Array, ContactMode, Bool[Array, ""]]:
    """Newton's method with an active set: the unknowns, the mode of all contacts, and whether it has converged."""
    system, c = step.system, step.system.contact_unknowns
    before = unknowns_at(step.old, system).flat()
    each = c // system.contacts
    limit = jnp.array([MOST, MOST, jnp.inf, jnp.inf][:each] * system.contacts)
    hold = HOLD if system.profile is not None and system.profile.has_edges else LET_GO
    counted = jnp.array([1.0, 1.0, 0.0, 0.0][:each])
    none, touching = jnp.zeros(system.contact_shape, int), step.old.rod.touching
    slips_off = none > 0 if touching is None else touching.touches & (touching.arc > 1 - LEAP)

    def improve(carry):
        flat, mode, size, k = carry
        flat = jnp.where((k == RESTART) | (k == LET_GO) | (k == hold), before, flat)
        free = jnp.where(k == LET_GO, slips_off & (system.over_contacts(size) > CLOSE), mode.imposed.free) & (k < hold)
        x = unknowns_of(system, flat)
        change, mode = _newton(step, x, Imposed(free, jnp.full_like(free, k >= hold)))
        contact = jnp.clip(change.contact, -limit, limit)
        # The closest points of whiskers that do not touch need not converge: they are found again after the step.
        moved = system.by_contact(contact) * counted * mode.touches[..., None]
        moved = moved.reshape(contact.shape)
        size = jnp.max(jnp.abs(jnp.concatenate([change.q, moved], axis=1)), axis=1)
        size = jnp.maximum(size, jnp.max(jnp.abs(change.z), initial=0.0))
        share = jnp.minimum(1.0, MOST_BENT / jnp.maximum(jnp.max(jnp.abs(change.q)), MOST_BENT))
        x = StepUnknowns(x.q + share * change.q, x.contact + share * contact, x.z + share * change.z)
        if c > 0:  # forces are not counted, but their signs are, and whether whiskers without them are inside
            wrong = mode.touches & ((system.by_contact(x.contact)[..., 2] < 0) | free)
            wrong = wrong if system.contacts == 1 else jnp.any(wrong, axis=1)
            size = jnp.where(wrong, jnp.maximum(size, 2 * CLOSE), size)
        return x.flat(), mode, size, k + 1

    def goes_on(carry):
        _, _, size, k = carry
        return ~jnp.all(size <= CLOSE) & ~jnp.any(jnp.isnan(size)) & (k < MOST_ITERATIONS)

    mode = ContactMode(none > 0, none, Imposed(none > 0, none > 0), none > 0 if system.may_wedge else None)
    start = guess, mode, jnp.full(none.shape[:1], jnp.inf), 0
    flat, mode, size, _ = jax.lax.while_loop(goes_on, improve, start)
    return flat, mode, jnp.all(size <= CLOSE)


def _equations(flat: Array, known: tuple[TimeStep, ContactMode]) -> Array:
    return residual(*known, flat)


def advance(system: System, old: Moving, drive: Array, rate: Array, h: Scalar) -> tuple[Moving, Forces]:
    """The state one time step later, with the drive at this pose and moving at this rate."""
    step, before = TimeStep(system, old, drive, h), unknowns_at(old, system).flat()
    guess = before + 2 * old.change[0] - old.change[1]
    flat, mode, solved = _iterate(*jax.lax.stop_gradient((step, guess)))
    flat = solution_of(_equations, flat, (step, mode))
    x = unknowns_of(system, flat)
    rows, trial = every(step, mode, x)
    base = system.bases(x.z, drive)
    at = nodes_of(system, base, trial.angle)
    touching, none = None, jnp.zeros(base.shape[0])
    contacts = system.by_contact(x.contact)
    normal, drag = (contacts[..., k] if contacts.shape[-1] > k else jnp.zeros(system.contact_shape) for k in (2, 3))
    if trial.gap is not None and old.rod.touching is not None:
        arc, parameter = contacts[..., 0], contacts[..., 1]
        began = mode.touches & ~old.rod.touching.lasts(arc)
        others, outside = old.rod.touching.others, none + jnp.inf
        if others is not None:
            others -= jnp.max(jnp.linalg.norm(jax.lax.stop_gradient(at - old.rod.at), axis=1), axis=1)
        found = arc, parameter, trial.gap, normal, drag, mode.touches, mode.slip, began, outside, others
        was = old.rod.touching
        touching = Touching(*found, piece=was.piece, away=was.away, distance=was.distance)
    velocity = old.rod.velocity + ((at - old.rod.at) / h - old.rod.velocity) / old.ahead
    spin = old.rod.spin + ((base[:, 2] - old.rod.base[:, 2]) / h - old.rod.spin) / old.ahead
    new = Moving(
        rod=Rod(x.q, base, trial.angle, at, velocity, spin, touching),
        z=x.z,
        drive=drive,
        change=jnp.stack([_extrapolated(system, flat - before), old.change[0]]),
        ledger=old.ledger,
        solved=old.solved & solved,
    )
    reaction = rows.reaction
    new = new._replace(ledger=booked(system, old, new, reaction, load_of(step, reaction), h))
    if system.rods.held is not None:
        pulls = jax.vmap(lambda *own: pulls_on(step, *own))(system.rods, old.rod, x.q, base, trial.angle)
        assert pulls is not None
        new = new._replace(ledger=with_pulls(system, old, new.ledger, pulls))
        # What the shaft carries at its base is the load of everything at the base and below.
        under = (system.rods.held.springs.at <= 0)[..., None]
        reaction += jnp.sum(jnp.where(under, pulls.about_base, 0.0), axis=1)
    if touching is not None:
        new, impulse = stopped(system, new, rate, h)
        reaction, normal, drag = reaction + impulse.reaction / h, normal + impulse.normal / h, drag + impulse.drag / h
        new = _with_closest(system, new, mode) if system.contacts == 1 else with_places(system, new)
    return new, Forces(reaction, normal, drag)


def _with_closest(system: System, moving: Moving, mode: ContactMode) -> Moving:
    """The state with the closest points where the step has not found them: of held contacts and of free whiskers."""
    rod, at = moving.rod, moving.rod.touching
    assert at is not None
    poses = system.rods.length, rod.base, rod.angle
    fixed, still, known = jax.lax.stop_gradient((system, poses, (at.arc, at.parameter)))

    def follow(poses, points):
        return jax.vmap(lambda pose, points: followed(posed(fixed, *pose), *points))(poses, points)

    def search(poses, points):
        return jax.vmap(lambda *pose: closest(posed(fixed, *pose)))(*poses), jnp.ones_like(mode.touches)

    off = jnp.abs(at.gap.end) + jnp.abs(at.gap.foot) > CLOSEST
    points, found = _where(~mode.touches & off & ~mode.imposed.held, follow, still, known, ~mode.imposed.held)
    if at.others is None:
        points, _ = _where(~found, search, still, points, found)
    else:  # another object may be nearer
        near, stays = at.others < jnp.maximum(at.gap.distance, 0.0) + NEAR, mode.touches & ~mode.imposed.held

        def renew(poses, points):
            points = jax.tree.map(lambda own, new: jnp.where(stays, own, new), points, search(poses, points)[0])
            return points, jax.vmap(lambda pose, parameter: others_distance(posed(fixed, *pose), parameter))(
                poses, points[1]
            )

        points, others = _where(near | ~found, renew, still, points, at.others)
        at, found = at._replace(others=others), found & (stays | ~near)

    def measure(poses, points):
        return points, jax.vmap(lambda pose, parameter: deepest(posed(fixed, *pose), parameter))(poses, points[1])

    # A convex object is on the other side of its tangent: a shaft that does not cross it is outside.
    off_tangent = jnp.sum(at.gap.normal[..., None] * rod.at, axis=1)
    touched = at.gap.normal[:, 0] * at.gap.object.x + at.gap.normal[:, 1] * at.gap.object.y
    crosses = jnp.min(off_tangent, axis=1) < touched - CROSSES
    points, least = _where(jax.lax.stop_gradient(crosses), measure, still, points, at.deepest)
    at = at._replace(deepest=least)
    changes = jax.tree.map(jnp.subtract, points, known)
    arc, parameter = at.arc + changes[0], at.parameter + changes[1]
    gap = jax.vmap(lambda pose, *points: gap_at(posed(system, *pose), *points))(poses, arc, parameter)
    last = unknowns_of(system, moving.change[0])
    last = last._replace(contact=jnp.where(found[:, None], last.contact, 0.0))
    return moving._replace(
        rod=rod._replace(touching=at._replace(arc=arc, parameter=parameter, gap=gap)),
        change=moving.change.at[0].set(last.flat()),
    )


def _where(
    needed: Array, found: Callable, poses: tuple[Array, ...], points: tuple[Array, Array], are_found: Array
) -> tuple[tuple[Array, Array], Array]:
    """Points, and whether they are found: computed anew for the whiskers that need it, and unchanged for the others.

    The loop runs once, or not at all if no whisker needs it. Below vmap, `cond` would always compute them. Without the
    barrier, XLA would move what follows from the poses out of the loop, and compute it in every time step.
    """

    def body(carry):
        needed, values = carry
        wanted, at = jax.lax.optimization_barrier((needed, poses))
        return jnp.zeros_like(needed), jax.tree.map(
            lambda new, old: jnp.where(wanted, new, old), found(at, values[0]), values
        )

    return jax.lax.while_loop(lambda carry: jnp.any(carry[0]), body, (needed, (points, are_found)))[1]


def _extrapolated(system: System, change: Array) -> Array:
    """The change without that of the contact forces, which are not extrapolated."""
    x = unknowns_of(system, change)
    each = x.contact.shape[1] // system.contacts
    places = jnp.array([1.0, 1.0, 0.0, 0.0][:each] * system.contacts)
    return StepUnknowns(x.q, x.contact * places, x.z).flat()
