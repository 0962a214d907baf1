"""The command `film`: one scene, moving."""

import argparse
from pathlib import Path

from jaxwhisker._scan.report import status_line
from jaxwhisker._scan.scan import scan
from jaxwhisker.cli.options import (
    NOT_ALL_OK,
    OK,
    UsageError,
    add_drive,
    add_object,
    add_sensor,
    check_writable,
    number,
)
from jaxwhisker.cli.scan import control_of, scene_of
from jaxwhisker.film.animate import FPS, animate, check

HELP = """\
Scan one object with the whiskers of one model and make a film of it: whiskers,
springs and contact forces at the left, the reactions growing at the right,
events as they happen. Snaps are shown as the motion of the bases that follows
the loss of stability, not to scale in time.
"""
END = """\
Units and signs are those of `jaxwhisker scan`. Videos (.mp4, .webm) need
ffmpeg; a .gif needs nothing.

exit codes:
  0  every step is ok
  1  some steps failed: whiskers are missing there, and the film says why
  2  an option or a parameter is wrong, or the file cannot be written

examples:
  jaxwhisker film --model FBFBR --stiffness 70 --distance 0.2 scan.mp4
  jaxwhisker film --model FB --profile circle --seconds 6 --width 640 scan.gif
"""


def add(commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "film",
        help="make a film of one scene of your own",
        description=HELP,
        epilog=END,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument("file", type=Path, metavar="FILE", help="film: .mp4, .webm or .gif")
    add_sensor(command)
    add_object(command, number)
    add_drive(command)
    add = command.add_argument_group("film").add_argument
    add("--seconds", type=number, default="12", metavar="T", help="how long the scan takes (default: %(default)s)")
    add("--fps", type=int, default=FPS, metavar="N", help="frames per second (default: %(default)s)")
    add("--width", type=int, default=960, metavar="PIXELS", help="width of the film (default: %(default)s)")
    command.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    check_writable(args.file)
    try:
        check(args.file, args.seconds, args.fps, args.width)
        scene = scene_of(args)
        control = control_of(args, scene)
    except ValueError as error:
        raise UsageError(str(error)) from None
    print(scene, flush=True)
    result = scan(scene) if control is None else scan(scene, control)
    failed, line = status_line(result)
    print(line, flush=True)
    animate(result, args.file, seconds=args.seconds, fps=args.fps, width=args.width)
    print(f"wrote {args.file}")
    return NOT_ALL_OK if failed else OK
