"""Newton's method for whiskers in space.

A contact on the surface has six degrees of freedom: force, roll and slack, two coordinates of the contact point, and
the direction in which the whisker runs along the surface. A straight round whisker has no roll. A Newton step is a step
in these coordinates, and one back onto the surface. A network of springs couples the bases of all whiskers. Where
contacts may slide after a loss of stability, their tractions are two more unknowns.
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
from jaxwhisker._space.contact import (
    AHEAD,
    POINT,
    ROLL,
    SLACK,
    TRACTION,
    UNKNOWNS,
    Body,
    base_of,
    frame_of,
    in_drive,
    on_surface,
)
from jaxwhisker._space.problem import Contacts, SpaceProblem, of_each

Phases = Int[Array, " whiskers"]


class Sliding(NamedTuple):
    """A time step in which contacts slide against a traction that is proportional to their speed."""

    now: Bool[Array, ""]  # whether they do; otherwise there is no traction
    time: Scalar  # length of the step
    start: Contacts


class Linear(NamedTuple):
    """A whisker, linearised about a contact.

    There are `rows` equations of its base and as many `steps`, or with a traction two more.
    """

    correction: Float[Array, "11"]  # of the contact, back onto the surface
    directions: Float[Array, "11 steps"]
    pose: Float[Array, " rows"]  # coordinates of the base, after the correction
    load: Float[Array, " rows"]
    pose_by: Float[Array, "rows steps"]  # derivatives with respect to the steps
    load_by: Float[Array, "rows steps"]
    pose_by_u: Float[Array, " rows"]
    load_by_u: Float[Array, " rows"]
    own: Scalar  # largest residual of the surface; infinite beyond the base, or if the base points the wrong way


def linearise(
    problem: SpaceProblem,
    body: Body,
    drives: tuple[Placement, Placement],
    z: Float[Array, "11"],
    phase: Int[Array, ""],
    *,
    slides: bool,
) -> Linear:
    """Linearise one whisker; `drives` are the frame of the drive and its rate of change with the control."""
    surface, rows = problem.surface, problem.rows
    drive, rate = drives
    ahead, across, out = frame_of(surface, z).T
    off, lean, stretch = on_surface(surface, z)
    curvature = surface.curvature(z[POINT])

    def step_of(point=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)):
        # A step of the contact point turns the direction with the surface.
        point = jnp.asarray(point)
        turn = jnp.asarray(turn) - jnp.sum(z[AHEAD] * jnp.sum(curvature * point, axis=1)) * out
        return jnp.concatenate([jnp.zeros(3), point, turn, jnp.zeros(2)])

    unit = np.eye(UNKNOWNS)
    scalars = [unit[k] for k in range(3) if problem.rolls or k != ROLL]
    tractions = [unit[9], unit[10]] * slides
    own = [step_of(ahead), step_of(across), step_of(turn=across)]
    directions = jnp.stack([*scalars, *own, *tractions], axis=1)
    correction = step_of(-off * out, -lean * out - stretch * z[AHEAD])

    def in_rows(base, drive, roll):
        inside = in_drive(base, drive, body.mount, roll)
        return (inside.pose[:rows], inside.load[:rows]), inside.upright

    def values(step):
        at = z + step
        base = base_of(body, surface, problem.rod, at, phase, slides=slides)
        both, upright = in_rows(base, drive, at[ROLL])
        return both, (both, base, upright)

    _, (pose_by, load_by), (value, base, upright) = jax.vmap(
        lambda direction: jax.jvp(values, (jnp.zeros(UNKNOWNS),), (direction,), has_aux=True),
        in_axes=1,
        out_axes=(None, -1, None),
    )(jnp.concatenate([directions, correction[:, None]], axis=1))
    _, (pose_by_u, load_by_u) = jax.jvp(lambda drive: in_rows(base, drive, z[ROLL])[0], (drive,), (rate,))
    pose, load = (part + by[:, -1] for part, by in zip(value, (pose_by, load_by), strict=True))
    missed = jnp.max(jnp.abs(jnp.stack([off, lean, stretch])))
    return Linear(
        correction,
        directions,
        pose,
        load,
        pose_by[:, :-1],
        load_by[:, :-1],
        pose_by_u,
        load_by_u,
        jnp.where(upright & (z[SLACK] < body.length), missed, jnp.inf),
    )


def phase_by_slack(z: Contacts, phase: Phases) -> Phases:
    """Phases of touching whiskers by the signs of their slacks."""
    touching = jnp.where(z[:, SLACK] > 0, int(Phase.tangential), int(Phase.tip))
    return jnp.where(phase == Phase.free, phase, touching)


def _tractions(problem: SpaceProblem, at: Contacts, phase: Phases, sliding: Sliding):
    """Residuals of the equations of the tractions, (whiskers, 2), and their derivatives by the steps."""

    def one(z, phase, start):
        ahead, across, _ = frame_of(problem.surface, z).T
        chord = z[POINT] - start[POINT]
        along, beside = jnp.sum(chord * ahead), jnp.sum(chord * across)
        # The material point that touches: a contact that rolls along the shaft does not slide.
        slid = along + jnp.maximum(z[SLACK], 0.0) - jnp.maximum(start[SLACK], 0.0)
        tangential, zero, one = (phase == Phase.tangential).astype(float), jnp.zeros(()), jnp.ones(())
        heads = [zero] * (problem.rows - 4)
        first = jnp.stack([*heads, tangential, one, zero, beside, sliding.time, zero])
        second = jnp.stack([*heads, zero, zero, one, -along, zero, sliding.time])
        return sliding.time * z[TRACTION] + jnp.stack([slid, beside]), jnp.stack([first, second])

    residual, by = jax.vmap(one)(at, phase, sliding.start)
    n = by.shape[2]
    return jnp.where(sliding.now, residual, at[:, TRACTION]), jnp.where(sliding.now, by, np.eye(2, n, n - 2))


class NewtonStep(NamedTuple):
    """A Newton step, and the tangent of the path from the same linear system."""

    step: Point
    tangent: Point  # condition . tangent = 1
    residual: Scalar  # before the step
    at: Linear  # fields (whiskers, ...)


def newton_step(
    problem: SpaceProblem, phase: Phases, condition: PathCondition, point: Point, sliding: Sliding | None = None
) -> NewtonStep:
    """Solve the linearised equations of all whiskers, the network and the condition."""
    n, rows, slides = phase.size, problem.rows, sliding is not None
    steps = rows + 2 * slides
    if sliding is not None:
        phase = jnp.where(sliding.now, phase_by_slack(point.z, phase), phase)
    drives = jax.jvp(problem.drive, (point.u,), (jnp.ones_like(point.u),))
    at = of_each(problem, lambda body, *own: linearise(problem, body, drives, *own, slides=slides), point.z, phase)
    touching = (phase != Phase.free)[:, None]
    block = touching[:, :, None]
    residual, system, by_u = at.pose, block_diagonal(at.pose_by), at.pose_by_u
    if problem.springs is not None:
        load, load_by, load_by_u = (
            jnp.where(touching if part.ndim == 2 else block, part, 0.0) for part in (at.load, at.load_by, at.load_by_u)
        )
        residual = residual - problem.springs.offset - problem.displacement(load)
        system -= jnp.sum(problem.springs.matrix[:, :, None] * block_diagonal(load_by), axis=1)
        by_u = by_u - problem.displacement(load_by_u)
    system = jnp.reshape(system, (n, rows, n * steps))
    correction = jnp.where(touching, at.correction, 0.0)
    if sliding is not None:
        held, held_by = _tractions(problem, point.z + correction, phase, sliding)
        residual = jnp.concatenate([residual, held], axis=1)
        system = jnp.concatenate([system, jnp.reshape(block_diagonal(held_by), (n, 2, n * steps))], axis=1)
        by_u = jnp.concatenate([by_u, jnp.zeros((n, 2))], axis=1)
    residual, by_u = jnp.where(touching, residual, 0.0), jnp.where(touching, by_u, 0.0)
    system = jnp.where(block, system, jnp.reshape(np.eye(n * steps), (n, steps, n * steps)))
    directions = jnp.where(block, at.directions, np.eye(UNKNOWNS)[:, :steps])
    weight = jnp.ravel(jnp.sum(condition.weight_z[:, :, None] * directions, axis=1))
    missed = condition.residual(Point(point.z + correction, point.u), jnp.zeros(n))
    bordered = jnp.block([
        [jnp.reshape(system, (n * steps, n * steps)), jnp.ravel(by_u)[:, None]],
        [weight[None, :], jnp.reshape(condition.weight_u, (1, 1))],
    ])  # fmt: skip
    residuals = jnp.append(jnp.ravel(residual), missed)
    last = np.eye(residuals.size)[-1]
    solution = solve(bordered, jnp.stack([-residuals, last], axis=1))

    def point_of(column):
        return Point(jnp.sum(directions * jnp.reshape(column[:-1], (n, 1, steps)), axis=-1), column[-1])

    step, tangent = point_of(solution[:, 0]), point_of(solution[:, 1])
    own = jnp.max(jnp.where(touching[:, 0], at.own, 0.0))
    return NewtonStep(step._replace(z=step.z + correction), tangent, jnp.maximum(jnp.max(jnp.abs(residuals)), own), at)


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


def solve_points(
    problem: SpaceProblem,
    phases: Int[Array, "*batch whiskers"],
    conditions: PathCondition,
    guesses: Point,
    sliding: Sliding | None = None,
) -> Solution:
    """Solve the equations of one point, or of several along a leading axis in one loop. Failure is a flag."""
    several = jnp.ndim(guesses.u) > 0

    def equations(point, args):
        problem, phases, conditions, sliding = args

        def one(phase, condition, point):
            return newton_step(problem, phase, condition, point, sliding)

        at = (jax.vmap(one) if several else one)(phases, conditions, point)
        return at.residual, at

    tolerance = problem.rod.newton_tolerance
    solution = optx.root_find(
        equations,
        SpaceNewton(0.0, tolerance),
        guesses,
        args=jax.lax.stop_gradient((problem, phases, conditions, sliding)),
        has_aux=True,
        max_steps=problem.rod.newton_steps,
        throw=False,
    )
    point = solution.value
    finite = jnp.all(jnp.isfinite(point.z), axis=(-2, -1)) & jnp.isfinite(point.u)
    return Solution(point, solution.aux, (solution.state.step_size < tolerance) & finite)
