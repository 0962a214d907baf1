"""The command `film`: a film of one scene."""

import argparse
from pathlib import Path

from jaxwhisker._scan.report import status_line
from jaxwhisker.cli import options
from jaxwhisker.cli.scan import exit_code, scan_of
from jaxwhisker.film.animate import FPS, animate, check


def add_film(commands) -> None:
    """Add the command `film`."""
    command = options.add_command(commands, run_film, "write a film of one scene")
    command.add_argument("file", type=Path, metavar="FILE", help="film: .mp4, .webm or .gif")
    options.add_sensor(command)
    options.add_object(command)
    options.add_drive(command)
    options.add_detect(command)
    add = command.add_argument_group("film").add_argument
    number = options.parse_number
    add("--seconds", type=number, default="12", metavar="T", help="duration of the scan (default: %(default)s)")
    add("--fps", type=int, default=FPS, metavar="N", help="frames per second (default: %(default)s)")
    add("--width", type=int, default=960, metavar="PIXELS", help="width of the film (default: %(default)s)")
    options.add_units(add)


def run_film(args: argparse.Namespace) -> int:
    """Scan one object with the whiskers of one model and write a film of it: whiskers,
    springs and contact forces on the left, the reactions on the right, and every
    event as it happens. A snap appears as the motion of the bases after the loss of
    stability. This motion is not to scale in time.

    Units and signs are those of `jaxwhisker scan`. Videos (.mp4, .webm) need
    ffmpeg; a .gif needs nothing.

    exit codes:
      0  every step is ok
      1  some steps failed: their whiskers are missing, and the film says why
      2  an option or a parameter is wrong, or the file cannot be written
      3  no whisker touches the object

    examples:
      jaxwhisker film --model FBFBR --stiffness 70 --distance 0.2 scan.mp4
      jaxwhisker film --model FB --profile circle --seconds 6 --width 640 scan.gif
    """
    options.check_writable(args.file)
    with options.usage_errors():
        check(args.file, args.seconds, args.fps, args.width)
        result = scan_of(args)
    print(status_line(result)[1], flush=True)
    code = exit_code(result)
    animate(result, args.file, seconds=args.seconds, fps=args.fps, width=args.width, units=args.units)
    print(f"wrote {args.file}")
    return code
