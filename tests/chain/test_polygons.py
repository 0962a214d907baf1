"""Polygons against brute force: their nearest face, whether points are inside, and shafts that run past corners."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._chain.polygons import at_corner, corner_signs, faces_of, nearest_face, of_corners
from jaxwhisker._model.objects import Objects
from several_cases import CASES

ROUNDING = 1e-12
TURN = 1e-9  # of directions: cosines and sines of sums of angles
OUTLINES = {
    "box": [[-0.3, 1.2], [-0.3, 0.4], [0.5, 0.4], [0.5, 1.2]],
    "wedge": [[-0.4, 0.6], [0.1, 0.2], [0.5, 0.6]],
    "roof": CASES["roof"]["objects"][0]["outline"],
}
INNER = {"roof": [0.0, 0.8]}  # corners at which an outline turns to the right

by_outline = pytest.mark.parametrize("name", OUTLINES)


def chain_of(name: str):
    """The chain of a polygon."""
    return jw.Polygon(OUTLINES[name]).in_unit(1.0)


def sides(name: str) -> tuple[np.ndarray, np.ndarray]:
    """First and last points of all sides, also of the top."""
    corners = np.array(OUTLINES[name])
    return corners, np.roll(corners, -1, axis=0)


def points(name: str) -> np.ndarray:
    """Points around and in a polygon, some of them exactly at the heights of its corners."""
    x = np.linspace(-1.2, 1.2, 49) + 1e-3
    heights = np.array(OUTLINES[name])[:, 1]
    y = np.concatenate([np.linspace(0.05, 1.6, 32) + 1e-3, heights])
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def distances(name: str, at: np.ndarray) -> np.ndarray:
    """Distance of points from all sides."""
    first, last = sides(name)
    along = last - first
    share = np.sum((at[:, None] - first) * along, axis=2) / np.sum(along**2, axis=1)
    foot = first + np.clip(share, 0, 1)[..., None] * along
    return np.linalg.norm(at[:, None] - foot, axis=2)


def is_inside(name: str, at: np.ndarray) -> np.ndarray:
    """Whether the outline turns around points."""
    a, b = (ends - at[:, None] for ends in sides(name))
    turns = np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], np.sum(a * b, axis=-1))
    return np.abs(np.sum(turns, axis=1)) > np.pi


@by_outline
def test_the_nearest_face_and_the_inside(name):
    at, faces = points(name), faces_of(chain_of(name))
    at = at[np.min(distances(name, at), axis=1) > 1e-6]  # off the outline
    found = jax.vmap(lambda x, y: nearest_face(faces, x, y))(*map(jnp.asarray, at.T))
    nearest, inside = np.min(distances(name, at), axis=1), is_inside(name, at)
    assert np.any(inside) and not np.all(inside)
    np.testing.assert_allclose(found.distance, np.where(inside, -nearest, nearest), atol=ROUNDING)
    number, along = np.asarray(found.number), np.asarray(found.along)
    foot = np.stack([faces.x[number] + along * faces.cos[number], faces.y[number] + along * faces.sin[number]], axis=1)
    np.testing.assert_allclose(np.linalg.norm(at - foot, axis=1), nearest, atol=ROUNDING)
    assert np.all(np.asarray(faces.real)[number])


@by_outline
def test_only_the_top_cannot_be_touched(name):
    faces, (first, last) = faces_of(chain_of(name)), sides(name)
    count = len(first)
    assert np.sum(faces.real) == count
    (top,) = np.flatnonzero(np.asarray(faces.real) & ~np.asarray(faces.touchable))
    leftwards = (first - last)[:, 0] / np.linalg.norm(last - first, axis=1)
    np.testing.assert_allclose(-faces.cos[top], np.max(leftwards), atol=ROUNDING)


@by_outline
def test_signs_of_corners(name):
    chain, (first, last) = chain_of(name), sides(name)
    signs = np.asarray(corner_signs(Objects((chain,))))
    ahead = last - first
    behind = np.roll(ahead, 1, axis=0)
    turns = np.sign(behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0])
    assert np.all(signs[1::2] == 0)  # of faces
    found = {tuple(xy): sign for xy, sign in zip(np.asarray(chain.xy).tolist(), signs[::2], strict=True) if sign}
    assert found == {tuple(xy): turn for xy, turn in zip(first.tolist(), turns, strict=True)}
    assert [list(xy) for xy, sign in found.items() if sign < 0] == ([INNER[name]] if name in INNER else [])


def test_pieces_of_several_objects():
    signs = corner_signs(Objects((jw.Circle(0.5, 0.2), chain_of("wedge"), jw.Parabola(0.4))))
    wedge = np.asarray(corner_signs(Objects((chain_of("wedge"),))))
    np.testing.assert_array_equal(signs, [0, *wedge, 0])


def shafts(name: str):
    """Straight shafts past each corner: its number, their distance from it and their direction from base to tip."""
    rng = np.random.default_rng(7)
    for k in range(len(OUTLINES[name])):
        for _ in range(60):
            # Close by on either side: deeper in, a shaft is on another side of the object.
            yield k, rng.uniform(0.001, 0.02) * rng.choice([-1, 1]), rng.uniform(-np.pi, np.pi)


@by_outline
def test_shafts_past_corners(name):
    chain = chain_of(name)
    faces, xy = faces_of(chain), np.asarray(chain.xy)
    numbers, shift, turn = map(np.array, zip(*shafts(name), strict=True))
    direction = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    left = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    at = xy[numbers] + shift[:, None] * left
    found: Any = jax.vmap(lambda *own: at_corner(chain, faces, *own))(*map(jnp.asarray, (numbers, *at.T, *direction.T)))
    first, last = sides(name)
    corners, along, met = first.tolist(), last - first, set()
    for i, k in enumerate(numbers):
        own = corners.index(xy[k].tolist())
        # A shaft through the corner has both sides on one side of it, and is outside.
        behind, ahead = -left[i] @ along[own - 1], left[i] @ along[own]
        touches = behind * ahead > 0 and corners[own] != INNER.get(name)
        assert bool(found.meets[i]) == touches, (corners[own], shift[i], turn[i])
        if not touches:
            continue
        gap = -np.sign(ahead) * shift[i]
        met.add(np.sign(gap))
        assert abs(float(found.gap[i]) - gap) < ROUNDING
        tangent = chain.point_on(jnp.asarray(2 * k), found.parameter[i])
        np.testing.assert_allclose([tangent.x, tangent.y], xy[k], atol=ROUNDING)
        own_way = float(found.side[i]) * np.array([tangent.cos, tangent.sin])
        np.testing.assert_allclose(own_way, direction[i], atol=TURN)
    assert met == {-1.0, 1.0}


def test_a_shaft_on_another_side_of_the_object_does_not_meet_a_corner():
    chain = chain_of("box")
    faces = faces_of(chain)
    corner = int(np.argmax(np.sum(np.asarray(chain.xy) * [1.0, -1.0], axis=1)))  # at the lower right
    for x, meets in ((0.51, True), (0.49, True), (-0.2, True), (-0.31, False)):
        found = at_corner(chain, faces, jnp.asarray(corner), *map(jnp.asarray, (x, 0.4, 0.0, 1.0)))
        assert bool(found.meets) == meets, x
        np.testing.assert_allclose(found.gap, x - 0.5, atol=ROUNDING)


def test_a_function_of_all_corners():
    chain = chain_of("wedge")
    (x,) = of_corners(chain, lambda k: (chain.xy[k, 0],))
    np.testing.assert_array_equal(x, chain.xy[:, 0])
