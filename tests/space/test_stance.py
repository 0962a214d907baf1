"""Stance: speeds and distances of free whiskers, contacts beyond the base."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._space.contact import SLACK, UNKNOWNS, Traction
from jaxwhisker._space.linear import linearise
from jaxwhisker._space.problem import of_each
from jaxwhisker._space.stance import bases_at_rest, stance_of

FREE = jnp.array([int(Phase.free)])
FORCES = Traction(None, jnp.asarray(True))  # tractions are forces


def free_stance(motion, u, length=1.0):
    """The stance of a free whisker, and its problem."""
    problem = dimensionless(jw.SpaceScene(jw.Whisker(length=length), jw.Sphere(0.3, (0.0, 0.7, 0.0)), motion=motion))
    point = Point(jnp.zeros((1, UNKNOWNS)).at[:, 6].set(1.0), jnp.asarray(u))
    drives = jax.jvp(problem.drive, (point.u,), (jnp.ones_like(point.u),))
    at = linear(problem, drives, point.z, FREE)
    return stance_of(problem, point, FREE, at, None), problem


def linear(problem, drives, z, phase):
    """All whiskers, linearised with tractions."""
    return of_each(problem, lambda body, z, phase: linearise(problem, body, drives, z, phase, FORCES), z, phase)


def test_the_speed_is_that_of_the_fastest_point():
    assert float(free_stance(jw.LinearDrive((-3.0, 4.0, 0.0)), -1.5)[0].speed) == pytest.approx(1.0)
    assert float(free_stance(jw.WhiskDrive(), -1.2)[0].speed) == pytest.approx(1.0)  # of the tip, a length per rad
    pivot = jw.RotaryDrive((0.0, 0.0, 1.0), pivot=(0.0, -0.5, 0.0))
    assert float(free_stance(pivot, -1.2)[0].speed) == pytest.approx(1.5)


def test_a_free_whisker_is_stable_and_as_far_from_the_object_as_it_is():
    stance, _ = free_stance(jw.LinearDrive((-1.0, 0.0, 0.0)), -0.5)
    assert bool(stance.stable) and bool(stance.opens) and bool(stance.sound)
    np.testing.assert_allclose(stance.nearest.distance, [(0.5**2 - 0.3**2) / (2 * 0.5)], atol=1e-9)


def test_bases_at_rest_are_on_their_mounts_and_at_the_rest_lengths():
    drive = jw.LinearDrive((3.0, 0.0, 4.0), origin=(0.0, 0.1, 0.0))
    ball = jw.Sphere(0.3, (0.0, 0.7, 0.0))
    problem = dimensionless(jw.SpaceScene(jw.Whisker(), ball, jw.Support.fbfb(9.0, 0.2), motion=drive))
    expected = [[0.3 + 0.2, 0.1, 0.4], [0.3 + 0.4, 0.1, 0.4]]
    np.testing.assert_allclose(bases_at_rest(problem, jnp.asarray(0.5)).position, expected, atol=1e-12)


def test_a_contact_beyond_the_base_is_not_sound():
    _, problem = free_stance(jw.LinearDrive((-1.0, 0.0, 0.0)), -0.5)
    drives = jax.jvp(problem.drive, (jnp.asarray(-0.5),), (jnp.ones(()),))
    z = jnp.array([[0.5, 0.0, 0.3, 0.3, 0.7, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])

    def own(slack):
        return float(linear(problem, drives, z.at[0, SLACK].set(slack), jnp.array([int(Phase.tangential)])).own[0])

    assert np.isfinite(own(0.3))
    assert own(1.1) == np.inf
