"""Films: their frames, above all of snaps; GIFs and videos as others read them; what is wrong with arguments."""

import argparse
import dataclasses
import json
import shutil
import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest
from PIL import Image, ImageSequence

import jaxwhisker as jw
from jaxwhisker._scan.shapes import Shapes, shapes_of
from jaxwhisker.cli import film as command
from jaxwhisker.cli.options import OK, UsageError
from jaxwhisker.film import Film, animate, writers
from jaxwhisker.film.canvas import Canvas
from jaxwhisker.film.captions import in_words
from jaxwhisker.film.flow import flows
from jaxwhisker.film.frames import SNAP_FRAMES, SWINGS, frames, lines_of
from jaxwhisker.film.stage import outline
from jaxwhisker.film.swing import DEEPEST, Outline, between
from jaxwhisker.plot.drawing import drawing_at
from pictured import ANGLES, turning

COUNT = 40  # frames of a scan's steps
CHORDS = 1e-4  # relative: a polyline of 64 points is shorter than the bent whisker
SOLVED = 1e-9  # Newton's method leaves poses and contacts of the flow this exact
INTEGRATED = 1e-7  # ... and centre lines, integrated from base to contact
SETTLED = 0.02  # lengths: the flow ends this near to where the march's Newton method takes over
ONE_STEP = 0.03  # lengths by which contacts and bases differ between two of its states
SCENE = 0.57  # of the width, from the left
BLUE = 80  # of 255, more than red: thin lines are mixed with paper
TOLD_ALIKE = 1e-12  # relative rounding between systems of units
FFMPEG = pytest.mark.skipif(shutil.which("ffprobe") is None, reason="ffprobe, which reads videos, comes with ffmpeg")


def scanned(stiffness, length=1.0, bending_stiffness=1.0):
    unit = bending_stiffness / length**3
    return jw.scan(
        jw.Scene(
            jw.Whisker(length, bending_stiffness),
            jw.Parabola(0.2 * length, 1.0 / length),
            jw.Support.fb(stiffness * unit, 0.2 * length),
            rod=jw.ClosedForm(),
        )
    )


@pytest.fixture(scope="module")
def soft():
    """Snaps through twice, the second time to the far side, and is released there."""
    return scanned(10.0)


@pytest.fixture(scope="module")
def stiff():
    """Snaps off."""
    return scanned(70.0)


@pytest.fixture(scope="module")
def film_of_soft(soft):
    return frames(soft, COUNT, outline(soft.scene))


@pytest.fixture(scope="module")
def flows_of_soft(soft):
    """Event, states of the flow and centre lines of both snaps."""
    numbers = snaps(soft)
    found = flows(soft, numbers)
    return list(zip([soft.events[k] for k in numbers], found, lines_of(found, soft), strict=True))


def snaps(result):
    return [k for k, event in enumerate(result.events) if event.kind >= jw.EventKind.snap_through]


def starts(marks):
    return [(first, event) for first, event in marks if event.kind >= jw.EventKind.snap_through]


def row(tree, k):
    return jax.tree.map(lambda leaf: leaf[k], tree)


def ends_moved(lines):
    """How far bases or tips move from one line to the next, whichever goes farther."""
    return np.hypot(np.diff(lines.x, axis=0), np.diff(lines.y, axis=0))[..., [0, -1]].max(axis=(1, 2))


def lengths(lines):
    return np.sum(np.hypot(np.diff(lines.x), np.diff(lines.y)), axis=-1)


def test_frames_run_evenly_from_the_first_step_to_the_last_with_more_for_every_snap(soft, film_of_soft):
    shown, marks = film_of_soft
    assert len(snaps(soft)) == 2
    assert shown.step.size == COUNT + 2 * SNAP_FRAMES
    assert np.all(np.diff(shown.step) >= 0)
    steps = shown.step[~shown.snap]
    assert steps[0] == 0 and steps[-1] == soft.control.size - 1
    assert np.ptp(np.diff(steps)) <= 1
    for name in ("fx", "mz", "base_x", "phase"):
        assert np.array_equal(getattr(shown.state, name)[~shown.snap], np.asarray(getattr(soft, name))[steps])
    assert np.array_equal(shown.control[~shown.snap], np.asarray(soft.control)[steps])
    assert [event.kind for _, event in marks] == [event.kind for event in soft.events]


