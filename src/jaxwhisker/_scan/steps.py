"""The steps of a scan: the equilibrium at every drive position, solved for from the path's interpolation."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact_state import ContactState, Places
from jaxwhisker._equilibrium.implicit import solved
from jaxwhisker._equilibrium.point import Contacts, Point, at_control, dot, scale_of
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

    def cubic(start, stop, leaving, arriving):
        return Cubic(start, stop, leaving * length, arriving * length / into)

    z_at, u_at = map(cubic, here.point, end, here.leaving, there.arriving)

    def towards(_, t):
        slope = u_at.rate(t)
        return jnp.clip(t - (u_at.value(t) - u) / jnp.where(slope == 0, 1.0, slope), 0.0, 1.0)

    span = end.u - here.point.u
    t = jnp.clip((u - here.point.u) / jnp.where(span == 0, 1.0, span), 0.0, 1.0)
    t = jax.lax.fori_loop(0, 6, towards, t)
    return Point(jnp.where(apart, z_at.value(t), here.point.z), u)


class Solutions(NamedTuple):
    """Equilibria at the steps of a scan. Steps that failed hold free whiskers."""

    z: Float[Array, "*steps whiskers numbers"]
    state: ContactState
    status: Int[Array, "*steps"]
    node: Int[Array, "*steps"] | None = None  # of the path, before the step; None without friction


def _solve(
    problem: Problem, path: Path, index: Int[Array, " steps"], u: Float[Array, " steps"], known: Int[Array, " steps"]
) -> Solutions:
    """Solve for the equilibria at controls after nodes `index`; `known` is the status of the path there."""
    state = jax.tree.map(lambda leaf: leaf[index], path.nodes.state)
    guess = jax.vmap(lambda index, u: interpolate(path, index, u))(index, u)
    solution = solve_points(problem, state, jax.vmap(at_control)(u, guess.z), guess)
    z = solution.point.z
    near = jnp.max(jnp.abs(z - guess.z) / scale_of(z), axis=(1, 2)) < JUMP
    stable = jax.vmap(lambda *own: is_stable(problem, *own))(state, solution.newton.condensed)
    status = jnp.where(solution.converged & near, jnp.where(stable, Status.ok, Status.unstable), Status.inexact)
    status = jnp.where(known == Status.ok, status, known)
    accepted = (status == Status.ok)[:, None]
    # Rejected steps are replaced by free whiskers, whose values and derivatives are finite (see `safe_placeholder`).
    state = state.ended(~accepted & jnp.ones_like(state.free))
    z = jnp.where(accepted[:, None], z, problem.unloaded(jnp.zeros(()))[0])
    return Solutions(z, state, status, None if state.friction is None else index)


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


def solved_states(
    problem: Problem, path: Path, control: Float[Array, " steps"], travel: Float[Array, " steps"]
) -> tuple[State, Int[Array, " steps"], Solutions]:
    """States and status at control positions, with derivatives, and the solutions that they follow from, without."""
    solutions = solve_steps(problem, path, control, travel)
    return *states(problem, control, with_places(solutions, path.nodes.state.places)), solutions


def with_places(solutions: Solutions, places: Places | None) -> Solutions:
    """The solutions, with derivatives of the places where contacts stick after each node; None without friction."""
    if places is None:
        return solutions
    parameter, arc_beyond = (leaf[solutions.node] for leaf in places)
    return solutions._replace(state=solutions.state.stuck_at((parameter, arc_beyond)))


def states(
    problem: Problem, control: Float[Array, " steps"], solutions: Solutions
) -> tuple[State, Int[Array, " steps"]]:
    """States and status of solved steps, in the scene's units, with derivatives; NaN for steps that failed."""
    u = control / problem.unit.control

    def point(u: Scalar, z: Contacts, state: ContactState) -> Point:
        return solved(Point(z, jax.lax.stop_gradient(u)), problem, state, at_control(u, z))

    # This is outside the loop because a loop that is differentiated backwards drops the rules for second derivatives.
    points = jax.vmap(point)(jnp.where(jnp.isfinite(u), u, 0.0), solutions.z, solutions.state)
    batch = min(BATCH, control.shape[0])
    values, residual = jax.lax.map(
        lambda one: signals(problem, one[0].z, one[0].u, one[1]), (points, solutions.state), batch_size=batch
    )
    ok = solutions.status == Status.ok
    status = jnp.where(ok & ~(residual < RESIDUAL), Status.inexact, solutions.status)
    ok = (status == Status.ok)[:, None]
    values = jax.tree.map(lambda leaf: jnp.where(ok, leaf, jnp.nan if eqx.is_inexact_array(leaf) else 0), values)
    return values, status
