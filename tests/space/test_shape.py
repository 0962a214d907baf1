"""Shapes of whiskers in contact."""

import jax
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._scan.space import follow_path_now, problem_now
from jaxwhisker._space.problem import of_each
from jaxwhisker._space.second_contact import touches_twice
from jaxwhisker._space.shape import LOADED, UNLOADED, shape
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
    line = jax.tree.map(lambda leaf: np.asarray(leaf)[0], of_each(problem, lambda *own: shape(problem, *own), z, phase))
    assert line.position.shape == line.tangent.shape == (LOADED + UNLOADED + 1, 3)
    np.testing.assert_allclose(line.position[LOADED], z[0, 3:6], atol=1e-12)
    np.testing.assert_allclose(line.position[0], 0.0, atol=BASE)  # the drive is at the origin
    chords = np.diff(line.position, axis=0)
    np.testing.assert_allclose(np.linalg.norm(chords, axis=1), line.spacing, atol=LENGTH)
    np.testing.assert_allclose(np.sum(line.spacing), 1.0, atol=1e-12)
    middle = (line.tangent[:-1] + line.tangent[1:]) / 2
    np.testing.assert_allclose(chords, line.spacing[:, None] * middle, atol=LENGTH)
    assert not bool(touches_twice(problem, z, phase))
