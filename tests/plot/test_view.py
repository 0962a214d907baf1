"""Projections and cameras."""

# pyright: reportIndexIssue=false, reportCallIssue=false, reportArgumentType=false

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.colors import to_hex
from mpl_toolkits.mplot3d import proj3d

import jaxwhisker as jw
from jaxwhisker.plot.body import body_of
from jaxwhisker.plot.view import BEHIND, VIEWS, check_no_view, check_view, direction_of, picture

PROJECTED = 1e-9  # coordinates after a few products of matrices
LOW, HIGH = np.array([-1.0, 0.0, -1.5]), np.array([1.5, 2.5, 1.0])
ANGLES = (15.0, 35.0), (-40.0, 200.0), (0.0, 0.0)


@pytest.fixture(scope="module")
def ball():
    return body_of(jw.Sphere(0.5, (0.0, 1.0, 0.0)), np.zeros(3), np.ones(3))


def drawn(view):
    canvas = picture(view)
    canvas.window(LOW, HIGH, ["$x$", "$y$", "$z$"])
    return canvas


@pytest.mark.parametrize("angles", ANGLES)
def test_a_camera_has_the_same_scale_along_all_axes(angles):
    """Orthographic projections P of the unit vectors satisfy P^T P = c^2 (1 - d d^T), d the direction to the camera."""
    ax = drawn(angles).ax
    origin, *ends = np.stack(proj3d.proj_transform(*np.vstack([np.zeros(3), np.eye(3)]).T, ax.get_proj()), axis=1)
    across = (np.array(ends) - origin)[:, :2].T
    product, d = across.T @ across, direction_of(*angles)
    scale = np.trace(product) / 2
    np.testing.assert_allclose(product / scale, np.eye(3) - np.outer(d, d), atol=PROJECTED)


def test_the_first_angle_raises_the_camera_and_the_second_turns_it_towards_x():
    np.testing.assert_allclose(direction_of(0.0, 0.0), [0.0, 0.0, 1.0], atol=PROJECTED)
    np.testing.assert_allclose(direction_of(0.0, 90.0), [1.0, 0.0, 0.0], atol=PROJECTED)
    np.testing.assert_allclose(direction_of(90.0, 0.0), [0.0, 1.0, 0.0], atol=PROJECTED)


@pytest.mark.parametrize("view", VIEWS)
def test_projections_are_seen_from_outside_with_right_handed_axes(view):
    canvas = drawn(view)
    right, up = np.eye(3)[canvas.shown]
    np.testing.assert_array_equal(np.cross(right, up), canvas.towards)
    ax = canvas.ax
    assert ax.get_aspect() == 1
    assert (ax.get_xlabel(), ax.get_ylabel()) == tuple(f"${'xyz'[k]}$" for k in canvas.shown)
    assert ax.get_xlim() == (LOW[canvas.shown[0]], HIGH[canvas.shown[0]])
    assert ax.get_ylim() == (LOW[canvas.shown[1]], HIGH[canvas.shown[1]])


def test_from_below_whiskers_are_in_front_of_the_object():
    assert drawn("xz").towards[1] == -1


@pytest.mark.parametrize("view", ["xy", (0.0, 0.0)])
def test_lines_are_paler_behind_the_object(view, ball):
    canvas = drawn(view)
    behind = np.stack([np.zeros(42), np.linspace(0.0, 2.0, 42), np.full(42, -1.0)], axis=1)
    line = canvas.line(behind, ball, color="C0", label="whisker 1")
    whole, seen = line.artists
    assert whole.get_alpha() == BEHIND and seen.get_alpha() is None and seen.get_label() == "whisker 1"
    canvas.ax.figure.draw_without_rendering()
    shown = np.isfinite(np.asarray(seen.get_xdata(), dtype=float))
    np.testing.assert_array_equal(shown, np.abs(behind[:, 1] - 1.0) > 0.5)
    line.move(behind * [1.0, 1.0, -1.0])
    canvas.ax.figure.draw_without_rendering()
    assert np.isfinite(np.asarray(seen.get_xdata(), dtype=float)).all()


