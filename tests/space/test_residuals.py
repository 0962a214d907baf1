"""Residuals of the equations: they vanish in equilibrium, and tell what is wrong elsewhere."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, at_control
from jaxwhisker._space.contact import TRACTION
from jaxwhisker._space.newton import plain, solve_points
from jaxwhisker._space.residuals import residuals

SOLVED = 1e-9
TIP, FREE = (jnp.array([int(phase)]) for phase in (Phase.tip, Phase.free))
U = jnp.asarray(-0.8)
GUESS = jnp.array([[0.45, 0.0, -0.3, 0.95, 0.987, 0.0, 0.313, 0.9497, 0.0, 0.0, 0.0]])


def test_they_vanish_in_equilibrium():
    scene = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.0)), motion=jw.LinearDrive((-1, 0, 0)))
    problem = dimensionless(scene)
    found = solve_points(problem, plain(TIP, at_control(U, GUESS)), Point(GUESS[None], U[None]))
    assert bool(found.converged)
    own, pose, base = residuals(problem, found.end.z, U, TIP, GUESS)
    np.testing.assert_allclose(own, 0, atol=SOLVED)
    np.testing.assert_allclose(pose, 0, atol=SOLVED)  # a clamped base
    np.testing.assert_allclose(base.position[0], [0.8, 0.0, 0.0], atol=SOLVED)
    off, _, _ = residuals(problem, found.end.z.at[0, 3].add(1e-3), U, TIP, GUESS)
    assert np.max(np.abs(off)) > 1e-4


def test_free_whiskers_have_given_values_and_tractions_are_the_last_residuals():
    scene = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.0)), friction=0.2)
    problem = dimensionless(scene)
    own, _, _ = residuals(problem, GUESS + 0.25, U, FREE, GUESS)
    np.testing.assert_allclose(own, 0.25)
    own, _, _ = residuals(problem, GUESS.at[0, TRACTION].set(jnp.array([0.6, -0.8])), U, TIP, GUESS)
    np.testing.assert_allclose(own[0, TRACTION], [0.6, -0.8])
