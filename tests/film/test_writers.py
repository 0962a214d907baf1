"""GIFs and videos as other programs read them."""

import json
import shutil
import subprocess
import sys

import matplotlib
import numpy as np
import pytest
from PIL import Image, ImageSequence

from jaxwhisker.film import animate, writers
from jaxwhisker.film.frames import SNAP_FRAMES

FFPROBE = pytest.mark.skipif(shutil.which("ffprobe") is None, reason="ffprobe, which reads videos, comes with ffmpeg")
FFMPEG = pytest.mark.skipif(not writers.has_ffmpeg(), reason="ffmpeg writes videos")
SCENE = 0.57  # of the width, from the left
BLUE = 80  # of 255, more than red: thin lines are mixed with the background


def blue(image):
    """Number of pixels of the scene with the colour of the first whisker."""
    red, _, other = np.moveaxis(image[:, : int(SCENE * image.shape[1])].astype(int), -1, 0)
    return np.sum(other - red > BLUE)


def open_figures():
    """Numbers of the figures of pyplot, which the films do without."""
    return sys.modules["matplotlib.pyplot"].get_fignums() if "matplotlib.pyplot" in sys.modules else []


def test_a_gif_is_what_pillow_reads(stiff, tmp_path):
    style, path, figures = dict(matplotlib.rcParams), tmp_path / "film.gif", open_figures()
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
    # matplotlib's settings are unchanged, and no figure is left open.
    assert dict(matplotlib.rcParams) == style
    assert open_figures() == figures


@FFPROBE
@pytest.mark.parametrize("suffix", ["mp4", "webm"])
def test_a_video_is_what_ffprobe_reads(stiff, tmp_path, suffix):
    path = tmp_path / f"film.{suffix}"
    assert animate(stiff, str(path), seconds=1.0, fps=25, width=301, progress=False) == path
    asked = ["-v", "error", "-count_frames", "-select_streams", "v:0", "-show_streams", "-of", "json"]
    answer = subprocess.run(["ffprobe", *asked, path], capture_output=True, check=True, text=True).stdout
    (stream,) = json.loads(answer)["streams"]
    assert stream["width"] == 300 and stream["height"] % 2 == 0
    assert stream["pix_fmt"] == "yuv420p"  # which every player shows
    assert stream["r_frame_rate"] == "25/1"
    assert int(stream["nb_read_frames"]) == 25 + SNAP_FRAMES + 25


@FFMPEG
def test_a_video_that_cannot_be_written_says_why(stiff, tmp_path):
    (tmp_path / "film.mp4").mkdir()
    with pytest.raises(OSError, match=r"cannot write .*film\.mp4: .*Is a directory"):
        animate(stiff, tmp_path / "film.mp4", seconds=0.2, width=100, progress=False)
