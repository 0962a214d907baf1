"""Films of scans and simulations: the scene on the left, the reactions on the right, events as they happen."""

import base64
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._dynamics.simulation import Simulation
from jaxwhisker._path.path import Status
from jaxwhisker._scan.quantities import UnitSystem, check_units
from jaxwhisker.plot.runs import Run, check_one_run, places

SECONDS = 12.0  # duration of a run
REAL = 0.005  # relative difference from real time that is not worth a word
FPS = 25  # a frame takes a whole number of hundredths of a second, as GIFs require
FASTEST = 60  # frames per second
LONGEST = 300.0  # seconds
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


def animate(
    result: Run,
    path: str | Path | None = None,
    *,
    seconds: float | None = None,
    speed: float | None = None,
    fps: int = FPS,
    width: int = 960,
    units: str = "auto",
    progress: bool | None = None,
) -> Path | Film:
    """Make a film of a scan or a simulation: the scene on the left, the reactions on the right, events as they happen.

    A snap takes no time in a scan. The film shows it in a few additional frames, marked as not to scale in time. They
    show the overdamped flow of the bases from the state before the snap to the state after it, which also determines
    the result of the snap in a scan. Where a whisker swings free or to the far side while its base stands still, no
    equilibrium lies between the two states. Its centre line is then turned from one to the other, past the object and
    without changing its length.

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

    from jaxwhisker.film import canvas, frames, writers

    seconds = _seconds(check_one_run(result), seconds, speed)
    path = check(path, seconds, fps, width, units)
    _check_begun(result)
    if path is None:
        kind = "video/mp4" if writers.has_ffmpeg() else "image/gif"
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / f"film.{kind[-3:]}"
            animate(result, made, seconds=seconds, fps=fps, width=width, units=units, progress=progress)
            return Film(kind, made.read_bytes())
    shown, marks = frames.frames(result, max(2, round(seconds * fps)))
    pace = _pace(result, seconds, units)
    drawn = canvas.Canvas(result, shown, marks, fps=fps, width=width, units=units, pace=pace)
    hidden = None if progress is None else not progress
    with tqdm(range(drawn.count), desc="film", unit=" frames", leave=False, disable=hidden) as counted:
        writers.write(path, drawn, counted, fps=fps)
    return path


def _seconds(result: Run, seconds: float | None, speed: float | None) -> float:
    """Duration of a run in its film."""
    if speed is None:
        return SECONDS if seconds is None else seconds
    if not isinstance(result, Simulation):
        checks.fail("speed", "None for the film of a scan, which has no time", repr(speed))
    if seconds is not None:
        checks.fail("speed", "None if `seconds` is given", repr(speed))
    checks.number("speed", speed, positive=True)
    seconds, least = _duration(result) / speed, _duration(result) / LONGEST
    if seconds > LONGEST:
        checks.fail("speed", f"at least {least:.3g} for a film of at most {LONGEST:g} seconds", f"{speed:g}")
    return seconds


def _check_begun(result: Run) -> None:
    status = int(np.asarray(result.status)[0])
    if isinstance(result, Simulation) and status != Status.ok:
        checks.fail("result", "a simulation whose first sample is ok", f"the status {Status(status).name}")


def _duration(motion: Simulation) -> float:
    time = places(motion, "time")
    return float(time[-1] - time[0])


def _pace(result: Run, seconds: float, units: str) -> str:
    """The speed of a film in words, if times are in seconds."""
    if not isinstance(result, Simulation) or UnitSystem(result.scene, units).dimensionless:
        return ""
    slower = seconds / _duration(result)
    if not slower > 0 or abs(slower - 1) < REAL:
        return " (real time)" if slower > 0 else ""
    return f" ({max(slower, 1 / slower):.3g} times {'slower' if slower > 1 else 'faster'})"


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
