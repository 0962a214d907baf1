"""The solver: several points in one loop, and how accurate contacts that stick must be."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from engine import dimensionless
from exact_contacts import contacts, fbfb_at
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import FORCE, LEAN
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.friction import Friction
from jaxwhisker._equilibrium.point import Point, at_control, scale_of
from jaxwhisker._equilibrium.solver import FINER, SMALL, SMALLEST, StructuredNewton, _of_sticking, solve_points

EXACT = 1e-9  # of solved contacts, in their scale
PAIR = 1.3, 0.4  # parameters of exact contacts of two whiskers, in equilibrium at control 0


@pytest.fixture(scope="module")
def solved():
    """Solutions from a near guess, beyond every equilibrium, from the solution itself, and at no control."""
    at, problem = contacts(*PAIR), dimensionless(fbfb_at(*PAIR))
    z, size = jnp.asarray(at.z), np.array([1.0, 1.0, 0.0, 1.0])
    off = 1e-3 * scale_of(z) * np.random.default_rng(0).uniform(-1, 1, z.shape)
    guesses = Point(z + size[:, None, None] * off, jnp.array([0.0, 0.0, 0.0, jnp.nan]))

    @Program
    def found(problem, guesses, u):
        states = ContactState(jnp.tile(at.phase, (4, 1)), jnp.ones((4, 2)))
        conditions = jax.vmap(at_control, in_axes=(0, None))(u, z)
        return solve_points(problem, states, conditions, guesses)

    return z, found(problem, guesses, jnp.array([0.0, -6.0, 0.0, jnp.nan]))


def test_points_are_solved_for_together_and_fail_alone(solved):
    z, solutions = solved
    assert solutions.converged.tolist() == [True, False, True, False]
    for lane in (0, 2):
        assert np.max(np.abs(solutions.point.z[lane] - z) / scale_of(z)) < EXACT
        assert np.all(np.isfinite(solutions.newton.load[lane]))


def test_contacts_that_stick_must_be_more_accurate():
    forces = np.array([20.0, 0.5, 0.5e-3, 1e-9])
    z, changes = jnp.zeros((4, 3)).at[:, FORCE].set(forces), jnp.ones((4, 3))
    friction = Friction(jnp.zeros(4, int), jnp.zeros(4), jnp.zeros(4))
    state = ContactState(jnp.full(4, 2), jnp.ones(4), friction)
    # Next to a small force, the other unknowns; next to a large one, the lean.
    others, leans = [1.0, 1.0, 2.0, SMALL / SMALLEST], [FINER, FINER / 2, 1.0, 1.0]
    weighted = Program(_of_sticking)(changes, z, (None, state))
    assert LEAN == 1
    np.testing.assert_allclose(weighted, np.stack([others, leans, others], axis=1))
    slips = state._replace(friction=friction._replace(slip=jnp.ones(4, int)))
    np.testing.assert_array_equal(Program(_of_sticking)(changes, z, (None, slips)), changes)


@pytest.mark.parametrize(("both", "steps"), [(False, 1), (True, 2)])
def test_residuals_before_a_short_step_must_be_small_too_if_asked(both, steps):
    stiff, near = 1e3, 1e-7  # a change of the unknowns changes the residual by so much more

    def equations(point, _):
        step = Point(-point.z, -point.u)
        return stiff * jnp.max(jnp.abs(point.z)), SimpleNamespace(step=step)

    guess = Point(jnp.full((1, 3), near), jnp.zeros(()))
    solver = StructuredNewton(0.0, 1e-6, with_residuals=both)
    state, count = solver.init(equations, guess, None, {}, None, None, frozenset()), 0
    while not bool(solver.terminate(equations, guess, None, {}, state, frozenset())[0]):
        guess, state, _ = solver.step(equations, guess, None, {}, state, frozenset())
        count += 1
    assert count == steps and np.all(guess.z == 0)
