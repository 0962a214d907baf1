"""Free whiskers: the nearest point of a straight and of a curved whisker to a sphere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.drives import Placement
from jaxwhisker._space.contact import POINT, SLACK
from jaxwhisker._space.free import INTERVALS, in_scene, nearest
from jaxwhisker._space.stance import clearance

POSITION = 1e-6  # along the whisker, of the nearest point
PROBLEM = dimensionless(jw.SpaceScene(jw.Whisker(), jw.Sphere(0.4, (0.0, 0.7, 0.1))))


def at(problem, x, z=0.0):
    upright = problem.mount.rotation[0]
    outline = jax.tree.map(lambda leaf: leaf[0], problem.outline)
    placed = in_scene(outline, Placement(jnp.array([x, 0.0, z]), upright))
    return nearest(problem.surface, placed, problem.length[0], rolls=problem.rolls)


def first_order(distance, radius):
    """G / |grad G| of a sphere at this distance from its centre."""
    return (distance**2 - radius**2) / (2 * distance)


@pytest.mark.parametrize("x", [0.3, 0.5, 1.4, -0.8])
def test_a_straight_whisker_is_nearest_beside_the_centre(x):
    found = at(PROBLEM, x)
    np.testing.assert_allclose(found.distance, first_order(np.hypot(x, 0.1), 0.4), atol=1e-9)
    np.testing.assert_allclose(found.contact[SLACK], 0.3, atol=POSITION)
    assert int(found.phase) == Phase.tangential


def test_a_whisker_below_the_object_is_nearest_with_its_tip():
    high = dimensionless(jw.SpaceScene(jw.Whisker(), jw.Sphere(0.4, (0.0, 1.3, 0.0))))
    found = at(high, 0.2, 0.1)
    reach = np.sqrt(0.2**2 + 0.3**2 + 0.1**2)
    np.testing.assert_allclose(found.distance, first_order(reach, 0.4), atol=1e-9)
    assert int(found.phase) == Phase.tip
    # The angle at which the tip would meet the surface, and the point below it to first order.
    np.testing.assert_allclose(np.sin(-found.contact[SLACK]), 0.3 / reach, atol=1e-9)
    assert np.linalg.norm(np.asarray(found.contact[POINT]) - [0.2, 1.0, 0.1]) == pytest.approx(abs(found.distance))


def test_a_curved_whisker_is_nearest_where_a_fine_search_finds_it():
    curved = dimensionless(jw.SpaceScene(jw.Whisker(intrinsic_curvature=1.0), jw.Sphere(0.3, (0.1, 0.6, 0.2))))
    found = at(curved, 0.6)
    s = np.linspace(0.0, 1.0, 200001)
    sign = np.sign(np.asarray(curved.mount.rotation[0] @ curved.outline.position[0, -1])[0])
    points = np.stack([0.6 + sign * (1 - np.cos(s)), np.sin(s), 0 * s], axis=1)
    distance = first_order(np.linalg.norm(points - [0.1, 0.6, 0.2], axis=1), 0.3)
    np.testing.assert_allclose(found.distance, np.min(distance), atol=1e-7)  # cubics between 33 points
    np.testing.assert_allclose(1 - found.contact[SLACK], s[np.argmin(distance)], atol=1e-4)


def test_the_clearance_of_a_scene_is_a_bound_for_its_unloaded_whiskers():
    for u in (0.6, 0.9, 1.7):
        x = PROBLEM.drive(jnp.asarray(u)).position[0]
        distance = np.hypot(x, 0.1)
        found = clearance(PROBLEM, jnp.asarray(u))
        # The planes of points up to half an interval from the nearest one.
        assert first_order(distance, 0.4) - 1 / INTERVALS < found < distance - 0.4
