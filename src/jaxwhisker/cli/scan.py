"""The command `scan`: one scene."""

import argparse
from pathlib import Path

import numpy as np

from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.export import to_csv
from jaxwhisker._scan.report import event_rows, peak_rows, status_line, table
from jaxwhisker._scan.scan import STEP, scan
from jaxwhisker.cli.options import (
    NOT_ALL_OK,
    OK,
    PROFILES,
    UsageError,
    add_drive,
    add_object,
    add_sensor,
    check_drive,
    check_picture,
    check_springs,
    check_writable,
    number,
    positions,
    shape_of,
)

HELP = """\
Scan one object with the whiskers of one model. A table of events, the peaks
and the count of failed steps go to the screen, the signals to --csv, a picture
to --plot.
"""
END = """\
Any consistent system of units will do. With the defaults all is dimensionless:
lengths in L, forces in EI/L^2, moments in EI/L, stiffnesses in EI/L^3. The
drive moves towards -x; reactions are those of the support on the whisker.

The CSV begins with a comment line: pandas.read_csv(file, comment="#").

exit codes:
  0  every step is ok
  1  some steps failed: they hold NaN, and the status says why
  2  an option or a parameter is wrong, or a file cannot be written

examples:
  jaxwhisker scan --model FBFBR --stiffness 70 --distance 0.2 \\
      --plot fig.png --csv scan.csv
  jaxwhisker scan --model FBFB --stiffness 70,inf --rest-length 0.2,0.3
  jaxwhisker scan --model clamped --profile circle --start 0.5 --stop -1
"""


def add(commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "scan",
        help="scan one scene of your own",
        description=HELP,
        epilog=END,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_sensor(command)
    add_object(command, number)
    add_drive(command)
    add = command.add_argument_group("output").add_argument
    add("--plot", type=Path, metavar="FILE", help="picture: .png, .pdf, .svg, ...")
    add("--csv", type=Path, metavar="FILE", help="control, reactions, base positions, spring lengths, phases, status")
    command.set_defaults(run=_run)


def scene_of(args: argparse.Namespace) -> Scene:
    """The scene that the options tell."""
    check_springs(args)
    stiffness = 70.0 if args.stiffness is None else args.stiffness
    rest_length = 0.2 if args.rest_length is None else args.rest_length
    support = Support.named(args.model, stiffness, rest_length)
    profile = PROFILES[args.profile][0](distance=args.distance, position=args.position, **shape_of(args))
    return Scene(Whisker(args.length, args.bending_stiffness), profile, support)


def control_of(args: argparse.Namespace, scene: Scene) -> np.ndarray | None:
    """Positions of the drive, None for the default ones."""
    check_drive(args)
    if args.start is None and args.stop is None and args.step is None:
        return None
    start, stop = args.start, args.stop
    if start is None or stop is None:
        usual = np.asarray(scan(scene).control)
        start, stop = (usual[0] if start is None else start), (usual[-1] if stop is None else stop)
    return positions(start, stop, STEP * args.length if args.step is None else args.step)


def _run(args: argparse.Namespace) -> int:
    for path in (args.plot, args.csv):
        check_writable(path)
    check_picture(args.plot)
    try:
        scene = scene_of(args)
        control = control_of(args, scene)
    except ValueError as error:
        raise UsageError(str(error)) from None
    print(scene, flush=True)
    result = scan(scene) if control is None else scan(scene, control)
    rows = event_rows(result)
    print()
    print(table(rows[0], rows[1:]) if len(rows) > 1 else "No events: the whiskers never touch the object.")
    rows = peak_rows(result)
    print()
    print(table(rows[0], rows[1:]))
    failed, line = status_line(result)
    print()
    print(line)
    if args.csv is not None:
        to_csv(result, args.csv)
        print(f"wrote {args.csv}")
    if args.plot is not None:
        from jaxwhisker import plot

        plot.save(plot.overview(result), args.plot, dpi=130)
        print(f"wrote {args.plot}")
    return NOT_ALL_OK if failed else OK
