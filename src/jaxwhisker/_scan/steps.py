"""The steps of a scan: the equilibrium at every drive position, solved for from the path's interpolation."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.friction import Friction, newly_slipping
from jaxwhisker._equilibrium.implicit import solved
from jaxwhisker._equilibrium.pieces import where_touching
from jaxwhisker._equilibrium.point import Contacts, Mode, Point, at_control, dot, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.solver import solve_points
from jaxwhisker._equilibrium.stability import is_stable
from jaxwhisker._path.path import Path, Status
from jaxwhisker._scan.signals import signals
from jaxwhisker._scan.state import State

BATCH = 32  # steps solved for at once
RESIDUAL = 1e-8  # largest residual of a step marked ok; along x, relative to 1 + |u|
JUMP = 0.05  # a solution this far from the path's interpolation belongs to another branch
TRAVEL_NOISE = 1e-12  # relative to the length of the path: travels that differ by less are taken as equal


def interpolate(path: Path, index: Int[Array, ""], u: Scalar) -> Point:
    """The point of the path at a control between a node and the next one: cubic in arc length."""
    here = jax.tree.map(lambda leaf: leaf[index], path.nodes)
    there = jax.tree.map(lambda leaf: leaf[jnp.minimum(index + 1, path.count - 1)], path.nodes)
    end = Point(there.z_before, there.point.u)
    scale = scale_of(here.point.z)
    chord = Point(end.z - here.point.z, end.u - here.point.u)
    length = dot(here.leaving, chord, scale)
    apart = length > 0
    length = jnp.where(apart, length, 1.0)
    into = dot(here.leaving, there.arriving, scale)
    into = jnp.where(into > 0, into, 1.0)

    def cubic(start, end, leaving, arriving, t):
        leaving, arriving = leaving * length, arriving * length / into
        bend = 3 * (end - start) - 2 * leaving - arriving
        twist = leaving + arriving - 2 * (end - start)
        return start + t * (leaving + t * (bend + t * twist)), leaving + t * (2 * bend + t * 3 * twist)

    def towards(_, t):
        value, slope = cubic(here.point.u, end.u, here.leaving.u, there.arriving.u, t)
        return jnp.clip(t - (value - u) / jnp.where(slope == 0, 1.0, slope), 0.0, 1.0)

    span = end.u - here.point.u
    t = jnp.clip((u - here.point.u) / jnp.where(span == 0, 1.0, span), 0.0, 1.0)
    t = jax.lax.fori_loop(0, 6, towards, t)
    z, _ = cubic(here.point.z, end.z, here.leaving.z, there.arriving.z, t)
    return Point(jnp.where(apart, z, here.point.z), u)


class Solutions(NamedTuple):
    """Equilibria at the steps of a scan. Steps that failed hold free whiskers."""

    z: Float[Array, "*steps whiskers numbers"]
    phase: Int[Array, "*steps whiskers"]
    side: Float[Array, "*steps whiskers"]
    status: Int[Array, "*steps"]
    friction: Friction | None = None
    node: Int[Array, "*steps"] | None = None  # of the path, before the step; None without friction
    piece: Int[Array, "*steps whiskers"] | None = None  # of the profile at each contact; None without edges

    @property
    def mode(self) -> Mode:
        """The modes of the steps."""
        separate = jnp.zeros(self.status.shape, bool)
        return Mode(self.phase, self.side, separate, friction=self.friction, piece=self.piece)


def _solve(
    problem: Problem, path: Path, index: Int[Array, " steps"], u: Float[Array, " steps"], known: Int[Array, " steps"]
) -> Solutions:
    """Solve for the equilibria at controls after nodes `index`; `known` is the status of the path there."""
    nodes = path.nodes
    friction = jax.tree.map(lambda leaf: leaf[index], nodes.friction)
    piece = None if nodes.piece is None else nodes.piece[index]
    mode = Mode(nodes.phase[index], nodes.side[index], jnp.zeros(index.shape, bool), friction=friction, piece=piece)
    guess = jax.vmap(lambda index, u: interpolate(path, index, u))(index, u)
    solution = solve_points(problem, mode, jax.vmap(at_control)(u, guess.z), guess)
    z = solution.point.z
    near = jnp.max(jnp.abs(z - guess.z) / scale_of(z), axis=(1, 2)) < JUMP
    stable = jax.vmap(lambda *own: is_stable(problem, *own))(mode, solution.newton.condensed)
    status = jnp.where(solution.converged & near, jnp.where(stable, Status.ok, Status.unstable), Status.inexact)
    status = jnp.where(known == Status.ok, status, known)
    accepted = (status == Status.ok)[:, None]
    # Rejected steps are replaced by free whiskers, whose values and derivatives are finite (see `safe_placeholder`).
    phase = jnp.where(accepted, mode.phase, Phase.free)
    z = jnp.where(accepted[:, None], z, problem.unloaded(jnp.zeros(()))[0])
    piece = where_touching(piece, phase != Phase.free)
    if friction is None:
        return Solutions(z, phase, mode.side, status, piece=piece)
    friction = newly_slipping(friction, ~accepted & jnp.ones_like(phase, bool), mode.side)
    return Solutions(z, phase, mode.side, status, friction, index, piece)


def solve_steps(
    problem: Problem, path: Path, control: Float[Array, " steps"], travel: Float[Array, " steps"]
) -> Solutions:
    """Solve for the equilibria at control positions that the drive passes after travelling `travel`.

    Positions are in the scene's units. The solutions have no derivatives: `states` attaches them.
    """
    problem, path, control, travel = jax.lax.stop_gradient((problem, path, control, travel))
    u, travel = control / problem.unit.control, travel / problem.unit.control
    node_travel = jnp.where(jnp.arange(path.nodes.travel.shape[0]) < path.count, path.nodes.travel, jnp.inf)
    end, u_end = (values[path.count - 1] for values in (node_travel, jnp.asarray(path.nodes.point.u)))
    noise = TRAVEL_NOISE * (1 + end)
    # A step exactly at an event belongs to the phase that begins, whichever side rounding puts it on.
    index = jnp.clip(jnp.searchsorted(node_travel, travel + noise, side="right") - 1, 0, path.count - 1)
    beyond = (travel > end + noise) | (path.count == 0)
    known = jnp.where(problem.valid, jnp.where(beyond, path.status, Status.ok), Status.invalid)
    # Newton's method would fail slowly at the steps beyond the end of a path.
    u = jnp.where(known == Status.ok, u, u_end)
    count = control.shape[0]
    batch = min(BATCH, count)
    padded = [jnp.pad(values, (0, -count % batch), mode="edge").reshape(-1, batch) for values in (index, u, known)]
    solutions = jax.lax.map(lambda some: _solve(problem, path, *some), padded)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:count], solutions)


def states(
    problem: Problem, control: Float[Array, " steps"], solutions: Solutions
) -> tuple[State, Int[Array, " steps"]]:
    """States and status of solved steps, in the scene's units, with derivatives; NaN for steps that failed."""
    u = control / problem.unit.control
    modes = solutions.mode

    def point(u: Scalar, z: Contacts, mode: Mode) -> Point:
        return solved(Point(z, jax.lax.stop_gradient(u)), problem, mode, at_control(u, z))

    # This is outside the loop because a loop that is differentiated backwards drops the rules for second derivatives.
    points = jax.vmap(point)(jnp.where(jnp.isfinite(u), u, 0.0), solutions.z, modes)
    batch = min(BATCH, control.shape[0])
    state, residual = jax.lax.map(
        lambda one: signals(problem, one[0].z, one[0].u, one[1]), (points, modes), batch_size=batch
    )
    ok = solutions.status == Status.ok
    status = jnp.where(ok & ~(residual < RESIDUAL), Status.inexact, solutions.status)
    ok = (status == Status.ok)[:, None]
    state = jax.tree.map(lambda leaf: jnp.where(ok, leaf, jnp.nan if eqx.is_inexact_array(leaf) else 0), state)
    return state, status
