"""The steps of a scan: the equilibrium at every drive position, solved for from the path's interpolation."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.point import Contacts, Point, dot, scale_of
from jaxwhisker._path.path import Path, Status
from jaxwhisker._scan.mechanics import AnyProblem, Mechanics, Memory, Solutions

BATCH = 32  # steps solved for at once
RESIDUAL = 1e-8  # largest residual of a step marked ok; along x, relative to 1 + |u|
JUMP = 0.05  # a solution this far from the path's interpolation belongs to another branch
TRAVEL_NOISE = 1e-12  # relative to the length of the path: travels that differ by less are taken as equal


def interpolate(path: Path, index: Int[Array, ""], u: Scalar) -> Point:
    """The point of the path at a control between a node and the next one: cubic in arc length."""
    nodes, after = path.nodes, jnp.minimum(index + 1, path.count - 1)
    start, leaving = jax.tree.map(lambda leaf: leaf[index], (nodes.point, nodes.leaving))
    end, arriving = jax.tree.map(lambda leaf: leaf[after], (Point(nodes.z_before, nodes.point.u), nodes.arriving))
    scale = scale_of(start.z)
    length = dot(leaving, Point(end.z - start.z, end.u - start.u), scale)
    apart = length > 0
    length = jnp.where(apart, length, 1.0)
    into = dot(leaving, arriving, scale)
    into = jnp.where(into > 0, into, 1.0)

    def cubic(first, last, leaving, arriving):
        return Cubic(first, last, leaving * length, arriving * length / into)

    z_at, u_at = map(cubic, start, end, leaving, arriving)

    def towards(_, t):
        slope = u_at.rate(t)
        return jnp.clip(t - (u_at.value(t) - u) / jnp.where(slope == 0, 1.0, slope), 0.0, 1.0)

    span = end.u - start.u
    t = jnp.clip((u - start.u) / jnp.where(span == 0, 1.0, span), 0.0, 1.0)
    t = jax.lax.fori_loop(0, 6, towards, t)
    return Point(jnp.where(apart, z_at.value(t), start.z), u)


def is_near(z: Contacts, guess: Contacts) -> Bool[Array, " steps"]:
    """Whether solutions, with a leading axis of steps, belong to the branch of the path that was interpolated."""
    return jnp.max(jnp.abs(z - guess) / scale_of(z), axis=(1, 2)) < JUMP


def solve_steps(
    mechanics: type[Mechanics],
    problem: AnyProblem,
    path: Path,
    control: Float[Array, " steps"],
    travel: Float[Array, " steps"],
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
    solutions = jax.lax.map(lambda some: mechanics.solve(problem, path, *some), padded)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:count], solutions)


def states(
    mechanics: type[Mechanics],
    problem: AnyProblem,
    control: Float[Array, " steps"],
    solutions: Solutions,
    remembered: Any = None,
) -> tuple[Any, Int[Array, " steps"], Any]:
    """States and status of solved steps, and displacements of the bases, in the scene's units, with derivatives.

    Steps that failed hold NaN. Displacements are None where they are not needed. `remembered` is what contacts with
    friction remember at each step.
    """
    u = control / problem.unit.control
    u = jnp.where(jnp.isfinite(u), u, 0.0)
    values, residual, displacement = mechanics.states(problem, u, solutions, remembered)
    ok = solutions.status == Status.ok
    status = jnp.where(ok & ~(residual < RESIDUAL), Status.inexact, solutions.status)
    status = mechanics.checked(problem, solutions, status)
    values, displacement = kept((values, displacement), status == Status.ok)
    return values, status, displacement


def kept(values: Any, good: Bool[Array, " rows"]) -> Any:
    """Arrays whose first axis runs over rows, with NaN, or zero for integers, in rows that are not good."""

    of_rows = {1: good}  # by number of axes

    def keep(leaf: Array) -> Array:
        if leaf.ndim not in of_rows:
            of_rows[leaf.ndim] = jnp.expand_dims(good, tuple(range(1, leaf.ndim)))
        return jnp.where(of_rows[leaf.ndim], leaf, jnp.nan if eqx.is_inexact_array(leaf) else 0)

    return jax.tree.map(keep, values)


def solved_states(
    mechanics: type[Mechanics],
    problem: AnyProblem,
    path: Path,
    control: Float[Array, " steps"],
    travel: Float[Array, " steps"],
    memory: Memory = None,
) -> tuple[Any, Int[Array, " steps"], Any, Solutions]:
    """What `states` returns at control positions, and the solutions that it follows from, without derivatives."""
    solutions = solve_steps(mechanics, problem, path, control, travel)
    remembered = mechanics.remembered(memory, path, solutions)
    return *states(mechanics, problem, control, solutions, remembered), solutions
