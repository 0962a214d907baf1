"""Shapes of curved whiskers in contact, and second contacts."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._scan.space_scan import follow_path_now, problem_now
from jaxwhisker._space.problem import of_each
from jaxwhisker._space.shape import LOADED, UNLOADED, curved_shape, touches_twice

ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))
BASE = 1e-8  # error of the rod between contact and base
LENGTH = 1e-3  # chords are shorter than arcs


def test_the_shape_runs_from_the_contact_to_the_base_and_to_the_tip():
    scene = jw.SpaceScene(jw.Whisker(intrinsic_curvature=0.5), jw.Sphere(1.0, (0.0, 1.3, 0.2)), motion=ALONG)
    problem = problem_now(scene)
    path = follow_path_now(problem, np.array([-1.2, 0.0]), np.asarray(1)).path
    at = int(path.count) - 1
    z, phase = path.nodes.point.z[at], path.nodes.phase[at]
    shape = np.asarray(of_each(problem, lambda *own: curved_shape(problem, *own), z, phase))[0]
    assert shape.shape == (LOADED + UNLOADED + 1, 3)
    np.testing.assert_allclose(shape[0], z[0, 3:6], atol=1e-12)
    np.testing.assert_allclose(shape[LOADED], 0.0, atol=BASE)  # the drive is at the origin
    pieces = np.linalg.norm(np.diff(np.concatenate([shape[LOADED::-1], shape[LOADED + 1 :]]), axis=0), axis=1)
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
