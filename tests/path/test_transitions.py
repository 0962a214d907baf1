"""Transitions of the march, with trials made by hand."""

import jax.numpy as jnp
import pytest

import jaxwhisker as jw
from exact_contacts import scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.solver import Solution
from jaxwhisker._path.march import _start
from jaxwhisker._path.march_state import Trial
from jaxwhisker._path.transitions import _is_over

SCENE = scene(jw.Support.fb(70.0))


@pytest.fixture(scope="module")
def problem():
    return Program(problem_of)(SCENE)


@pytest.fixture(scope="module")
def state(problem):
    """A state ahead of the object, whose drive moves towards -x."""
    return Program(_start)(problem, jnp.array([1.0, -1.0]))


def trial(end=None, tangent=None, stance=None, stable=True):
    """What these decisions see of a trial."""
    solution = Solution(end, None, jnp.asarray(True), jnp.asarray(1))  # pyright: ignore[reportArgumentType]
    yes = jnp.asarray(True)
    parts = solution, tangent, None, jnp.asarray(stable), yes, None, None, stance, jnp.ones(1), jnp.ones(1)
    return Trial(*parts)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("goal", "direction", "x", "at_stop", "over"),
    [
        (1, -1.0, -2.0, False, True),  # on the last leg, beyond the object
        (1, -1.0, -0.3, False, False),  # ... still before it
        (0, -1.0, -2.0, False, False),  # on the way to the first stop
        (1, 1.0, -2.0, False, False),  # on the way back, towards the object
        (2, -1.0, -0.3, True, True),  # at the last stop
        (1, -1.0, -0.3, True, False),  # at an earlier stop
    ],
)
def test_the_end_of_a_march(problem, state, goal, direction, x, at_stop, over):
    turned = state.state._replace(side=-jnp.ones(1))
    at = state._replace(goal=jnp.asarray(goal), direction=jnp.asarray(direction), state=turned)
    stance = problem.stance(0.0, jnp.array([[x]]))
    assert bool(_is_over(problem, at, trial(stance=stance), jnp.asarray(1), jnp.asarray(at_stop))) == over
