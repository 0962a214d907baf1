"""Tangent rules of the programs of a scan in space, as those in slopes.py.

With friction, the nodes of a path follow from each other: `linked` has slopes of its own. A state then depends on the
numbers of the problem, its control, and the start and the stages of the step of the path within which it lies.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.program import Program
from jaxwhisker._base.slopes import along, along_each, are_few, direction_of, jacobian
from jaxwhisker._scan.space_result import SpaceEvents
from jaxwhisker._scan.space_signals import events, public_nodes
from jaxwhisker._scan.space_steps import SpaceSolutions, states
from jaxwhisker._space.history import Linked, linked
from jaxwhisker._space.march_state import SpacePath
from jaxwhisker._space.problem import SpaceProblem

MOST_NUMBERS = 96  # a curved whisker on springs past a quadric has 82


def state_slopes(
    problem: SpaceProblem,
    control: Float[Array, " steps"],
    solutions: SpaceSolutions,
    path: SpacePath | None = None,
    links: Linked | None = None,
):
    """Slopes of all fields with respect to the numbers of the problem and, last, those of the step.

    These are its control and, with friction, the node before it and the stages that end at the next one.
    """

    def function(numbers):
        numbers, moved, shift = numbers
        return states(eqx.combine(numbers, problem), control + moved, solutions, path, _shifted(links, shift))

    return jacobian(function, (problem.numbers(), jnp.zeros(()), _of_one(links)))


def event_slopes(
    problem: SpaceProblem, path: SpacePath, links: Linked | None = None, room: int | None = None
) -> SpaceEvents:
    """Slopes of all fields of the events with respect to the numbers of the problem and, last, those of their node."""

    def function(numbers):
        numbers, shift = numbers
        return events(eqx.combine(numbers, problem), path, _shifted(links, shift), room)

    return jacobian(function, (problem.numbers(), _of_one(links)))


def chain_slopes(problem: SpaceProblem, path: SpacePath, stops: Float[Array, " stops"]) -> Linked:
    """Slopes of the nodes of a path with friction with respect to the numbers of the problem, then to the stops."""

    def function(numbers):
        numbers, stops = numbers
        return linked(eqx.combine(numbers, problem), path, stops)

    return jacobian(function, (problem.numbers(), stops))


states_now = Program(states)  # differentiated in single directions
state_slopes_now, chain_slopes_now = Program(state_slopes), Program(chain_slopes)
event_slopes_now = Program(event_slopes, quick=True)


def state_tangents(args, args_dot, results):
    """The tangent rule of `solved_states`."""
    (problem, path, control, _, links), (problem_dot, _, control_dot, _, links_dot) = args, args_dot
    numbers, own, (*_, solutions) = problem.numbers(), direction_of([control], [control_dot]), results
    none, used = jax.tree.map(lambda _: None, solutions), None if links is None else path
    if not are_few(numbers, MOST_NUMBERS):
        dots = problem_dot, control_dot, none, jax.tree.map(lambda _: None, used), links_dot
        return *states_now.along((problem, control, solutions, used, links), dots), none
    slopes = state_slopes_now(problem, control, solutions, used, links)
    if links is not None:
        node = solutions.node
        own += _at(links, links_dot, node, jnp.minimum(node + 1, path.count - 1))
    return *along_each(slopes, direction_of(numbers, problem_dot.numbers()), own), none


def event_tangents(args, args_dot, _):
    """The tangent rule of `events`."""
    (problem, path, links, *room), (problem_dot, _, links_dot, *_) = args, args_dot
    numbers = problem.numbers()
    if not are_few(numbers, MOST_NUMBERS):
        return NotImplemented
    slopes, direction = event_slopes_now(problem, path, links, *room), direction_of(numbers, problem_dot.numbers())
    if links is None:
        return along(slopes, direction)
    at = _places_now(path, *room)
    return along_each(slopes, direction, _at(links, links_dot, at, at))


def linked_tangents(args, args_dot, _):
    """The tangent rule of `linked`."""
    (problem, path, stops), (problem_dot, _, stops_dot) = args, args_dot
    numbers = problem.numbers()
    if not are_few(numbers, MOST_NUMBERS):
        return NotImplemented
    direction = direction_of((numbers, stops), (problem_dot.numbers(), stops_dot))
    return along(chain_slopes_now(problem, path, stops), direction)


def _of_one(links: Linked | None) -> Linked | None:
    """Zeros like the numbers of one node."""
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape[1:]), links)


def _shifted(links: Linked | None, shift: Linked | None) -> Linked | None:
    """Nodes that are all shifted alike: each state depends on one of them and on the stages of one."""
    return jax.tree.map(jnp.add, links, shift)


def _at(links: Linked, dots: Linked, node: Int[Array, " places"], end: Int[Array, " places"]) -> list:
    """Tangents of these nodes, and of the stages that end at others, in the order of the numbers of a node."""
    point, stages = jax.tree.unflatten(jax.tree.structure(links), direction_of(links, dots))
    return [leaf[node] for leaf in point] + [leaf[end] for leaf in stages]


def _places(path: SpacePath, room: int | None = None) -> Int[Array, " events"]:
    return public_nodes(path, True, room)[2]


_places_now = Program(_places, frozen=True)