def test_a_camera_that_turns_sees_other_faces(ball):
    canvas = drawn((0.0, 0.0))
    canvas.body(ball)
    faces, outline = canvas.ax.collections
    canvas.ax.figure.draw_without_rendering()
    corners = np.array([path.vertices[:3] for path in faces.get_paths()])
    assert len(corners) == np.sum(ball.normals[:, 2] > 0)
    assert len(outline.get_segments()) == len(ball.outline(np.array([0.0, 0.0, 1.0])))
    canvas.ax.view_init(elev=0.0, azim=90.0, vertical_axis="y")
    canvas.ax.figure.draw_without_rendering()
    assert len(faces.get_paths()) == np.sum(ball.normals[:, 0] > 0)


@pytest.mark.parametrize("view", ["xz", (20.0, 30.0)])
def test_arrows_point_from_tail_to_head_or_vanish(view):
    canvas = drawn(view)
    ends = np.array([[0.0, 0.5, 0.2], [0.3, 0.6, -0.4]])
    arrow = canvas.arrow(ends, "black")
    canvas.ax.figure.draw_without_rendering()
    (patch,) = arrow.artists
    exact = ends[:, canvas.shown] if isinstance(view, str) else None
    if exact is None:
        exact = np.stack(proj3d.proj_transform(*ends.T, canvas.ax.get_proj()), axis=1)[:, :2]
    np.testing.assert_allclose(patch._posA_posB, exact, atol=PROJECTED)
    arrow.move(np.full((2, 3), np.nan))
    assert not patch.get_visible()


WRONG = "`view` must be one of xy, xz, yz, or \\(elevation, azimuth\\) in degrees, got "


@pytest.mark.unchecked
@pytest.mark.parametrize("view", ["zx", 3.0, (1.0,), (1.0, 2.0, 3.0), (np.nan, 0.0), (None, 0.0), ("a", 1.0)], ids=str)
def test_wrong_views_are_rejected(view):
    with pytest.raises(ValueError, match=WRONG):
        check_view(view)


def test_axes_must_suit_the_view():
    plain = pyplot.figure().add_subplot()
    solid = pyplot.figure().add_subplot(projection="3d")
    assert check_view(None, plain) == "xy" and isinstance(check_view(None, solid), tuple)
    with pytest.raises(ValueError, match="`ax` must be plain Axes for a projection, got 3D Axes"):
        check_view("xz", solid)
    with pytest.raises(ValueError, match='`ax` must be Axes with projection="3d" for a view by a camera, got plain'):
        check_view((10.0, 20.0), plain)
    with pytest.raises(ValueError, match="`view` must be None in the plane, got 'xy'"):
        check_no_view("xy")


def test_grid_lines_end_at_the_edges_of_their_panes():
    ax = drawn((15.0, 35.0)).ax
    ax.figure.canvas.draw()
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        assert axis.pane.get_edgecolor()[3] == 1.0 and axis.pane.get_facecolor()[3] == 0.0
        assert axis.pane.get_closed() and axis.pane.get_alpha() is None
        edge, grid = (to_hex(colour) for colour in (axis.pane.get_edgecolor(), axis.gridlines.get_edgecolor()[0]))
        assert edge == grid


@pytest.mark.parametrize("high", [(0.4, 2.0, 0.6), (2.0, 2.0, 2.0), (3.0, 0.5, 0.5)], ids=str)
@pytest.mark.parametrize("angles", [(15.0, 35.0), (40.0, -30.0)], ids=str)
def test_labels_of_a_camera_are_inside_the_figure(high, angles):
    canvas = picture(angles)
    canvas.window(np.zeros(3), np.array(high), ["$x$ (mm)", "$y$ (mm)", "$z$ (mm)"])
    figure = canvas.ax.figure
    figure.canvas.draw()
    for axis in (canvas.ax.xaxis, canvas.ax.yaxis, canvas.ax.zaxis):
        label = axis.label.get_window_extent()
        assert figure.bbox.x0 <= label.x0 and label.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= label.y0 and label.y1 <= figure.bbox.y1
