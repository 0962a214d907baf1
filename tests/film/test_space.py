"""Films of scans in space."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxwhisker as jw
from jaxwhisker.film.canvas import Canvas
from jaxwhisker.film.space import frames_in_space

MM = 1e3
ROUNDING = 1e-9  # of lengths in mm
COUNT = 31  # every other step


@pytest.fixture(scope="module")
def film(in_space):
    return frames_in_space(in_space, COUNT)


def test_frames_are_evenly_spaced_steps(in_space, film):
    shown, marks = film
    np.testing.assert_array_equal(shown.step, np.arange(0, 61, 2))
    np.testing.assert_allclose(shown.lines.y, jw.shapes(in_space, shown.control).y)
    np.testing.assert_array_equal(shown.state.fz, np.asarray(in_space.fz)[shown.step])
    assert [mark.event.kind for mark in marks] == [event.kind for event in in_space.events]
    for mark in marks:  # the first frame at or after the event
        assert shown.control[mark.first] <= mark.event.control < shown.control[mark.first - 1]


@pytest.mark.parametrize("view", [None, "xy", "xz", "yz", (-10.0, 60.0)], ids=str)
def test_whiskers_move_and_stay_in_the_window(in_space, film, view):
    canvas = Canvas(in_space, *film, fps=25, width=320, view=view)
    axes = canvas.stage.axes
    for k in (0, 15, 30):
        pixels = canvas.image(k)
        assert pixels.std() > 0
        whole, seen = canvas.stage._parts._whiskers[0].artists
        lines = [MM * np.asarray(getattr(film[0].lines, name))[k, 0] for name in "xyz"]
        if isinstance(view, str):
            lines = [lines["xyz".index(name)] for name in {"yz": "zy"}.get(view, view)]
            drawn, limits = whole.get_data(), (axes.get_xlim(), axes.get_ylim())
        else:
            drawn, limits = whole.get_data_3d(), (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())
            np.testing.assert_allclose(seen.get_data_3d(), lines, atol=ROUNDING)
        np.testing.assert_allclose(drawn, lines, atol=ROUNDING)
        for line, (low, high) in zip(lines, limits, strict=True):
            assert np.all((line > low) & (line < high))
    assert len(canvas.curves.axes) == 6
    assert [ax.get_ylabel() for ax in canvas.curves.axes][::5] == ["$f_x$ (mN)", "$m_z$\n(mN mm)"]
    np.testing.assert_allclose(canvas.curves._heads[2][0].get_xydata()[0], [MM * -0.039, MM * film[0].state.fz[30, 0]])


@pytest.mark.parametrize("units", ["SI", "dimensionless"])
@pytest.mark.parametrize("width", [320, 640, 1280])
def test_labels_and_numbers_of_curves_stay_in_their_rows(in_space, film, units, width):
    canvas = Canvas(in_space, *film, fps=25, width=width, units=units)
    canvas.image(0)
    scene = canvas.stage.axes.bbox.x1
    for ax in canvas.curves.axes:
        label = ax.yaxis.label.get_window_extent()
        assert ax.bbox.y0 <= label.y0 and label.y1 <= ax.bbox.y1 and scene < label.x0
        numbers = [
            text.get_window_extent()
            for text in ax.get_yticklabels()
            if ax.get_ylim()[0] <= text.get_position()[1] <= ax.get_ylim()[1]
        ]
        assert numbers and label.x1 < min(number.x0 for number in numbers)
        room = 0.06 * ax.bbox.height
        assert all(ax.bbox.y0 - room < number.y0 and number.y1 < ax.bbox.y1 + room for number in numbers)


@pytest.mark.parametrize("view", ["xz", (15.0, 35.0)], ids=str)
def test_a_ring_marks_the_contact_at_an_event(in_space, film, view):
    canvas, touch = Canvas(in_space, *film, fps=25, width=320, view=view), film[1][1]
    canvas.image(touch.first)
    assert canvas.captions.words[1:] == ["touch of whisker 1", "tangential contact of whisker 1"]
    (circle,) = canvas.captions._rings[1][0].artists
    state = touch.event.before
    contact = MM * np.array([state.contact_x[0], state.contact_y[0], state.contact_z[0]])
    drawn = circle.get_data_3d() if view != "xz" else circle.get_data()
    np.testing.assert_allclose(np.ravel(drawn), contact if view != "xz" else contact[[0, 2]], atol=ROUNDING)
    assert circle.get_visible()


def test_a_snap_has_no_frames_and_a_failed_step_has_no_whisker(in_space):
    failed = np.arange(in_space.control.size) > 40
    names = [name for name in jw.SpaceState.__dataclass_fields__ if getattr(in_space, name) is not None]
    fields = {}
    for name in names:
        values = jnp.asarray(getattr(in_space, name))
        gone = failed.reshape(-1, *[1] * (values.ndim - 1))
        fields[name] = jnp.where(gone, 0 if name == "phase" else jnp.nan, values)
    result = dataclasses.replace(in_space, **fields, status=jnp.where(failed, int(jw.Status.lost), 0))
    shown, marks = frames_in_space(result, COUNT)
    assert not shown.snap.any() and shown.step.size == COUNT
    canvas = Canvas(result, shown, marks, fps=25, width=320)
    canvas.image(COUNT - 1)
    assert canvas.captions.words[1] == "no state: lost"
    assert np.isnan(canvas.stage._parts._whiskers[0].artists[0].get_data_3d()).all()


def test_animate_writes_a_film(in_space, tmp_path):
    path = jw.animate(in_space, tmp_path / "film.gif", seconds=0.2, fps=10, width=160, view="xz")
    with Image.open(path) as film:
        assert film.n_frames >= 2 and film.width == 160
    with pytest.raises(ValueError, match=r"`view` must be one of xy, xz, yz, or .* got 'zx'"):
        jw.animate(in_space, tmp_path / "other.gif", view="zx")
    assert not (tmp_path / "other.gif").exists()
