"""Films of simulations: times of the frames, the end, failures, speed, arguments."""

import jax
import numpy as np
import pytest
from PIL import Image, ImageSequence

from jaxwhisker.film import animate, frames
from jaxwhisker.film.canvas import Canvas
from pictured import failed_motion

FRAMES = 41
LOST = 60  # sample at which a simulation fails


def test_frames_are_evenly_spaced_in_time_and_show_the_samples(motion):
    shown, marks = frames.frames(motion, FRAMES)
    assert shown.step.size == FRAMES and not shown.snap.any()
    sample = float(motion.time[1])
    np.testing.assert_allclose(shown.place, np.linspace(0.0, float(motion.time[-1]), FRAMES), atol=0.51 * sample)
    assert np.all(np.diff(shown.place) > 0)
    lines = motion.shapes(frames.FILMED_POINTS)
    np.testing.assert_allclose(shown.lines.x, lines.x[shown.step], atol=1e-12)
    assert np.array_equal(shown.state.mz, np.asarray(motion.mz)[shown.step])
    assert shown.step[-1] == motion.time.size - 1
    for first, event, place in marks:
        assert place in {one.time for one in motion.events if one.kind == event.kind}
        assert first in (0, FRAMES) or shown.place[first - 1] < place <= shown.place[first] + 1e-9


def test_the_picture_shows_the_time_and_signals_up_to_it(motion):
    shown, marks = frames.frames(motion, FRAMES)
    canvas = Canvas(motion, shown, marks, fps=10, width=160, units="SI", pace=" (2 times slower)")
    for k in (0, 20, FRAMES - 1):
        canvas.draw(k)
        assert canvas.captions.words[0].startswith(f"t = {1000 * shown.place[k]:.0f} ms (2 times slower), u = ")
        (line,), (head,) = canvas.curves._curves[2], canvas.curves._heads[2]
        np.testing.assert_allclose(np.asarray(line.get_xdata()), 1000 * motion.time[: shown.step[k] + 1])
        assert np.asarray(head.get_xdata())[0] == pytest.approx(1000 * shown.place[k])
    assert canvas.curves.axes[-1].get_xlabel() == "$t$ (ms)"


def test_a_film_of_a_simulation_that_fails_ends_at_the_last_state(motion):
    lost = failed_motion(motion, LOST)
    shown, marks = frames.frames(lost, FRAMES)
    assert LOST - 4 < shown.step[-1] < LOST and np.isfinite(shown.place).all()
    canvas = Canvas(lost, shown, marks, fps=10, width=160)
    canvas.draw(canvas.count - 2)
    assert "no state after this: lost" not in canvas.captions.words
    canvas.draw(canvas.count - 1)
    assert canvas.captions.words[1] == "no state after this: lost"


def test_the_speed_decides_the_number_of_frames(motion, tmp_path):
    animate(motion, tmp_path / "film.gif", speed=2.0, fps=10, width=64, progress=False)
    with Image.open(tmp_path / "film.gif") as film:
        assert sum(1 for _ in ImageSequence.Iterator(film)) == 15  # 3.0 of time


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"speed": 0.0}, "`speed` must be .*positive.*0"),
        ({"speed": 1e-3}, "`speed` must be at least 0.01 for a film of at most 300 seconds, got 0.001"),
        ({"speed": 1.0, "seconds": 3.0}, "`speed` must be None if `seconds` is given, got 1.0"),
    ],
)
def test_invalid_speeds_are_rejected(motion, arguments, words):
    with pytest.raises(ValueError, match=words):
        animate(motion, "film.gif", **arguments)


@pytest.mark.unchecked
def test_wrong_runs_are_rejected(motion, stiff):
    with pytest.raises(ValueError, match=r"`speed` must be None for the film of a scan, which has no time, got 1\.0"):
        animate(stiff, "film.gif", speed=1.0)
    with pytest.raises(ValueError, match="`result` must be a simulation whose first sample is ok, got the status lost"):
        animate(failed_motion(motion, 0), "film.gif")
    with pytest.raises(ValueError, match="`result` must be a single simulation"):
        animate(jax.tree.map(lambda leaf: np.stack([leaf, leaf]), motion), "film.gif")
