"""The command `scan`: one scene."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxwhisker._file.scene_file import save_scene
from jaxwhisker._scan.export import to_csv
from jaxwhisker._scan.lateral import lateral_loss
from jaxwhisker._scan.report import event_table, is_timed, peak_table, status_line, timed_event_table, touches_object
from jaxwhisker._scan.result import Result
from jaxwhisker._scan.scan import scan
from jaxwhisker.cli import options
from jaxwhisker.cli.motion import add_motion, check_motion, motion_of
from jaxwhisker.cli.scene_file import add_scene_file, control_of, file_of

if TYPE_CHECKING:
    from jaxwhisker.plot.runs import Run


def add_scan(commands) -> None:
    """Add the command `scan`."""
    command = options.add_command(commands, run_scan, "scan one scene")
    add_scene_file(command)
    options.add_sensor(command)
    options.add_object(command)
    options.add_drive(command)
    options.add_detect(command)
    add_motion(command)
    text = "report where whiskers leave the plane without lateral guidance; K: curvature of the object across it"
    command.add_argument("--lateral-curvature", type=options.parse_number, metavar="K", help=text)
    add = options.add_output(command, csv="control, reactions, base positions, spring lengths, phases, status")
    add("--save", type=Path, metavar="SCENE.toml", help="file of the scene, for this and other commands")
    options.add_units(add)


def run_scan(args: argparse.Namespace) -> int:
    r"""Scan one object with the whiskers of one model, or the scene of a file, which
    may be in space. The command prints the events, the peaks and the number of
    failed steps. It writes the signals to --csv and a picture to --plot.

    Any consistent system of units is allowed: other defaults follow from --length
    (L) and --bending-stiffness (EI). With the defaults of these everything is
    dimensionless: lengths in L, forces in EI/L^2, moments in EI/L, stiffnesses in
    EI/L^3. Other numbers are shown as SI units (m, N, N m) with prefixes. The drive
    moves towards -x; reactions are those of the support on the whisker.

    The CSV has the units of the options. It begins with a comment line:
    pandas.read_csv(file, comment="#").

    With --drive-speed, the motion in time is simulated instead, with a sample at
    every drive position. By default it ends 2 T later than the scan. The unit of
    time is T = L^2 sqrt(RHO/EI), or a second if all options are in SI units. The
    CSV has the columns time, gap_1, tip_x_1 and tip_y_1 as well. Peaks contain
    impacts, whose height depends on the time step.

    exit codes:
      0  every step is ok
      1  some steps failed: they contain NaN and a status with the reason
      2  an option or a parameter is wrong, or a file cannot be written
      3  no whisker touches the object

    examples:
      jaxwhisker scan --model FBFBR --stiffness 70 --distance 0.2 \
          --plot fig.png --csv scan.csv
      jaxwhisker scan examples/sensor.toml --start 0.03 --csv scan.csv
      jaxwhisker scan --model FBFB --stiffness 70,inf --rest-length 0.2,0.3
      jaxwhisker scan --model clamped --profile circle --start 0.5 --stop -1
      jaxwhisker scan --model clamped --profile circle --lateral-curvature 0
      jaxwhisker scan --drive-speed 0.1 --mass-per-length 1 \
          --stiffness-damping 0.02 --csv motion.csv
    """
    options.check_outputs(args.plot, args.csv)
    options.check_writable(args.save)
    with options.usage_errors():
        if None not in (args.lateral_curvature, args.drive_speed):
            raise ValueError("--lateral-curvature belongs to scans, and --drive-speed to motions in time: choose one.")
        result = run_of(args)
        losses = None
        if args.lateral_curvature is not None and isinstance(result, Result):
            losses = np.asarray(lateral_loss(result, args.lateral_curvature))
    if touches_object(result):
        units = args.units
        events = timed_event_table(result, units) if is_timed(result) else event_table(result, units)
        print(f"\n{events}\n\n{peak_table(result, units)}\n")
    for k, loss in enumerate([] if losses is None else losses, 1):
        where = "stays in the plane" if np.isnan(loss) else f"leaves the plane at u = {float(loss):+.6g}"
        print(f"without lateral guidance, whisker {k} {where}")
    print(status_line(result)[1])
    if args.csv is not None:
        to_csv(result, args.csv)
        print(f"wrote {args.csv}")
    if args.save is not None:
        scene: Any = result.scene
        save_scene(scene, args.save)
        print(f"wrote {args.save}")

    def picture(plot):
        figure = plot.overview(result, units=args.units)
        if losses is not None:
            plot.lateral_losses(result, losses, axs=figure.axes[1:], units=args.units)
        return figure

    options.save_picture(args.plot, picture)
    return exit_code(result)


def run_of(args: argparse.Namespace) -> "Run":
    """Print the scene that the options or a file describe, and scan it, or simulate its motion."""
    file = file_of(args)
    scene: Any = options.scene_of(args) if file is None else file.scene
    options.check_drive(args)
    check_motion(args, scene)
    if scene.in_space and getattr(args, "lateral_curvature", None) is not None:
        raise ValueError("--lateral-curvature needs a scene in the plane.")
    print(scene, flush=True)
    if args.drive_speed is None:
        return scan(scene, control_of(args, scene, file))
    return motion_of(args, scene, file)


def exit_code(result: "Run") -> int:
    """The exit code for a scan or a motion; print a line if no whisker touches the object."""
    failed, _ = status_line(result)
    if failed:
        return options.NOT_ALL_OK
    if touches_object(result):
        return options.OK
    print("No whisker touches the object" + ": all reactions are zero" * (not is_timed(result)) + ".")
    return options.NO_CONTACT
