"""Shapes of whiskers in contact, and second contacts."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._scan.space import follow_path_now, problem_now
from jaxwhisker._space.problem import of_each
from jaxwhisker._space.shape import LOADED, UNLOADED, shape, touches_twice
from random_space import Cone

ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))
BASE = 1e-8  # error of the rod between contact and base
LENGTH = 1e-3  # chords are shorter than arcs


@pytest.mark.parametrize(
    ("whisker", "friction"),
    [
        (jw.Whisker(intrinsic_curvature=0.5), None),
        (jw.Whisker(lateral_curvature=0.3), 0.3),
        (jw.Whisker(), 0.3),
        (jw.Whisker(bending_stiffness=Cone(0.5)), 0.3),
    ],
    ids=["curved", "curved with friction", "straight with friction", "cone with friction"],
)
def test_the_shape_runs_from_the_contact_to_the_base_and_to_the_tip(whisker, friction):
    ball = jw.Sphere(1.0, (0.0, 1.3, 0.2))
    scene = jw.SpaceScene(whisker, ball, motion=ALONG, friction=friction)
    problem = problem_now(scene)
    path = follow_path_now(problem, np.array([-1.2, 0.0]), np.asarray(1)).path
    at = int(path.count) - 1
    z, phase = path.nodes.point.z[at], path.nodes.state.phase[at]
    line = np.asarray(of_each(problem, lambda *own: shape(problem, *own), z, phase))[0]
    assert line.shape == (LOADED + UNLOADED + 1, 3)
    np.testing.assert_allclose(line[0], z[0, 3:6], atol=1e-12)
    np.testing.assert_allclose(line[LOADED], 0.0, atol=BASE)  # the drive is at the origin
    pieces = np.linalg.norm(np.diff(np.concatenate([line[LOADED::-1], line[LOADED + 1 :]]), axis=0), axis=1)
    np.testing.assert_allclose(np.sum(pieces), 1.0, atol=LENGTH)
    assert not bool(touches_twice(problem, z, phase))


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
