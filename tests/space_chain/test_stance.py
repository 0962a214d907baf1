"""Stability and shape of whiskers in space with several contacts."""

import jax
import jax.numpy as jnp
import numpy as np

import pegs
from jaxwhisker._equilibrium.point import Point, at_control
from jaxwhisker._space_chain.newton import newton_step, plain
from jaxwhisker._space_chain.stance import sliding_stiffness, stance_of
from pegs_engine import PHASE, contacts, problem


@jax.jit
def stance(problem, z, phase):
    point = Point(z, jnp.asarray(pegs.CONTROL))
    step = newton_step(problem, phase, at_control(pegs.CONTROL, z), plain(z), point)
    return stance_of(problem, point, phase, step), sliding_stiffness(problem, z, phase, step)


def test_an_equilibrium_before_the_crests_of_pegs_is_stable():
    here, stiffness = stance(problem(), contacts(), PHASE)
    np.testing.assert_allclose(stiffness, stiffness.T, rtol=1e-6, atol=1e-6)
    # Along the pegs, which are flat there, and along the whisker.
    assert np.all(np.linalg.eigvalsh(stiffness) > 0)
    assert here.stable and here.opens and here.outside and here.sound
    assert np.all(here.candidates.distance > 0.01)


def test_free_whiskers_are_stable_and_see_the_pegs():
    here, stiffness = stance(problem(), jnp.zeros((2, 11)), jnp.zeros(2, int))
    np.testing.assert_array_equal(stiffness, np.eye(4))
    assert here.stable and here.opens
    # An upright whisker is inside the second peg here: distances of quadrics are to first order.
    away = np.array([0.64, 0.09])
    gaps = (away**2 - np.array([0.2, 0.12]) ** 2) / (2 * away)
    np.testing.assert_allclose(here.candidates.distance[0], [gaps[0], np.inf, gaps[1], np.inf], atol=1e-9)
