"""Tangent rules of the programs of a scan in space, as those in slopes.py.

With friction, states depend on all nodes of the path before them, and JAX differentiates them.
"""

import equinox as eqx
from jax import numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.program import Program
from jaxwhisker._base.slopes import along, along_each, are_few, direction_of, jacobian
from jaxwhisker._scan.space_result import SpaceEvents
from jaxwhisker._scan.space_signals import events
from jaxwhisker._scan.space_steps import SpaceSolutions, states
from jaxwhisker._space.march_state import SpacePath
from jaxwhisker._space.problem import SpaceProblem

MOST_NUMBERS = 96  # a curved whisker on springs past a quadric has 82


def state_slopes(problem: SpaceProblem, control: Float[Array, " steps"], solutions: SpaceSolutions):
    """Slopes of all fields with respect to the numbers of the problem and, last, to the control of the step."""

    def function(numbers):
        numbers, moved = numbers
        return states(eqx.combine(numbers, problem), control + moved, solutions)

    return jacobian(function, (problem.numbers(), jnp.zeros(())))


def event_slopes(problem: SpaceProblem, path: SpacePath) -> SpaceEvents:
    """Slopes of all fields of the events with respect to the numbers of the problem."""
    return jacobian(lambda numbers: events(eqx.combine(numbers, problem), path), problem.numbers())


state_slopes_now, event_slopes_now = Program(state_slopes), Program(event_slopes, quick=True)


def state_tangents(args, args_dot):
    """The tangent rule of `states`."""
    (problem, control, solutions, *_), (problem_dot, control_dot, *_) = args, args_dot
    numbers = problem.numbers()
    if not are_few(numbers, MOST_NUMBERS) or problem.friction is not None:
        return NotImplemented
    slopes = state_slopes_now(problem, control, solutions)
    return along_each(slopes, direction_of(numbers, problem_dot.numbers()), direction_of([control], [control_dot]))


def event_tangents(args, args_dot):
    """The tangent rule of `events`."""
    problem, path, *_ = args
    numbers = problem.numbers()
    if not are_few(numbers, MOST_NUMBERS) or problem.friction is not None:
        return NotImplemented
    return along(event_slopes_now(problem, path), direction_of(numbers, args_dot[0].numbers()))
