"""The command `jaxwhisker`: `scan` for one scene of your own, `reproduce` for the thesis's results."""

import argparse
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

import jaxwhisker
from jaxwhisker.profile import AbstractProfile, Circle, Ellipse, Parabola
from jaxwhisker.report import event_rows, peak_rows, status_line, table, write_scan
from jaxwhisker.scan import scan
from jaxwhisker.scene import Scene
from jaxwhisker.support import Support
from jaxwhisker.whisker import Whisker

MODELS = ("clamped", "FB", "FBFB", "FBFBR", "FBFBFBR")
MAX_STEPS = 1_000_000
OK, NOT_ALL_OK, USAGE, INTERRUPTED = 0, 1, 2, 130  # exit codes

# The options of each profile and their defaults; an option of another profile is refused.
PROFILES = {
    "parabola": (Parabola, {"a": 1.0}),
    "circle": (Circle, {"radius": 1.0}),
    "ellipse": (Ellipse, {"a": 1.0, "b": 0.8}),
}

SCAN_HELP = """\
Scan one object with the whiskers of one model. A table of events, the peaks
and the count of failed steps go to the screen, the signals to --csv, a picture
to --plot.
"""
SCAN_END = """\
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
REPRODUCE_HELP = """\
Compute and draw the results of the thesis: tables A.1-A.4, figures 5.10-5.16,
6.1-6.24 and 7.4, each as PNG with the data behind it as CSV, its claims with
numbers (claims.md), and all of it on one page (README.md, index.html).
"""


class _UsageError(Exception):
    """What the user has to change; its message goes to stderr as one line."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str):
        # One line, without the usage, which would bury it.
        self.exit(USAGE, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, but is {text!r}") from None


def _numbers(text: str) -> float | tuple[float, ...]:
    parts = tuple(_number(part) for part in text.split(","))
    return parts[0] if len(parts) == 1 else parts


def _model(text: str) -> str:
    for name in MODELS:
        if text.lower() == name.lower():
            return name
    raise argparse.ArgumentTypeError(f"must be one of {', '.join(MODELS)}, but is {text!r}")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="jaxwhisker", description="Quasi-static scans with elastically coupled tactile whiskers.")
    parser.add_argument("--version", action="version", version=f"jaxwhisker {jaxwhisker.__version__}")
    commands = parser.add_subparsers(dest="command", metavar="command", required=True)
    _add_scan(commands)
    _add_reproduce(commands)
    return parser


