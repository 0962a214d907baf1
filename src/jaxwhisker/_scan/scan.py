"""The scan: drag whiskers past an object, quasi-statically, and read the signals at their bases.

A scan has two parts. The march follows the path of equilibria from where all whiskers are free to the end of the
control. It chooses its steps itself and finds all events: stability, snaps and the states after them do not depend on
the caller's grid. Then the equilibria at all control positions are solved for in batches, starting from the path's
interpolation.

Both parts are programs of the dimensionless problem, compiled once per problem shape.
"""

from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.aside import Compilers
from jaxwhisker._base.primitive import LANES
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.slopes import by_slopes
from jaxwhisker._base.types import Control, Scalar
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._model.canonical import canonical
from jaxwhisker._model.scene import AbstractScene, Scene, moves_along_x
from jaxwhisker._path.approach import approach_of
from jaxwhisker._path.gains import without_gains
from jaxwhisker._path.march import capacity_of, march, sweeps_of
from jaxwhisker._path.path import Path, Status, event_room, room_for
from jaxwhisker._scan.blocks import BLOCK, in_blocks
from jaxwhisker._scan.detect import Kinds, detect, kinds_of
from jaxwhisker._scan.memory import remembered
from jaxwhisker._scan.resolution import warn_of_steps
from jaxwhisker._scan.result import Result
from jaxwhisker._scan.route import (
    TRACED_STEPS,
    Route,
    across,
    default_positions,
    evenly,
    evenly_now,
    route_of,
    route_through,
    traced_route,
    warn_of_no_touch,
)
from jaxwhisker._scan.signals import events
from jaxwhisker._scan.slopes import event_tangents, remembered_tangents, spring_tangents, state_tangents
from jaxwhisker._scan.springs import bases_of, lengths_along_x, spring_lengths, suspension
from jaxwhisker._scan.state import State
from jaxwhisker._scan.steps import solved_states

if TYPE_CHECKING:
    from jaxwhisker._model.space_scene import SpaceScene
    from jaxwhisker._scan.space_result import SpaceResult


@overload
def scan(scene: Scene, control: Control | None = None) -> Result: ...
@overload
def scan(scene: "SpaceScene", control: Control | None = None) -> "SpaceResult": ...
@with_own_settings
def scan(scene: Any, control: Control | None = None) -> Any:
    """Scan the object quasi-statically with the drive at every position of `control`.

    Args:
        scene: whiskers, object and support; with a surface as its object, a scene in space.
        control: drive positions u, shape (steps,): lengths, or angles in rad for a Rotation; arbitrarily spaced; may
            reverse direction. The drive approaches control[0] from where all whiskers are free (the right of the
            object, the left for `Translation(direction=1)`, or the start of a bounded motion) and then visits the
            positions in order. Default: from just before the first touch to just after the last whisker is free, or to
            the end of the motion, in steps of 0.001 whisker lengths, of 0.001 rad for a Rotation, or of 0.001 times the
            range of a Motion. While the scene is traced, the default has 2048 equally spaced positions over the same
            range.

    Returns:
        A Result, or a SpaceResult of a scene in space. The values of a step that fails are NaN, and its status says why
        (`invalid`: a parameter is outside its domain; `lost`, `unsettled`, `not_convex`, `too_long`, `inexact`,
        `unstable`, `undetermined`: see `Status`). With `Scene(detect=...)`, a scan also ends where a contact that is
        not modelled begins: from there on, the status is `second_contact` or `crossing`.

    Raises:
        ValueError: if a concrete argument is invalid, if the default control would have more than a million steps
            (springs so soft that the drive travels a thousand lengths), if a whisker is so curved that it would touch
            in two places, or if JAX is in float32 mode.

    Warns:
        UserWarning: if integration steps do not resolve a concrete function of arc length; see `Whisker(breaks=)`.

    `scan` works under jax.jit and jax.vmap. Signals, states and event positions have first and second derivatives, in
    both modes, with respect to every numeric field of the scene and to the control. Derivatives are taken at fixed
    control along the step's own branch; exactly at a change of phase they are those of the phase that begins. With
    friction, a contact that sticks also depends on where the drive turned. Reactions of failed steps and of free
    whiskers have derivative 0. Inside your own lax.map or lax.scan, jax.hessian returns NaN with jax 0.10; use vmap, or
    jacfwd of jacfwd.
    """
    checks.float64_mode()
    checks.instance("scene", scene, AbstractScene, "a Scene")
    control = checks.as_array(control)
    if not isinstance(scene, Scene):
        from jaxwhisker._scan.space_scan import scan_in_space

        return scan_in_space(scene, control)
    if control is not None:
        checks.vector("control", control)
    scene = jax.tree.map(checks.as_float, scene)
    if checks.is_staged((scene, control)):
        return _scan_staged(scene, control)
    return _scan(scene, control, TRACED_STEPS if checks.is_traced(scene) else None)


