"""Writers of GIFs and videos: those of matplotlib, with faster ways to grab a frame."""

import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.figure import Figure
from PIL import Image

from jaxwhisker.film.canvas import Canvas

WEBM = ("-pix_fmt", "yuv420p", "-b:v", "0", "-crf", "34", "-deadline", "realtime", "-cpu-used", "6")
FFMPEG_OPTIONS = {".mp4": ("-movflags", "+faststart"), ".webm": WEBM}
SUFFIXES = (*FFMPEG_OPTIONS, ".gif")
HOLD = 1.0  # seconds for which the last frame stays
PALETTE_SIZE = 240  # colours of a GIF; pillow needs some of 256 for itself
PALETTE_FRAMES = 12  # frames from which the colours are chosen
NEARLY_WHITE = 245  # of 255: paler colours become white, because compression of a pure background is best


def has_ffmpeg() -> bool:
    """Whether videos can be written."""
    return FFMpegWriter.isAvailable()


def write(path: Path, canvas: Canvas, frames: Iterable[int], *, fps: int) -> None:
    """Write a film in the format that the path's suffix selects.

    Args:
        path: path of the file.
        canvas: the canvas that draws the frames.
        frames: numbers of the frames, 0 to canvas.count - 1.
        fps: frames per second.

    Raises:
        OSError: if the file cannot be written; its message contains that of ffmpeg.
    """
    suffix = path.suffix.lower()
    writer: AbstractMovieWriter = (
        _Gif(fps, _palette(canvas))
        if suffix == ".gif"
        else _Video(fps, codec="h264", extra_args=[*FFMPEG_OPTIONS[suffix]])
    )
    try:
        with writer.saving(canvas.figure, str(path), canvas.figure.dpi):
            for frame in frames:
                canvas.draw(frame)
                writer.grab_frame()
            for _ in range(round(HOLD * fps)):
                writer.grab_frame()
    except subprocess.CalledProcessError as error:
        raise OSError(f"cannot write {path}: {' '.join(error.stderr.split())}") from None


class _Video(FFMpegWriter):
    """Sends the pixels that the canvas has drawn; `savefig` would draw the whole figure again, six times slower."""

    def grab_frame(self, **_) -> None:
        self._proc.stdin.write(_pixels(self.fig))  # pyright: ignore[reportAttributeAccessIssue]


class _Gif(PillowWriter):
    """Uses one palette for all frames: colours do not flicker, and the still background takes no space."""

    def __init__(self, fps: int, palette: Image.Image):
        super().__init__(fps=fps)
        self._palette = palette

    def grab_frame(self, **_) -> None:
        image = Image.fromarray(_pixels(self.fig)[..., :3]).quantize(palette=self._palette, dither=Image.Dither.NONE)
        self._frames.append(image)  # pyright: ignore[reportAttributeAccessIssue]


def _pixels(figure: Figure) -> UInt8[np.ndarray, "height width 4"]:
    return np.asarray(figure.canvas.buffer_rgba())  # pyright: ignore[reportAttributeAccessIssue]


def _palette(canvas: Canvas) -> Image.Image:
    samples = np.unique(np.linspace(0, canvas.count - 1, PALETTE_FRAMES).astype(int))
    pixels = np.concatenate([canvas.image(int(frame)) for frame in samples])
    image = Image.fromarray(pixels).quantize(PALETTE_SIZE, method=Image.Quantize.MEDIANCUT)
    colours = np.array(image.getpalette()).reshape(-1, 3)
    colours[colours.min(axis=1) > NEARLY_WHITE] = 255
    image.putpalette(colours.ravel().tolist())
    return image
