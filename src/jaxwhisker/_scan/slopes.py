"""Programs of a scan, and the rules for their derivatives.

States depend on the numbers of the dimensionless problem, on the control of their own step and on what contacts with
friction remember there only: their slopes have one column for each of these, not for every step.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.program import Program
from jaxwhisker._base.slopes import along, along_each, are_few, direction_of, jacobian
from jaxwhisker._path.path import Path, Stops
from jaxwhisker._scan.events import events, public_nodes
from jaxwhisker._scan.mechanics import AnyProblem, Mechanics, Memory, Solutions
from jaxwhisker._scan.steps import solved_states, states


def _smooth(tree: Any) -> Any:
    return eqx.filter(tree, eqx.is_inexact_array)


def _of_one(remembered: Any) -> Any:
    """Zeros like the numbers that one row of this tree remembers."""
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape[1:]), _smooth(remembered))


def _shifted(remembered: Any, shift: Any) -> Any:
    """Rows that are all shifted alike: each state depends on one of them."""
    return eqx.combine(jax.tree.map(lambda leaf, by: leaf + by, _smooth(remembered), shift), remembered)


def state_slopes(
    mechanics: type[Mechanics],
    problem: AnyProblem,
    control: Float[Array, " steps"],
    solutions: Solutions,
    remembered: Any = None,
) -> Any:
    """Slopes of what `states` returns by the numbers of the problem and, last, those of the step.

    These are its control and what its contacts remember.
    """

    def function(numbers):
        numbers, moved, shift = numbers
        rows = _shifted(remembered, shift)
        return states(mechanics, eqx.combine(numbers, problem), control + moved, solutions, rows)

    return jacobian(function, (problem.numbers(), jnp.zeros(()), _of_one(remembered)))


def event_slopes(
    mechanics: type[Mechanics], problem: AnyProblem, path: Path, memory: Memory = None, room: int | None = None
) -> Any:
    """Slopes of all fields of the events by the numbers of the problem and, last, what their node remembers."""

    def function(numbers):
        numbers, shift = numbers
        return events(mechanics, eqx.combine(numbers, problem), path, _shifted(memory, shift), room)

    return jacobian(function, (problem.numbers(), _of_one(memory)))


def memory_slopes(mechanics: type[Mechanics], problem: AnyProblem, path: Path, stops: Stops) -> Memory:
    """Slopes of what contacts with friction remember, by the numbers of the problem, then by the stops."""

    def function(numbers):
        numbers, stops = numbers
        return mechanics.remember(eqx.combine(numbers, problem), path, stops)

    return jacobian(function, (problem.numbers(), stops))


def remember(mechanics: type[Mechanics], problem: AnyProblem, path: Path, stops: Stops) -> Memory:
    """What contacts with friction remember at the nodes of a path, with derivatives."""
    return mechanics.remember(problem, path, jnp.asarray(stops))


def _event_places(
    mechanics: type[Mechanics], problem: AnyProblem, path: Path, room: int | None = None
) -> Int[Array, " events"]:
    nodes = mechanics.event_nodes(problem, path)
    return public_nodes(nodes, path.count, mechanics.event_room(nodes.whiskers.shape[1]) if room is None else room)[1]


states_now = Program(states)  # differentiated in single directions
state_slopes_now = Program(state_slopes)
event_slopes_now = Program(event_slopes, quick=True)
memory_slopes_now = Program(memory_slopes, quick=True)
_event_places_now = Program(_event_places, frozen=True)


def _filled(tree: Any, dots: Any) -> Any:
    """Tangents of all numbers of a tree, with zeros where they are None; nothing else."""
    numbers = _smooth(tree)
    return jax.tree.unflatten(jax.tree.structure(numbers), direction_of(numbers, dots))


def state_tangents(args, args_dot, results):
    """The tangent rule of `solved_states`."""
    (mechanics, problem, path, control, _, memory), (_, problem_dot, _, control_dot, _, memory_dot) = args, args_dot
    numbers, (*_, solutions) = problem.numbers(), results
    none = jax.tree.map(lambda _: None, solutions)
    remembered = mechanics.remembered(memory, path, solutions)
    dots = mechanics.remembered(_filled(memory, memory_dot), path, solutions)
    dots = jax.tree.map(lambda leaf, dot: dot if eqx.is_inexact_array(leaf) else None, remembered, dots)
    if not are_few(numbers, mechanics.most_numbers):
        known = mechanics, problem, control, solutions, remembered
        return *states_now.along(known, (None, problem_dot, control_dot, none, dots)), none
    slopes = state_slopes_now(mechanics, problem, control, solutions, remembered)
    own = [*direction_of([control], [control_dot]), *jax.tree.leaves(dots)]
    return *along_each(slopes, direction_of(numbers, problem_dot.numbers()), own), none


def event_tangents(args, args_dot, _):
    """The tangent rule of `events`."""
    (mechanics, problem, path, memory, *room), (_, problem_dot, _, memory_dot, *_) = args, args_dot
    numbers = problem.numbers()
    if not are_few(numbers, mechanics.most_numbers) or mechanics.at_nodes(memory, None) is NotImplemented:
        return NotImplemented
    slopes = event_slopes_now(mechanics, problem, path, memory, *room)
    direction = direction_of(numbers, problem_dot.numbers())
    if memory is None:
        return along(slopes, direction)
    at = _event_places_now(mechanics, problem, path, *room)
    return along_each(slopes, direction, jax.tree.leaves(mechanics.at_nodes(_filled(memory, memory_dot), at)))


def memory_tangents(args, args_dot, _):
    """The tangent rule of `remember`."""
    (mechanics, problem, path, stops), (_, problem_dot, _, stops_dot) = args, args_dot
    numbers = problem.numbers()
    if not are_few(numbers, mechanics.most_numbers):
        return NotImplemented
    direction = direction_of((numbers, stops), (problem_dot.numbers(), stops_dot))
    return along(memory_slopes_now(mechanics, problem, path, stops), direction)


solved_states_now = Program(solved_states, tangent=state_tangents)
events_now = Program(events, tangent=event_tangents)
memory_now = Program(remember, tangent=memory_tangents)