def scan_across(scene: Scene, steps: int) -> Result:
    """Scan right across the object, at equidistant positions over the range of the default control.

    Raises:
        ValueError: if a concrete scene is invalid.
    """
    scene = jax.tree.map(checks.as_float, scene)
    if not checks.is_staged(scene):
        return _scan(scene, None, steps)
    problem = problem_of(scene)
    path, start, stop = path_through(problem, kinds_of(scene), *map(jnp.asarray, across()))
    return _staged_result(scene, problem, path, evenly(start, stop, steps))


def _scan(scene: Scene, control: Control | None, steps: int | None) -> Result:
    """A scan outside any jit; without a control, its positions are `steps` equidistant ones or those of the default."""
    kinds, problem = kinds_of(scene), problem_now(scene)
    if not checks.is_traced((scene, control)):
        check_valid(scene, problem)
        warn_of_steps(scene)
    route, status = (None, None) if control is None else route_through(control)
    path, start, stop = path_along(problem, kinds, route, status)
    if route is None:
        warn_of_no_touch(path.nodes.state.phase, path.status, scene.profile)
    if route is None and steps is not None:
        route = evenly_now(start, stop, steps)
        route = route if checks.is_traced(route) else jax.tree.map(np.asarray, route)
    elif route is None:
        route = route_of(default_positions(float(start), float(stop), problem.unit))
    state, step_status, lengths = _states(scene, problem, path, route)
    return _result(scene, problem, path, jnp.asarray(route.control), state, step_status, lengths)


def _states(
    scene: Scene, problem: Problem, path: Path, route: Route
) -> tuple[State, Int[Array, " steps"], Float[Array, "steps springs"]]:
    """States, status and spring lengths of all steps."""
    known = moves_along_x(scene) and not checks.is_traced((scene, path, route.control))

    def block(control, travel):
        state, status, _ = solved_states_now(problem, path, control, travel)
        by_program = None if known else spring_lengths_now(suspension(scene), bases_of(scene, state), control)
        return state, status, by_program

    state, status, lengths = in_blocks(block, (route.control, route.travel), BLOCK)
    if known:
        lengths = jax.device_put(lengths_along_x(scene.support, np.asarray(state.base_x), np.asarray(route.control)))
    return state, status, lengths


def path_along(problem: Problem, kinds: Kinds, route: Route | None, status: Int[Array, ""] | None = None) -> "ScanPath":
    """The path along a route, or right across the object, with the derivatives of places where contacts stick."""
    stops, last = across() if route is None else (route.stops, route.last)
    if not checks.is_staged((problem, stops)):
        prepare(problem, stops.shape[0], kinds)
    path, start, stop = path_through(problem, kinds, stops, last if checks.is_traced(last) else np.asarray(last))
    path = _if_ok(path, status)
    if problem.friction_angle is not None and checks.is_traced((problem, stops)):
        path = remembered_now(path, problem, np.zeros(2) if route is None else stops)
    return ScanPath(path, start, stop)


