"""The writers of a film: images into a video, by ffmpeg, or into a GIF, by pillow."""

import subprocess
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from matplotlib.animation import FFMpegWriter
from PIL import Image

Draw = Callable[[int], UInt8[np.ndarray, "height width 3"]]

CODECS = {
    ".mp4": ("-c:v", "h264", "-movflags", "+faststart"),
    ".webm": ("-c:v", "libvpx-vp9", "-b:v", "0", "-crf", "34", "-deadline", "realtime", "-cpu-used", "6"),
}
SUFFIXES = (*CODECS, ".gif")
HOLD = 1.0  # seconds for which the last image stays
COLOURS = 240  # of a GIF; some are left for what does not change
SAMPLES = 12  # images from which these are chosen


def has_ffmpeg() -> bool:
    """Whether videos can be written."""
    return FFMpegWriter.isAvailable()


def write(path: Path, draw: Draw, frames: Iterable[int], *, count: int, fps: int) -> None:
    """Write a film in the format that the path's suffix tells.

    Args:
        path: of the file.
        draw: makes the image of a frame.
        frames: 0 to count - 1.
        count: how many there are.
        fps: frames per second.

    Raises:
        OSError: if the file cannot be written; with what ffmpeg says.
    """
    if path.suffix.lower() == ".gif":
        _write_gif(path, draw, frames, count, fps)
    else:
        _write_video(path, draw, frames, fps)


def _write_video(path: Path, draw: Draw, frames: Iterable[int], fps: int) -> None:
    height, width, _ = draw(0).shape
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-framerate", str(fps), "-i", "-")
    command = [FFMpegWriter.bin_path(), "-y", "-loglevel", "error", *raw, "-an", *CODECS[path.suffix.lower()]]
    command += ["-pix_fmt", "yuv420p", str(path)]
    with tempfile.TemporaryFile() as said:
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said) as running:
            assert running.stdin is not None
            try:
                image = b""
                for frame in frames:
                    image = draw(frame).tobytes()
                    running.stdin.write(image)
                for _ in range(round(HOLD * fps)):
                    running.stdin.write(image)
                running.stdin.close()
            except BrokenPipeError:
                pass  # it has given up, and says why
            except BaseException:
                running.kill()
                raise
        if running.returncode != 0:
            said.seek(0)
            raise OSError(f"cannot write {path}: {' '.join(said.read().decode(errors='replace').split())}")


def _write_gif(path: Path, draw: Draw, frames: Iterable[int], count: int, fps: int) -> None:
    # One palette for all images: colours do not flicker, and what stands still costs nothing.
    samples = np.concatenate([draw(int(k)) for k in np.unique(np.linspace(0, count - 1, SAMPLES).astype(int))])
    chosen = Image.fromarray(samples).quantize(COLOURS, method=Image.Quantize.MEDIANCUT).getpalette()
    palette = np.concatenate([np.reshape(np.array(chosen), (-1, 3))[: COLOURS - 1], [[255, 255, 255]]])
    nearest = _nearest(palette)

    def images():
        for frame in frames:
            red, green, blue = np.moveaxis(draw(frame) >> 2, -1, 0).astype(np.int32)
            image = Image.fromarray(nearest[(red << 12) + (green << 6) + blue])
            image.putpalette(palette.ravel().tolist())
            yield image

    durations = [1000 / fps] * (count - 1) + [1000 / fps + 1000 * HOLD]
    first, *others = images()
    first.save(path, "GIF", save_all=True, append_images=others, duration=durations, loop=0, optimize=True)


def _nearest(palette: np.ndarray) -> UInt8[np.ndarray, " colours"]:
    """For every colour with six bits a channel the nearest of the palette; pillow's own search misses many."""
    six = np.arange(64) << 2 | np.arange(64) >> 4
    red, green, blue = (six[:, None] - palette.T[:, None, :]).astype(np.float32) ** 2  # (64, palette) each
    found = [(one + green[:, None] + blue).argmin(axis=-1).ravel() for one in red]
    return np.concatenate(found).astype(np.uint8)
