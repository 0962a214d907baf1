"""Functions of the engine as programs: outside a program, JAX compiles each of their operations on its own."""

from typing import Any

import jax

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._scan import scan, space_scan


def dimensionless(scene: Any) -> Any:
    """The dimensionless problem of a scene, in the plane or in space."""
    module = scan if isinstance(scene, jw.Scene) else space_scan
    return module.problem_now(jax.tree.map(checks.as_float, scene))
