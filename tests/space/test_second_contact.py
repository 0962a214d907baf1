"""Whiskers that touch an object in a second place."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._scan.space import problem_now
from jaxwhisker._space.second_contact import touches_twice

ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))


@pytest.mark.parametrize(("roll", "twice"), [(0.0, False), (np.pi, True)])
def test_a_shaft_that_curves_around_the_object_is_inside_it(roll, twice):
    """An arc of radius 1/1.5 that touches a sphere of radius 1 with its middle, from outside on either side."""
    problem = problem_now(
        jw.SpaceScene(jw.Whisker(intrinsic_curvature=1.5), jw.Sphere(1.0, (0.0, 1.0, 0.0)), motion=ALONG)
    )
    at_lowest_point = jnp.array([0.0, roll, 0.5, *(0.0, 0.0, 0.0), *(1.0, 0.0, 0.0), 0.0, 0.0])
    assert bool(touches_twice(problem, at_lowest_point[None], jnp.array([int(jw.Phase.tangential)]))) == twice


def test_straight_whiskers_touch_once():
    problem = problem_now(jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), motion=ALONG))
    assert not bool(touches_twice(problem, jnp.zeros((1, 11)), jnp.array([1])))


@pytest.mark.parametrize(("pull", "twice"), [(0.0, False), (1.0, True), (-1.0, False)])
def test_friction_may_wind_a_straight_whisker_back_to_the_object(pull, twice):
    """A tip on top of a ball, at an angle of 0.3: strong friction that pulls it on bends the shaft into a loop."""
    problem = problem_now(jw.SpaceScene(jw.Whisker(), jw.Sphere(2.0, (0.0, 0.0, 0.0)), motion=ALONG, friction=5.0))
    tip = jnp.array([6.0, 0.0, -0.3, *(0.0, 2.0, 0.0), *(1.0, 0.0, 0.0), pull, 0.0])
    assert bool(touches_twice(problem, tip[None], jnp.array([int(jw.Phase.tip)]))) == twice
