"""Derivatives of states and events: one program each for all transformations outside of a jit.

A program computes the derivatives of all fields with respect to every number of the dimensionless problem that states
depend on, and to the control of the step. Tangents are linear combinations of them, so jvp, grad and their batches need
nothing else to be compiled.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._path.path import Path
from jaxwhisker._scan.result import Events
from jaxwhisker._scan.signals import events
from jaxwhisker._scan.state import State
from jaxwhisker._scan.steps import Solutions, states


def slopes(problem: Problem, control: Float[Array, " steps"], solutions: Solutions) -> State:
    """Derivatives of all fields: the last axis runs over the numbers of the problem and the control of the step."""
    numbers, rebuilt = ravel_pytree(problem.numbers())

    def smooth(numbers, control):
        state, _ = states(eqx.combine(rebuilt(numbers), problem), control, solutions)
        return eqx.filter(state, eqx.is_inexact_array)

    def towards(direction):
        dots = direction[:-1], jnp.full_like(control, direction[-1])
        return jax.jvp(smooth, (numbers, control), dots)[1]

    return jax.vmap(towards, out_axes=-1)(jnp.eye(numbers.size + 1))


def event_slopes(problem: Problem, path: Path) -> Events:
    """Derivatives of all fields of the events: the last axis runs over the numbers of the problem."""
    numbers, rebuilt = ravel_pytree(problem.numbers())

    def smooth(numbers):
        return eqx.filter(events(eqx.combine(rebuilt(numbers), problem), path), eqx.is_inexact_array)

    return jax.vmap(lambda direction: jax.jvp(smooth, (numbers,), (direction,))[1], out_axes=-1)(jnp.eye(numbers.size))


slopes_now, event_slopes_now = Program(slopes), Program(event_slopes, quick=True)


@jax.jit
def _along(slopes: Any, direction: list, control_dot: Float[Array, " steps"] | None) -> Any:
    """Tangents for directions of the problem's numbers and of the control."""
    flat = jnp.concatenate([jnp.ravel(leaf) for leaf in direction])

    def along(slope):
        by_numbers = slope[..., : flat.size] @ flat
        return by_numbers if control_dot is None else by_numbers + slope[..., -1] * control_dot[:, None]

    return jax.tree.map(along, slopes)


def _direction(problem: Problem, problem_dot: Problem) -> list:
    """Tangents of the problem's numbers."""
    leaves, structure = jax.tree.flatten(problem.numbers())
    dots = structure.flatten_up_to(problem_dot.numbers())
    return [jnp.zeros(leaf.shape) if dot is None else dot for leaf, dot in zip(leaves, dots, strict=True)]


def state_tangents(args, args_dot) -> tuple[State, None]:
    """The tangent rule of `states`."""
    problem, control, solutions = args
    problem_dot, control_dot, _ = args_dot
    return _along(slopes_now(problem, control, solutions), _direction(problem, problem_dot), control_dot), None


def event_tangents(args, args_dot) -> Events:
    """The tangent rule of `events`."""
    problem, path = args
    return _along(event_slopes_now(problem, path), _direction(problem, args_dot[0]), None)
