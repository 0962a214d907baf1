"""Given loads in space: their units and order, and forces and moments past which a whisker is walked."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxwhisker as jw
from jaxwhisker._rod.space import SpaceLoad
from jaxwhisker._space.given import CLAMP, LoadsInSpace, sorted_in_space

EXACT = 1e-13
LENGTH, STIFFNESS = 0.05, 2.4e-5
FORCE, MOMENT = LENGTH**2 / STIFFNESS, LENGTH / STIFFNESS


def test_loads_are_dimensionless_and_begin_at_the_tip():
    loads = (
        jw.SpaceMoment(1e-4, -2e-4, 3e-4, position=0.02, follower=True),
        jw.PointForce(0.012, position=0.03, follower=True, direction=0.4),
        jw.LineLoad(1.0),
        jw.SpaceForce(-0.02, 0.01, 0.03),
        jw.PointMoment(1e-4),
    )
    rows = sorted_in_space(jw.Whisker(LENGTH, STIFFNESS), loads)
    np.testing.assert_allclose(rows.position, [1.0, 1.0, 0.6, 0.4], rtol=EXACT)
    along = 0.012 * np.array([np.cos(0.4), np.sin(0.4), 0.0])
    np.testing.assert_allclose(rows.force, FORCE * np.array([[-0.02, 0.01, 0.03], [0] * 3, along, [0] * 3]), rtol=EXACT)
    none = [0.0] * 3
    moments = np.array([none, [0.0, 0.0, 1e-4], none, [1e-4, -2e-4, 3e-4]])
    np.testing.assert_allclose(rows.moment, MOMENT * moments, rtol=EXACT)
    assert rows.follower.tolist() == [0.0, 0.0, 1.0, 1.0]


def test_without_loads_at_points_there_is_one_of_zero_at_the_tip():
    rows = sorted_in_space(jw.Whisker(), (jw.LineLoad(1.0),))
    assert [leaf.tolist() for leaf in jax.tree.leaves(rows)] == [[[0.0] * 3], [[0.0] * 3], [0.0], [1.0]]


@pytest.mark.parametrize("follower", [False, True])
def test_a_load_adds_its_force_and_its_moment_about_the_origin(follower):
    force, moment, place = np.array([0.3, -0.7, 1.1]), np.array([0.2, 0.5, -0.4]), np.array([0.4, 0.8, -0.3])
    load = LoadsInSpace(*map(jnp.asarray, (force, moment, float(follower), 1.0)))
    turn = Rotation.from_rotvec([0.4, -0.8, 0.3])
    w, x, y, z = CLAMP
    i, j, k, r = (turn * Rotation.from_quat([x, y, z, w])).as_quat()
    before = SpaceLoad((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))
    after = load.added(before, (tuple(place), (r, i, j, k)), 0.7)
    if follower:
        force, moment = turn.apply(force), turn.apply(moment)
    np.testing.assert_allclose(np.array(after.force) - before.force, 0.7 * force, atol=EXACT)
    about = 0.7 * (moment + np.cross(place, force))
    np.testing.assert_allclose(np.array(after.moment) - before.moment, about, atol=EXACT)
