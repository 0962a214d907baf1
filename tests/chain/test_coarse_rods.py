"""Coarse rods: their shape, and how objects push them."""

# pyright: reportArgumentType=false
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._chain.coarse_rods import (
    BESIDE,
    BETWEEN,
    LINKS,
    POINTS,
    SHARES,
    ends_of_shares,
    links_of,
    poses_of,
    tangents,
    touching,
)
from jaxwhisker._equilibrium.contact import of_each
from jaxwhisker._scan.chain import problem_now

ROUNDING = 1e-12
DEEP = 1e-3  # lengths: of the corner in the rod
LEAN = 0.05  # rad
HEIGHT = 0.5  # of the corner above the base


@cache
def problem():
    """An upright whisker whose shaft a corner of a box pushes."""
    box = jw.Box(HEIGHT, 0.4, 1.2, position=-0.2 + DEEP)
    return problem_now(jax.tree.map(checks.as_float, jw.Scene(jw.Whisker(), box, contacts=2)))


@jax.jit
def touched(problem, angle, x=0.0):
    """How objects push the only rod, their distances, and where its points are, with its base at this x."""
    own = jax.tree.map(lambda leaf: leaf[0], of_each(problem.bodies(jnp.asarray(0.0)), links_of))
    ends = ends_of_shares(own, angle, jnp.array([1.0, 0.0, 0.0]) * x)
    return *touching(problem, own, problem.length[0], angle, ends), ends


def test_directions_are_linear_between_the_middles_of_links():
    np.testing.assert_allclose(BETWEEN.sum(axis=1), 1, rtol=ROUNDING)
    middles = (np.arange(POINTS) + 0.5) / SHARES - 0.5
    np.testing.assert_allclose(BETWEEN @ np.arange(LINKS), middles, rtol=ROUNDING, atol=ROUNDING)


def test_an_upright_rod_is_straight_and_as_long_as_its_whisker():
    _, _, ends = touched(problem(), jnp.full(LINKS, np.pi / 2))
    np.testing.assert_allclose(ends[-1], [0.0, 1.0], atol=ROUNDING)
    np.testing.assert_allclose(ends[:, 1], np.arange(1, POINTS + 1) / POINTS, rtol=ROUNDING)


def test_points_beside_a_corner_that_pushes_do_not_catch_on_it():
    # The rod leans to the right: the corner is in it, and points above the corner are in the side next to it.
    found, _, _ = touched(problem(), jnp.full(LINKS, np.pi / 2 - LEAN), -HEIGHT * LEAN)
    depth, arc = np.asarray(found.depth), np.asarray(found.arc)
    faces, corners = slice(POINTS), slice(POINTS, None)
    pushing = arc[corners][depth[corners] > 0]
    assert pushing.size == 1
    beside = np.abs(arc[faces] - pushing[0]) < BESIDE
    assert beside.any() and np.all(depth[faces][beside] == -1)


def test_tangents_are_normals_turned_to_the_left():
    found, _, _ = touched(problem(), jnp.full(LINKS, np.pi / 2 - LEAN))
    along = tangents(found)
    np.testing.assert_allclose(np.sum(along * found.normal, axis=1), 0, atol=ROUNDING)
    cross = found.normal[:, 0] * along[:, 1] - found.normal[:, 1] * along[:, 0]
    np.testing.assert_allclose(cross, 1, rtol=ROUNDING)


def test_distances_from_the_nearest_object():
    _, apart, ends = touched(problem(), jnp.full(LINKS, np.pi / 2 + LEAN), 0.1)
    # The box is on the left of its corner, above HEIGHT, and its right side at x = DEEP.
    right, below = np.maximum(ends[:, 0] - DEEP, 0), np.maximum(HEIGHT - ends[:, 1], 0)
    outside = (right > 0) | (below > 0)
    assert outside.sum() > POINTS / 2
    np.testing.assert_allclose(apart[outside], np.hypot(right, below)[outside], atol=ROUNDING)


def test_clamped_bases_do_not_move():
    own = problem()
    np.testing.assert_array_equal(poses_of(own, jnp.zeros(own.flexibility.root.shape[1])), own.rest)


def test_an_inner_corner_pulls_back_a_tip_behind_it():
    # Above the rod, the corner between two sides of a roof; the tip is behind it, next to neither of them.
    corners = [(-0.8, 1.5), (-0.5, 0.6), (0.0, 1 - DEEP), (0.5, 0.6), (0.8, 1.5)]
    roof = problem_now(jax.tree.map(checks.as_float, jw.Scene(jw.Whisker(), jw.Polygon(corners), contacts=2)))
    for lean in (-LEAN, 0.0, LEAN):
        found, _, ends = touched(roof, jnp.full(LINKS, np.pi / 2 - lean * DEEP))
        tip, away = POINTS - 1, np.array([0.0, 1 - DEEP]) - np.asarray(ends[-1])
        np.testing.assert_allclose(found.depth[tip], np.hypot(*away), rtol=ROUNDING)
        np.testing.assert_allclose(found.depth[tip] * found.normal[tip], away, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(found.curvature[tip] * found.depth[tip], -1, rtol=ROUNDING)
        # It is in the corner, third of five, where the object's normal is that of the force.
        assert found.piece[tip] == 2 * 2
        at = roof.profile.point_on(found.piece[tip], found.parameter[tip])
        np.testing.assert_allclose(at.normal, found.normal[tip], rtol=0, atol=ROUNDING)
        np.testing.assert_allclose([at.x, at.y], [0.0, 1 - DEEP], rtol=0, atol=ROUNDING)
