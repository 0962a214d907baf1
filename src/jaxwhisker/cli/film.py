"""The command `film`: a film of one scene."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from jaxwhisker._base import checks
from jaxwhisker._scan.report import status_line
from jaxwhisker.cli import options
from jaxwhisker.cli.motion import add_motion
from jaxwhisker.cli.scan import exit_code, run_of
from jaxwhisker.cli.scene_file import add_scene_file
from jaxwhisker.film.animate import FPS, LONGEST, SECONDS, animate, check

if TYPE_CHECKING:
    from jaxwhisker.plot.runs import Run


def add_film(commands) -> None:
    """Add the command `film`."""
    command = options.add_command(commands, run_film, "write a film of one scene")
    add_scene_file(command)
    command.add_argument("file", type=Path, metavar="FILE", help="film: .mp4, .webm or .gif")
    options.add_sensor(command)
    options.add_object(command)
    options.add_drive(command)
    options.add_detect(command)
    add_motion(command)
    add = command.add_argument_group("film").add_argument
    number = options.parse_number
    text = f"duration of the scan or motion in the film (default: {SECONDS:g}, or that of --playback-speed)"
    add("--seconds", type=number, metavar="T", help=text)
    text = "time of the motion per second of the film; 0.1 is ten times slower (default: that of --seconds)"
    add("--playback-speed", type=number, metavar="V", help=text)
    add("--fps", type=int, default=FPS, metavar="N", help="frames per second (default: %(default)s)")
    add("--width", type=int, default=960, metavar="PIXELS", help="width of the film (default: %(default)s)")
    options.add_units(add)


def run_film(args: argparse.Namespace) -> int:
    r"""Scan one object with the whiskers of one model, or the scene of a file, and
    write a film of it: whiskers, springs and contact forces on the left, the
    reactions on the right, and every event as it happens. A snap appears as the
    motion of the bases after the loss of stability. This motion is not to scale in
    time.

    With --drive-speed, the film shows the motion in time instead, with reactions
    over time; see `jaxwhisker scan`.

    Units and signs are those of `jaxwhisker scan`. Videos (.mp4, .webm) need
    ffmpeg; a .gif needs nothing.

    exit codes:
      0  every step is ok
      1  some steps failed: their whiskers are missing, and the film says why
      2  an option or a parameter is wrong, or the file cannot be written
      3  no whisker touches the object

    examples:
      jaxwhisker film --model FBFBR --stiffness 70 --distance 0.2 scan.mp4
      jaxwhisker film examples/sensor.toml scan.gif
      jaxwhisker film --model FB --profile circle --seconds 6 --width 640 scan.gif
      jaxwhisker film --drive-speed 0.2 --mass-per-length 1 \
          --stiffness-damping 0.02 --playback-speed 1 motion.mp4
    """
    options.check_writable(args.file)
    with options.usage_errors():
        check(args.file, SECONDS if args.seconds is None else args.seconds, args.fps, args.width)
        _check_playback(args)
        result = run_of(args)
        seconds = _seconds_of(result, args)
    print(status_line(result)[1], flush=True)
    code = exit_code(result)
    animate(result, args.file, seconds=seconds, fps=args.fps, width=args.width, units=args.units)
    print(f"wrote {args.file}")
    return code


def _check_playback(args: argparse.Namespace) -> None:
    if args.playback_speed is None:
        return
    checks.number("speed", args.playback_speed, positive=True)
    if args.seconds is not None:
        raise ValueError("--playback-speed must not be given with --seconds: each of them sets the duration.")


def _seconds_of(result: "Run", args: argparse.Namespace) -> float:
    """Duration of the film."""
    from jaxwhisker.film.pace import duration_of_film

    return duration_of_film(result, args.seconds, args.playback_speed, default=SECONDS, longest=LONGEST)
