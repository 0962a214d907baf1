"""Newton's method for whiskers in space.

A Newton step is a step in the coordinates of the contacts (linear.py), and one back onto the surface. A network of
springs couples the bases of all whiskers. Where contacts move by a law of their own (slip.py), their tractions are two
more unknowns, and all stages of a step along the path are solved for at once.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import block_diagonal, solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import PathCondition, Point
from jaxwhisker._equilibrium.solver import StructuredNewton
from jaxwhisker._space.contact import SLACK, UNKNOWNS
from jaxwhisker._space.linear import Linear, linearise
from jaxwhisker._space.problem import SpaceProblem, of_each
from jaxwhisker._space.slip import ContactMotion, laws_of, radau

ROUNDED = 1e-12  # residuals that are rounding errors
LARGEST_NOISE = 1e-4  # of a Newton step for such residuals, dimensionless

Phases = Int[Array, " whiskers"]


def phase_by_slack(z: Float[Array, "*stages whiskers 11"], phase: Int[Array, "*stages whiskers"]) -> Array:
    """Phases of touching whiskers by the signs of their slacks."""
    touching = jnp.where(z[..., SLACK] > 0, int(Phase.tangential), int(Phase.tip))
    return jnp.where(phase == Phase.free, phase, touching)


class SpaceNewtonStep(NamedTuple):
    """A Newton step of all stages, and the tangent of the path at the last one."""

    step: Point  # fields (stages, ...)
    tangent: Point  # condition . tangent = 1
    residual: Scalar  # before the step
    at: Linear  # of the last stage, fields (whiskers, ...)


class Equations(NamedTuple):
    """What selects the stages of a step along the path; the last of them is its end."""

    phase: Int[Array, "stages whiskers"]
    condition: PathCondition  # of the last stage
    between: PathCondition | None  # its weights measure how far the others are; None if there are no others
    motion: ContactMotion | None  # None if there are no tractions


def newton_step(problem: SpaceProblem, equations: Equations, points: Point) -> SpaceNewtonStep:
    """Solve the linearised equations of all whiskers, the network and the conditions, at all stages."""
    phase, condition, between, motion = equations
    stages, n, rows = phase.shape[0], phase.shape[1], problem.rows
    traction = None if motion is None else motion.traction
    steps = rows if motion is None else rows + 2
    places, rates = radau(stages)
    if motion is not None:
        phase = jnp.where(motion.traction.flows, phase_by_slack(points.z, phase), phase)

    def at_stage(point, phase):
        drives = jax.jvp(problem.drive, (point.u,), (jnp.ones_like(point.u),))

        def one(body, z, phase):
            return linearise(problem, body, drives, z, phase, traction)

        return of_each(problem, one, point.z, phase)

    at = jax.vmap(at_stage)(points, phase)
    touching = (phase != Phase.free)[:, :, None]
    block = touching[:, :, :, None]
    z, u = points.z + jnp.where(touching, at.correction, 0.0), jnp.asarray(points.u)
    residual, system, by_u = at.pose, jax.vmap(block_diagonal)(at.pose_by), at.pose_by_u
    if problem.springs is not None:
        load, load_by = jnp.where(touching, at.load, problem.on_free), jnp.where(block, at.load_by, 0.0)
        load_by_u = jnp.where(touching, at.load_by_u, 0.0)
        residual = residual - problem.springs.offset - jax.vmap(problem.displacement)(load)
        coupled = jax.vmap(block_diagonal)(load_by)
        system -= jnp.sum(problem.springs.matrix[:, :, None] * coupled[:, None], axis=2)
        by_u = by_u - jax.vmap(problem.displacement)(load_by_u)
    system = np.eye(stages)[:, None, None, :, None, None] * jnp.reshape(system, (stages, n, rows, 1, n, steps))
    directions = jnp.where(block, at.directions, np.eye(UNKNOWNS)[:, :steps])
    weight = condition.weight_z
    missed = condition.residual(Point(z[-1], u[-1]), jnp.zeros(n))
    last_by = jnp.zeros((stages, n, steps)).at[-1].set(jnp.sum(weight[:, :, None] * directions[-1], axis=1))
    rate_rows = None
    if motion is not None:
        laws = laws_of(motion, z, phase, at, rates[1:])
        residual = jnp.concatenate([residual, laws.residual], axis=2)
        law_by = np.eye(n)[:, None, None, :, None] * laws.by[:, :, :, :, None]
        system = jnp.concatenate([system, law_by], axis=2)
        by_u = jnp.concatenate([by_u, jnp.zeros((stages, n, 2))], axis=2)
        missed, last_by = missed + laws.missed, last_by + laws.missed_by
        rate_rows = laws.rates
    residual, by_u = jnp.where(touching, residual, 0.0), jnp.where(touching, by_u, 0.0)
    size = n * steps
    identity = np.reshape(np.eye(stages * size), (stages, n, steps, stages, n, steps))
    system = jnp.where(touching[:, :, :, None, None, None], system, identity)
    conditions = jnp.zeros((stages, stages, n, steps)).at[-1].set(last_by)
    conditions_u = jnp.zeros((stages, stages)).at[-1, -1].set(condition.weight_u)
    residuals = jnp.zeros(stages).at[-1].set(missed)
    if between is not None:
        share = places[:-1]
        apart = np.eye(stages)[:-1] - share[:, None] * np.eye(stages)[-1]
        measured = jnp.sum(between.weight_z[:, :, None] * directions, axis=2)
        conditions = conditions.at[:-1].set(apart[:, :, None, None] * measured)
        conditions_u = conditions_u.at[:-1].set(apart * between.weight_u)
        reach = jax.vmap(lambda z, u: between.residual(Point(z, u), jnp.zeros(n)))(z, u)
        residuals = residuals.at[:-1].set(reach[:-1] - share * reach[-1])
        if motion is not None and motion.turn is not None:
            conditions_u = conditions_u.at[-1].add(motion.turn * rates[-1])
            residuals = residuals.at[-1].add(motion.turn * jnp.sum(rates[-1] * (u - between.u0)))
    bordered = jnp.block([
        [jnp.reshape(system, (stages * size,) * 2), _by_stage(jnp.reshape(by_u, (stages, size)))],
        [jnp.reshape(conditions, (stages, -1)), conditions_u],
    ])  # fmt: skip
    residuals = jnp.append(jnp.ravel(residual), residuals)
    last = np.eye(residuals.size)[-1]
    solution = solve(bordered, jnp.stack([-residuals, last], axis=1))

    def points_of(column):
        coordinates = jnp.reshape(column[:-stages], (stages, n, 1, steps))
        return Point(jnp.sum(directions * coordinates, axis=-1), column[-stages:])

    step, tangent = (points_of(column) for column in solution.T)
    tangent = jax.tree.map(lambda leaf: leaf[-1], tangent)
    if rate_rows is not None and between is not None:
        own = np.eye(n)[:, None, :, None] * rate_rows[:, :, None]
        own = jnp.concatenate([system[-1, :, :rows, -1], own], axis=1)
        own = jnp.where(touching[-1, :, :, None, None], own, system[-1, :, :, -1])
        tangent = _tangent(between, directions[-1], own, by_u[-1])
    own = jnp.max(jnp.where(touching[:, :, 0], at.own, 0.0))
    return SpaceNewtonStep(
        step._replace(z=step.z + z - points.z),
        tangent,
        jnp.maximum(jnp.max(jnp.abs(residuals)), own),
        jax.tree.map(lambda leaf: leaf[-1], at),
    )


def _tangent(
    measure: PathCondition,
    directions: Float[Array, "whiskers 11 steps"],
    system: Float[Array, "whiskers steps whiskers steps"],
    by_u: Float[Array, "whiskers steps"],
) -> Point:
    """The tangent of a path whose equations are these, with the length 1 in this measure."""
    n, _, steps = directions.shape
    weight = jnp.ravel(jnp.sum(measure.weight_z[:, :, None] * directions, axis=1))
    bordered = jnp.block([
        [jnp.reshape(system, (n * steps, n * steps)), jnp.ravel(by_u)[:, None]],
        [weight[None, :], jnp.reshape(measure.weight_u, (1, 1))],
    ])  # fmt: skip
    last = np.eye(n * steps + 1)[-1]
    column = solve(bordered, jnp.asarray(last)[:, None])[:, 0]
    return Point(jnp.sum(directions * jnp.reshape(column[:-1], (n, 1, steps)), axis=-1), column[-1])


def _by_stage(columns: Float[Array, "stages rows"]) -> Float[Array, "all stages"]:
    """Each row of a stage in a column of its own."""
    stages = columns.shape[0]
    return jnp.reshape(columns[:, :, None] * np.eye(stages)[:, None], (-1, stages))


class SpaceSolution(NamedTuple):
    """Solved stages; `newton` is a linearisation at most one step before them."""

    points: Point  # fields (*batch, stages, ...)
    newton: SpaceNewtonStep
    converged: Bool[Array, "*batch"]

    @property
    def end(self) -> Point:
        """The last stage."""
        return Point(self.points.z[..., -1, :, :], jnp.asarray(self.points.u)[..., -1])


def solve_points(problem: SpaceProblem, equations: Equations, guesses: Point) -> SpaceSolution:
    """Solve the equations of all stages of a step; or of several steps, along a leading axis, in one loop.

    Failure is a flag.
    """
    steps = jax.vmap(newton_step, (None, 0, 0)) if jnp.ndim(guesses.u) > 1 else newton_step

    def residuals(points, args):
        problem, equations = args
        at = steps(problem, equations, points)
        return at.residual, at

    tolerance = problem.rod.newton_tolerance
    solution = optx.root_find(
        residuals,
        # Where the surface is strongly curved, small steps turn its normal by much more.
        StructuredNewton(0.0, tolerance, stages=True, with_residuals=True),
        guesses,
        args=jax.lax.stop_gradient((problem, equations)),
        has_aux=True,
        max_steps=problem.rod.newton_steps,
        throw=False,
    )
    points = solution.value
    finite = jnp.all(jnp.isfinite(points.z), axis=(-3, -2, -1)) & jnp.all(jnp.isfinite(points.u), axis=-1)
    # Along a nearly straight whisker, a light force is known only to the rounding of positions over its deflection
    # squared: Newton steps do not get smaller although the equations are satisfied.
    size = solution.state.step_size
    converged = (size < tolerance) | ((solution.aux.residual < ROUNDED) & (size < LARGEST_NOISE))
    return SpaceSolution(points, solution.aux, converged & finite)


def plain(phase: Phases, condition: PathCondition) -> Equations:
    """The equations of a single point, without tractions."""
    return Equations(phase[None], condition, None, None)