def test_an_event_happens_between_the_last_frame_before_it_and_the_first_one_behind_it(film_of_soft):
    shown, marks = film_of_soft
    for first, event in marks:
        assert shown.control[first - 1] >= event.control >= shown.control[first]


def test_a_snap_begins_at_the_state_before_it_and_ends_at_the_one_after_it(soft, film_of_soft):
    shown, marks = film_of_soft
    for first, event in starts(marks):
        assert np.all(shown.snap[first : first + SNAP_FRAMES])
        assert not shown.snap[first - 1] and not shown.snap[first + SNAP_FRAMES]
        assert np.all(shown.control[first : first + SNAP_FRAMES] == event.control)
        for k, state in ((first, event.before), (first + SNAP_FRAMES - 1, event.after)):
            for name in jw.State.__dataclass_fields__:
                assert np.array_equal(getattr(shown.state, name)[k], getattr(state, name))
            line = shapes_of(jax.tree.map(jnp.asarray, state), soft.scene.whiskers, points=64)
            np.testing.assert_allclose(shown.lines.x[k], line.x, atol=SOLVED)
            np.testing.assert_allclose(shown.lines.y[k], line.y, atol=SOLVED)


def test_whiskers_keep_their_length_and_stay_out_of_the_object(soft, film_of_soft):
    shown, _ = film_of_soft
    np.testing.assert_allclose(lengths(shown.lines), 1.0, rtol=CHORDS)
    parabola = outline(soft.scene)
    for k in np.flatnonzero(shown.snap):
        assert parabola.depth(shown.lines.x[k, 0], shown.lines.y[k, 0]) < DEEPEST


def test_frames_of_a_snap_are_about_evenly_far_apart(film_of_soft):
    shown, marks = film_of_soft
    for first, _ in starts(marks):
        moved = ends_moved(row(shown.lines, slice(first, first + SNAP_FRAMES)))
        assert moved.min() > 0.25 * moved.mean()
        assert moved.max() < 3 * moved.mean()  # a tip that swings takes a longer way than the straight one


def test_the_flow_passes_equilibria_of_whiskers_whose_bases_are_held(flows_of_soft):
    kinds = []
    for event, flow, lines in flows_of_soft:
        touching = flow.phase[:, 0] != jw.Phase.free
        kinds.append(touching.all())
        # Upright at height 0, and the object's own point at the end of the whisker that the reaction bends.
        np.testing.assert_allclose(flow.base_y, 0.0, atol=SOLVED)
        np.testing.assert_allclose(flow.base_angle, 0.0, atol=SOLVED)
        at, lines = row((flow, lines), touching)
        np.testing.assert_allclose(at.contact_y, 0.2 + at.contact_x**2, atol=SOLVED)
        end = np.arange(len(at.phase)), 0, np.where(at.phase[:, 0] == jw.Phase.tip, -1, -2)
        np.testing.assert_allclose(lines.x[end], at.contact_x[:, 0], atol=INTEGRATED)
        np.testing.assert_allclose(lines.y[end], at.contact_y[:, 0], atol=INTEGRATED)
        # Not in balance with the spring: that is what moves it on.
        assert np.abs(10.0 * (flow.base_x[:, 0] - event.control - 0.2) + flow.fx[:, 0]).max() > 0.5
        for place, state in ((0, event.before), (-1, event.after)):
            np.testing.assert_allclose(flow.base_x[place], state.base_x, atol=SETTLED)
            assert np.array_equal(flow.phase[place], state.phase)
    # The first keeps its contact; the second swings free and touches again from the other side, bent the other way.
    assert kinds == [True, False]
    assert flow.mz[0, 0] > 0 > flow.mz[-1, 0]


def test_whiskers_move_steadily_unless_they_let_go_or_touch(flows_of_soft):
    for _, flow, lines in flows_of_soft:
        stays = (np.diff(flow.phase[:, 0]) == 0) & (flow.phase[1:, 0] != jw.Phase.free)
        assert ends_moved(lines)[stays].max() < SWINGS
        assert np.abs(np.diff(flow.contact_x[:, 0])[stays]).max() < ONE_STEP


