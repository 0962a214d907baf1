"""Derivatives of solved points by the implicit function theorem: what was iterated to find a point leaves no trace."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxwhisker.contact import RATE_STEPS, Phase
from jaxwhisker.equilibrium import (
    Local,
    Mode,
    Point,
    Row,
    coupled,
    linearised,
    local,
    missing,
    newton_step,
    scale_of,
    values,
)
from jaxwhisker.path import unit
from jaxwhisker.scene import Problem


@eqx.filter_custom_jvp
def solved(point: Point, problem: Problem, mode: Mode, row: Row) -> Point:
    """The point, which solves the equations of problem, mode and row, with its derivatives by all of them.

    The derivative is minus the inverse Jacobian times the equations' own derivative, which is what a Newton step from
    the solution changes by.
    """
    del problem, mode, row
    return point


@solved.def_jvp
def _(primals, tangents):
    point, problem, mode, row = primals
    _, problem_dot, _, row_dot = tangents
    here = solved(point, problem, mode, row)
    _, point_dot = _moved(here, problem, mode, row, problem_dot, row_dot)
    return here, point_dot


def _moved(here: Point, problem: Problem, mode: Mode, row: Row, problem_dot, row_dot) -> tuple[Local, Point]:
    """The whiskers linearised at a solution, and how it moves with problem and row."""
    value, gradient = linearised(problem, here.z, mode, RATE_STEPS)

    def step(problem, row):
        # The Jacobian's own derivative meets equations that are fulfilled.
        at = local(here.z, mode, values(problem, here.z, mode), gradient)
        return coupled(problem, mode, row, here, at).step

    _, point_dot = eqx.filter_jvp(step, (problem, row), (problem_dot, row_dot))
    return local(here.z, mode, value, gradient), point_dot


@eqx.filter_custom_jvp
def solved_event(point: Point, problem: Problem, mode: Mode, along: Point, row: Row, fold: Bool[Array, ""]) -> Point:
    """The point of a path at which the row is fulfilled, or, at a fold, the control turns back; with its derivatives.

    The path's equations are solved across its direction `along`, in which they are regular at folds, too; how far the
    event then moves along the path follows from the equation that it is known by. At a fold that is du/ds = 0, whose
    derivative takes second derivatives of the whiskers.
    """
    del problem, mode, along, row, fold
    return point


@solved_event.def_jvp
def _(primals, tangents):
    point, problem, mode, along, row, fold = primals
    _, problem_dot, _, _, row_dot, _ = tangents
    here = solved_event(point, problem, mode, along, row, fold)
    none = jnp.zeros_like(here.z[:, 0])
    across = jax.lax.stop_gradient(Row(along.z / scale_of(here.z) ** 2, here.z, along.u, here.u, none, none, none))
    at, drift = _moved(here, problem, mode, across, problem_dot, jax.tree.map(lambda _: None, across))
    tangent = coupled(problem, mode, across, here, at).tangent

    def vanishing(point, problem, row):
        turn = unit(newton_step(problem, mode, across, point, RATE_STEPS).tangent, point.z)[0].u
        value, touching = values(problem, point.z, mode), mode.phase != Phase.free
        slope_sin, force_x = (jnp.where(touching, v, 0.0) for v in (value.slope_sin, value.force_x))
        return jnp.where(fold, turn, missing(problem, row, point, slope_sin, force_x))

    _, by_drift = eqx.filter_jvp(vanishing, (here, problem, row), (drift, problem_dot, row_dot))
    none_of = jax.tree.map(lambda _: None, (problem, row))
    _, by_tangent = eqx.filter_jvp(vanishing, (here, problem, row), (tangent, *none_of))
    distance = -by_drift / by_tangent
    return here, Point(drift.z + distance * tangent.z, drift.u + distance * tangent.u)
