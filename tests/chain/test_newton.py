"""The equations of whiskers with several contacts at stored exact states, and Newton's method."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._chain.newton import newton_step, residuals, solve_points
from jaxwhisker._equilibrium.point import Point, at_control
from several_engine import STORED, problem, with_contacts

AWAY = 1e-3  # of a guess; the force next to a release is 0.2
STEP = 1e-6  # of central differences
TANGENT = 1e-7  # of the tangent, by central differences


def test_stored_states_solve_the_equations():
    for count in (1, 2):
        u, z, state = with_contacts(count)
        residual, at = jax.jit(residuals)(problem(), z, u, state)
        assert np.max(np.abs(residual)) < 10 * STORED  # by sine of angle: curvatures are up to 30
        assert not bool(jnp.any(at.backwards))
        changed, _ = jax.jit(residuals)(problem(), z.at[0, 0].add(AWAY), u, state)
        assert np.max(np.abs(changed)) > 1e-6


def test_newton_finds_stored_states_from_nearby():
    u, z, state = with_contacts(2)
    guess = Point(z.at[:2].add(AWAY * jnp.array([[1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])), u)
    found = jax.jit(solve_points)(problem(), state, at_control(u, guess.z), guess)
    assert bool(found.converged)
    np.testing.assert_allclose(found.point.z, z, atol=3 * STORED)


def test_the_tangent_is_the_derivative_by_the_control():
    u, z, state = with_contacts(2)
    solve = jax.jit(solve_points)
    ends = [
        solve(problem(), state, at_control(u + sign * STEP, z), Point(z, u + sign * STEP)).point for sign in (1, -1)
    ]
    step = jax.jit(newton_step)(problem(), state, at_control(u, z), Point(z, u))
    slope = (ends[0].z - ends[1].z) / (2 * STEP)
    np.testing.assert_allclose(step.tangent.z, slope, rtol=TANGENT, atol=TANGENT * np.max(np.abs(slope)))
    assert float(step.tangent.u) == 1.0
    np.testing.assert_allclose(step.tangent_pose, 0.0, atol=1e-12)  # in the drive's frame, a clamped base does not move
