"""The critical stiffness: below it a scan snaps through the vertex and skips the maximum.

A base on a spring is stable while the stiffness exceeds the slope of the force, c > dF_x/dx0 of the clamped whisker,
where F_x = -fx is the force on the whisker. The steepest slope before the vertex is therefore the critical stiffness of
one whisker. (Towards the snap-off the slope grows without bound. Every spring gives way there, and no maximum is
skipped.) It is a smooth maximum or, if the object is so far away that the tip touches it at the vertex, the slope
there. For coupled whiskers, the critical stiffness is larger by the ratio of the softest base's flexibility to that of
a single spring, if the forces on the other whiskers stay the same. They do not, so this is an estimate.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import EventKind, Path
from jaxwhisker._scan.route import across
from jaxwhisker._scan.scan import check_valid, follow_path_now, problem_now
from jaxwhisker._scan.steps import solve_steps, states
from jaxwhisker._study.parameters import Parameters

if TYPE_CHECKING:
    import xarray as xr

SEARCH_STEPS = 257  # per search; each further search covers the neighbours of the best step of the previous one
SEARCHES = 4  # the steps of the last one are 1e-8 of the range of the first one
CURVE_POINTS = 33  # values of each parameter between which the critical stiffness is interpolated


class Steepest(NamedTuple):
    """The steepest slope dF_x/dx0 of a clamped whisker (force per length), and the position x0 of its base there."""

    slope: float
    base_x: float


def steepest(whisker: Whisker, profile: AbstractProfile) -> Steepest:
    """The largest slope of the clamped whisker's force between first touch and vertex, with relative accuracy 1e-9.

    It is NaN if the whisker does not reach the vertex: the object is out of reach, or the clamped whisker snaps before.

    Args:
        whisker: the whisker.
        profile: the object.

    Raises:
        ValueError: if an argument is traced: the maximum is found by a search; or if there are several objects.
    """
    checks.float64_mode()
    if len(profile.objects) > 1:
        checks.fail("profile", "a single object, whose steepest slope is wanted", str(profile))
    if checks.is_traced((whisker, profile)):
        raise ValueError(
            "`whisker` and `profile` must be concrete, got traced ones: the steepest slope is found by a search."
        )
    scene = jax.tree.map(checks.as_float, Scene(whisker, profile))
    problem = problem_now(scene)
    check_valid(scene, problem)
    path, start, _ = follow_path_now(problem, *map(np.asarray, across()))
    best, unit = Steepest(np.nan, np.nan), float(problem.unit.control)
    passed = np.flatnonzero(np.asarray(path.nodes.kind)[: int(path.count)] == EventKind.vertex)
    if passed.size == 0:
        return best
    first, last = unit * float(problem.touch_right.x[0]), unit * float(path.nodes.point.u[passed[0]])
    for _ in range(SEARCHES):
        x = np.linspace(first, last, SEARCH_STEPS)
        slope, force = (np.asarray(leaf) for leaf in _slope(problem, path, x, float(start) - x))
        k = int(np.argmax(np.where(np.isfinite(slope) & (force > 0), slope, -np.inf)))
        best, first, last = Steepest(float(slope[k]), float(x[k])), x[max(k - 1, 0)], x[min(k + 1, SEARCH_STEPS - 1)]
    return best


@Program
def _slope(
    problem: Problem, path: Path, base_x: Float[Array, " steps"], travel: Float[Array, " steps"]
) -> tuple[Float[Array, " steps"], Float[Array, " steps"]]:
    """dF_x/dx0 and the contact force at positions of the clamped base."""
    solutions = solve_steps(problem, path, base_x, travel)

    def force(base_x):
        state, _ = states(problem, base_x, solutions)
        return -state.fx[:, 0], state.contact_force[:, 0]

    (_, size), (slope, _) = jax.jvp(force, (base_x,), (jnp.ones_like(base_x),))
    return slope, size


def softest(support: Support) -> float:
    """Displacement of the softest base per force on it: max C_ii, a length per force; 0 for clamped bases."""
    flexibility = support.flexibility()
    return 0.0 if flexibility is None else float(np.max(np.diag(np.asarray(flexibility.matrix))))


def steepness(build: Callable[..., Scene], data: xr.Dataset) -> xr.DataArray:
    """Steepest slope of the clamped whisker's force times the softest base's flexibility, over the range of a study.

    Where the product is above 1, a scan snaps through the vertex: the springs are softer than the critical stiffness
    (an estimate for coupled whiskers). It is NaN where a scene is invalid or there is no steepest slope.

    Args:
        build: makes a scene from named parameters, as in `study`.
        data: the Dataset of the study or its summary, over one or more axes.

    Returns:
        An array over the same axes, with `CURVE_POINTS` values each.
    """
    import xarray as xr

    axes = [str(dim) for dim in data.sizes if dim not in ("control", "whisker", "spring", "event")]
    ranges = {axis: data[axis].values[np.isfinite(data[axis].values)] for axis in axes}
    values = {axis: np.linspace(known.min(), known.max(), CURVE_POINTS) for axis, known in ranges.items()}
    grid, slopes = Parameters(values, False), {}
    found = [_steepness_at(build, grid.one(k), slopes) for k in range(grid.total)]
    return xr.DataArray(np.reshape(found, grid.shape), values, axes)


def _steepness_at(build: Callable[..., Scene], point: dict[str, float], slopes: dict[str, float]) -> float:
    try:
        scene = build(**point)
    except ValueError:
        return np.nan
    whisker = scene.whiskers[0]
    # The slope does not depend on the springs: scenes with the same whisker and object share one search.
    leaves, structure = jax.tree.flatten(whisker)
    same = repr(([np.asarray(leaf).tolist() for leaf in leaves], structure, scene.profile))
    if same not in slopes:
        slopes[same] = np.max([steepest(whisker, one).slope for one in scene.profile.objects])
    return slopes[same] * softest(scene.support)
