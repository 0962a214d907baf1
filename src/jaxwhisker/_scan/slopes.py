"""Tangent rules of the programs of a scan.

States depend on the numbers of the dimensionless problem and on the control of their own step only, and spring lengths
on the bases of their step: their slopes have one column for each of these, not for every step.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.program import Program
from jaxwhisker._base.slopes import along, along_each, are_few, direction_of, jacobian
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._path.path import Path
from jaxwhisker._scan.memory import chained, with_memory
from jaxwhisker._scan.result import Events
from jaxwhisker._scan.signals import events
from jaxwhisker._scan.springs import Bases, Suspension, spring_length
from jaxwhisker._scan.state import State
from jaxwhisker._scan.steps import Solutions, states, with_places


def state_slopes(problem: Problem, control: Float[Array, " steps"], solutions: Solutions) -> State:
    """Slopes of all fields with respect to the numbers of the problem and, last, those of the step.

    These are its control and, with friction, the places where its contacts stick.
    """
    known = solutions.state.places

    def function(numbers):
        numbers, moved, shifted = numbers
        steps = solutions
        if known is not None:
            places = jax.tree.map(lambda place, shift: place + shift, known, shifted)
            steps = solutions._replace(state=solutions.state.stuck_at(places))
        return states(eqx.combine(numbers, problem), control + moved, steps)[0]

    still = jax.tree.map(lambda place: jnp.zeros(place.shape[1:]), known)
    return jacobian(function, (problem.numbers(), jnp.zeros(()), still))


def chain_slopes(path: Path, problem: Problem, stops: Float[Array, " stops"]):
    """Slopes of what contacts with friction remember: with respect to the numbers of the problem, then to the stops."""

    def function(numbers):
        numbers, stops = numbers
        return chained(path, eqx.combine(numbers, problem), stops)

    return jacobian(function, (problem.numbers(), stops))


def event_slopes(problem: Problem, path: Path, room: int | None = None) -> Events:
    """Slopes of all fields of the events with respect to the numbers of the problem."""
    return jacobian(lambda numbers: events(eqx.combine(numbers, problem), path, room), problem.numbers())


def spring_slopes(
    scene: Suspension, bases: Bases, control: Float[Array, " steps"]
) -> Float[Array, "steps springs numbers"]:
    """Slopes with respect to the numbers of the scene, then those of the step: x, y, angle of all bases, control."""

    def at(base, u):
        def function(numbers):
            numbers, base, u = numbers
            return spring_length(eqx.combine(numbers, scene), base, u)

        return jacobian(function, (eqx.filter(scene, eqx.is_inexact_array), base, u))

    return jax.vmap(at)(bases, control)


states_now = Program(states)  # differentiated in single directions
state_slopes_now, spring_slopes_now = Program(state_slopes), Program(spring_slopes)
event_slopes_now, chain_slopes_now = Program(event_slopes, quick=True), Program(chain_slopes, quick=True)


def state_tangents(args, args_dot, results):
    """The tangent rule of `solved_states`."""
    (problem, path, control, _), (problem_dot, path_dot, control_dot, _) = args, args_dot
    numbers, (*_, solutions) = problem.numbers(), results
    none, at = jax.tree.map(lambda _: None, solutions), solutions.node
    solutions = with_places(solutions, path.nodes.state.places)
    places, dots = solutions.state.places or (), path_dot.nodes.state.places or ()
    dots = [None if dot is None else dot[at] for dot in dots]
    if not are_few(numbers):
        solutions_dot = none._replace(state=none.state.stuck_at(tuple(dots) if places else None))
        return *states_now.along((problem, control, solutions), (problem_dot, control_dot, solutions_dot)), none
    slopes, direction = state_slopes_now(problem, control, solutions), direction_of(numbers, problem_dot.numbers())
    return along_each(slopes, direction, direction_of([control, *places], [control_dot, *dots])), None, none


def remembered_tangents(args, args_dot, _):
    """The tangent rule of `remembered`."""
    path, problem, stops = args
    _, problem_dot, stops_dot = args_dot
    numbers = problem.numbers()
    if not are_few(numbers):
        return NotImplemented
    direction = direction_of((numbers, stops), (problem_dot.numbers(), stops_dot))
    none = jax.tree.map(lambda _: None, path)
    return with_memory(none, *along(chain_slopes_now(path, problem, stops), direction))


def spring_tangents(args, args_dot, _):
    """The tangent rule of `spring_lengths`."""
    scene, bases, control = args
    scene_dot, bases_dot, control_dot = args_dot
    numbers = eqx.filter(scene, eqx.is_inexact_array)
    if not are_few(numbers):
        return NotImplemented
    own = direction_of([*bases, control], [*bases_dot, control_dot])
    return along_each(spring_slopes_now(scene, bases, control), direction_of(numbers, scene_dot), own)


def event_tangents(args, args_dot, _):
    """The tangent rule of `events`."""
    problem, path, *room = args
    numbers = problem.numbers()
    if not are_few(numbers) or problem.friction_angle is not None:
        return NotImplemented
    return along(event_slopes_now(problem, path, *room), direction_of(numbers, args_dot[0].numbers()))
