"""The mechanics of scans in space, with the signals of an equilibrium."""

from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.program import Program
from jaxwhisker._base.rotation import left_jacobian
from jaxwhisker._base.slopes import by_slopes
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, at_control
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._model.support import Support
from jaxwhisker._path.march import follow
from jaxwhisker._path.path import STOP, Last, Node, Path, ScanPath, Status, Stops
from jaxwhisker._scan.mechanics import EventSides, Mechanics, Solutions
from jaxwhisker._scan.result import SpaceEvents, SpaceResult
from jaxwhisker._scan.signals import beyond_phase
from jaxwhisker._scan.slopes import memory_now
from jaxwhisker._scan.state import SpaceState
from jaxwhisker._scan.steps import interpolate, is_near
from jaxwhisker._space.contact import (
    AHEAD,
    FORCE,
    POINT,
    ROLL,
    SLACK,
    TRACTION,
    UNKNOWNS,
    SpaceBase,
    angle_and_arc,
)
from jaxwhisker._space.friction import continuation_of
from jaxwhisker._space.history import Followed, LinkedNodes, contacts_within, interpolated, linked, stages_before
from jaxwhisker._space.implicit import sides_of_events, solved, with_turns
from jaxwhisker._space.newton import Equations, Phases, plain, solve_points
from jaxwhisker._space.problem import THINNEST, Contacts, SpaceProblem, of_each, problem_in_space
from jaxwhisker._space.residuals import residuals
from jaxwhisker._space.second_contact import touches_twice
from jaxwhisker._space.slip import SlipMode, following
from jaxwhisker._space.stance import base_placement

EVENTS = 32  # events of one whisker that a scan has room for
BLOCK = 256  # steps computed by one call; each takes longer than in the plane
LANES = 16  # of a batch that run together: a block takes as long as its slowest lane
WIND_UP = 300.0  # turn of a base by the roll at the contact: a rod that magnifies errors more is `inexact`


class Within(NamedTuple):
    """The step of the path with friction within which an equilibrium lies; fields (steps, ...)."""

    start: Point
    stages: Point
    before: Phases  # at the start, on arrival
    mode: Phases


def follow_path(problem: SpaceProblem, stops: Stops, last: Last, sweeps: int | None = None) -> ScanPath:
    """March to all stops, given in the scene's units; right across the object if the first one is NaN.

    There is room for the nodes of so many `sweeps` past the object; by default, of one for each stop. A path has no
    derivatives: they are attached to what is computed from it.
    """
    problem, stops = jax.lax.stop_gradient((problem, jnp.asarray(stops)))
    return follow(continuation_of(problem), stops, last, sweeps)


problem_now = Program(problem_in_space, tangent=by_slopes(problem_in_space))
follow_path_now = Program(follow_path, frozen=True, together=LANES)
spring_lengths_now = Program(Support.spring_length)


