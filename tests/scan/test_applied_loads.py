"""Given loads at points: their units and order, and forces and moments past which a whisker is walked, by statics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._rod.rod import Load
from jaxwhisker._scan.applied_loads import Loads, sorted_loads, with_load

EXACT = 1e-13
LENGTH, STIFFNESS = 0.05, 2.4e-5
WHISKER = jw.Whisker(LENGTH, STIFFNESS)


def test_loads_are_dimensionless_and_begin_at_the_tip():
    loads = (
        jw.PointMoment(3e-4, position=0.02),
        jw.PointForce(0.012, position=0.03, follower=True, direction=0.4),
        jw.LineLoad(1.0),
        jw.PointForce(-0.02),
        jw.PointMoment(1e-4),
    )
    rows = sorted_loads(WHISKER, loads)
    np.testing.assert_allclose(rows.position, [1.0, 1.0, 0.6, 0.4], rtol=EXACT)
    # Those at the same place stay in their order.
    np.testing.assert_allclose(rows.force, np.array([-0.02, 0.0, 0.012, 0.0]) * LENGTH**2 / STIFFNESS, rtol=EXACT)
    np.testing.assert_allclose(rows.moment, np.array([0.0, 1e-4, 0.0, 3e-4]) * LENGTH / STIFFNESS, rtol=EXACT)
    np.testing.assert_allclose(rows.direction, [np.pi, 0.0, 0.4, 0.0])
    assert rows.follower.tolist() == [0.0, 0.0, 1.0, 0.0]


def test_without_loads_at_points_there_is_one_of_zero_at_the_tip():
    for loads in ((), (jw.LineLoad(1.0),)):
        rows = sorted_loads(WHISKER, loads)
        assert [leaf.tolist() for leaf in jax.tree.leaves(rows)] == [[0.0], [0.0], [0.0], [0.0], [1.0]]


@jax.jit
def passed(load, state, factor):
    """Force and moment about the origin, after others, of one load at this state."""
    before = Load(jnp.asarray(0.5), jnp.asarray(-0.2), jnp.asarray(0.1))
    after = with_load(before, load, state, factor)
    return jnp.stack([*map(jnp.asarray, (after.force_x, after.force_y, after.moment))]) - jnp.array([0.5, -0.2, 0.1])


def one(force, direction, follower, moment=0.0):
    return Loads(*(jnp.asarray(value) for value in (force, direction, float(follower), moment, 1.0)))


def state(angle, x=0.3, y=0.8):
    """A point of a whisker whose tangent has this angle to x."""
    return tuple(map(jnp.asarray, (x, y, np.cos(angle), np.sin(angle))))


@pytest.mark.parametrize("follower", [False, True])
def test_a_load_adds_its_force_and_its_moment_about_the_origin(follower):
    angle, direction = 1.1, 2.5
    way = direction + (angle - np.pi / 2 if follower else 0.0)
    force = 0.7 * 1.4 * np.array([np.cos(way), np.sin(way)])
    about = 0.3 * force[1] - 0.8 * force[0] + 0.7 * 0.25
    found = passed(one(1.4, direction, follower, 0.25), state(angle), 0.7)
    np.testing.assert_allclose(found, [*force, about], atol=EXACT)


def test_a_follower_turns_with_the_whisker():
    # Turned by 0.6, the whole picture is the same.
    turn, load = 0.6, one(1.4, 2.5, True, 0.25)
    x, y = np.cos(turn) * 0.3 - np.sin(turn) * 0.8, np.sin(turn) * 0.3 + np.cos(turn) * 0.8
    fx, fy, about = passed(load, state(1.1), 1.0)
    turned = passed(load, state(1.1 + turn, x, y), 1.0)
    expected = [np.cos(turn) * fx - np.sin(turn) * fy, np.sin(turn) * fx + np.cos(turn) * fy, about]
    np.testing.assert_allclose(turned, expected, atol=EXACT)
    # It is a dead load as long as the whisker is upright.
    np.testing.assert_allclose(
        passed(load, state(np.pi / 2), 1.0), passed(one(1.4, 2.5, False, 0.25), state(np.pi / 2), 1.0), atol=EXACT
    )
