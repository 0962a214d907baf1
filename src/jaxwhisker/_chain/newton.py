"""Newton's method for whiskers with several contacts on their network of springs.

The unknowns are the contacts of all whiskers, one after the other, with three numbers each, and the control. Every
whisker is linearised with respect to its own contacts; the network couples the loads and poses of the bases.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool

from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainEquations, ChainState, equations, last_contact
from jaxwhisker._chain.problem import BasePoses, ChainProblem
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._equilibrium.contact import in_base_frame, of_each
from jaxwhisker._equilibrium.point import PathCondition, Point
from jaxwhisker._equilibrium.solver import StructuredNewton


class ChainStep(NamedTuple):
    """A Newton step, and the tangent of the path from the same linear system."""

    step: Point
    tangent: Point  # condition . tangent = 1
    residual: Scalar  # largest residual of any equation, before the step
    pose: BasePoses  # before the step
    tangent_pose: BasePoses
    load: BasePoses
    backwards: Bool[Array, ""]  # whether a whisker runs the wrong way at a contact


def of_whiskers(problem: ChainProblem, tree):
    """Contacts of all whiskers one after the other, as arrays (whiskers, contacts, ...)."""
    shape = problem.length.shape[0], problem.contacts
    return jax.tree.map(lambda leaf: jnp.reshape(leaf, (*shape, *leaf.shape[1:])), tree)


def evaluate(problem: ChainProblem, z: RowsOfContacts, u: Scalar, state: ChainState) -> ChainEquations:
    """The equations of all whiskers; fields (whiskers, ...)."""
    return of_each(problem.bodies(u), equations, *of_whiskers(problem, (z, state)))


def residuals(
    problem: ChainProblem, z: RowsOfContacts, u: Scalar, state: ChainState
) -> tuple[RowsOfContacts, ChainEquations]:
    """Residuals of all equations, like the contacts, and what they are made of."""
    at = evaluate(problem, z, u, state)
    last = jax.vmap(last_contact)(of_whiskers(problem, state).touches)
    wanted = problem.rest + problem.displacement(at.load)
    own = at.own - jnp.where(last[:, :, None], wanted[:, None, :], 0.0)
    return jnp.reshape(own, z.shape), at


def newton_step(problem: ChainProblem, state: ChainState, condition: PathCondition, point: Point) -> ChainStep:
    """Solve the linearised equations of all whiskers, the network and the condition."""
    n, k, rows = problem.length.shape[0], problem.contacts, problem.rows
    z, each = of_whiskers(problem, (point.z, state))

    def linearised(body, z, state):
        def values(flat):
            at = equations(body, jnp.reshape(flat, z.shape), state)
            return (at.own, at.load), at

        (own_by, load_by), at = jax.jacfwd(values, has_aux=True)(jnp.ravel(z))

        def in_frame(frame):
            at_base = in_base_frame(body._replace(frame=frame), at.base)
            return jnp.stack(jnp.broadcast_arrays(*(jnp.asarray(part) for part in at_base[:6])))

        by_u = jax.jvp(in_frame, (body.frame,), (body.frame_rate,))[1]
        return at, own_by, load_by, by_u[:3], by_u[3:]

    at, own_by, load_by, pose_by_u, load_by_u = of_each(problem.bodies(point.u), linearised, z, each)
    last = jax.vmap(last_contact)(each.touches)
    touching = jnp.any(last, axis=1)
    load_by_u = jnp.where(touching[:, None], load_by_u, 0.0)
    wanted = problem.rest + problem.displacement(at.load)
    residual = at.own - jnp.where(last[:, :, None], wanted[:, None, :], 0.0)
    # own_by: (whiskers, contacts, 3, 3 contacts) of the same whisker; load_by: (whiskers, 3, 3 contacts)
    block = np.eye(n)[:, None, None, :, None] * own_by[:, :, :, None, :]
    flexibility = jnp.reshape(problem.flexibility.matrix, (n, 3, n, 3))
    yields = jnp.sum(flexibility[:, :, :, :, None] * load_by[None, None], axis=3)  # (whiskers, 3, whiskers, 3 contacts)
    block = block - jnp.where(last[:, :, None, None, None], yields[:, None], 0.0)
    moved = pose_by_u - problem.displacement(load_by_u)
    by_u = jnp.where(last[:, :, None], moved[:, None, :], 0.0)
    size = 3 * rows
    system = jnp.block([
        [jnp.reshape(block, (size, size)), jnp.reshape(by_u, (size, 1))],
        [jnp.reshape(condition.weight_z, (1, size)), jnp.reshape(condition.weight_u, (1, 1))],
    ])  # fmt: skip
    missed = condition.residual(point, jnp.zeros(rows))
    right = jnp.append(jnp.ravel(residual), missed)
    solution = solve(system, jnp.stack([-right, jnp.asarray(np.eye(size + 1)[-1])], axis=1))
    step, tangent = (Point(jnp.reshape(column[:-1], (rows, 3)), column[-1]) for column in solution.T)
    pose = jnp.where(touching[:, None], jnp.sum(jnp.where(last[:, :, None], at.own, 0.0), axis=1), wanted)
    turned = jnp.reshape(tangent.z, (n, 3 * k))
    load_rate = jnp.sum(load_by * turned[:, None, :], axis=2) + load_by_u * tangent.u
    return ChainStep(
        step, tangent, jnp.max(jnp.abs(right)), pose, problem.displacement(load_rate), at.load, jnp.any(at.backwards)
    )


class ChainSolution(NamedTuple):
    """A solved point; `newton` is a linearisation at most one step before that point."""

    point: Point
    newton: ChainStep
    converged: Bool[Array, "*batch"]


def solve_points(problem: ChainProblem, state: ChainState, condition: PathCondition, guess: Point) -> ChainSolution:
    """Solve the equations of a point, or of several points along a leading axis in one loop. Failure is a flag."""
    steps = jax.vmap(newton_step, (None, 0, 0, 0)) if jnp.ndim(guess.u) > 0 else newton_step

    def residual(point, args):
        problem, state, condition = args
        at = steps(problem, state, condition, point)
        return at.residual, at

    tolerance = problem.rod.newton_tolerance
    solution = optx.root_find(
        residual,
        StructuredNewton(0.0, tolerance),
        guess,
        args=jax.lax.stop_gradient((problem, state, condition)),
        has_aux=True,
        max_steps=problem.rod.newton_steps,
        throw=False,
    )
    point = solution.value
    finite = jnp.all(jnp.isfinite(point.z), axis=(-2, -1)) & jnp.isfinite(point.u)
    converged = (solution.state.step_size < tolerance) & finite & ~solution.aux.backwards
    return ChainSolution(point, solution.aux, converged)