def default_control(scene: AbstractScene) -> np.ndarray:
    """The drive positions of `scan(scene)`: from just before the first touch to just after the last whisker is free.

    Raises:
        ValueError: if the scene is traced: the number of positions depends on its values.
    """
    checks.float64_mode()
    if checks.is_traced(scene):
        raise ValueError("`scene` must be concrete, got a traced one: the number of positions depends on its values.")
    ends = tuple(map(np.asarray, across()))
    if isinstance(scene, Scene):
        problem = problem_now(jax.tree.map(checks.as_float, scene))
        path = follow_path_now(problem, *ends)
    else:
        from jaxwhisker._scan import space_scan

        problem = space_scan.problem_now(jax.tree.map(checks.as_float, scene))
        path = space_scan.follow_path_now(problem, *ends)
    return default_positions(float(path.start), float(path.stop), problem.unit)


class Range(NamedTuple):
    """The range of the default control of a scene, and the unit of the control; undefined if it is invalid."""

    valid: Bool[Array, ""]
    start: Float[Array, ""]
    stop: Float[Array, ""]
    unit: Scalar


def range_of(scene: AbstractScene) -> Range:
    """The range of the default control; prepares the programs of the scans that follow."""
    scene, (stops, last) = jax.tree.map(checks.as_float, scene), across()
    if isinstance(scene, Scene):
        problem, follow = problem_now(scene), follow_path_now
        prepare(problem, stops.size, kinds_of(scene), events=True)
    else:
        from jaxwhisker._scan import space_scan

        problem, follow = space_scan.problem_now(scene), space_scan.follow_path_now
        space_scan.prepare(problem, stops.size, events=True)
    path = follow(problem, stops, np.asarray(last))
    return Range(problem.valid, path.start, path.stop, problem.unit.control)


def check_valid(scene: Scene, problem: Problem) -> None:
    """Raise an error for invalid values that the constructors do not detect."""
    if bool(problem.valid):
        return
    if not bool(scene.profile.valid()):
        _, height = scene.profile.vertex()
        raise ValueError(
            "`profile` must be strictly convex with its lowest point above the bases, but the lowest point of "
            f"{scene.profile} is at height {float(height):.4g}."
        )
    if any(whisker.intrinsic_curvature is not None and bool(whisker.valid()) for whisker in scene.whiskers):
        raise ValueError(
            "`intrinsic_curvature` must let each unloaded whisker touch the object in one place only, but a whisker "
            "would touch it in two."
        )
    raise ValueError(f"`scene` must have parameters that its constructors accept, got {scene}.")


class ScanPath(NamedTuple):
    """A path, and the range of the control in which whiskers touch the object."""

    path: Path
    start: Float[Array, ""]
    stop: Float[Array, ""]


def follow_path(
    problem: Problem, stops: Float[Array, " stops"], last: Int[Array, ""], sweeps: int | None = None
) -> ScanPath:
    """March to all stops, given in the scene's units; right across the object if the first one is NaN.

    There is room for the nodes of so many `sweeps` past the object; by default, of one for each stop.

    A path has no derivatives: they are attached to what is computed from it.
    """
    problem, stops = jax.lax.stop_gradient((problem, jnp.asarray(stops)))
    unit, approach = problem.unit, approach_of(problem)
    limits, whole = approach.limits(), jnp.isnan(stops[0])
    stops = jnp.where(whole, jnp.full_like(stops, limits.far).at[0].set(limits.start), stops / unit.control)
    capacity = capacity_of(problem, min(sweeps or stops.size, stops.size))
    path = march(problem, stops, jnp.asarray(last), capacity=capacity)
    path, start, stop = approach.crop(path, whole, limits)
    path = without_gains(problem, path)
    return ScanPath(path, jnp.asarray(start * unit.control), jnp.asarray(stop * unit.control))


def path_through(problem: Problem, kinds: Kinds, stops: Any, last: Any) -> ScanPath:
    """The path to all stops, which ends where a contact of these kinds begins."""
    found = follow_path_now(problem, stops, last, *sweeps_of(last))
    return found._replace(path=detect_now(problem, found.path, kinds)) if kinds else found


