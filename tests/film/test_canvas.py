"""What the frames of a film show."""

# pyright: reportAttributeAccessIssue=false

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
import several
from jaxwhisker.film.canvas import Canvas, event_in_words
from jaxwhisker.film.frames import SNAP_FRAMES, frames
from jaxwhisker.plot.drawing import drawing_at
from pictured import ANGLES, FILM_STEPS, turning

SOLVED = 1e-9  # accuracy of Newton's method
SCENE = 0.57  # of the width, from the left
BLUE = 80  # of 255, more than red: thin lines are mixed with the background


def starts(marks):
    return [(first, event) for first, event, _ in marks if event.kind >= jw.EventKind.snap_through]


def blue(image):
    """Number of pixels of the scene with the colour of the first whisker."""
    red, _, other = np.moveaxis(image[:, : int(SCENE * image.shape[1])].astype(int), -1, 0)
    return np.sum(other - red > BLUE)


def test_dimensionless_films_do_not_depend_on_the_scenes_units(soft, film_of_soft, soft_in_si):
    shown, marks = frames(soft_in_si, FILM_STEPS)
    one = Canvas(soft, *film_of_soft, fps=25, width=320)
    other = Canvas(soft_in_si, shown, marks, fps=25, width=320, units="dimensionless")
    for k in (0, 20, marks[2][0] + 5):
        assert np.mean(one.image(k) != other.image(k)) < 1e-3


def test_films_in_si_units_have_prefixes(soft_in_si):
    shown, marks = frames(soft_in_si, FILM_STEPS)
    canvas = Canvas(soft_in_si, shown, marks, fps=25, width=320)
    touch, snap = marks[0][0], starts(marks)[0][0]
    assert [ax.get_ylabel() for ax in canvas.curves.axes] == ["$f_x$ (mN)", "$f_y$ (mN)", "$m_z$ (mN mm)"]
    assert canvas.curves.axes[-1].get_xlabel() == "$u$ (mm)"
    assert (canvas.stage.axes.get_xlabel(), canvas.stage.axes.get_ylabel()) == ("$x$ (mm)", "$y$ (mm)")
    for k in (0, touch, snap + 5):
        canvas.draw(k)
        number = f"{1000 * shown.control[k]:+.1f}".replace("-", "\N{MINUS SIGN}")
        assert canvas.captions.words[0] == f"u = {number} mm"
        (base,), (whisker,) = canvas.stage._bases, canvas.stage._whiskers
        np.testing.assert_allclose(np.asarray(base.get_xdata()), 1000 * shown.state.base_x[k])
        np.testing.assert_allclose(np.asarray(whisker.get_ydata()), 1000 * np.asarray(shown.lines.y[k, 0]))
        head = canvas.curves._heads[2][0]
        np.testing.assert_allclose(head.get_xydata()[0], [1e3 * shown.control[k], 1e6 * shown.state.mz[k, 0]])
    left, right = canvas.stage.axes.get_xlim()
    assert left < 1000 * shown.lines.x.min() and 1000 * shown.lines.x.max() < right


def test_where_a_step_failed_the_whisker_vanishes_and_the_status_is_shown(stiff):
    failed = np.arange(stiff.control.size) > 900
    fields = {
        name: jnp.where(failed[:, None], jnp.nan, getattr(stiff, name))
        for name in jw.State.__dataclass_fields__
        if getattr(stiff, name) is not None
    }
    fields["phase"] = jnp.where(failed[:, None], 0, stiff.phase)
    status = jnp.where(failed, int(jw.Status.lost), int(jw.Status.ok))
    result = dataclasses.replace(stiff, **fields, status=status)
    shown, marks = frames(result, FILM_STEPS)
    canvas = Canvas(result, shown, marks, fps=25, width=640)
    known, unknown = (int(np.flatnonzero(failed[shown.step] == bad)[3]) for bad in (False, True))
    assert blue(canvas.image(known)) > 100
    assert "no state: lost" not in canvas.captions.words
    assert blue(canvas.image(unknown)) == 0
    assert canvas.captions.words[1] == "no state: lost"


def test_a_base_that_moves_along_all_axes_on_a_rotating_drive_stays_in_the_window():
    result = jw.scan(turning(), ANGLES)
    shown, marks = frames(result, FILM_STEPS)
    canvas = Canvas(result, shown, marks, fps=25, width=320)
    stage = canvas.stage.axes
    window = stage.get_xlim(), stage.get_ylim()
    for k in (0, shown.step.size // 2, shown.step.size - 1):
        canvas.image(k)
        drawn = drawing_at(result, int(shown.step[k]))
        assert drawn.arm is not None
        artists = [canvas.stage._arm, *canvas.stage._springs, *canvas.stage._whiskers]
        for artist, line in zip(artists, [drawn.arm, *drawn.springs, *drawn.whiskers], strict=True):
            np.testing.assert_allclose(np.asarray(artist.get_xydata()), np.column_stack([line.x, line.y]), atol=SOLVED)
            assert np.all((line.x > window[0][0]) & (line.x < window[0][1]))
            assert np.all((line.y > window[1][0]) & (line.y < window[1][1]))
        square: Any = canvas.stage._drive.get_marker()
        assert square[2] == pytest.approx(45 + np.degrees(result.control[shown.step[k]]))
        assert canvas.captions.words[0].endswith(" rad")
    assert window == (stage.get_xlim(), stage.get_ylim())


def test_events_flash_for_half_a_second_and_snaps_while_they_last(soft, film_of_soft):
    shown, marks = film_of_soft
    canvas = Canvas(soft, shown, marks, fps=10, width=160)

    def words(frame):
        canvas.image(frame)
        return canvas.captions.words[1:]

    touch, snap = marks[0][0], starts(marks)[0][0]
    assert words(touch - 1) == []
    assert words(touch) == words(touch + 4) == ["touch of whisker 1"]
    assert words(touch + 5) == []
    for k in (snap, snap + SNAP_FRAMES - 1):
        assert words(k) == ["snap: not to scale in time", "snap-through of whisker 1"]
    assert "snap: not to scale in time" not in words(snap + SNAP_FRAMES)


def test_events_are_described_in_words(stiff):
    event = stiff.events[0]
    assert event_in_words(event) == "touch of whisker 1"
    off = event._replace(kind=jw.EventKind.snap_off, whiskers=(1, 2, 3))
    assert event_in_words(off) == "snap-off of whiskers 1, 2 and 3"


def test_rings_mark_the_contact_that_an_event_concerns():
    result = several.scanned()
    shown, marks = frames(result, 20)
    canvas = Canvas(result, shown, marks, fps=10, width=160)
    first, event, _ = marks[1]
    canvas.image(first)
    assert canvas.captions.words[-1] == event_in_words(event) == "touch of whisker 1 with object 2 at contact 2"
    slot = len(canvas.captions.words) - 2
    ((ring,),) = (ring.artists for ring in canvas.captions._rings[slot])
    np.testing.assert_allclose(ring.get_xydata(), [[event.after.contact_x[0, 1], event.after.contact_y[0, 1]]])
    assert ring.get_visible() and len(canvas.stage._arrows) == 2