def test_a_clamped_whisker_swings_over_to_the_far_side_while_its_base_stands():
    # A cone, five times thinner at its tip: the flow looks for its far side from where it would touch there.
    cone = jw.Whisker(1.0, lambda s: (1 - 0.8 * s) ** 4)
    result = jw.scan(jw.Scene(cone, jw.Parabola(0.2)), np.linspace(-0.6, -0.8, 11))
    (number,) = snaps(result)
    (flow,) = flows(result, [number])
    event = result.events[number]
    np.testing.assert_allclose(flow.base_x, event.control, atol=SETTLED)
    assert np.all(flow.phase != jw.Phase.free)
    # From its right to its left. The moment tells nothing here: it turns before the whisker lets go.
    assert event.before.contact_x > event.control > flow.contact_x[-1]
    shown, marks = frames(result, 2, outline(result.scene))
    first = starts(marks)[0][0]
    snap = row(shown.state, slice(first, first + SNAP_FRAMES))
    # Bent one way, then without a contact that could be told, then bent the other way.
    touching = snap.phase[:, 0] != jw.Phase.free
    assert touching[0] and touching[-1] and not touching[SNAP_FRAMES // 2]
    assert np.all(snap.contact_force[~touching] == 0) and np.all(snap.mz[~touching] == 0)


def test_a_film_of_no_snap_has_no_flow(stiff):
    assert flows(stiff, []) == []


def test_a_line_turns_from_one_to_another_and_keeps_its_length():
    s = np.linspace(0.0, 2.0, 64)
    upright = Shapes(jnp.zeros((1, 64)), jnp.asarray(s)[None])
    bent = Shapes(1.0 + (1 - jnp.cos(s))[None], jnp.sin(s)[None])  # a circle of radius one, two long
    far = Outline(np.array([-1.0, 1.0]), np.array([9.0, 9.0]))
    half = between(upright, bent, np.array([2.0]), 0.5, far)
    # Half of the curvature: a circle of radius two, from a base half-way.
    np.testing.assert_allclose(half.x[0], 0.5 + 2 * (1 - np.cos(s / 2)), atol=2e-3)
    np.testing.assert_allclose(half.y[0], 2 * np.sin(s / 2), atol=2e-3)
    np.testing.assert_allclose(lengths(half), 2.0, rtol=TOLD_ALIKE)


def test_a_line_that_would_reach_into_the_object_is_curled_around_it(stiff):
    event = stiff.events[snaps(stiff)[0]]
    ends = [
        shapes_of(jax.tree.map(jnp.asarray, s), stiff.scene.whiskers, points=64) for s in (event.before, event.after)
    ]
    nowhere = Outline(np.array([-9.0, 9.0]), np.array([9.0, 9.0]))
    parabola = outline(stiff.scene)
    before, after = jax.tree.map(np.asarray, ends)
    found = [between(before, after, np.ones(1), 0.4, object_) for object_ in (nowhere, parabola)]
    straight, curled = jax.tree.map(np.asarray, found)
    assert parabola.depth(straight.x[0], straight.y[0]) > 10 * DEEPEST
    assert parabola.depth(curled.x[0], curled.y[0]) < DEEPEST
    np.testing.assert_allclose(lengths(curled), 1.0, rtol=TOLD_ALIKE)


def test_physical_units_make_the_same_pictures(soft, film_of_soft):
    length, bending_stiffness = 0.05, 3e-6
    result = scanned(10.0, length, bending_stiffness)
    shown, marks = frames(result, COUNT, outline(result.scene))
    one, other = Canvas(soft, *film_of_soft, fps=25, width=320), Canvas(result, shown, marks, fps=25, width=320)
    for k in (0, 20, marks[2][0] + 5):
        assert np.mean(one.image(k) != other.image(k)) < 1e-3


def blue(image):
    """How many pixels have the colour of the first whisker, where the scene is."""
    red, _, other = np.moveaxis(image[:, : int(SCENE * image.shape[1])].astype(int), -1, 0)
    return np.sum(other - red > BLUE)


def test_where_a_step_failed_the_whisker_vanishes_and_the_status_is_told(stiff):
    failed = np.arange(stiff.control.size) > 900
    fields = {name: jnp.where(failed[:, None], jnp.nan, getattr(stiff, name)) for name in jw.State.__dataclass_fields__}
    fields["phase"] = jnp.where(failed[:, None], 0, stiff.phase)
    status = jnp.where(failed, int(jw.Status.lost), int(jw.Status.ok))
    result = dataclasses.replace(stiff, **fields, status=status)
    shown, marks = frames(result, COUNT, outline(result.scene))
    canvas = Canvas(result, shown, marks, fps=25, width=640)
    known, unknown = (int(np.flatnonzero(failed[shown.step] == bad)[3]) for bad in (False, True))
    assert blue(canvas.image(known)) > 100
    assert "no state: lost" not in canvas.captions.words
    assert blue(canvas.image(unknown)) == 0
    assert canvas.captions.words[1] == "no state: lost"


def test_a_base_that_yields_along_all_axes_on_a_drive_that_turns_moves_in_one_window():
    result = jw.scan(turning(), ANGLES)
    shown, marks = frames(result, COUNT, outline(result.scene))
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
        turned: Any = canvas.stage._drive.get_marker()
        assert turned[2] == pytest.approx(45 + np.degrees(result.control[shown.step[k]]))
        assert canvas.captions.words[0].endswith(" rad")
    assert window == (stage.get_xlim(), stage.get_ylim())


def test_events_flash_for_half_a_second_and_snaps_while_they_last(soft, film_of_soft):
    shown, marks = film_of_soft
    canvas = Canvas(soft, shown, marks, fps=10, width=160)

    def told(frame):
        canvas.image(frame)
        return canvas.captions.words[1:]

    touch, snap = marks[0][0], starts(marks)[0][0]
    assert told(touch - 1) == []
    assert told(touch) == told(touch + 4) == ["touch of whisker 1"]
    assert told(touch + 5) == []
    for k in (snap, snap + SNAP_FRAMES - 1):
        assert told(k) == ["snap: not to scale in time", "snap-through of whisker 1"]
    assert "snap: not to scale in time" not in told(snap + SNAP_FRAMES)


def test_events_are_told_in_words(stiff):
    event = stiff.events[0]
    assert in_words(event) == "touch of whisker 1"
    off = event._replace(kind=jw.EventKind.snap_off, whiskers=(1, 2, 3))
    assert in_words(off) == "snap-off of whiskers 1, 2 and 3"


def test_a_gif_is_what_pillow_reads(stiff, tmp_path):
    style, path = dict(matplotlib.rcParams), tmp_path / "film.gif"
    assert animate(stiff, path, seconds=1.6, fps=20, width=300, progress=False) == path
    with Image.open(path) as opened:
        images = [np.array(image.convert("RGB")) for image in ImageSequence.Iterator(opened)]
        durations = [image.info["duration"] for image in ImageSequence.Iterator(opened)]
        assert opened.info["loop"] == 0
    assert len(images) == 32 + SNAP_FRAMES
    assert durations == [50] * (len(images) - 1) + [1050]
    assert images[0].shape[1] == 300 and images[0].shape[0] % 2 == 0
    assert tuple(images[0][1, 1]) == (255, 255, 255)
    assert min(blue(image) for image in images) > 20
    # Nothing is changed for others, and no figure is left.
    assert dict(matplotlib.rcParams) == style
    assert "matplotlib.pyplot" not in sys.modules or not sys.modules["matplotlib.pyplot"].get_fignums()


@FFMPEG
@pytest.mark.parametrize("suffix", ["mp4", "webm"])
def test_a_video_is_what_ffprobe_reads(stiff, tmp_path, suffix):
    path = tmp_path / f"film.{suffix}"
    assert animate(stiff, str(path), seconds=1.0, fps=25, width=301, progress=False) == path
    asked = ["-v", "error", "-count_frames", "-select_streams", "v:0", "-show_streams", "-of", "json"]
    told = json.loads(subprocess.run(["ffprobe", *asked, path], capture_output=True, check=True, text=True).stdout)
    (stream,) = told["streams"]
    assert stream["width"] == 300 and stream["height"] % 2 == 0
    assert stream["pix_fmt"] == "yuv420p"  # which every player shows
    assert stream["r_frame_rate"] == "25/1"
    assert int(stream["nb_read_frames"]) == 25 + SNAP_FRAMES + 25


def test_notebooks_show_a_film_without_a_file(stiff, monkeypatch):
    monkeypatch.setattr(writers, "has_ffmpeg", lambda: False)
    film = animate(stiff, seconds=0.2, width=100, progress=False)
    assert isinstance(film, Film)
    assert film.data[:6] == b"GIF89a"
    assert film._repr_html_().startswith("<img") and "data:image/gif;base64,R0lGODlh" in film._repr_html_()
    assert "image/gif" in repr(film)


@FFMPEG
def test_notebooks_show_a_video_where_there_is_ffmpeg(stiff):
    film = animate(stiff, seconds=0.2, width=100, progress=False)
    assert isinstance(film, Film)
    assert film._repr_html_().startswith("<video controls") and "data:video/mp4;base64," in film._repr_html_()
    assert film.data[4:8] == b"ftyp"


def test_a_video_that_cannot_be_written_says_why(stiff, tmp_path):
    if not writers.has_ffmpeg():
        pytest.skip("without ffmpeg no video is begun")
    (tmp_path / "film.mp4").mkdir()
    with pytest.raises(OSError, match=r"cannot write .*film\.mp4: .*Is a directory"):
        animate(stiff, tmp_path / "film.mp4", seconds=0.2, width=100, progress=False)


WRONG = {
    "suffix": ({"path": "film.avi"}, ["`path`", ".mp4, .webm or .gif", "film.avi"]),
    "no suffix": ({"path": "film"}, ["`path`", ".gif"]),
    "no path": ({"path": 3}, ["`path`", "3"]),
    "folder": ({"path": "nowhere/film.gif"}, ["`path`", "folder", "nowhere"]),
    "seconds": ({"seconds": 0.0}, ["`seconds`", "positive", "0.0"]),
    "seconds unknown": ({"seconds": float("nan")}, ["`seconds`", "nan"]),
    "fps": ({"fps": 0}, ["`fps`", "positive int", "0"]),
    "too fast": ({"fps": 61}, ["`fps`", "60", "61"]),
    "width": ({"width": 1.5}, ["`width`", "positive int", "1.5"]),
    "too narrow": ({"width": 10}, ["`width`", "64", "10"]),
    "result": ({"result": None}, ["`result`", "None"]),
}


@pytest.mark.unchecked
@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told_by_name(name, stiff):
    arguments, words = WRONG[name]
    with pytest.raises(ValueError) as told:
        animate(**{"result": stiff, "path": "film.gif"} | arguments)
    for word in words:
        assert word in str(told.value)


@pytest.mark.unchecked
def test_a_batch_of_scans_is_no_film(stiff):
    with pytest.raises(ValueError, match="pick a lane first"):
        animate(jax.tree.map(lambda leaf: np.stack([leaf, leaf]), stiff), "film.gif")


def test_videos_without_ffmpeg_are_refused_with_a_way_out(stiff, monkeypatch, tmp_path):
    monkeypatch.setattr(writers, "has_ffmpeg", lambda: False)
    with pytest.raises(ValueError, match=r"`path` must end with \.gif.*film\.mp4.*[Ii]nstall ffmpeg"):
        animate(stiff, tmp_path / "film.mp4")


def run(argv):
    parser = argparse.ArgumentParser()
    command.add(parser.add_subparsers())
    args = parser.parse_args(["film", *map(str, argv)])
    return args.run(args)


def test_the_command_scans_and_writes(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "scan", lambda scene, control: scanned(70.0))
    path = tmp_path / "scan.gif"
    options = ["--seconds", 0.4, "--fps", 10, "--width", 120, "--start", 0.8, "--stop", 0.7]
    assert run([*options, path]) == OK
    out, _ = capsys.readouterr()
    assert out.startswith("FB: 1 whisker") and out.endswith(f"wrote {path}\n") and " ok\n" in out
    with Image.open(path) as opened:
        assert opened.width == 120
        assert sum(1 for _ in ImageSequence.Iterator(opened)) == 4 + SNAP_FRAMES


def test_the_command_refuses_before_it_scans(tmp_path, monkeypatch):
    monkeypatch.setattr(command, "scan", lambda *_: pytest.fail("scanned all the same"))
    for argv in (["scan.avi"], ["nowhere/scan.gif"], ["--width", 1, "scan.gif"], ["--stiffness", -1, "scan.gif"]):
        with pytest.raises(UsageError):
            run(argv)
