"""Derivatives of solved points by the implicit function theorem: what was iterated to find a point leaves no trace."""

import equinox as eqx

from jaxwhisker.equilibrium import Mode, Point, Row, newton_step
from jaxwhisker.scene import Problem


@eqx.filter_custom_jvp
def solved(point: Point, problem: Problem, mode: Mode, row: Row) -> Point:
    """The point, which solves the equations of problem, mode and row, with its derivatives by all of them.

    The derivative is minus the inverse Jacobian at the solution times the equations' own derivative, which is what a
    Newton step's derivative at its root is. Where the row leaves the path's direction open (a fold, with the row across
    it), the control's derivative is that of the fold's position.
    """
    del problem, mode, row
    return point


@solved.def_jvp
def _(primals, tangents):
    point, problem, mode, row = primals
    _, problem_tangent, _, row_tangent = tangents
    here = solved(point, problem, mode, row)

    def step(problem, row):
        return newton_step(problem, mode, row, here).step

    _, tangent = eqx.filter_jvp(step, (problem, row), (problem_tangent, row_tangent))
    return here, tangent
