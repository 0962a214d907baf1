"""Functions of the engine as programs: outside a program, JAX compiles each of their operations on its own."""

from typing import Any

import jax

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._plane.continuation import ContinuationInPlane
from jaxwhisker._plane.march_state import MarchInPlane
from jaxwhisker._scan.scan import mechanics_of


def dimensionless(scene: Any) -> Any:
    """The dimensionless problem of a scene, in the plane or in space."""
    return mechanics_of(scene).problem(jax.tree.map(checks.as_float, scene))


def begin(problem: Any, stops: Any) -> MarchInPlane:
    """The first state of a march in the plane."""
    mechanics = ContinuationInPlane(problem)
    return mechanics.start(stops, mechanics.limits(stops[0]))


begun_march = Program(begin)
