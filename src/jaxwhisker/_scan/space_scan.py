"""Scans in space: the path of equilibria, and the state at every position of the drive."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.aside import Compilers
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.slopes import by_slopes
from jaxwhisker._base.types import Control
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._model.support import Support
from jaxwhisker._path.march import sweeps_of
from jaxwhisker._path.path import Status, room_for
from jaxwhisker._scan.blocks import in_blocks
from jaxwhisker._scan.route import (
    TRACED_STEPS,
    across,
    default_positions,
    evenly,
    evenly_now,
    route_of,
    route_through,
    traced_route,
    warn_of_no_touch,
)
from jaxwhisker._scan.space_result import SpaceResult, SpaceState
from jaxwhisker._scan.space_signals import event_room, events
from jaxwhisker._scan.space_slopes import event_tangents, linked_tangents, state_tangents
from jaxwhisker._scan.space_steps import solved_states
from jaxwhisker._space.approach import crop, limits_of
from jaxwhisker._space.history import linked
from jaxwhisker._space.march import capacity_of, march
from jaxwhisker._space.march_state import SpacePath
from jaxwhisker._space.problem import THINNEST, SpaceProblem, problem_in_space
from jaxwhisker._space.shape import until_second_contact

BLOCK = 256  # steps computed by one call; each takes longer than in the plane
LANES = 16  # of a batch that run together: a block takes as long as its slowest lane


class SpaceScanPath(NamedTuple):
    """A path, and the range of the control in which whiskers touch the object."""

    path: SpacePath
    start: Float[Array, ""]
    stop: Float[Array, ""]


@with_own_settings
def scan_in_space(scene: SpaceScene, control: Control | None = None, steps: int | None = None) -> SpaceResult:
    """Scan past a surface in space; see `scan`. With `steps`, the default control has so many equidistant positions."""
    if control is not None:
        checks.vector("control", control)
    scene = jax.tree.map(checks.as_float, scene)
    if checks.is_staged((scene, control)):
        return _staged(scene, control)
    problem = problem_now(scene)
    if not checks.is_traced(scene) and not bool(problem.valid):
        check_thickness(scene)
        raise ValueError(f"`scene` must have parameters that its constructors accept, got {scene}.")
    route, status = (None, None) if control is None else route_through(control)
    stops, last = across() if route is None else (route.stops, route.last)
    if not checks.is_traced((problem, stops)):
        prepare(problem, stops.shape[0])
    path, start, stop = follow_path_now(
        problem, stops, last if checks.is_traced(last) else np.asarray(last), *sweeps_of(last)
    )
    path = _if_ok(path, status)
    if route is None:
        warn_of_no_touch(path.nodes.phase, path.status, scene.surface)
    traced = checks.is_traced((problem, start))
    if route is None and (traced or steps is not None):
        route = evenly_now(start, stop, TRACED_STEPS if steps is None else steps)
        route = route if traced else jax.tree.map(np.asarray, route)
    elif route is None:
        route = route_of(default_positions(float(start), float(stop), problem.unit))

    links = None if problem.friction is None else linked_now(problem, path, stops)

    def block(control, travel):
        state, status, displacement, _ = solved_states_now(problem, path, control, travel, links)
        return state, status, None if displacement is None else spring_lengths_now(scene.support, displacement)

    states = in_blocks(block, (route.control, route.travel), BLOCK)
    return _result(scene, problem, path, links, jnp.asarray(route.control), *states)


def check_thickness(scene: SpaceScene) -> None:
    """Raise an error if the object is too thin for the whiskers of a scene."""
    length = float(scene.whiskers[0].length)
    if float(scene.surface.thickness()) <= THINNEST * length:
        raise ValueError(
            f"`surface` must be thicker than about {2 * THINNEST:.0e} of a whisker's length ({length:g}), got "
            f"{scene.surface}."
        )


def _staged(scene: SpaceScene, control: Control | None) -> SpaceResult:
    """The result as part of a caller's jit."""
    problem, status = problem_in_space(scene), None
    if control is None:
        stops, last = across()
    else:
        route, status = traced_route(jnp.asarray(control, dtype=float))
        stops, last = route.stops, route.last
    path, start, stop = follow_path(problem, jnp.asarray(stops), jnp.asarray(last), *sweeps_of(last))
    route = evenly(start, stop, TRACED_STEPS) if control is None else route
    path, positions = _if_ok(path, status), jnp.asarray(route.control)
    links = None if problem.friction is None else linked(problem, path, jnp.asarray(stops))
    state, status, displacement, _ = solved_states(problem, path, positions, jnp.asarray(route.travel), links)
    lengths = None if displacement is None else scene.support.spring_length(displacement)
    return _result(scene, problem, path, links, positions, state, status, lengths)


def _if_ok(path: SpacePath, status: Int[Array, ""] | None) -> SpacePath:
    """The path, or no path and this status if it is not ok."""
    if status is None:
        return path
    good = status == Status.ok
    return path._replace(count=jnp.where(good, path.count, 0), status=jnp.where(good, path.status, status))


def _result(scene, problem, path, links, control, state, status, lengths) -> SpaceResult:
    fields = {name: getattr(state, name) for name in SpaceState.__dataclass_fields__}
    usual = event_room(len(scene.whiskers))
    return SpaceResult(
        **fields,
        control=control,
        spring_length=jnp.zeros((control.size, 0)) if lengths is None else lengths,
        status=status,
        deferred_events=lambda: events_now(problem, path, links, *room_for(path.nodes, path.count, usual)),
        scene=scene,
    )


def follow_path(
    problem: SpaceProblem, stops: Float[Array, " stops"], last: Int[Array, ""], sweeps: int | None = None
) -> SpaceScanPath:
    """March to all stops, given in the scene's units; right across the object if the first one is NaN.

    There is room for the nodes of so many `sweeps` past the object; by default, of one for each stop.

    A path has no derivatives: they are attached to what is computed from it.
    """
    problem, stops = jax.lax.stop_gradient((problem, jnp.asarray(stops)))
    stops, whole = stops / problem.unit.control, jnp.isnan(stops[0])
    limits = limits_of(problem, stops[0])
    stops = jnp.where(whole, jnp.full_like(stops, limits.far).at[0].set(limits.start), stops)
    capacity = capacity_of(problem, min(sweeps or stops.size, stops.size))
    path = march(problem, limits.start, stops, jnp.asarray(last), capacity=capacity)
    path, start, stop = crop(problem, path, limits, whole)
    path = until_second_contact(problem, path)
    return SpaceScanPath(path, start * problem.unit.control, stop * problem.unit.control)


problem_now = Program(problem_in_space, tangent=by_slopes(problem_in_space))
follow_path_now = Program(follow_path, frozen=True, together=LANES)
solved_states_now = Program(solved_states, tangent=state_tangents)
linked_now = Program(linked, tangent=linked_tangents)
events_now = Program(events, tangent=event_tangents)
spring_lengths_now = Program(Support.spring_length)


def prepare(problem: SpaceProblem, stops: int, events: bool = False) -> None:
    """Compile the programs of a scan for a problem shape at the same time; one compiler alone leaves a core idle."""
    ends = np.zeros(stops), np.asarray(0)
    if follow_path_now.is_ready(problem, *ends):
        return
    block = np.zeros(BLOCK)
    with Compilers() as pool:
        path = follow_path_now.prepare(pool, problem, *ends).path
        links = None if problem.friction is None else linked_now.prepare(pool, problem, path, ends[0])
        solved_states_now.prepare(pool, problem, path, block, block, links)
        if events:
            events_now.prepare(pool, problem, path, links)