def _add_scan(commands) -> None:
    scan = commands.add_parser(
        "scan",
        help="scan one scene of your own",
        description=SCAN_HELP,
        epilog=SCAN_END,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = scan.add_argument_group("whiskers and springs").add_argument
    add("--model", type=_model, default="FB", metavar="NAME", help=f"{', '.join(MODELS)} (default: %(default)s)")
    add(
        "--stiffness",
        type=_numbers,
        metavar="C[,C...]",
        help="stiffness of all springs, or of each, in the order c1, c2, ...; inf is a rigid link (default: 70)",
    )
    add(
        "--rest-length",
        type=_numbers,
        metavar="L[,L...]",
        help="rest length of each spring of the row, or one per spring, feedback included; one number gives a feedback "
        "spring the sum of those that it spans (default: 0.2)",
    )
    add("--length", type=_number, default=1.0, metavar="L", help="length of the whiskers (default: %(default)s)")
    add("--bending-stiffness", type=_number, default=1.0, metavar="EI", help="of the whiskers (default: %(default)s)")
    add = scan.add_argument_group("object").add_argument
    add("--profile", choices=tuple(PROFILES), default="parabola", help="shape of the object (default: %(default)s)")
    add("--distance", type=_number, default=0.2, metavar="Q", help="height of its lowest point (default: %(default)s)")
    add("--position", type=_number, default=0.0, metavar="X", help="x of its lowest point (default: %(default)s)")
    add(
        "--a",
        type=_number,
        metavar="A",
        help="parabola y = q + A x^2: half the curvature at the vertex; ellipse: horizontal half axis (default: 1)",
    )
    add("--b", type=_number, metavar="B", help="ellipse: vertical half axis (default: 0.8)")
    add("--radius", type=_number, metavar="R", help="circle: radius (default: 1)")
    add = scan.add_argument_group("drive").add_argument
    add("--start", type=_number, metavar="U", help="first position (default: just before the first touch)")
    add("--stop", type=_number, metavar="U", help="last position (default: just after the last whisker is free)")
    add("--step", type=_number, metavar="DU", help="distance of the positions (default: 0.001 of a whisker's length)")
    add = scan.add_argument_group("output").add_argument
    add("--plot", type=Path, metavar="FILE", help="picture: .png, .pdf, .svg, ...")
    add("--csv", type=Path, metavar="FILE", help="control, reactions, base positions, spring lengths, phases, status")
    scan.set_defaults(run=_scan)


def _add_reproduce(commands) -> None:
    reproduce = commands.add_parser(
        "reproduce",
        help="the thesis's tables, figures and claims",
        description=REPRODUCE_HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    reproduce.add_argument(
        "--out", type=Path, default=Path("out"), metavar="DIR", help="folder for the results (default: %(default)s)"
    )
    reproduce.add_argument(
        "--only",
        metavar="NAME[,NAME...]",
        help="only these figures, tables or the claims, e.g. 6.2,A.1,claims (default: everything)",
    )
    reproduce.set_defaults(run=_reproduce)


def _profile(args: argparse.Namespace) -> AbstractProfile:
    kind, defaults = PROFILES[args.profile]
    for option in ("a", "b", "radius"):
        if getattr(args, option) is not None and option not in defaults:
            raise ValueError(f"--{option} does not belong to --profile {args.profile}.")
    given = {
        name: default if getattr(args, name) is None else getattr(args, name) for name, default in defaults.items()
    }
    return kind(distance=args.distance, position=args.position, **given)


def _scene(args: argparse.Namespace) -> Scene:
    if args.model == "clamped":
        for option in ("stiffness", "rest_length"):
            if getattr(args, option) is not None:
                raise ValueError(f"--{option.replace('_', '-')} does not belong to --model clamped: it has no springs.")
    stiffness = 70.0 if args.stiffness is None else args.stiffness
    rest_length = 0.2 if args.rest_length is None else args.rest_length
    support = Support.named(args.model, stiffness, rest_length)
    return Scene(Whisker(args.length, args.bending_stiffness), _profile(args), support)


def _control(args: argparse.Namespace, scene: Scene) -> np.ndarray | None:
    """Positions of the drive, None for the default ones."""
    if args.start is None and args.stop is None and args.step is None:
        return None
    for option in ("start", "stop", "step"):
        value = getattr(args, option)
        if value is not None and not math.isfinite(value):
            raise ValueError(f"--{option} must be a finite number, but is {value}.")
    step = 0.001 * args.length if args.step is None else args.step
    if not step > 0:
        raise ValueError(f"--step must be positive, but is {step}; a scan towards +x has --stop above --start.")
    start, stop = args.start, args.stop
    if start is None or stop is None:
        usual = np.asarray(scan(scene).control)
        start, stop = (usual[0] if start is None else start), (usual[-1] if stop is None else stop)
    steps = abs(stop - start) / step
    if steps > MAX_STEPS:
        raise ValueError(f"--step must leave at most {MAX_STEPS} positions, but is {step}: they would be {steps:.3g}.")
    # A last position that rounding alone puts beyond --stop is kept.
    return start + np.sign(stop - start) * step * np.arange(int(steps + 1e-9) + 1)


def _check_writable(path: Path | None) -> None:
    # Before the work, not after it.
    if path is None:
        return
    if path.is_dir():
        raise _UsageError(f"cannot write {path}: it is a folder")
    if not path.absolute().parent.is_dir():
        raise _UsageError(f"cannot write {path}: there is no folder {path.parent}")
    if not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
        raise _UsageError(f"cannot write {path}: no permission")


def _check_picture(path: Path | None) -> None:
    if path is None:
        return
    from matplotlib.backend_bases import FigureCanvasBase

    if path.suffix.lstrip(".").lower() not in FigureCanvasBase.get_supported_filetypes():
        raise _UsageError(f"--plot must end with .png, .pdf, .svg or another format of matplotlib, but is {path}.")


def _scan(args: argparse.Namespace) -> int:
    for path in (args.plot, args.csv):
        _check_writable(path)
    _check_picture(args.plot)
    try:
        scene = _scene(args)
        control = _control(args, scene)
    except ValueError as error:
        raise _UsageError(str(error)) from None
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
        write_scan(result, args.csv)
        print(f"wrote {args.csv}")
    if args.plot is not None:
        from jaxwhisker.plot import overview

        overview(result).savefig(args.plot, dpi=130)
        print(f"wrote {args.plot}")
    return NOT_ALL_OK if failed else OK


def _reproduce(args: argparse.Namespace) -> int:
    from jaxwhisker.reproduce import names, reproduce

    try:
        wanted = None if args.only is None else names(args.only)
    except ValueError as error:
        raise _UsageError(str(error)) from None
    if args.out.exists() and not args.out.is_dir():
        raise _UsageError(f"cannot write to {args.out}: it is a file")
    reproduce(args.out, wanted)
    return OK


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code.

    Wrong options and parameters, and files that cannot be written, end with one line on stderr and exit code 2.
    """
    parser = _parser()
    try:
        args = parser.parse_args(argv)
    except SystemExit as stop:  # argparse has printed what there is to say
        return stop.code if isinstance(stop.code, int) else USAGE
    jax.config.update("jax_enable_x64", True)
    try:
        return args.run(args)
    except (_UsageError, OSError) as error:
        message = " ".join(str(error).split())
        print(f"{parser.prog} {args.command}: error: {message}", file=sys.stderr)
        return USAGE
    except KeyboardInterrupt:
        return INTERRUPTED
