"""Derivatives of solved points by the implicit function theorem; they do not depend on the solver's iterations."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, PyTree

from jaxwhisker._base.leaves import Tree
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.newton import (
    Condensed,
    condense,
    evaluate,
    newton_step,
    solve_coupled,
    with_dummy_contacts,
)
from jaxwhisker._equilibrium.point import Mode, Point, Row, scale_of, unit
from jaxwhisker._equilibrium.problem import Problem


def without_rule(point: Tree, known: PyTree) -> Tree:
    """The point, with NaN as its derivatives with respect to `known`: only a custom rule knows the true derivatives.

    When a loop around a solved point (lax.scan, lax.map) is differentiated backwards and then once more, jax 0.10 drops
    the custom rule. Without the NaN, the derivatives would be zero: wrong, and unnoticed.
    """
    leaves = [jnp.ravel(leaf) for leaf in jax.tree.leaves(eqx.filter(known, eqx.is_inexact_array))]
    everything = jnp.concatenate(leaves)
    # The value is 0. The derivative is NaN, because the square root has no derivative at 0.
    nothing = 0.0 * jnp.sqrt(jnp.sum(jnp.where(jnp.isfinite(everything), 0.0 * everything, 0.0)))
    return jax.tree.map(lambda leaf: leaf + nothing, point)


@eqx.filter_custom_jvp
def solved(point: Point, problem: Problem, mode: Mode, row: Row) -> Point:
    """The solution of the equations of problem, mode and row, with its derivatives with respect to problem and row.

    The derivative is minus the inverse Jacobian times the derivative of the equations, which is the derivative of a
    Newton step that starts at the solution.
    """
    del mode
    return without_rule(point, (problem, row))


@solved.def_jvp
def _(primals, tangents):
    point, problem, mode, row = primals
    _, problem_dot, _, row_dot = tangents
    here = solved(point, problem, mode, row)
    _, point_dot = _implicit_step(here, problem, mode, row, problem_dot, row_dot)
    return here, point_dot


def _linear(function, *at):
    """Value of a function and its differential, which takes tangents (None for zero). The function is traced once."""
    some, rest = eqx.partition(at, eqx.is_inexact_array)
    value, push = jax.linearize(lambda some: function(*eqx.combine(some, rest)), some)

    def differential(*tangents):
        def filled(x, tangent):
            return x if x is None else jnp.zeros_like(x) if tangent is None else tangent

        return push(jax.tree.map(filled, some, tangents, is_leaf=lambda leaf: leaf is None))

    return value, differential


def _no_tangents(tree):
    return jax.tree.map(lambda _: None, tree)


def _implicit_step(
    here: Point, problem: Problem, mode: Mode, row: Row, problem_dot, row_dot
) -> tuple[Condensed, Point]:
    """The condensed whiskers at a solution, and the solution's tangent for given tangents of problem and row."""
    z, phase = with_dummy_contacts(problem, here.z, mode.phase)
    value, differential = _linear(
        lambda problem, z, u: evaluate(problem, Point(z, u), phase, mode.side), problem, z, here.u
    )
    # A whisker's equations depend on its own contact only: three directions serve all whiskers.
    columns = jax.vmap(lambda e: differential(_no_tangents(problem), jnp.broadcast_to(e, z.shape), None))(jnp.eye(3))
    gradient = jax.tree.map(jnp.transpose, columns)
    by_u = differential(_no_tangents(problem), None, jnp.ones_like(here.u)) if problem.frames_move else None
    value_dot = differential(problem_dot, None, None)

    def at(problem, value):
        return condense(problem, here.z, mode, value, gradient, by_u)

    def step(value, problem, row):
        # The derivative of the Jacobian does not matter: it is multiplied by residuals, which are zero.
        return solve_coupled(problem, mode, row, here, at(problem, value)).step

    _, point_dot = eqx.filter_jvp(step, (value, problem, row), (value_dot, problem_dot, row_dot))
    return at(problem, value), point_dot


@eqx.filter_custom_jvp
def solved_event(point: Point, problem: Problem, mode: Mode, along: Point, row: Row, fold: Bool[Array, ""]) -> Point:
    """The point of a path that satisfies the row or, at a fold, where the control turns back; with its derivatives.

    The equations are solved in a plane transverse to the path's direction `along`, where they are regular at folds too.
    The distance that the event then moves along the path follows from the event's own equation. At a fold this is
    du/ds = 0, whose derivative needs second derivatives of the whiskers.
    """
    del mode, along, fold
    return without_rule(point, (problem, row))


@solved_event.def_jvp
def _(primals, tangents):
    point, problem, mode, along, row, fold = primals
    _, problem_dot, _, _, row_dot, _ = tangents
    here = solved_event(point, problem, mode, along, row, fold)
    none = jnp.zeros_like(here.z[:, 0])
    weight = jax.lax.stop_gradient(
        Point(along.z / scale_of(here.z) ** 2, along.u)
    )  # any plane transverse to the path would do
    across = Row(weight.z, here.z, weight.u, here.u, none)
    at, drift = _implicit_step(here, problem, mode, across, problem_dot, _no_tangents(across))
    tangent = solve_coupled(problem, mode, across, here, at).tangent

    def row_residual(point, problem, row):
        touching = mode.phase != Phase.free
        at_contact, _ = with_dummy_contacts(problem, point.z, mode.phase)
        slope_sin = jax.vmap(lambda p: problem.profile.point(p).sin)(at_contact[:, 1])
        return row.residual(point, jnp.where(touching, slope_sin, 0.0))

    def turn(point, problem):
        row = Row(weight.z, point.z, weight.u, point.u, none)
        return unit(newton_step(problem, mode, row, point, problem.rod.for_rates()).tangent, point.z)[0].u

    def distance(vanishing, holds, known, known_dot):
        """Distance by which the event moves along the path to keep `vanishing` zero; 0 unless `holds`."""
        _, rate = _linear(vanishing, here, *known)
        by_drift, by_tangent = rate(drift, *known_dot), rate(tangent, *_no_tangents(known))
        return jnp.where(holds, -by_drift / jnp.where(holds, by_tangent, 1.0), 0.0)

    by_row = distance(row_residual, ~fold, (problem, row), (problem_dot, row_dot))
    by_turn = distance(turn, fold, (problem,), (problem_dot,))
    # At a fold the control does not change along the path: its derivative needs no second derivatives.
    return here, Point(drift.z + (by_row + by_turn) * tangent.z, drift.u + by_row * tangent.u)
