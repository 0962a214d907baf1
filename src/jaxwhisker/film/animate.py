"""The film of a scan: the scene at the left, the reactions growing at the right, events as they happen."""

import base64
import tempfile
from pathlib import Path
from typing import Any

from jaxwhisker._base import checks
from jaxwhisker._scan.result import Result, check_one_scan

FPS = 25  # whole hundredths of a second, as GIFs have them
FASTEST = 60  # frames per second
LEAST_WIDTH, MOST_WIDTH = 64, 4096  # pixels


class Film:
    """A film in memory; notebooks show it."""

    def __init__(self, kind: str, data: bytes):
        self.kind, self.data = kind, data

    def _repr_html_(self) -> str:
        source = f'src="data:{self.kind};base64,{base64.b64encode(self.data).decode()}"'
        if self.kind.startswith("video"):
            return f'<video controls loop autoplay muted playsinline style="max-width: 100%" {source}></video>'
        return f'<img style="max-width: 100%" {source}>'

    def __repr__(self) -> str:
        return f"Film({self.kind}, {len(self.data) / 1000:.0f} kB)"


def animate(
    result: Result,
    path: str | Path | None = None,
    *,
    seconds: float = 12.0,
    fps: int = FPS,
    width: int = 960,
    progress: bool | None = None,
) -> Path | Film:
    """Make a film of a scan: the scene at the left, the reactions at the right, each event as it happens.

    A snap, which takes no time in a scan, is shown as a snap: in a few frames more, marked as not to scale in time, the
    overdamped flow of the bases from the one state to the other, the same that decides what follows a loss of
    stability. A whisker that swings free or over to the far side while its base stands passes no equilibrium; its
    centre line is then turned from the one state to the other, its length kept, past the object.

    Lengths are drawn in L, forces in EI/L^2, moments in EI/L of the first whisker. Where steps failed whiskers are
    missing, and the film says why.

    Args:
        result: of one `scan`.
        path: of the file: .gif, or, with ffmpeg, .mp4 or .webm. By default the film is returned, for notebooks.
        seconds: how long the scan takes in the film; every snap adds half a second, and the last image stays for one.
        fps: frames per second, 1 to 60; GIFs have delays of whole hundredths of a second.
        width: of the film in pixels, made even; its height, 0.4 to 0.7 of that, follows from the scene.
        progress: whether to show a progress bar. Default: on a terminal.

    Returns:
        The path, or the Film, an MP4 with ffmpeg and else a GIF.

    Raises:
        ValueError: if an argument is wrong, the result is a batch, or a video is asked for without ffmpeg.
        OSError: if the file cannot be written.
    """
    check_one_scan(result)
    path = check(path, seconds, fps, width)
    if path is not None:
        _write(result, path, seconds, fps, width, progress)
        return path
    from jaxwhisker.film.writers import has_ffmpeg

    kind = "video/mp4" if has_ffmpeg() else "image/gif"
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / f"film.{kind[-3:]}"
        _write(result, made, seconds, fps, width, progress)
        return Film(kind, made.read_bytes())


def check(path: Any, seconds: Any, fps: Any, width: Any) -> Path | None:
    """Check what a film is to be, before anything is computed for it.

    Raises:
        ValueError: as `animate` says.
    """
    checks.number("seconds", seconds, positive=True)
    checks.count("fps", fps)
    if fps > FASTEST:
        raise ValueError(f"`fps` must be at most {FASTEST}, but is {fps}.")
    checks.count("width", width)
    if not LEAST_WIDTH <= width <= MOST_WIDTH:
        raise ValueError(f"`width` must lie between {LEAST_WIDTH} and {MOST_WIDTH} pixels, but is {width}.")
    if path is None:
        return None
    from jaxwhisker.film.writers import SUFFIXES, has_ffmpeg

    if not isinstance(path, (str, Path)):
        raise ValueError(f"`path` must be a path, but is {path!r}.")
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"`path` must end with {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}, but is {str(path)!r}.")
    if suffix != ".gif" and not has_ffmpeg():
        raise ValueError(
            f"`path` must end with .gif where there is no ffmpeg, but is {str(path)!r}. Install ffmpeg (on Debian: apt "
            f"install ffmpeg) for {suffix}."
        )
    if not path.absolute().parent.is_dir():
        raise ValueError(f"`path` must lie in a folder that exists, but is {str(path)!r}.")
    return path


def _write(result: Result, path: Path, seconds: float, fps: int, width: int, progress: bool | None) -> None:
    from tqdm import tqdm

    from jaxwhisker.film.canvas import Canvas
    from jaxwhisker.film.frames import frames
    from jaxwhisker.film.stage import outline
    from jaxwhisker.film.writers import write

    shown, events = frames(result, max(2, round(seconds * fps)), outline(result.scene))
    canvas = Canvas(result, shown, events, fps=fps, width=width)
    off = None if progress is None else not progress
    with tqdm(range(canvas.count), desc="film", unit=" frames", leave=False, disable=off) as counted:
        write(path, canvas.image, counted, count=canvas.count, fps=fps)
