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
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Control, Scalar
from jaxwhisker._model.scene import AbstractScene, Scene
from jaxwhisker._path.path import Path, ScanPath, Status, room_for
from jaxwhisker._scan.blocks import in_blocks
from jaxwhisker._scan.mechanics import AnyProblem, Mechanics, Memory
from jaxwhisker._scan.plane import InThePlane
from jaxwhisker._scan.result import Result, SpaceResult
from jaxwhisker._scan.route import (
    TRACED_STEPS,
    Route,
    across,
    check_extent,
    default_positions,
    evenly_now,
    route_of,
    route_through,
    warn_of_no_touch,
)
from jaxwhisker._scan.slopes import events_now, solved_states_now

if TYPE_CHECKING:
    from jaxwhisker._model.space_scene import SpaceScene


@overload
def scan(scene: Scene, control: Control | None = None) -> Result: ...
@overload
def scan(scene: "SpaceScene", control: Control | None = None) -> SpaceResult: ...
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
        `unstable`, `undetermined`: see `Status`). A scan also ends where a contact that is not modelled begins: from
        there on, the status is `second_contact` or `crossing` (see `Scene(detect=)`), or `too_many_contacts` if a
        whisker needs more than `Scene(contacts=)`.

    Raises:
        ValueError: if a concrete argument is invalid, if the default control would have more than a million steps
            (springs so soft that the drive travels a thousand lengths) or the object's extent along the drive is not
            known, if a whisker is so curved that it would touch
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
    if control is not None:
        checks.vector("control", control)
    return _scan(scene, control)


@with_own_settings
def scan_across(scene: AbstractScene, steps: int) -> Any:
    """Scan right across the object, at equidistant positions over the range of the default control.

    Raises:
        ValueError: if a concrete scene is invalid.
    """
    return _scan(scene, None, steps)


def mechanics_of(scene: AbstractScene) -> type[Mechanics]:
    """The mechanics of a scene."""
    return mechanics_in(space=scene.in_space, contacts=scene.contacts)


def mechanics_in(*, space: bool, contacts: int) -> type[Mechanics]:
    """The mechanics of the plane or of space, with one contact or several; all but the first are loaded if needed."""
    if space and contacts > 1:
        from jaxwhisker._scan.space_chain import SeveralContactsInSpace

        return SeveralContactsInSpace
    if space:
        from jaxwhisker._scan.space import Space

        return Space
    if contacts > 1:
        from jaxwhisker._scan.chain import SeveralContacts

        return SeveralContacts
    return InThePlane


def _scan(scene: AbstractScene, control: Control | None, steps: int | None = None) -> Any:
    """A scan, outside a jit or as part of a caller's; without a control, at `steps` equidistant positions, if given."""
    mechanics, scene = mechanics_of(scene), jax.tree.map(checks.as_float, scene)
    problem = mechanics.problem(scene)
    if not checks.is_traced((scene, control)):
        mechanics.check(scene, problem)
    route, status = (None, None) if control is None else route_through(control)
    path, start, stop = path_along(mechanics, scene, problem, route, status)
    memory = mechanics.memory(problem, path, np.zeros(2) if route is None else route.stops)
    if route is None:
        check_extent(start)
        warn_of_no_touch(path.nodes.state.phase, path.status, scene)
        route = _route_across(start, stop, steps, problem)

    differences = None if checks.is_traced((scene, path, route.control)) else mechanics.differences(scene)

    def block(control, travel):
        state, status, displacement, _ = solved_states_now(mechanics, problem, path, control, travel, memory)
        lengths = None if differences is not None else mechanics.lengths(scene, state, displacement, control)
        return state, status, lengths

    control = jnp.asarray(route.control)
    if checks.is_staged((problem, path, control)):
        state, status, lengths = block(control, jnp.asarray(route.travel))
    else:
        state, status, lengths = in_blocks(block, (route.control, route.travel), mechanics.block)
    if differences is not None:
        lengths = jax.device_put(differences(state, route.control))  # compiles nothing
    return _result(mechanics, scene, problem, path, memory, control, state, status, lengths)


