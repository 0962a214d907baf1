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
from jaxwhisker._base.slopes import by_slopes
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import EventKind, Path
from jaxwhisker._scan.mechanics import Solutions
from jaxwhisker._scan.plane import InThePlane, check_valid, follow_path_now, problem_now
from jaxwhisker._scan.route import across
from jaxwhisker._scan.slopes import events_now
from jaxwhisker._scan.steps import solve_steps, states
from jaxwhisker._study.parameters import Parameters

if TYPE_CHECKING:
    import xarray as xr

SEARCH_STEPS = 257  # per search; each further search covers the neighbours of the best step of the previous one
SEARCHES = 4  # the steps of the last one are 2e-9 of the range of the first one
AT_EVENT = 1e-8  # of the range: a maximum as close to an event as this is at the event
CURVE_POINTS = 33  # values of each parameter between which the critical stiffness is interpolated


class Steepest(NamedTuple):
    """The steepest slope dF_x/dx0 of a clamped whisker (force per length), and the position x0 of its base there."""

    slope: Float[Array, ""]
    base_x: Float[Array, ""]  # without derivatives


def critical_stiffness(
    whisker: Whisker, profile: AbstractProfile | tuple[AbstractProfile, ...], model: str = "FB"
) -> Float[Array, ""]:
    """Critical stiffness of the springs: with softer ones, a scan snaps through the vertex and skips the maximum.

    It is max dF_x/dx0 before the vertex, where F_x = -fx is the force on a clamped whisker whose base is at x0, for one
    whisker on one spring. For coupled whiskers, it is this slope times the flexibility of the softest base, relative to
    that of a single spring. That is an estimate, because it takes the forces on the other whiskers as constant.

    Args:
        whisker: the whisker; of coupled whiskers, each of them.
        profile: the object, or a tuple of objects, the largest of whose values is returned. There is no friction.
        model: a model of the thesis, whose springs are equally stiff; see `Support.named`.

    Returns:
        A stiffness, force per length, with a relative accuracy of 1e-9. It is NaN if the whisker does not reach the
        vertex: the object is out of reach, or the clamped whisker snaps before.

    Raises:
        ValueError: if an argument is invalid, or JAX is in float32 mode.

    It works under jax.jit and jax.vmap, and has derivatives with respect to all numbers of whisker and object, in both
    modes.

    Examples:
        >>> print(f"{jw.critical_stiffness(jw.Whisker(), jw.Parabola(0.2)):.4f}")  # in EI/L^3
        28.7916
    """
    checks.instance("whisker", whisker, Whisker, "a Whisker")
    softness = softest(Support.named(model, 1.0))
    scene = Scene(whisker, profile)
    checks.instance("profile", scene, Scene, "one or more profiles")
    return jnp.max(jnp.stack([steepest(whisker, one).slope for one in scene.profile.objects])) * softness


def steepest(whisker: Whisker, profile: AbstractProfile) -> Steepest:
    """The largest slope of the clamped whisker's force between first touch and vertex, with relative accuracy 1e-9.

    It is NaN if the whisker does not reach the vertex: the object is out of reach, or the clamped whisker snaps before.

    Args:
        whisker: the whisker.
        profile: a single object.

    Raises:
        ValueError: if there are several objects.
    """
    checks.float64_mode()
    if len(profile.objects) > 1:
        checks.fail("profile", "a single object, whose steepest slope is wanted", str(profile))
    scene = jax.tree.map(checks.as_float, Scene(whisker.without_masses(), profile))
    problem = problem_now(scene)
    if not checks.is_traced(scene):
        check_valid(scene, problem)
    path, start, _ = follow_path_now(problem, *map(jnp.asarray, across()))
    events = events_now(InThePlane, problem, path, None)
    passes, places = events.kind == EventKind.vertex, jax.lax.stop_gradient(events.control)
    found, first = jnp.any(passes), jax.lax.stop_gradient(problem.unit.control * problem.touch_right.x[0])
    last = jnp.where(found, places[jnp.argmax(passes)], first)
    at, solution = search_now(problem, path, first, last, start)
    # The slope is stationary at a smooth maximum. A maximum at an event, such as the vertex, moves with the event.
    apart = jnp.where(jnp.isfinite(places), jnp.abs(places - at), jnp.inf)
    event = jnp.argmin(apart)
    moved = jnp.where(apart[event] < AT_EVENT * jnp.abs(last - first), events.control[event] - places[event], 0.0)
    slope, _ = slopes_now(problem, (at + moved)[None], solution)
    return Steepest(*(jnp.where(found, value, jnp.nan) for value in (slope[0], at)))


def _search(
    problem: Problem, path: Path, first: Float[Array, ""], last: Float[Array, ""], start: Float[Array, ""]
) -> tuple[Float[Array, ""], Solutions]:
    """Position of the base between first and last at which the slope is largest, and the solution there."""
    problem, path, *ends, start = jax.lax.stop_gradient((problem, path, first, last, start))

    def narrower(ends, _):
        x = jnp.linspace(ends[0], ends[1], SEARCH_STEPS)
        solutions = solve_steps(InThePlane, problem, path, x, start - x)
        slope, force = _slopes(problem, x, solutions)
        k = jnp.argmax(jnp.where(jnp.isfinite(slope) & (force > 0), slope, -jnp.inf))
        around = x[jnp.maximum(k - 1, 0)], x[jnp.minimum(k + 1, SEARCH_STEPS - 1)]
        return around, (x[k], jax.tree.map(lambda leaf: leaf[k][None], solutions))

    _, found = jax.lax.scan(narrower, tuple(ends), length=SEARCHES)
    return jax.tree.map(lambda leaf: leaf[-1], found)


def _slopes(
    problem: Problem, base_x: Float[Array, " steps"], solutions: Solutions
) -> tuple[Float[Array, " steps"], Float[Array, " steps"]]:
    """dF_x/dx0 and the contact force at solved positions of the clamped base."""

    def force(base_x):
        state, *_ = states(InThePlane, problem, base_x, solutions)
        return -state.fx[:, 0], state.contact_force[:, 0]

    (_, size), (slope, _) = jax.jvp(force, (base_x,), (jnp.ones_like(base_x),))
    return slope, size


search_now, slopes_now = Program(_search, frozen=True), Program(_slopes, tangent=by_slopes(_slopes))


def softest(support: Support) -> Float[Array, ""]:
    """Displacement along x of the softest base per force on it: max C_ii, a length per force; 0 for clamped bases."""
    flexibility = support.flexibility()
    return jnp.max(jnp.diagonal(flexibility.matrix)[:: flexibility.offset.size // support.whiskers])


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
        slopes[same] = float(critical_stiffness(whisker, scene.profile))
    return slopes[same] * float(softest(scene.support))
