"""Newton's method for whiskers in space.

A contact on the surface has six degrees of freedom: force, roll and slack, two coordinates of the contact point, and the
direction in which the whisker runs along the surface. A straight round whisker has no roll. A Newton step is a step in
these coordinates, and one back onto the surface. A network of springs couples the bases of all whiskers.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import block_diagonal, solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import PathCondition, Point, scale_of
from jaxwhisker._model.drives import Placement
from jaxwhisker._rod.elastica import AbstractRod
from jaxwhisker._space.contact import AHEAD, POINT, ROLL, UNKNOWNS, Body, base_of, frame_of, in_drive, on_surface
from jaxwhisker._space.problem import Contacts, SpaceProblem, of_each

Phases = Int[Array, " whiskers"]


class Linear(NamedTuple):
    """A whisker, linearised about a contact; `rows` are the equations of its base, `steps` as many and those of drag."""

    correction: Float[Array, "9"]  # of the contact, back onto the surface
    directions: Float[Array, "9 rows"]  # of steps along the surface
    pose: Float[Array, " rows"]  # coordinates of the base, after the correction
    load: Float[Array, " rows"]
    pose_by: Float[Array, "rows steps"]  # derivatives with respect to the steps
    load_by: Float[Array, "rows steps"]
    pose_by_u: Float[Array, " rows"]
    load_by_u: Float[Array, " rows"]
    own: Scalar  # largest residual of the equations of the surface, and infinite if the base points the wrong way


def linearise(
    problem: SpaceProblem,
    body: Body,
    drives: tuple[Placement, Placement],
    z: Float[Array, "9"],
    phase: Int[Array, ""],
    drag: Float[Array, "2"] | None = None,
) -> Linear:
    """Linearise one whisker; `drives` are the frame of the drive and its rate of change with the control."""
    surface, rows = problem.surface, problem.rows
    drive, rate = drives
    ahead, across, out = frame_of(surface, z).T
    off, lean, stretch = on_surface(surface, z)
    curvature = surface.curvature(z[POINT])

    def towards(point):  # a step of the contact point turns the direction with the surface
        return jnp.concatenate([jnp.zeros(3), point, -jnp.sum(z[AHEAD] * jnp.sum(curvature * point, axis=1)) * out])

    unit = np.eye(UNKNOWNS)
    scalars = [unit[k] for k in range(3) if problem.rolls or k != ROLL]
    turned = jnp.concatenate([jnp.zeros(6), across])
    directions = jnp.stack([*scalars, towards(ahead), towards(across), turned], axis=1)
    correction = towards(-off * out) - jnp.concatenate([jnp.zeros(6), lean * out + stretch * z[AHEAD]])

    def in_rows(base, drive, roll):
        inside = in_drive(base, drive, body.mount, roll)
        return (inside.pose[:rows], inside.load[:rows]), inside.upright

    def values(step):
        at = z + step[:UNKNOWNS]
        base = base_of(body, surface, problem.rod, at, phase, None if drag is None else drag + step[UNKNOWNS:])
        both, upright = in_rows(base, drive, at[ROLL])
        return both, (both, base, upright)

    steps = jnp.concatenate([directions, correction[:, None]], axis=1)
    if drag is not None:
        steps = jnp.block([[directions, jnp.zeros((UNKNOWNS, 2)), correction[:, None]], [jnp.zeros((2, rows)), np.eye(2, 3)]])
    _, (pose_by, load_by), (value, base, upright) = jax.vmap(
        lambda direction: jax.jvp(values, (jnp.zeros_like(direction),), (direction,), has_aux=True),
        in_axes=1,
        out_axes=(None, -1, None),
    )(steps)
    _, (pose_by_u, load_by_u) = jax.jvp(lambda drive: in_rows(base, drive, z[ROLL])[0], (drive,), (rate,))
    pose, load = (part + by[:, -1] for part, by in zip(value, (pose_by, load_by), strict=True))
    own = jnp.max(jnp.abs(jnp.stack([off, lean, stretch])))
    return Linear(
        correction,
        directions,
        pose,
        load,
        pose_by[:, :-1],
        load_by[:, :-1],
        pose_by_u,
        load_by_u,
        jnp.where(upright, own, jnp.inf),
    )


class NewtonStep(NamedTuple):
    """A Newton step, and the tangent of the path from the same linear system."""

    step: Point
    tangent: Point  # condition . tangent = 1
    residual: Scalar  # before the step
    system: Float[Array, "rows rows"]  # of the equilibrium at a fixed control


def newton_step(problem: SpaceProblem, phase: Phases, condition: PathCondition, point: Point) -> NewtonStep:
    """Solve the linearised equations of all whiskers, the network and the condition."""
    n, rows = phase.size, problem.rows
    drives = jax.jvp(problem.drive, (point.u,), (jnp.ones_like(point.u),))
    at = of_each(problem, lambda body, z, phase: linearise(problem, body, drives, z, phase), point.z, phase)
    touching = (phase != Phase.free)[:, None]
    block = touching[:, :, None]
    residual = jnp.where(touching, at.pose, 0.0)
    pose_by = jnp.where(block, at.pose_by, jnp.eye(rows))
    by_u = jnp.where(touching, at.pose_by_u, 0.0)
    system = block_diagonal(pose_by)
    if problem.springs is not None:
        load, load_by, load_by_u = (
            jnp.where(touching if part.ndim == 2 else block, part, 0.0) for part in (at.load, at.load_by, at.load_by_u)
        )
        moved = problem.displacement(load)
        residual = jnp.where(touching, residual - problem.springs.offset - moved, 0.0)
        yields = jnp.sum(problem.springs.matrix[:, :, None] * block_diagonal(load_by), axis=1)
        system -= jnp.where(jnp.repeat(touching, rows, axis=0), yields, 0.0)
        by_u = jnp.where(touching, by_u - problem.displacement(load_by_u), 0.0)
    correction = jnp.where(touching, at.correction, 0.0)
    directions = jnp.where(block, at.directions, np.eye(UNKNOWNS)[:, :rows])
    weight = jnp.ravel(jnp.sum(condition.weight_z[:, :, None] * directions, axis=1))
    missed = condition.residual(Point(point.z + correction, point.u), jnp.zeros(n))
    bordered = jnp.block([[system, jnp.ravel(by_u)[:, None]], [weight[None, :], jnp.reshape(condition.weight_u, (1, 1))]])
    residuals = jnp.append(jnp.ravel(residual), missed)
    last = np.eye(residuals.size)[-1]
    solution = solve(bordered, jnp.stack([-residuals, last], axis=1))

    def point_of(column):
        steps = jnp.reshape(column[:-1], (n, 1, rows))
        return Point(jnp.sum(directions * steps, axis=-1), column[-1])

    step, tangent = point_of(solution[:, 0]), point_of(solution[:, 1])
    own = jnp.max(jnp.where(touching[:, 0], at.own, 0.0))
    return NewtonStep(
        step._replace(z=step.z + correction),
        tangent,
        jnp.maximum(jnp.max(jnp.abs(residuals)), own),
        system,
    )


class _State(NamedTuple):
    step_size: Float[Array, "*batch"]


class SpaceNewton(optx.AbstractRootFinder):
    """Newton's method for a function that returns its own Newton step as auxiliary output.

    The tolerance applies to the last step, which the returned point includes.
    """

    rtol: float
    atol: float
    norm: Any = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        del fn, args, options, f_struct, aux_struct, tags
        return _State(jnp.full_like(y.u, jnp.inf))

    def step(self, fn, y, args, options, state, tags):
        del options, tags
        _, newton = fn(y, args)
        step = newton.step
        size = jnp.maximum(jnp.max(jnp.abs(step.z) / scale_of(y.z), axis=(-2, -1)), jnp.abs(step.u))
        # Solved and failed points of a batch stay where they are.
        solved, failed = state.step_size < self.atol, ~jnp.isfinite(size)
        stays = solved | failed
        step = Point(jnp.where(stays[..., None, None], 0.0, step.z), jnp.where(stays, 0.0, step.u))
        size = jnp.where(solved, state.step_size, jnp.where(failed, jnp.nan, size))
        return jax.tree.map(jnp.add, y, step), _State(size), newton

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, args, options, tags
        return jnp.all((state.step_size < self.atol) | jnp.isnan(state.step_size)), optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        del fn, args, options, state, tags, result
        return y, aux, {}


class Solution(NamedTuple):
    """A solved point; `newton` is a linearisation at most one step before that point."""

    point: Point
    newton: NewtonStep
    converged: Bool[Array, "*batch"]


def solve_points(problem: SpaceProblem, phases: Phases, conditions: PathCondition, guesses: Point) -> Solution:
    """Solve the equations of one point, or of several along a leading axis in one loop. Failure is a flag."""
    problem, conditions, guesses = jax.lax.stop_gradient((problem, conditions, guesses))
    several = jnp.ndim(guesses.u) > 0

    def equations(point, args):
        problem, phases, conditions = args
        one = lambda *own: newton_step(problem, *own)
        at = (jax.vmap(one) if several else one)(phases, conditions, point)
        return at.residual, at

    tolerance = problem.rod.newton_tolerance
    solution = optx.root_find(
        equations,
        SpaceNewton(0.0, tolerance),
        guesses,
        args=(problem, phases, conditions),
        has_aux=True,
        max_steps=problem.rod.newton_steps,
        throw=False,
    )
    point = solution.value
    finite = jnp.all(jnp.isfinite(point.z), axis=(-2, -1)) & jnp.isfinite(point.u)
    return Solution(point, solution.aux, (solution.state.step_size < tolerance) & finite)
