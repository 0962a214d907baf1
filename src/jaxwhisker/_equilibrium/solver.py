"""Newton's method for points of the path, as a solver of optimistix."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._equilibrium.contact import FORCE, LEAN
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.newton import Apart, NewtonStep, newton_step
from jaxwhisker._equilibrium.point import Contacts, PathCondition, Point, scale_of
from jaxwhisker._equilibrium.problem import Problem

FINER = 100.0  # factor by which leans of large forces must be more accurate than other unknowns
SMALL = 1e-3  # force below which other unknowns must be more accurate
SMALLEST = 1e-6  # force below which they need not be still more accurate


class _NewtonState(NamedTuple):
    step_size: Float[Array, "*batch"]


class StructuredNewton(optx.AbstractRootFinder):
    """Newton's method for a function that returns its own Newton step as auxiliary output.

    A general Newton solver would push tangents of all unknowns through all rods and solve a dense system of that size.
    Here each whisker is linearised with respect to its own contact. The tolerance applies to the last step, which the
    solution includes: a tolerance of 1e-6 gives an error near 1e-12.

    Several points along a leading axis are solved for in one loop, in which solved and failed points stay where they
    are. Points of a step with several stages have an axis of stages (`stages`) behind that.
    """

    rtol: float
    atol: float
    stages: bool = False
    weigh: Callable[[Contacts, Contacts, Any], Contacts] | None = None  # changes of contacts, by contacts and args
    with_residuals: bool = False  # whether the tolerance applies to the residuals before the last step, too
    norm: Any = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        del fn, args, options, f_struct, aux_struct, tags
        return _NewtonState(jnp.full_like(y.u[..., 0] if self.stages else y.u, jnp.inf))

    def step(self, fn, y, args, options, state, tags):
        del options, tags
        residual, newton = fn(y, args)
        step = newton.step
        changes, change_u = jnp.abs(step.z) / scale_of(y.z), jnp.abs(step.u)
        if self.weigh is not None:
            changes = self.weigh(changes, y.z, args)
        if self.stages:
            changes, change_u = jnp.max(changes, axis=-3), jnp.max(change_u, axis=-1)
        size = jnp.maximum(jnp.max(changes, axis=(-2, -1)), change_u)
        if self.with_residuals:
            size = jnp.maximum(size, jnp.where(jnp.isinf(residual), 0.0, residual))  # infinite beyond the base
        if size.ndim > 0:
            solved, failed = state.step_size < self.atol, ~jnp.isfinite(size)
            # The loop would end for all points as soon as one is not finite.
            stays = solved | failed
            axes = range(1, jnp.ndim(step.u))
            step = Point(
                jnp.where(jnp.expand_dims(stays, (*axes, -2, -1)), 0.0, step.z),
                jnp.where(jnp.expand_dims(stays, tuple(axes)), 0.0, step.u),
            )
            size = jnp.where(solved, state.step_size, jnp.where(failed, jnp.nan, size))
        return jax.tree.map(jnp.add, y, step), _NewtonState(size), newton

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, args, options, tags
        return jnp.all((state.step_size < self.atol) | jnp.isnan(state.step_size)), optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        del fn, args, options, state, tags, result
        return y, aux, {}


def _of_sticking(changes: Contacts, z: Contacts, args: tuple) -> Contacts:
    """The changes of contacts in a Newton step, with those of contacts that stick weighted.

    Next to a small force, small changes of the other unknowns matter.
    """
    _, state, *_ = args
    if state.friction is None:
        return changes
    sticks = state.sticks[..., None]
    force = jnp.clip(z[..., FORCE], SMALLEST, 1.0)
    others = jnp.broadcast_to(jnp.maximum(SMALL / force, 1.0)[..., None], changes.shape)
    weight = others.at[..., LEAN].set(jnp.maximum(FINER * force, 1.0))
    return changes * jnp.where(sticks, weight, 1.0)


class Solution(NamedTuple):
    """A solved point; `newton` is a linearisation at most one step before that point."""

    point: Point
    newton: NewtonStep
    converged: Bool[Array, "*batch"]
    iterations: Int[Array, ""]


def solve_point(
    problem: Problem, state: ContactState, condition: PathCondition, guess: Point, apart: Apart | None = None
) -> Solution:
    """Solve the equations of one point with Newton's method. Failure is a flag, never an exception."""
    return _solve(problem, state, condition, guess, newton_step, apart)


def solve_points(problem: Problem, states: ContactState, conditions: PathCondition, guesses: Point) -> Solution:
    """Solve the equations of several points in one loop, which is traced and compiled faster than a batch of loops."""

    def each(problem, states, conditions, points, *, sequential, apart):
        del apart
        return jax.vmap(lambda *own: newton_step(problem, *own, sequential=sequential))(states, conditions, points)

    return _solve(problem, states, conditions, guesses, each)


def _solve(
    problem: Problem,
    state: ContactState,
    condition: PathCondition,
    guess: Point,
    newton: Callable[..., NewtonStep],
    apart: Apart | None = None,
) -> Solution:
    # Derivatives are attached to the solution (implicit.py); they do not depend on the solver's iterations.
    problem, condition, guess, apart = jax.lax.stop_gradient((problem, condition, guess, apart))
    solver = StructuredNewton(0.0, problem.rod.newton_tolerance, weigh=_of_sticking)
    if jnp.ndim(guess.u) > 0:
        finite = jnp.all(jnp.isfinite(guess.z), axis=(-2, -1)) & jnp.isfinite(guess.u)
        guess = Point(jnp.where(finite[:, None, None], guess.z, 0.0), jnp.where(finite, guess.u, 0.0))

    def equations(point, args):
        problem, state, condition, apart = args
        at = newton(problem, state, condition, point, sequential=True, apart=apart)
        return at.residual, at

    solution = optx.root_find(
        equations,
        solver,
        guess,
        args=(problem, state, condition, apart),
        has_aux=True,
        max_steps=problem.rod.newton_steps,
        throw=False,
    )
    point = solution.value
    finite = jnp.all(jnp.isfinite(point.z), axis=(-2, -1)) & jnp.isfinite(point.u)
    converged = (solution.state.step_size < solver.atol) & finite
    return Solution(point, solution.aux, converged, solution.stats["num_steps"])