def _staged_result(
    scene: Scene, problem: Problem, path: Path, route: Route, status: Int[Array, ""] | None = None
) -> Result:
    """The result along a route, as part of a caller's jit; a status of the route that is not ok replaces the path's."""
    path, control, travel = _if_ok(path, status), jnp.asarray(route.control), jnp.asarray(route.travel)
    if problem.friction_angle is not None:
        path = remembered(path, problem, jnp.asarray(route.stops))
    state, step_status, _ = solved_states(problem, path, control, travel)
    lengths = spring_lengths(suspension(scene), bases_of(scene, state), control)
    return _result(scene, problem, path, control, state, step_status, lengths)


def _if_ok(path: Path, status: Int[Array, ""] | None) -> Path:
    """The path, or no path and this status if it is not ok."""
    if status is None:
        return path
    good = status == Status.ok
    return path._replace(count=jnp.where(good, path.count, 0), status=jnp.where(good, path.status, status))


def _scan_staged(scene: Scene, control: Control | None) -> Result:
    if control is None:
        return scan_across(scene, TRACED_STEPS)
    if checks.is_traced(control):
        route, status = traced_route(jnp.asarray(control, dtype=float))
    else:
        route, status = route_of(np.asarray(control, dtype=float)), None
    problem = problem_of(scene)
    path = path_through(problem, kinds_of(scene), jnp.asarray(route.stops), jnp.asarray(route.last)).path
    return _staged_result(scene, problem, path, route, status)


def _result(
    scene: Scene,
    problem: Problem,
    path: Path,
    control: Float[Array, " steps"],
    state: State,
    status: Int[Array, " steps"],
    lengths: Float[Array, "steps springs"],
) -> Result:
    fields, n = {name: getattr(state, name) for name in State.__dataclass_fields__}, len(scene.whiskers)
    return Result(
        **fields,
        control=control,
        spring_length=_of_springs(scene, lengths),
        status=status,
        deferred_events=lambda: events_now(problem, path, *room_for(path.nodes, path.count, event_room(n))),
        scene=scene,
    )


def _of_springs(scene: Scene, lengths: Float[Array, "steps columns"]) -> Float[Array, "steps springs"]:
    """The lengths of the springs that the scene has."""
    count = len(scene.support.springs)
    if lengths.shape[1] == count or checks.is_traced(lengths):
        return lengths[:, :count]
    return jax.device_put(np.asarray(lengths)[:, :count])  # compiles nothing


canonical_problem_now = Program(problem_of, tangent=by_slopes(problem_of))
follow_path_now = Program(follow_path, frozen=True, together=LANES)
detect_now = Program(detect, frozen=True, together=LANES)
remembered_now = Program(remembered, tangent=remembered_tangents)
solved_states_now = Program(solved_states, tangent=state_tangents)
events_now = Program(events, tangent=event_tangents)
spring_lengths_now = Program(spring_lengths, tangent=spring_tangents)


def problem_now(scene: Scene) -> Problem:
    """The dimensionless problem of a scene, by a program that all scenes of one canonical form share."""
    return canonical_problem_now(canonical(scene))


def prepare(problem: Problem, stops: int, kinds: Kinds = (), events: bool = False) -> None:
    """Compile the programs of a scan for a problem shape at the same time; one compiler alone leaves a core idle."""
    if not follow_path_now.is_ready(problem, np.zeros(stops), np.asarray(0)):
        with Compilers() as pool:
            _prepare(pool, problem, stops, kinds, events)


def prepare_scan(pool: Executor, scene: Scene, control: Control) -> None:
    """Trace the programs of a scan and its events, and compile them in the pool while the caller goes on."""
    scene, (route, _) = jax.tree.map(checks.as_float, scene), route_through(control)
    _prepare(pool, problem_now(scene), route.stops.shape[0], kinds_of(scene), events=True)


def _prepare(pool: Executor, problem: Problem, stops: int, kinds: Kinds, events: bool) -> None:
    block = np.zeros(BLOCK)
    path = follow_path_now.prepare(pool, problem, np.zeros(stops), np.asarray(0)).path
    if kinds:
        detect_now.prepare(pool, problem, path, kinds)
    solved_states_now.prepare(pool, problem, path, block, block)
    if events:
        events_now.prepare(pool, problem, path)