def path_along(
    mechanics: type[Mechanics],
    scene: AbstractScene,
    problem: AnyProblem,
    route: Route | None,
    status: Int[Array, ""] | None = None,
) -> ScanPath:
    """The path along a route, or right across the object; no path if the status of the route is not ok."""
    stops, last = across() if route is None else (route.stops, route.last)
    if not checks.is_staged((problem, stops)):
        prepare(mechanics, scene, problem, stops.shape[0])
    found = mechanics.follow(problem, stops, last if checks.is_traced(last) else np.asarray(last))
    path = mechanics.detected(scene, problem, found.path)
    if status is None:
        return found._replace(path=path)
    good = status == Status.ok
    count, status = jnp.where(good, path.count, 0), jnp.where(good, path.status, status)
    return found._replace(path=path._replace(count=count, status=status))


def _route_across(start: Float[Array, ""], stop: Float[Array, ""], steps: int | None, problem: AnyProblem) -> Route:
    """The route of the default control, of so many steps; its default number must not depend on traced values."""
    if checks.is_traced((problem, start)) or steps is not None:
        route = evenly_now(start, stop, TRACED_STEPS if steps is None else steps)
        return route if checks.is_traced(route) else jax.tree.map(np.asarray, route)
    return route_of(default_positions(float(start), float(stop), problem.unit))


def _result(
    mechanics: type[Mechanics],
    scene: Any,
    problem: AnyProblem,
    path: Path,
    memory: Memory,
    control: Float[Array, " steps"],
    state: Any,
    status: Int[Array, " steps"],
    lengths: Any,
) -> Any:
    springs = len(scene.support.springs)
    if lengths.shape[1] != springs:
        some = lengths if checks.is_traced(lengths) else np.asarray(lengths)
        lengths = jnp.asarray(some[:, :springs])
    usual = mechanics.event_room(len(scene.whiskers))
    return mechanics.result(
        **{name: getattr(state, name) for name in type(state).__dataclass_fields__},
        control=control,
        spring_length=lengths,
        status=status,
        deferred_events=lambda: events_now(mechanics, problem, path, memory, *room_for(path.nodes, path.count, usual)),
        scene=scene,
    )


def default_control(scene: AbstractScene) -> np.ndarray:
    """The drive positions of `scan(scene)`: from just before the first touch to just after the last whisker is free.

    Raises:
        ValueError: if the scene is traced: the number of positions depends on its values.
    """
    checks.float64_mode()
    if checks.is_traced(scene):
        raise ValueError("`scene` must be concrete, got a traced one: the number of positions depends on its values.")
    problem, path = _path_across(scene)
    return default_positions(float(path.start), float(path.stop), problem.unit)


class Range(NamedTuple):
    """The range of the default control of a scene, and the unit of the control; undefined if it is invalid."""

    valid: Bool[Array, ""]
    start: Float[Array, ""]
    stop: Float[Array, ""]
    unit: Scalar


def range_of(scene: AbstractScene) -> Range:
    """The range of the default control; prepares the programs of the scans that follow."""
    problem, path = _path_across(scene, prepared=True)
    return Range(problem.valid, path.start, path.stop, problem.unit.control)


def _path_across(scene: AbstractScene, prepared: bool = False) -> tuple[AnyProblem, ScanPath]:
    """The problem of a scene, and its path right across the object."""
    mechanics, scene = mechanics_of(scene), jax.tree.map(checks.as_float, scene)
    problem, (stops, last) = mechanics.problem(scene), across()
    if prepared:
        prepare(mechanics, scene, problem, stops.size, events=True)
    return problem, mechanics.follow(problem, stops, np.asarray(last))


def prepare(
    mechanics: type[Mechanics], scene: AbstractScene, problem: AnyProblem, stops: int, events: bool = False
) -> None:
    """Compile the programs of a scan for a problem shape at the same time; one compiler alone leaves a core idle."""
    if not mechanics.is_ready(problem, stops):
        with Compilers() as pool:
            _prepare(pool, mechanics, scene, problem, stops, events)


def prepare_scan(pool: Executor, scene: Scene, control: Control) -> None:
    """Trace the programs of a scan and its events, and compile them in the pool while the caller goes on."""
    scene, (route, _) = jax.tree.map(checks.as_float, scene), route_through(control)
    mechanics = mechanics_of(scene)
    _prepare(pool, mechanics, scene, mechanics.problem(scene), route.stops.shape[0], events=True)


def _prepare(
    pool: Executor, mechanics: type[Mechanics], scene: AbstractScene, problem: AnyProblem, stops: int, events: bool
) -> None:
    block = np.zeros(mechanics.block)
    path, memory = mechanics.prepare(pool, scene, problem, stops)
    solved_states_now.prepare(pool, mechanics, problem, path, block, block, memory)
    if events:
        events_now.prepare(pool, mechanics, problem, path, memory)
