"""The states of a scan in space: equilibria at all positions of the drive, with their derivatives."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, at_control, dot, scale_of
from jaxwhisker._path.path import STOP, Status
from jaxwhisker._scan.space_result import SpaceState
from jaxwhisker._scan.space_signals import signals, solved
from jaxwhisker._space.contact import ROLL
from jaxwhisker._space.history import Followed, Linked, contacts_within, interpolated, stages_before
from jaxwhisker._space.march_state import SpacePath
from jaxwhisker._space.newton import Equations, Phases, plain, solve_points
from jaxwhisker._space.problem import Contacts, SpaceProblem
from jaxwhisker._space.shape import touches_twice
from jaxwhisker._space.slip import Mode, following

BATCH = 32  # steps solved for at once
RESIDUAL = 1e-8  # largest residual of a step marked ok
JUMP = 0.05  # a solution this far from the path's interpolation belongs to another branch
WIND_UP = 300.0  # turn of a base by the roll at the contact: a rod that magnifies errors more is `inexact`
TRAVEL_NOISE = 1e-12  # relative to the length of the path: travels that differ by less are taken as equal


def interpolate(path: SpacePath, index: Int[Array, ""], u: Scalar) -> Point:
    """The point of the path at a control between a node and the next one: cubic in arc length."""
    here = jax.tree.map(lambda leaf: leaf[index], path.nodes)
    there = jax.tree.map(lambda leaf: leaf[jnp.minimum(index + 1, path.count - 1)], path.nodes)
    scale = scale_of(here.point.z)
    end = Point(there.z_before, there.point.u)
    chord = Point(end.z - here.point.z, end.u - here.point.u)
    length = dot(here.leaving, chord, scale)
    apart = length > 0
    length = jnp.where(apart, length, 1.0)
    into = dot(here.leaving, there.arriving, scale)
    into = jnp.where(into > 0, into, 1.0)

    def cubic(start, stop, leaving, arriving):
        return Cubic(start, stop, leaving * length, arriving * length / into)

    z_at, u_at = map(cubic, here.point, end, here.leaving, there.arriving)

    def towards(_, t):
        slope = u_at.rate(t)
        return jnp.clip(t - (u_at.value(t) - u) / jnp.where(slope == 0, 1.0, slope), 0.0, 1.0)

    span = end.u - here.point.u
    t = jnp.clip((u - here.point.u) / jnp.where(span == 0, 1.0, span), 0.0, 1.0)
    t = jax.lax.fori_loop(0, 6, towards, t)
    touching = (here.phase != Phase.free)[:, None]
    return Point(jnp.where(apart & touching, z_at.value(t), here.point.z), u)


class SpaceSolutions(NamedTuple):
    """Equilibria at the steps of a scan. Steps that failed hold free whiskers."""

    z: Float[Array, "*steps whiskers 11"]
    phase: Int[Array, "*steps whiskers"]
    status: Int[Array, "*steps"]
    node: Int[Array, "*steps"]  # index of the node before


def _solve(
    problem: SpaceProblem, path: SpacePath, index: Int[Array, " steps"], u: Float[Array, " steps"], known: Array
) -> SpaceSolutions:
    """Solve for the equilibria at controls after nodes `index`; `known` is the status of the path there."""
    phase = path.nodes.phase[index]
    guess = jax.vmap(lambda index, u: interpolate(path, index, u))(index, u)
    equations = jax.vmap(plain)(phase, jax.vmap(at_control)(u, guess.z))
    solution = solve_points(problem, equations, jax.tree.map(lambda leaf: leaf[:, None], guess))
    return _accepted(problem, path, index, solution, guess, phase, known)


def _accepted(problem, path, index, solution, guess, phase, known) -> SpaceSolutions:
    z = solution.end.z
    near = jnp.max(jnp.abs(z - guess.z) / scale_of(z), axis=(1, 2)) < JUMP
    good = solution.converged & near
    if problem.rolls:
        # Curved rods with little torsional stiffness wind up: errors grow exponentially from either end to the other.
        turn = jnp.abs(solution.newton.at.pose_by[..., ROLL])
        good &= jnp.all((turn < WIND_UP) | (phase == Phase.free)[:, :, None], axis=(1, 2))
    status = jnp.where(good, Status.ok, Status.inexact)
    status = jnp.where(known == Status.ok, status, known)
    accepted = (status == Status.ok)[:, None]
    phase = jnp.where(accepted, phase, int(Phase.free))
    z = jnp.where(accepted[:, None], z, path.nodes.point.z[0])
    return SpaceSolutions(z, phase, status, index)


def _solve_with_friction(
    problem: SpaceProblem, path: SpacePath, index: Int[Array, " steps"], u: Float[Array, " steps"], known: Array
) -> SpaceSolutions:
    """The same with friction: the contacts are those within the steps of the path."""
    nodes, modes, friction = path.nodes, path.nodes.mode, problem.friction
    assert modes is not None and friction is not None
    # The last node ends a step.
    index = index - ((index == path.count - 1) & (nodes.kind[index] == STOP) & (index > 0))

    def at(index, u):
        end = jnp.minimum(index + 1, path.count - 1)
        start, before, phase = jax.tree.map(lambda leaf: leaf[index], (nodes.point, nodes.phase_before, nodes.phase))
        guess = interpolated(start, stages_before(nodes, end), before, phase, u)
        motion = following(guess, friction, modes[end])
        return Point(guess, u), Equations(phase[None], at_control(u, guess), None, motion)

    guess, equations = jax.vmap(at)(index, u)
    solution = solve_points(problem, equations, jax.tree.map(lambda leaf: leaf[:, None], guess))
    return _accepted(problem, path, index, solution, guess, nodes.phase[index], known)


def solve_steps(
    problem: SpaceProblem, path: SpacePath, control: Float[Array, " steps"], travel: Float[Array, " steps"]
) -> SpaceSolutions:
    """Solve for the equilibria at control positions that the drive passes after travelling `travel`.

    Positions are in the scene's units. The solutions have no derivatives: `states` attaches them.
    """
    problem, path, control, travel = jax.lax.stop_gradient((problem, path, control, travel))
    u, travel = control / problem.unit.control, travel / problem.unit.control
    node_travel = jnp.where(jnp.arange(path.nodes.travel.shape[0]) < path.count, path.nodes.travel, jnp.inf)
    last = jnp.maximum(path.count - 1, 0)
    end, u_end = (values[last] for values in (node_travel, jnp.asarray(path.nodes.point.u)))
    noise = TRAVEL_NOISE * (1 + end)
    # A step exactly at an event belongs to the phase that begins, whichever side rounding puts it on.
    index = jnp.clip(jnp.searchsorted(node_travel, travel + noise, side="right") - 1, 0, last)
    # A path that ends well has left the object behind.
    free = jnp.all(path.nodes.phase[last] == Phase.free) & (path.status == Status.ok)
    beyond = ((travel > end + noise) & ~free) | (path.count == 0)
    known = jnp.where(problem.valid, jnp.where(beyond, path.status, Status.ok), Status.invalid)
    # Newton's method would fail slowly at the steps beyond the end of a path.
    u = jnp.where(known == Status.ok, u, u_end)
    count = control.shape[0]
    batch = min(BATCH, count)
    padded = [jnp.pad(values, (0, -count % batch), mode="edge").reshape(-1, batch) for values in (index, u, known)]
    solve = _solve if problem.friction is None else _solve_with_friction

    def solve_touching(some):
        index, _, known = some
        z, phase = path.nodes.point.z[index], path.nodes.phase[index]
        free = SpaceSolutions(z, phase, known, index)
        return jax.lax.cond(jnp.any(phase != Phase.free), lambda: solve(problem, path, *some), lambda: free)

    solutions = jax.lax.map(solve_touching, padded)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:count], solutions)


def solved_states(
    problem: SpaceProblem,
    path: SpacePath,
    control: Float[Array, " steps"],
    travel: Float[Array, " steps"],
    links: Linked | None = None,
) -> tuple[SpaceState, Int[Array, " steps"], Float[Array, "steps whiskers 6"] | None, SpaceSolutions]:
    """What `states` returns at control positions, and the solutions, which have no derivatives."""
    solutions = solve_steps(problem, path, control, travel)
    return *states(problem, control, solutions, path, links), solutions


def states(
    problem: SpaceProblem,
    control: Float[Array, " steps"],
    solutions: SpaceSolutions,
    path: SpacePath | None = None,
    links: Linked | None = None,
) -> tuple[SpaceState, Int[Array, " steps"], Float[Array, "steps whiskers 6"] | None]:
    """States and status of solved steps, and displacements of the bases, in the scene's units, with derivatives.

    With friction, states follow from the nodes of the path, and `links` are these with their derivatives. Steps that
    failed hold NaN. Clamped bases have no displacements.
    """
    u = control / problem.unit.control

    def one(u: Scalar, z: Contacts, phase: Phases):
        return signals(problem, solved(problem, z, u, phase), u, phase)

    def one_with_friction(u: Scalar, found: SpaceSolutions):
        assert path is not None and path.nodes.mode is not None and links is not None
        end = jnp.minimum(found.node + 1, path.count - 1)
        start = jax.tree.map(lambda leaf: leaf[found.node], links.point)
        stages, mode = jax.tree.map(lambda leaf: leaf[end], (links.stages, path.nodes.mode))
        within = interpolated(start, stages, path.nodes.phase_before[found.node], found.phase, u)
        within = jnp.where((found.phase != Phase.free)[:, None], within, found.z)
        z = contacts_within(Followed(problem, u, found.phase, mode, within), found.z)
        return signals(problem, z, u, found.phase, mode == Mode.slips)

    u = jnp.where(jnp.isfinite(u), u, 0.0)
    if links is None:
        values, residual, displacement = jax.vmap(one)(u, solutions.z, solutions.phase)
    else:
        values, residual, displacement = jax.vmap(one_with_friction)(u, solutions)
    ok = solutions.status == Status.ok
    status = jnp.where(ok & ~(residual < RESIDUAL), Status.inexact, solutions.status)
    if problem.may_touch_twice:
        twice = jax.vmap(lambda z, phase: touches_twice(problem, z, phase))(solutions.z, solutions.phase)
        status = jnp.where((status == Status.ok) & twice, Status.second_contact, status)
    ok = status == Status.ok

    def if_ok(leaf):
        keep = jnp.reshape(ok, (-1,) + (1,) * (leaf.ndim - 1))
        return jnp.where(keep, leaf, jnp.nan if eqx.is_inexact_array(leaf) else 0)

    values, displacement = jax.tree.map(if_ok, (values, displacement))
    return values, status, displacement