class Space(Mechanics):
    """Whiskers in space."""

    most_numbers = 96  # a curved whisker on springs past a quadric has 82
    block, result, events, follows = BLOCK, SpaceResult, SpaceEvents, follow_path_now
    problem = staticmethod(problem_now)

    @staticmethod
    def check(scene: SpaceScene, problem: SpaceProblem) -> None:
        if not bool(problem.valid):
            check_thickness(scene)
            check_weight(scene, problem)
            raise ValueError(f"`scene` must have parameters that its constructors accept, got {scene}.")

    @staticmethod
    def detected(scene: SpaceScene, problem: SpaceProblem, path: Path) -> Path:
        return path  # `follow_path` has looked for second contacts

    @staticmethod
    def prepare(
        pool: Executor, scene: SpaceScene, problem: SpaceProblem, stops: int
    ) -> tuple[Path, LinkedNodes | None]:
        ends = np.zeros(stops), np.asarray(0)
        path = follow_path_now.prepare(pool, problem, *ends).path
        return path, None if problem.friction is None else memory_now.prepare(pool, Space, problem, path, ends[0])

    @classmethod
    def memory(cls, problem: SpaceProblem, path: Path, stops: Any) -> LinkedNodes | None:
        return None if problem.friction is None else memory_now(cls, problem, path, stops)

    @staticmethod
    def remember(problem: SpaceProblem, path: Path, stops: Stops) -> LinkedNodes:
        return linked(problem, path, stops)

    @staticmethod
    def remembered(memory: LinkedNodes | None, path: Path | None, solutions: Solutions) -> Within | None:
        if memory is None or path is None or path.nodes.before.mode is None:
            return None
        node, end = solutions.node, jnp.minimum(solutions.node + 1, path.count - 1)
        start, before = jax.tree.map(lambda leaf: leaf[node], (memory.point, path.nodes.before.phase))
        stages, mode = jax.tree.map(lambda leaf: leaf[end], (memory.stages, path.nodes.before.mode))
        return Within(start, stages, before, mode)

    @staticmethod
    def solve(problem, path, index, u, known) -> Solutions:
        index = jnp.maximum(index, 0)  # of a path without nodes
        z, phase = path.nodes.point.z[index], path.nodes.state.phase[index]
        free = Solutions(z, phase, known, index)
        solve = _solve if problem.friction is None else _solve_with_friction
        return jax.lax.cond(jnp.any(phase != Phase.free), lambda: solve(problem, path, index, u, known), lambda: free)

    @staticmethod
    def states(problem, u, solutions, remembered):
        def one(u: Scalar, z: Contacts, phase: Phases):
            return signals(problem, solved(problem, z, u, phase), u, phase)

        def one_with_friction(u: Scalar, found: Solutions, at: Within):
            within = interpolated(at.start, at.stages, at.before, found.state, u)
            within = jnp.where((found.state != Phase.free)[:, None], within, found.z)
            z = contacts_within(Followed(problem, u, found.state, at.mode, within), found.z)
            return signals(problem, z, u, found.state, at.mode == SlipMode.slips)

        if remembered is None:
            return jax.vmap(one)(u, solutions.z, solutions.state)
        return jax.vmap(one_with_friction)(u, solutions, remembered)

    @staticmethod
    def checked(problem, solutions, status):
        if not problem.may_touch_twice:
            return status
        twice = jax.vmap(lambda z, phase: touches_twice(problem, z, phase))(solutions.z, solutions.state)
        return jnp.where((status == Status.ok) & twice, Status.second_contact, status)

    @staticmethod
    def lengths(scene: SpaceScene, state: Any, displacement: Any, control: Any) -> Float[Array, "steps springs"]:
        none = jnp.zeros((control.shape[0], 0))
        return none if displacement is None else spring_lengths_now(scene.support, displacement)

    @staticmethod
    def differences(scene: SpaceScene) -> None:
        return None

    @staticmethod
    def signals(problem, *side):
        return signals(problem, *side)

    @staticmethod
    def event_room(whiskers: int) -> int:
        return EVENTS * whiskers

    @staticmethod
    def event_nodes(problem: SpaceProblem, path: Path) -> Node:
        return with_turns(path)

    @staticmethod
    def at_events(problem, path, memory, at, filled) -> EventSides:
        return EventSides(*sides_of_events(problem, path, memory, at, filled))

    @staticmethod
    def event_controls(problem, path, memory, at, filled):
        control, *_ = sides_of_events(problem, path, memory, at, filled)
        nodes = path.nodes
        return control, (nodes.before.phase[at] != Phase.free) & (nodes.state.phase[at] == Phase.free)

    @staticmethod
    def at_nodes(memory: LinkedNodes | None, at: Any) -> Any:
        return None if memory is None or at is None else jax.tree.map(lambda leaf: leaf[at], memory)


def _solve(
    problem: SpaceProblem, path: Path, index: Int[Array, " steps"], u: Float[Array, " steps"], known: Array
) -> Solutions:
    """Solve for the equilibria at controls after nodes `index`; `known` is the status of the path there."""
    phase, z = path.nodes.state.phase[index], path.nodes.point.z[index]
    guess = jax.vmap(lambda index, u: interpolate(path, index, u))(index, u)
    guess = guess._replace(z=jnp.where((phase != Phase.free)[:, :, None], guess.z, z))
    equations = jax.vmap(plain)(phase, jax.vmap(at_control)(u, guess.z))
    solution = solve_points(problem, equations, jax.tree.map(lambda leaf: leaf[:, None], guess))
    return _accepted(problem, path, index, solution, guess, phase, known)


