"""Scans in space: the path of equilibria, and the state at every position of the drive."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Control, Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, at_control, dot, scale_of
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._path.path import Status
from jaxwhisker._scan.route import Route, across, route_of, straight, stops_of, traced_route
from jaxwhisker._scan.space_result import SpaceResult, SpaceState
from jaxwhisker._scan.space_signals import events, signals, solved
from jaxwhisker._space.approach import crop, limits_of
from jaxwhisker._space.march import SpacePath, march
from jaxwhisker._space.newton import Phases, solve_points
from jaxwhisker._space.problem import Contacts, SpaceProblem, problem_in_space

STEP = 0.001  # of the default control, dimensionless
TRACED_STEPS = 2048  # of the default control of a traced scene
BATCH = 32  # steps solved for at once
BLOCK = 512
RESIDUAL = 1e-8  # largest residual of a step marked ok
JUMP = 0.05  # a solution this far from the path's interpolation belongs to another branch
TRAVEL_NOISE = 1e-12


class SpaceScanPath(NamedTuple):
    """A path, and the range of the control in which whiskers touch the object."""

    path: SpacePath
    start: Scalar
    stop: Scalar


def follow_path(problem: SpaceProblem, stops: Float[Array, " stops"], last: Int[Array, ""]) -> SpaceScanPath:
    """March to all stops, given in the scene's units; right across the object if the first one is NaN."""
    problem, stops = jax.lax.stop_gradient((problem, jnp.asarray(stops)))
    stops, whole = stops / problem.unit.control, jnp.isnan(stops[0])
    limits = limits_of(problem, stops[0])
    stops = jnp.where(whole, jnp.full_like(stops, limits.far).at[0].set(limits.start), stops)
    path = march(problem, limits.start, stops, jnp.asarray(last))
    path, start, stop = crop(problem, path, limits, whole)
    return SpaceScanPath(path, start * problem.unit.control, stop * problem.unit.control)


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
    into = jnp.where(into > 0.1, into, 1.0)

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


def _solve(problem: SpaceProblem, path: SpacePath, index, u, known) -> SpaceSolutions:
    phase = path.nodes.phase[index]
    guess = jax.vmap(lambda index, u: interpolate(path, index, u))(index, u)
    solution = solve_points(problem, phase, jax.vmap(at_control)(u, guess.z), guess)
    z = solution.point.z
    near = jnp.max(jnp.abs(z - guess.z) / scale_of(z), axis=(1, 2)) < JUMP
    status = jnp.where(solution.converged & near, Status.ok, Status.inexact)
    status = jnp.where(known == Status.ok, status, known)
    accepted = (status == Status.ok)[:, None]
    phase = jnp.where(accepted, phase, int(Phase.free))
    z = jnp.where(accepted[:, None] & jnp.isfinite(z), z, path.nodes.point.z[0])
    return SpaceSolutions(z, phase, status)


def solve_steps(problem: SpaceProblem, path: SpacePath, control: Array, travel: Array) -> SpaceSolutions:
    """Solve for the equilibria at control positions that the drive passes after travelling `travel`."""
    problem, path, control, travel = jax.lax.stop_gradient((problem, path, control, travel))
    u, travel = control / problem.unit.control, travel / problem.unit.control
    node_travel = jnp.where(jnp.arange(path.nodes.travel.shape[0]) < path.count, path.nodes.travel, jnp.inf)
    end, u_end = (values[path.count - 1] for values in (node_travel, jnp.asarray(path.nodes.point.u)))
    noise = TRAVEL_NOISE * (1 + end)
    index = jnp.clip(jnp.searchsorted(node_travel, travel + noise, side="right") - 1, 0, path.count - 1)
    # A path that ends well has left the object behind.
    free = jnp.all(path.nodes.phase[path.count - 1] == Phase.free) & (path.status == Status.ok)
    beyond = ((travel > end + noise) & ~free) | (path.count == 0)
    known = jnp.where(problem.valid, jnp.where(beyond, path.status, Status.ok), Status.invalid)
    u = jnp.where(known == Status.ok, u, u_end)
    count = control.shape[0]
    batch = min(BATCH, count)
    padded = [jnp.pad(values, (0, -count % batch), mode="edge").reshape(-1, batch) for values in (index, u, known)]
    solutions = jax.lax.map(lambda some: _solve(problem, path, *some), padded)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:count], solutions)


def states(problem: SpaceProblem, control: Array, solutions: SpaceSolutions) -> tuple[SpaceState, Int[Array, " steps"]]:
    """States and status of solved steps, in the scene's units, with derivatives; NaN for steps that failed."""
    u = control / problem.unit.control

    def one(u: Scalar, z: Contacts, phase: Phases):
        return signals(problem, solved(problem, z, u, phase), u, phase)

    values, residual = jax.vmap(one)(jnp.where(jnp.isfinite(u), u, 0.0), solutions.z, solutions.phase)
    ok = solutions.status == Status.ok
    status = jnp.where(ok & ~(residual < RESIDUAL), Status.inexact, solutions.status)
    ok = status == Status.ok

    def if_ok(leaf):
        keep = jnp.reshape(ok, (-1,) + (1,) * (leaf.ndim - 1))
        return jnp.where(keep, leaf, jnp.nan if eqx.is_inexact_array(leaf) else 0)

    return jax.tree.map(if_ok, values), status


follow_path_now = Program(follow_path, frozen=True)
solve_steps_now = Program(solve_steps, frozen=True)
states_now, events_now, problem_now = Program(states), Program(events), Program(problem_in_space)


def scan_in_space(scene: SpaceScene, control: Control | None = None) -> SpaceResult:
    """Scan past a surface in space; see `scan`."""
    if control is not None:
        checks.vector("control", control)
    scene = jax.tree.map(checks.as_float, scene)
    problem = problem_now(scene)
    stops, last = across()
    route = None
    if control is not None:
        route = route_of(np.asarray(control, dtype=float))
        stops, last = route.stops, route.last
    path, start, stop = follow_path_now(problem, stops, np.asarray(last))
    if route is None:
        step = STEP * float(problem.unit.control)
        count = max(2, int(np.ceil(abs(float(stop) - float(start)) / step)) + 1)
        route = route_of(float(start) + np.sign(float(stop) - float(start)) * step * np.arange(count))
    solutions = solve_steps_now(problem, path, route.control, route.travel)
    state, status = states_now(problem, route.control, solutions)
    fields = {name: getattr(state, name) for name in SpaceState.__dataclass_fields__}
    return SpaceResult(**fields, control=jnp.asarray(route.control), status=status,
                       deferred_events=lambda: events_now(problem, path), scene=scene)
