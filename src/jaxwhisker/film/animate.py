"""Films of scans and simulations: the scene on the left, the reactions on the right, events as they happen."""

import base64
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxwhisker._base import checks
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._scan.quantities import check_units

if TYPE_CHECKING:
    from jaxwhisker.plot.runs import Run

FPS = 25  # a frame takes a whole number of hundredths of a second, as GIFs require
FASTEST = 60  # frames per second
SECONDS, LONGEST = 12.0, 300.0  # default and largest duration of a run
LEAST_WIDTH, MOST_WIDTH = 64, 4096  # pixels


class Film:
    """A film in memory, which notebooks display.

    Args:
        kind: media type, such as "video/mp4".
        data: contents of the file.
    """

    def __init__(self, kind: str, data: bytes):
        self.kind, self.data = kind, data

    def _repr_html_(self) -> str:
        source = f'src="data:{self.kind};base64,{base64.b64encode(self.data).decode()}"'
        if self.kind.startswith("video"):
            return f'<video controls loop autoplay muted playsinline style="max-width: 100%" {source}></video>'
        return f'<img style="max-width: 100%" {source}>'

    def __repr__(self) -> str:
        return f"Film({self.kind}, {len(self.data) / 1000:.0f} kB)"


@with_own_settings
def animate(
    result: "Run",
    path: str | Path | None = None,
    *,
    seconds: float | None = None,
    speed: float | None = None,
    fps: int = FPS,
    width: int = 960,
    view: Any = None,
    units: str = "auto",
    progress: bool | None = None,
) -> Path | Film:
    """Make a film of a scan or a simulation: the scene on the left, the reactions on the right, events as they happen.

    A snap takes no time in a scan. The film shows it in a few additional frames, marked as not to scale in time. They
    show the overdamped flow of the bases from the state before the snap to the state after it, which also determines
    the result of the snap in a scan. Where a whisker swings free or to the far side while its base stands still, no
    equilibrium lies between the two states. Its centre line is then turned from one to the other, past the object and
    without changing its length.

    If whiskers may have several contacts, the flow is not computed: in a snap, bases move along straight lines, and
    centre lines are turned as described.

    In space, a snap adds no frames: the state after it follows that before. What the object hides is paler.

    Whiskers are missing at failed steps, where the film shows the status.

    A simulation is shown evenly in time, with the reactions over time. Each frame shows the sample nearest to its time,
    so the simulation should have at least as many samples as the film has frames. A film of a simulation that fails
    ends at the last state before.

    Args:
        result: result of one `scan` or one `simulate`.
        path: path of the file: .gif or, with ffmpeg, .mp4 or .webm. By default the film is returned, for notebooks.
        seconds: duration of the run in the film, at most 300; by default 12. Every snap adds half a second, and the
            last frame stays for one second.
        speed: for a simulation, instead of `seconds`: its time that passes in each second of the film. With SI units,
            1.0 is real time, and 0.1 is ten times slower.
        fps: frames per second, 1 to 60. Frames of a GIF last a whole number of hundredths of a second.
        width: width of the film in pixels, 64 to 4096, rounded down to an even number. The height follows from the
            scene: 0.4 to 0.7 times the width.
        view: of a scan in space: a camera at (elevation, azimuth) in degrees, or the projection "xy", "xz" or "yz", see
            `jw.plot.scene`. Default: (15, 35).
        units: "auto", "SI" (with prefixes: mm, mN) or "dimensionless" (in L and EI of the first whisker). "auto" is
            "dimensionless" for a first whisker with L = EI = 1, else "SI".
        progress: whether to show a progress bar; by default, on a terminal.

    Returns:
        The path, or the Film: an MP4 if ffmpeg is installed, else a GIF.

    Raises:
        ValueError: if an argument is invalid, the result is not that of one scan or simulation, or ffmpeg is missing
            for a video.
        OSError: if the file cannot be written.
    """
    from tqdm import tqdm

    from jaxwhisker._scan.result import SpaceResult
    from jaxwhisker.film import canvas, frames, pace, writers
    from jaxwhisker.plot.view import check_no_view, check_view

    seconds = pace.duration_of_film(result, seconds, speed, default=SECONDS, longest=LONGEST)
    path = check(path, seconds, fps, width, units)
    pace.check_begun(result)
    (check_view if isinstance(result, SpaceResult) else check_no_view)(view)
    if path is None:
        kind = "video/mp4" if writers.has_ffmpeg() else "image/gif"
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / f"film.{kind[-3:]}"
            animate(result, made, seconds=seconds, fps=fps, width=width, view=view, units=units, progress=progress)
            return Film(kind, made.read_bytes())
    count = max(2, round(seconds * fps))
    if isinstance(result, SpaceResult):
        from jaxwhisker.film.space import frames_in_space

        shown, marks = frames_in_space(result, count)
    else:
        shown, marks = frames.frames(result, count)
    words = pace.in_words(result, seconds, units)
    drawn = canvas.Canvas(result, shown, marks, fps=fps, width=width, units=units, pace=words, view=view)
    hidden = None if progress is None else not progress
    with tqdm(range(drawn.count), desc="film", unit=" frames", leave=False, disable=hidden) as counted:
        writers.write(path, drawn, counted, fps=fps)
    return path


def check(path: Any, seconds: Any, fps: Any, width: Any, units: Any = "auto") -> Path | None:
    """Check the arguments of `animate` before anything is computed; return the path.

    Raises:
        ValueError: as for `animate`.
    """
    checks.number("seconds", seconds, positive=True)
    if seconds > LONGEST:
        raise ValueError(f"`seconds` must be at most {LONGEST:g}, got {seconds:g}.")
    checks.count("fps", fps)
    if fps > FASTEST:
        raise ValueError(f"`fps` must be at most {FASTEST}, got {fps}.")
    checks.count("width", width)
    if not LEAST_WIDTH <= width <= MOST_WIDTH:
        raise ValueError(f"`width` must lie between {LEAST_WIDTH} and {MOST_WIDTH} pixels, got {width}.")
    check_units(units)
    return None if path is None else _check_path(path)


def _check_path(path: Any) -> Path:
    from jaxwhisker.film.writers import SUFFIXES, has_ffmpeg

    if not isinstance(path, (str, Path)):
        raise ValueError(f"`path` must be a path, got {path!r}.")
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"`path` must end with {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}, got {str(path)!r}.")
    if suffix != ".gif" and not has_ffmpeg():
        raise ValueError(
            f"`path` must end with .gif because there is no ffmpeg, got {str(path)!r}. Install ffmpeg (on Debian: apt "
            f"install ffmpeg) for {suffix}."
        )
    if not path.absolute().parent.is_dir():
        raise ValueError(f"`path` must be in an existing folder, got {str(path)!r}.")
    return path
