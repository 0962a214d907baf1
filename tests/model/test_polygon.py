"""Polygons, boxes and cut profiles: points, pieces, first touches, errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

EXACT = 1e-12
UNCUT = 1e6  # the breaks of a side that is not cut are further away
WEDGE = [(-0.4, 0.6), (0.1, 0.2), (0.5, 0.6)]
PROFILES = [
    *(jw.Polygon(WEDGE), jw.Box(0.3, 0.8, 0.5, 0.1), jw.Polygon([(-0.5, 0.4), (0.5, 0.3)])),
    *(jw.Cut(jw.Parabola(0.2), -0.3, 0.5), jw.Cut(jw.Circle(0.2, 0.5), right=0.3)),
    jw.Tilted(jw.Box(0.3, 0.8, 0.5), 0.3),
]


@pytest.mark.parametrize("profile", PROFILES, ids=str)
def test_point_and_slope_are_continuous_from_piece_to_piece(profile):
    profile = profile.in_unit(1.0)
    breaks = np.asarray(profile.breaks())
    breaks = breaks[np.isfinite(breaks)]  # the others are those of repetitions of the last corner
    assert np.all(np.diff(breaks) > 0)
    for k in np.flatnonzero(np.abs(breaks) < UNCUT):
        p = breaks[k]
        before, after = (profile.point_on(jnp.asarray(piece), p) for piece in (int(k), int(k) + 1))
        np.testing.assert_allclose(before, after, atol=EXACT)


@pytest.mark.parametrize("profile", PROFILES, ids=str)
def test_arcs_move_along_the_slope_and_edges_turn(profile):
    profile = profile.in_unit(1.0)
    breaks = np.asarray(profile.breaks())
    breaks = breaks[np.isfinite(breaks)]  # the others are those of repetitions of the last corner
    for piece in range(breaks.size + 1):
        if piece == 0 and breaks[0] < -UNCUT:
            continue
        low, high = (breaks[max(piece - 1, 0)], breaks[min(piece, breaks.size - 1)])
        p = jnp.asarray((max(low, -1.0) + min(high, 8.0)) / 2 if piece else low - 0.1)
        at = profile.point_on(jnp.asarray(piece), p)
        dx, dy, _, dsin = jax.jacfwd(lambda p, piece=piece: jnp.stack(profile.point_on(jnp.asarray(piece), p)))(p)
        if piece % 2 == 0:
            np.testing.assert_allclose([dx, dy, dsin], [0, 0, at.cos], atol=EXACT)
        else:
            np.testing.assert_allclose(dx * at.sin, dy * at.cos, atol=EXACT)
            assert np.hypot(dx, dy) > 0.1


@pytest.mark.parametrize("profile", PROFILES, ids=str)
def test_other_units_scale_points(profile):
    for side in (1.0, -1.0):
        here, small = profile.in_unit(1.0).first_touch(0.45, side), profile.in_unit(10.0).first_touch(0.045, side)
        np.testing.assert_allclose([10 * small.x, 10 * small.y], [here.x, here.y], atol=1e-9)
        assert small.piece == here.piece


def test_corners_may_start_anywhere():
    turned = [jw.Polygon(np.roll(WEDGE, k, axis=0)).in_unit(1.0) for k in range(3)]
    for chain in turned[1:]:
        np.testing.assert_allclose(chain.xy, turned[0].xy)
        np.testing.assert_allclose(chain.slopes, turned[0].slopes)


def test_slopes_of_a_box_turn_by_right_angles():
    np.testing.assert_allclose(np.degrees(jw.Box(0.3, 0.8, 0.5).chain().slopes), [-180, -90, 0, 90, 180], atol=1e-9)


@pytest.mark.parametrize(
    ("profile", "height", "x", "y", "piece"),
    [
        (jw.Box(0.3, 0.8, 0.5), 1.0, 0.4, 0.3, 4),  # the lower corner
        (jw.Box(0.3, 0.8, 0.5), 0.5, 0.4, 0.3, 4),
        (jw.Polygon(WEDGE), 0.4, 0.3, 0.4, 3),  # a face, with the tip
        (jw.Polygon(WEDGE), 1.0, 0.5, 0.6, 4),
        (jw.Cut(jw.Parabola(0.2), -0.3, 0.5), 0.3, np.sqrt(0.1), 0.3, 1),
        (jw.Cut(jw.Parabola(0.2), -0.3, 0.5), 1.0, 0.5, 0.45, 2),
    ],
)
def test_first_touch_of_an_upright_whisker(profile, height, x, y, piece):
    touch = profile.in_unit(1.0).first_touch(height, 1.0)
    np.testing.assert_allclose([touch.x, touch.y], [x, y], atol=1e-9)
    assert touch.piece == piece
    at = profile.in_unit(1.0).point_on(touch.piece, touch.parameter)
    np.testing.assert_allclose([at.x, at.y], [x, y], atol=1e-9)
    if piece % 2 == 0:
        np.testing.assert_allclose([at.cos, at.sin], [0, 1], atol=1e-9)


def test_the_outermost_point_at_a_height():
    box = jw.Box(0.3, 0.8, 0.5)
    at = box.above_widest(0.5, 1.0)
    np.testing.assert_allclose([at.x, at.y], [0.4, 0.5], atol=EXACT)
    assert at.piece == 5
    assert box.above_widest(0.9, 1.0).y != 0.9 and box.above_widest(0.1, 1.0).y != 0.1
    # A face that leans back is beside a point, but not in the way of an upright shaft.
    rhombus = jw.Polygon([(0.0, 0.2), (0.5, 0.6), (0.0, 1.0), (-0.5, 0.6)])
    np.testing.assert_allclose(rhombus.above_widest(0.8, -1.0).x, -0.25, atol=EXACT)
    np.testing.assert_allclose(rhombus.first_touch(0.8, -1.0).x, -0.5, atol=EXACT)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("vertices", "allowed", "got"),
    [
        ([(0.0, 0.2)], "shape (n, 2), n at least 2", "shape (1, 2)"),
        (np.zeros((3, 3)), "shape (n, 2), n at least 2", "shape (3, 3)"),
        ("corners", "shape (n, 2), n at least 2", "'corners'"),
        ([(0.0, 0.2), (np.nan, 0.3), (0.0, 0.5)], "finite numbers", "nan"),
        (np.ma.masked_equal([(-0.4, 0.6), (0.1, 0.2), (0.5, 0.6)], 0.1), "finite numbers", "nan"),
        (WEDGE[::-1], "counter-clockwise", "0.6"),
        ([(-0.4, 0.6), (0.0, 0.6), (0.4, 0.6), (0.0, 0.9)], "no three of them in line", "0.9"),
        ([(-0.4, 0.2), (0.4, 0.9), (0.4, 0.2), (-0.4, 0.9)], "does not cross itself", "0.9"),
    ],
)
def test_wrong_corners_are_rejected(vertices, allowed, got):
    with pytest.raises(ValueError, match="`vertices`") as error:
        jw.Polygon(vertices)
    assert allowed in str(error.value) and got in str(error.value)


def test_inner_corners_need_several_contacts():
    roof = jw.Polygon([(-0.4, 0.2), (0.0, 0.4), (0.4, 0.2), (0.4, 0.9), (-0.4, 0.9)])
    assert roof.is_concave and not jw.Polygon(WEDGE).is_concave
    assert jw.Scene(jw.Whisker(), roof, contacts=2).contacts == 2
    with pytest.raises(ValueError, match=r"`contacts` must be at least 2 for .* inner corners, got 1"):
        jw.Scene(jw.Whisker(), roof)


@pytest.mark.parametrize(
    ("concave", "vertices"),
    [(True, WEDGE), (False, [(-0.4, 0.2), (0.0, 0.4), (0.4, 0.2), (0.4, 0.9), (-0.4, 0.9)])],
)
def test_whether_corners_are_inner_ones_is_checked_where_it_is_given(concave, vertices):
    assert jw.Polygon(vertices, concave=not concave).concave != concave
    with pytest.raises(ValueError, match=f"`concave` must be {not concave} for these corners, got {concave}"):
        jw.Polygon(vertices, concave=concave)


def test_an_object_below_the_bases_is_rejected():
    with pytest.raises(ValueError, match="lowest point above the bases"):
        jw.scan(jw.Scene(jw.Whisker(), jw.Polygon([(-0.4, 0.6), (0.1, -0.2), (0.5, 0.6)])))


@pytest.mark.parametrize("name", ["distance", "width", "height"])
def test_wrong_sizes_of_a_box_are_rejected(name):
    with pytest.raises(ValueError, match=f"`{name}` must be a positive finite number, got -1.0"):
        jw.Box(**{"distance": 0.3, "width": 0.8, "height": 0.5, name: -1.0})


def test_texts():
    assert str(jw.Polygon(WEDGE)) == "polygon of 3 corners"
    assert str(jw.Box(0.3, 0.8, 0.5, 0.1)) == "box q = 0.3, width 0.8, height 0.5, x = 0.1"