def _accepted(problem, path, index, solution, guess, phase, known) -> Solutions:
    z = solution.end.z
    good = solution.converged & is_near(z, guess.z)
    if problem.rolls:
        # Curved rods with little torsional stiffness wind up: errors grow exponentially from either end to the other.
        turn = jnp.abs(solution.newton.at.pose_by[..., ROLL])
        good &= jnp.all((turn < WIND_UP) | (phase == Phase.free)[:, :, None], axis=(1, 2))
    status = jnp.where(good, Status.ok, Status.inexact)
    status = jnp.where(known == Status.ok, status, known)
    accepted = (status == Status.ok)[:, None]
    phase = jnp.where(accepted, phase, int(Phase.free))
    z = jnp.where(accepted[:, None], z, path.nodes.point.z[0])
    return Solutions(z, phase, status, index)


def _solve_with_friction(
    problem: SpaceProblem, path: Path, index: Int[Array, " steps"], u: Float[Array, " steps"], known: Array
) -> Solutions:
    """The same with friction: the contacts are those within the steps of the path."""
    nodes, modes, friction = path.nodes, path.nodes.before.mode, problem.friction
    assert modes is not None and friction is not None
    # The last node ends a step.
    index = index - ((index == path.count - 1) & (nodes.kind[index] == STOP) & (index > 0))

    def at(index, u):
        end = jnp.minimum(index + 1, path.count - 1)
        start, before, phase = jax.tree.map(
            lambda leaf: leaf[index], (nodes.point, nodes.before.phase, nodes.state.phase)
        )
        guess = interpolated(start, stages_before(nodes, end), before, phase, u)
        motion = following(guess, friction, modes[end])
        return Point(guess, u), Equations(phase[None], at_control(u, guess), None, motion)

    guess, equations = jax.vmap(at)(index, u)
    solution = solve_points(problem, equations, jax.tree.map(lambda leaf: leaf[:, None], guess))
    return _accepted(problem, path, index, solution, guess, nodes.state.phase[index], known)


def check_thickness(scene: SpaceScene) -> None:
    """Raise an error if the object is too thin for the whiskers of a scene."""
    length = float(scene.whiskers[0].length)
    if float(scene.surface.thickness()) <= THINNEST * length:
        raise ValueError(
            f"`surface` must be thicker than about {2 * THINNEST:.0e} of a whisker's length ({length:g}), got "
            f"{scene.surface}."
        )


def check_weight(scene: SpaceScene, problem: SpaceProblem) -> None:
    """Raise an error if whiskers of a valid scene buckle under their own weight."""
    if problem.weight is not None and bool(scene.valid()):
        raise ValueError(
            "`gravity` must leave free whiskers stable, which an upright one is up to a weight of 7.84 EI/L^2, got "
            f"{scene}."
        )


class SpaceSignals(NamedTuple):
    """An equilibrium in the scene's units, and its largest residual."""

    state: SpaceState
    residual: Scalar
    displacement: Float[Array, "whiskers 6"] | None  # of the bases relative to their mounts; None if they are clamped


