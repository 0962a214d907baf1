"""The mechanics of scans in the plane."""

from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.primitive import LANES
from jaxwhisker._base.program import Program
from jaxwhisker._base.slopes import by_slopes
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact_state import ContactState, Places
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.implicit import solved
from jaxwhisker._equilibrium.point import Contacts, Point, at_control
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.solver import solve_points
from jaxwhisker._equilibrium.stability import is_stable
from jaxwhisker._model.canonical import canonical
from jaxwhisker._model.scene import Scene, moves_along_x
from jaxwhisker._path.march import follow, sweeps_of
from jaxwhisker._path.path import Last, Node, Path, ScanPath, Status, Stops, event_room
from jaxwhisker._plane.continuation import ContinuationInPlane
from jaxwhisker._scan.blocks import BLOCK
from jaxwhisker._scan.detect import Kinds, detect, kinds_of
from jaxwhisker._scan.mechanics import EventSides, Mechanics, Solutions
from jaxwhisker._scan.memory import Memory, after_event, memory_of, remembered
from jaxwhisker._scan.resolution import warn_of_steps
from jaxwhisker._scan.result import Events, Result
from jaxwhisker._scan.signals import control_at_event, nodes_at, sides_of_events, signals
from jaxwhisker._scan.slopes import memory_now
from jaxwhisker._scan.springs import bases_of, lengths_along_x, spring_lengths, spring_tangents, suspension
from jaxwhisker._scan.state import State
from jaxwhisker._scan.steps import BATCH, interpolate, is_near


def follow_path(problem: Problem, stops: Stops, last: Last, sweeps: int | None = None) -> ScanPath:
    """March to all stops, given in the scene's units; right across the object if the first one is NaN.

    There is room for the nodes of so many `sweeps` past the object; by default, of one for each stop. A path has no
    derivatives: they are attached to what is computed from it.
    """
    problem, stops = jax.lax.stop_gradient((problem, jnp.asarray(stops)))
    return follow(ContinuationInPlane(problem), stops, last, sweeps)


def path_through(problem: Problem, kinds: Kinds, stops: Any, last: Any) -> ScanPath:
    """The path to all stops, which ends where a contact of these kinds begins."""
    found = follow_path_now(problem, stops, last, *sweeps_of(last))
    return found._replace(path=detect_now(problem, found.path, kinds)) if kinds else found


def problem_now(scene: Scene) -> Problem:
    """The dimensionless problem of a scene, by a program that all scenes of one canonical form share."""
    return canonical_problem_now(canonical(scene))


canonical_problem_now = Program(problem_of, tangent=by_slopes(problem_of))
follow_path_now = Program(follow_path, frozen=True, together=LANES)
detect_now = Program(detect, frozen=True, together=LANES)
spring_lengths_now = Program(spring_lengths, tangent=spring_tangents)


class InThePlane(Mechanics):
    """Whiskers in the plane."""

    most_numbers, block, result, events, follows = 64, BLOCK, Result, Events, follow_path_now
    problem = staticmethod(problem_now)
    event_room = staticmethod(event_room)

    @staticmethod
    def check(scene: Scene, problem: Problem) -> None:
        check_valid(scene, problem)
        warn_of_steps(scene, masses=scene.gravity is not None)

    @staticmethod
    def detected(scene: Scene, problem: Problem, path: Path) -> Path:
        return detect_now(problem, path, kinds) if (kinds := kinds_of(scene)) else path

    @staticmethod
    def prepare(pool: Executor, scene: Scene, problem: Problem, stops: int) -> tuple[Path, Memory | None]:
        path = follow_path_now.prepare(pool, problem, np.zeros(stops), np.asarray(0)).path
        if kinds := kinds_of(scene):
            detect_now.prepare(pool, problem, path, kinds)
        return path, jax.eval_shape(memory_of, path)

    @classmethod
    def memory(cls, problem: Problem, path: Path, stops: Any) -> Memory | None:
        if problem.friction_angle is None or not checks.is_traced((problem, stops)):
            return memory_of(path)
        return memory_now(cls, problem, path, stops)

    @staticmethod
    def remember(problem: Problem, path: Path, stops: Stops) -> Memory:
        return remembered(after_event, problem, path, stops)

    @staticmethod
    def remembered(memory: Memory | None, path: Path | None, solutions: Solutions) -> Places | None:
        """The places where contacts stick, fields (steps, whiskers)."""
        return None if memory is None else jax.tree.map(lambda leaf: leaf[solutions.node], memory.places)

    @staticmethod
    def solve(problem, path, index, u, known) -> Solutions:
        state = jax.tree.map(lambda leaf: leaf[index], path.nodes.state)
        guess = jax.vmap(lambda index, u: interpolate(path, index, u))(index, u)
        solution = solve_points(problem, state, jax.vmap(at_control)(u, guess.z), guess)
        z = solution.point.z
        stable = jax.vmap(lambda *own: is_stable(problem, *own))(state, solution.newton.condensed)
        good = solution.converged & is_near(z, guess.z)
        status = jnp.where(good, jnp.where(stable, Status.ok, Status.unstable), Status.inexact)
        status = jnp.where(known == Status.ok, status, known)
        accepted = (status == Status.ok)[:, None]
        # Rejected steps are replaced by free whiskers, with finite values and derivatives (see `safe_placeholder`).
        state = state.ended(~accepted & jnp.ones_like(state.free))
        z = jnp.where(accepted[:, None], z, problem.unloaded(jnp.zeros(()))[0])
        return Solutions(z, state, status, index)

    @staticmethod
    def states(problem, u, solutions, remembered) -> tuple[State, Float[Array, " steps"], None]:
        def point(u: Scalar, z: Contacts, state: ContactState) -> Point:
            return solved(Point(z, jax.lax.stop_gradient(u)), problem, state, at_control(u, z))

        state = solutions.state if remembered is None else solutions.state.stuck_at(remembered)
        # This is outside the loop: a loop that is differentiated backwards drops the rules for second derivatives.
        points = jax.vmap(point)(u, solutions.z, state)
        batch = min(BATCH, u.shape[0])
        values, residual, _ = jax.lax.map(
            lambda one: signals(problem, one[0].z, one[0].u, one[1]), (points, state), batch_size=batch
        )
        return values, residual, None

    @staticmethod
    def checked(problem, solutions, status):
        return status

    @staticmethod
    def lengths(scene: Scene, state: State, displacement: None, control: Any) -> Float[Array, "steps springs"]:
        return spring_lengths_now(suspension(scene), bases_of(scene, state), control)

    @staticmethod
    def differences(scene: Scene) -> Callable | None:
        if not moves_along_x(scene):
            return None
        return lambda state, control: lengths_along_x(scene.support, np.asarray(state.base_x), np.asarray(control))

    @staticmethod
    def signals(problem, *side):
        return signals(problem, *side)

    @staticmethod
    def event_nodes(problem: Problem, path: Path) -> Node:
        return path.nodes

    @staticmethod
    def at_events(problem, path, memory, at, filled) -> EventSides:
        return sides_of_events(problem, path if memory is None else memory.on(path), at, filled)

    @staticmethod
    def event_controls(problem, path, memory, at, filled):
        path = path if memory is None else memory.on(path)
        node, previous = nodes_at(path, at, filled)
        control, before = jax.vmap(partial(control_at_event, problem))(node, previous)
        return control, before.touches & node.state.free

    @staticmethod
    def at_nodes(memory: Memory | None, at: Any) -> Any:
        return None if memory is None else NotImplemented


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
