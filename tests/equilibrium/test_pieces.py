"""Contacts on the pieces of polygons: passing from one to the next, and the first corner that a shaft touches."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import pieces
from jaxwhisker._model.objects import as_one

ROUNDING = 1e-13  # a handful of products of numbers near 1
SOLVED = 1e-12  # a corner's place on a curved shaft, by three steps of Newton's method

CORNERS = np.array([(-0.5, 0.9), (-0.4, 0.5), (0.1, 0.3), (0.4, 0.45), (0.55, 0.9)])
POLYGON = jw.Polygon(CORNERS).in_unit(1.0)  # its top goes from the last corner to the first
SIDES = np.diff(CORNERS, axis=0)
SLOPES = np.arctan2(SIDES[:, 1], SIDES[:, 0])
TOP = -np.pi  # of its slope before the first corner
TURNS = np.diff(np.concatenate([[TOP], SLOPES, [TOP + 2 * np.pi]]))
# Lengths of all pieces: turns at corners, and faces between them.
EXTENTS = np.ravel(np.column_stack([TURNS, np.append(np.hypot(*SIDES.T), 0.0)]))[:-1]
BREAKS = np.cumsum(EXTENTS)[:-1]

ends_of = Program(lambda profile, piece: pieces.ends_of(profile, piece))
step = Program(pieces.after_step)
between = Program(pieces.break_between)


def test_pieces_are_turns_at_corners_and_faces_between_them():
    low, high = ends_of(POLYGON, jnp.arange(9))
    np.testing.assert_allclose(low[1:], BREAKS, atol=ROUNDING)
    np.testing.assert_allclose(high[:-1], BREAKS, atol=ROUNDING)
    assert low[0] == -np.inf and high[-1] == np.inf


def test_neighbouring_pieces_meet_at_a_break_in_either_order():
    first, second = jnp.arange(8), jnp.arange(1, 9)
    for before, after in ((first, second), (second, first)):
        np.testing.assert_allclose(between(POLYGON, before, after), BREAKS, atol=ROUNDING)
    # A circle of one piece, and then the polygon.
    two = as_one((jw.Circle(0.2, 0.3, -2.0), POLYGON)).in_unit(1.0)
    np.testing.assert_allclose(between(two, second, first), [0.0, *BREAKS[:-1]], atol=ROUNDING)


def moved_to(parameters, moved):
    """Contacts that all move from the middle of the third piece to these parameters."""
    middle = (BREAKS[1] + BREAKS[2]) / 2
    previous = np.column_stack([[2.0] * 4, [middle] * 4, [0.3] * 4])
    z = np.column_stack([[3.0] * 4, parameters, [-0.1] * 4])
    after = step(POLYGON, jnp.full(4, 2), jnp.asarray(previous), jnp.asarray(z), jnp.asarray(moved))
    return previous, z, after


def test_a_contact_that_moves_past_an_end_of_its_piece_stops_there():
    low, high = BREAKS[1:3]
    inside = low + 0.9 * (high - low)
    previous, z, (piece, after) = moved_to([low - 0.1, high + 0.2, inside, high + 5e-13], [True] * 4)
    assert piece.tolist() == [1, 3, 2, 2]  # the last one has passed it by rounding only
    share = np.array([(low - previous[0, 1]) / (z[0, 1] - previous[0, 1]), 0.0, 1.0, 1.0])
    share[1] = (high - previous[1, 1]) / (z[1, 1] - previous[1, 1])
    assert 0.1 < share[1] < share[0] < 1
    np.testing.assert_allclose(after, previous + share[:, None] * (z - previous), atol=ROUNDING)
    low, high = ends_of(POLYGON, jnp.arange(9))
    assert after[0, 1] == low[2] and after[1, 1] == high[2]


def test_contacts_that_have_not_moved_stay_on_their_piece():
    _, z, (piece, after) = moved_to([BREAKS[1] - 0.1, BREAKS[2] + 0.2, 0.0, np.nan], [False] * 4)
    assert piece.tolist() == [2] * 4
    np.testing.assert_allclose(after, z, atol=ROUNDING)


def test_free_whiskers_have_the_first_piece():
    touches = jnp.array([True, False, True])
    assert pieces.where_touching(jnp.array([3, 4, 5]), touches).tolist() == [3, 0, 5]  # pyright: ignore[reportOptionalMemberAccess]
    assert pieces.where_touching(None, touches) is None


CELLS = 12
# Angle of the base to the upright, curvature, side of the approach.
CASES = [(t, c, s) for t in (-0.7, 0.0, 0.4, 0.9) for c in (0.0, -0.4, 0.3) for s in (1.0, -1.0)]


def arc(turn, curvature):
    """Points and directions of a shaft of length 1, base at the origin, and these at any place, in cells."""

    def at(place):
        # Of a circle, whose chord has half of the turn; sinc keeps straight shafts finite.
        s = place / CELLS
        half, end = turn + curvature * s / 2, turn + curvature * s
        chord = s * jnp.sinc(curvature * s / 2 / jnp.pi)
        return jnp.stack([-chord * jnp.sin(half), chord * jnp.cos(half)]), jnp.stack(
            [-jnp.sin(end), jnp.cos(end)]
        ) / CELLS

    return at


@Program
def first_corners(profile, turns, curvatures, sides):
    """The first corners that shafts touch, and points and tangents of the profile there."""

    def one(turn, curvature, side):
        shaft = arc(turn, curvature)
        heights = jax.vmap(lambda place: shaft(place)[0][1])(jnp.arange(CELLS + 1.0))
        found = pieces.first_corner(profile, shaft, heights, side)
        return found, profile.point_on(found.piece, found.parameter), shaft(found.cell)

    return jax.vmap(one)(turns, curvatures, sides)


def test_the_first_corner_that_a_shaft_touches():
    turns, curvatures, sides = np.array(CASES).T
    found, at, ((x, y), (along_x, along_y)) = jax.tree.map(
        lambda leaf: np.moveaxis(np.asarray(leaf), -1, 0) if leaf.ndim > 1 else np.asarray(leaf),
        first_corners(POLYGON, jnp.asarray(turns), jnp.asarray(curvatures), jnp.asarray(sides)),
    )
    s = np.linspace(0.0, 1.0, 4001)
    touched = 0
    for k, (turn, curvature, side) in enumerate(CASES):
        # The shaft as a polyline: where its base is when it passes each corner, and its direction there.
        direction = turn + curvature * s
        middle = (direction[1:] + direction[:-1]) / 2
        lines = [np.append(0.0, np.cumsum(part)) / 4000 for part in (-np.sin(middle), np.cos(middle))]
        if lines[1][-1] <= CORNERS[:, 1].min():
            continue
        place = np.interp(CORNERS[:, 1], lines[1], s)
        ahead = side * (CORNERS[:, 0] - np.interp(CORNERS[:, 1], lines[1], lines[0]))
        ahead[lines[1][-1] < CORNERS[:, 1]] = -np.inf
        first = int(np.argmax(ahead))
        # It is the first place of all if the shaft lies between the tangents at the corner.
        upright = np.pi / 2 + turn + curvature * place[first] - (np.pi if side < 0 else 0.0)
        into, out = (TOP + np.cumsum(np.concatenate([[0.0], TURNS])))[first : first + 2]
        if not into + 1e-6 < upright < out - 1e-6:
            continue
        touched += 1
        assert found.piece[k] == 2 * first
        np.testing.assert_allclose(found.ahead[k], ahead[first], atol=1e-7)  # of the polyline
        np.testing.assert_allclose(found.cell[k] / CELLS, place[first], atol=1e-6)
        # Exactly there the shaft goes through the corner, along the profile's tangent.
        np.testing.assert_allclose([at.x[k], at.y[k]], CORNERS[first], atol=ROUNDING)
        np.testing.assert_allclose([side * found.ahead[k] + x[k], y[k]], CORNERS[first], atol=SOLVED)
        np.testing.assert_allclose(along_x[k] * at.sin[k] - along_y[k] * at.cos[k], 0.0, atol=SOLVED)
    assert touched > len(CASES) / 2


def test_shafts_touch_no_corner_that_is_too_high_or_where_they_first_touch_a_face():
    # The first two lie low: their tips are 0.17 high. The third bulges towards the right face, and is steeper than it
    # at the corner below.
    turns, curvatures, sides = (np.resize(each, len(CASES)) for each in ([1.4, -1.4, 0.7], [0, 0, -2.0], [1.0, -1, 1]))
    found, _, _ = first_corners(POLYGON, jnp.asarray(turns), jnp.asarray(curvatures), jnp.asarray(sides))
    assert np.all(found.ahead == -np.inf) and np.all(np.isfinite([found.cell, found.parameter]))