def signals(
    problem: SpaceProblem, z: Contacts, u: Scalar, phase: Phases, slips: Bool[Array, " whiskers"] | None = None
) -> SpaceSignals:
    """State of an equilibrium, and what is known besides; with friction, `slips` tells which contacts slip."""
    unit, touching = problem.unit, phase != Phase.free
    drive = problem.drive(u)
    residual, pose, base = residuals(problem, z, u, phase, z)
    placed = of_each(problem, lambda body, pose: base_placement(problem, drive, body.mount, pose), pose)
    arc = of_each(problem, lambda body, z, phase: angle_and_arc(body, z, phase)[1], z, phase)
    wrong = beyond_phase(phase, z[:, FORCE], z[:, SLACK])
    if problem.friction is not None:
        residual = residual.at[:, TRACTION].set(0.0)
        beyond = (jnp.sum(z[:, TRACTION] ** 2, axis=1) - 1) * problem.friction * z[:, FORCE]
        wrong = jnp.maximum(wrong, beyond)
    wrong = jnp.where(touching, jnp.maximum(wrong, 0.0), 0.0)

    def if_touching(values: Array) -> Array:
        return jnp.where(touching.reshape(touching.shape + (1,) * (values.ndim - 1)), values, 0.0)

    reaction = if_touching(-base.force), if_touching(-base.moment)
    if problem.hanging is not None:  # a drive that moves along a line does not turn
        turn = jax.vmap(lambda turn, load: solve(left_jacobian(turn).T, load[:, None])[:, 0])
        weights = problem.hanging[:, :3], turn(pose[:, 3:], problem.hanging[:, 3:])
        reaction = (part - jnp.where(touching[:, None], 0.0, own) for part, own in zip(reaction, weights, strict=True))
    force, moment = reaction
    vectors = {
        ("fx", "fy", "fz"): force * unit.force,
        ("mx", "my", "mz"): moment * unit.moment,
        ("base_x", "base_y", "base_z"): placed.position * unit.length,
        ("contact_x", "contact_y", "contact_z"): if_touching(z[:, POINT]) * unit.length,
    }
    components = {name: part for names, vector in vectors.items() for name, part in zip(names, vector.T, strict=True)}
    state = SpaceState(
        **components,
        base_rotation=placed.rotation,
        contact_force=if_touching(_size(problem, z)) * unit.force,
        contact_arc=if_touching(arc) * unit.length,
        phase=phase,
        **_objects(problem, z, touching),
        **({} if slips is None else _friction(problem, z, base, slips, if_touching)),
    )
    displacement = None
    if problem.springs is not None:
        displacement = jnp.concatenate([pose[:, :3] * unit.length, pose[:, 3:]], axis=1)
    return SpaceSignals(state, jnp.maximum(jnp.max(jnp.abs(residual)), jnp.max(wrong)), displacement)


def _size(problem: SpaceProblem, z: Contacts) -> Float[Array, " whiskers"]:
    """Size of the contact forces."""
    if problem.friction is None:
        return z[:, FORCE]
    return z[:, FORCE] * jnp.sqrt(1 + problem.friction**2 * jnp.sum(z[:, TRACTION] ** 2, axis=1))


def _objects(problem: SpaceProblem, z: Contacts, touching: Array) -> dict[str, Array]:
    """Fields of a state with several objects."""
    if len(problem.surface.objects) == 1:
        return {}
    return {"contact_object": jnp.where(touching, jax.vmap(problem.surface.object_of)(z[:, POINT]) + 1, 0)}


def _friction(
    problem: SpaceProblem, z: Contacts, base: SpaceBase, slips: Array, if_touching: Callable
) -> dict[str, Array]:
    """Fields of a state with friction."""
    normal = jax.vmap(problem.surface.normal)(z[:, POINT])
    push = base.force if base.push is None else base.push
    along = if_touching(push - z[:, FORCE, None] * normal) * problem.unit.force
    return {
        "slip": jnp.where(if_touching(slips.astype(int)) > 0, 1, 0),
        "normal_force": if_touching(z[:, FORCE]) * problem.unit.force,
        **{f"friction_{axis}": part for axis, part in zip("xyz", along.T, strict=True)},
    }


def _free_state(problem: SpaceProblem, control: Scalar) -> SpaceState:
    """State of free whiskers at a control, as if there were no object."""
    z = jnp.zeros((problem.length.size, UNKNOWNS)).at[:, AHEAD].set(np.array([1.0, 0.0, 0.0]))
    return signals(problem, z, control / problem.unit.control, jnp.full(z.shape[0], int(Phase.free))).state


free_state_now = Program(_free_state)
