"""Derivatives of solved points by the implicit function theorem: what was iterated to find a point leaves no trace."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, PyTree

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.newton import (
    Local,
    Mode,
    Point,
    Row,
    coupled,
    harmless,
    local,
    missing,
    newton_step,
    scale_of,
    unit,
    values,
)
from jaxwhisker._equilibrium.problem import Problem

Tree = TypeVar("Tree")


def without_rule(point: Tree, known: PyTree) -> Tree:
    """The point, with NaN for its derivatives by what it was solved from, which only a custom rule knows.

    Where a loop around a solved point (lax.scan, lax.map) is differentiated backwards and then once more, jax 0.10
    drops the rule: zeros then would be wrong, and silent.
    """
    leaves = [jnp.ravel(leaf) for leaf in jax.tree.leaves(eqx.filter(known, eqx.is_inexact_array))]
    everything = jnp.concatenate(leaves)
    nothing = 0.0 * jnp.sqrt(jnp.sum(jnp.where(jnp.isfinite(everything), 0.0 * everything, 0.0)))
    return jax.tree.map(lambda leaf: leaf + nothing, point)


@eqx.filter_custom_jvp
def solved(point: Point, problem: Problem, mode: Mode, row: Row) -> Point:
    """The point, which solves the equations of problem, mode and row, with its derivatives by all of them.

    The derivative is minus the inverse Jacobian times the equations' own derivative, which is what a Newton step from
    the solution changes by.
    """
    del mode
    return without_rule(point, (problem, row))


@solved.def_jvp
def _(primals, tangents):
    point, problem, mode, row = primals
    _, problem_dot, _, row_dot = tangents
    here = solved(point, problem, mode, row)
    _, point_dot = _moved(here, problem, mode, row, problem_dot, row_dot)
    return here, point_dot


def _linear(function, *at):
    """Value of a function, and its differential: takes tangents, None for none. It is traced and evaluated once."""
    some, rest = eqx.partition(at, eqx.is_inexact_array)
    value, push = jax.linearize(lambda some: function(*eqx.combine(some, rest)), some)

    def differential(*tangents):
        def filled(x, tangent):
            return x if x is None else jnp.zeros_like(x) if tangent is None else tangent

        return push(jax.tree.map(filled, some, tangents, is_leaf=lambda leaf: leaf is None))

    return value, differential


def _nothing(tree):
    return jax.tree.map(lambda _: None, tree)


def _moved(here: Point, problem: Problem, mode: Mode, row: Row, problem_dot, row_dot) -> tuple[Local, Point]:
    """The whiskers linearised at a solution, and how it moves with problem and row."""
    z, phase = harmless(problem, here.z, mode.phase)
    value, differential = _linear(
        lambda problem, z, u: values(problem, Point(z, u), phase, mode.side), problem, z, here.u
    )
    # No whisker knows of another one's contact: three directions for all of them at once.
    columns = jax.vmap(lambda e: differential(_nothing(problem), jnp.broadcast_to(e, z.shape), None))(jnp.eye(3))
    gradient = jax.tree.map(jnp.transpose, columns)
    by_u = None if problem.axes == 1 else differential(_nothing(problem), None, jnp.ones_like(here.u))
    value_dot = differential(problem_dot, None, None)

    def at(problem, value):
        return local(problem, here.z, mode, value, gradient, by_u)

    def step(value, problem, row):
        # The Jacobian's own derivative meets equations that are fulfilled.
        return coupled(problem, mode, row, here, at(problem, value)).step

    _, point_dot = eqx.filter_jvp(step, (value, problem, row), (value_dot, problem_dot, row_dot))
    return at(problem, value), point_dot


@eqx.filter_custom_jvp
def solved_event(point: Point, problem: Problem, mode: Mode, along: Point, row: Row, fold: Bool[Array, ""]) -> Point:
    """The point of a path at which the row is fulfilled, or, at a fold, the control turns back; with its derivatives.

    The path's equations are solved across its direction `along`, in which they are regular at folds, too; how far the
    event then moves along the path follows from the equation that it is known by. At a fold that is du/ds = 0, whose
    derivative takes second derivatives of the whiskers.
    """
    del mode, along, fold
    return without_rule(point, (problem, row))


@solved_event.def_jvp
def _(primals, tangents):
    point, problem, mode, along, row, fold = primals
    _, problem_dot, _, _, row_dot, _ = tangents
    here = solved_event(point, problem, mode, along, row, fold)
    none = jnp.zeros_like(here.z[:, 0])
    weight = jax.lax.stop_gradient(Point(along.z / scale_of(here.z) ** 2, along.u))  # any across the path would do
    across = Row(weight.z, here.z, weight.u, here.u, none)
    at, drift = _moved(here, problem, mode, across, problem_dot, _nothing(across))
    tangent = coupled(problem, mode, across, here, at).tangent

    def missed(point, problem, row):
        touching = mode.phase != Phase.free
        at_contact, _ = harmless(problem, point.z, mode.phase)
        slope_sin = jax.vmap(lambda p: problem.profile.point(p).sin)(at_contact[:, 1])
        return missing(row, point, jnp.where(touching, slope_sin, 0.0))

    def turn(point, problem):
        row = Row(weight.z, point.z, weight.u, point.u, none)
        return unit(newton_step(problem, mode, row, point, problem.rod.for_rates()).tangent, point.z)[0].u

    def distance(vanishing, holds, known, known_dot):
        """How far the event moves along the path, where it is the vanishing of this function; else zero."""
        _, rate = _linear(vanishing, here, *known)
        by_drift, by_tangent = rate(drift, *known_dot), rate(tangent, *_nothing(known))
        return jnp.where(holds, -by_drift / jnp.where(holds, by_tangent, 1.0), 0.0)

    by_row = distance(missed, ~fold, (problem, row), (problem_dot, row_dot))
    by_turn = distance(turn, fold, (problem,), (problem_dot,))
    # At a fold the control does not change along the path: whoever asks for positions only pays no second derivatives.
    return here, Point(drift.z + (by_row + by_turn) * tangent.z, drift.u + by_row * tangent.u)
