"""Outlines of polygons, also with inner corners: points, slopes, which corners are those of a polygon."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._model.polygon_chain import chain, is_convex, is_simple, positive
from several_cases import CASES

EXACT = 1e-12
ROOF = CASES["roof"]["objects"][0]["outline"]
LOPSIDED = [*ROOF[:-1], [0.1, 1.4]]  # only one side faces up most
STAR = [[0.0, 0.4], [0.2, 0.7], [0.6, 0.8], [0.2, 0.9], [0.0, 1.3], [-0.2, 0.9], [-0.6, 0.8], [-0.2, 0.7]]
BOX = [[-0.3, 1.2], [-0.3, 0.4], [0.5, 0.4], [0.5, 1.2]]
by_outline = pytest.mark.parametrize("outline", [ROOF, STAR, BOX], ids=["roof", "star", "box"])


def made(outline):
    """The chain of a polygon, in a unit of length of 1."""
    return jw.Polygon(outline).in_unit(1.0)


def real_breaks(one) -> np.ndarray:
    """The parameters between two pieces; those of repetitions are infinite."""
    breaks = np.asarray(one.breaks())
    return breaks[np.isfinite(breaks)]


@by_outline
def test_point_and_slope_are_continuous_from_piece_to_piece(outline):
    one = made(outline)
    breaks = real_breaks(one)
    assert breaks.size == 2 * len(outline) - 2 and np.all(np.diff(breaks) > 0)
    for k, p in enumerate(breaks):
        before, after = (one.point_on(jnp.asarray(piece), p) for piece in (k, k + 1))
        np.testing.assert_allclose(before, after, atol=EXACT)


@by_outline
def test_faces_move_along_the_slope_and_corners_turn_the_shorter_way(outline):
    one = made(outline)
    ends = np.array([0.0, *real_breaks(one), float(one.ends()[1])])
    slopes = np.asarray(one.slopes)
    for piece in range(ends.size - 1):
        p = jnp.asarray((ends[piece] + ends[piece + 1]) / 2)
        at, rate = jax.jvp(lambda p, piece=piece: one.point_on(jnp.asarray(piece), p), (p,), (jnp.ones(()),))
        turn = float(rate.sin * at.cos - rate.cos * at.sin)
        if piece % 2:
            np.testing.assert_allclose([rate.x, rate.y, turn], [at.cos, at.sin, 0.0], atol=EXACT)
        else:
            way = np.sign(slopes[piece // 2 + 1] - slopes[piece // 2])
            np.testing.assert_allclose([rate.x, rate.y, turn], [0.0, 0.0, way], atol=EXACT)


@by_outline
def test_the_outline_runs_once_around_through_all_corners(outline):
    one = made(outline)
    xy = np.asarray(one.xy)[: len(outline)]
    assert sorted(xy.tolist()) == sorted(outline)
    np.testing.assert_allclose(one.slopes[len(outline)] - one.slopes[0], 2 * np.pi, atol=EXACT)
    at = jax.vmap(one.point)(jnp.linspace(0.0, one.ends()[1], 2000))
    # It begins and ends at the two ends of the top.
    np.testing.assert_allclose([at.x[0], at.y[0]], xy[0], atol=EXACT)
    np.testing.assert_allclose([at.x[-1], at.y[-1]], xy[-1], atol=EXACT)
    k = outline.index(xy[0].tolist())
    np.testing.assert_array_equal(xy, np.roll(outline, -k, axis=0))
    # The object is on the left of its outline: the middle of a short line to the right is outside.
    turns = np.asarray(at.cos[:-1] * at.sin[1:] - at.sin[:-1] * at.cos[1:])
    assert np.any(turns > 0)
    assert np.any(turns < -EXACT) == (outline is not BOX)


@pytest.mark.parametrize("outline", [LOPSIDED, BOX], ids=["roof", "box"])
def test_corners_may_start_anywhere(outline):
    turned = [made(np.roll(outline, k, axis=0)) for k in range(len(outline))]
    for other in turned[1:]:
        np.testing.assert_allclose(other.xy, turned[0].xy, atol=EXACT)
        np.testing.assert_allclose(other.slopes, turned[0].slopes, atol=EXACT)


@pytest.mark.parametrize(
    ("outline", "simple", "convex"),
    [
        (BOX, True, True),
        (ROOF, True, False),
        (STAR, True, False),
        (BOX[::-1], False, False),
        (ROOF[::-1], False, False),
        ([[0.0, 0.2], [1.0, 1.0], [1.0, 0.2], [0.0, 1.0]], False, False),  # two sides cross
        ([[0.0, 0.2], [0.5, 0.2], [1.0, 0.2], [0.5, 1.0]], False, False),  # three corners in line
        # It turns once in all, but its arm crosses a side: left, down through the bottom, and back up.
        (
            [[0.0, 0.4], [1.0, 0.4], [1.0, 1.4], [0.6, 1.4], [0.6, 0.2], [0.4, 0.2], [0.4, 1.4], [0.0, 1.4]],
            False,
            False,
        ),
    ],
)
def test_which_corners_are_those_of_a_polygon(outline, simple, convex):
    corners = np.array(outline)
    assert is_simple(corners) == simple
    assert bool(is_convex(jnp.asarray(corners))) == convex
    assert all(bool(value > 0) for value in positive(jnp.asarray(corners))) == convex


def test_repeated_last_corners_change_nothing():
    corners, count = jnp.asarray(ROOF), np.asarray(len(ROOF))
    filled = jnp.concatenate([corners, jnp.repeat(corners[-1:], 2, axis=0)])
    own, other = chain(corners, count, concave=True), chain(filled, count, concave=True)
    assert all(bool(value > 0) for value in positive(filled, count, concave=True))
    np.testing.assert_array_equal(other.ends(), own.ends())
    for p in np.linspace(0.01, float(own.ends()[1]) - 0.01, 20):
        np.testing.assert_allclose(other.point(jnp.asarray(p)), own.point(jnp.asarray(p)), atol=EXACT)


def test_corners_of_no_polygon_are_replaced_and_not_valid():
    """Programs must not fail for numbers that a constructor would reject."""
    wrong = chain(jnp.asarray(ROOF[::-1]), np.asarray(len(ROOF)), concave=True)
    assert np.all(np.isfinite(wrong.slopes)) and bool(wrong.valid())
    below = chain(jnp.asarray(ROOF) - jnp.array([0.0, 0.6]), np.asarray(len(ROOF)), concave=True)
    assert not bool(below.valid())
