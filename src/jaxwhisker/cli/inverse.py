"""The commands `identify` and `reconstruct`: from measured signals back to sensor and object."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxwhisker._inverse.fit_status import FitStatus
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.report import write_columns, write_rows
from jaxwhisker.cli.options import (
    NOT_ALL_OK,
    OK,
    PROFILES,
    UsageError,
    add_object,
    add_sensor,
    check_picture,
    check_springs,
    check_writable,
    number,
    shape_of,
)

DATA = """\
The file has a line of names, control and any of fx, fy, mz (fx_1, fx_2, ... of
several whiskers), and a line per position of the drive, in the order in which
it moved; lines that begin with # are skipped. Signs and units are those of
`jaxwhisker scan --csv`, whose files will do.
"""
IDENTIFY = f"""\
Find stiffnesses, rest lengths, the object's distance and shape, ... from
measured support reactions. Options give the scene; what --free names is
fitted, from --guess or from the option's value.

{DATA}"""
IDENTIFY_END = """\
names: stiffness (of all springs, each its own: c1, c2, ...), rest_length (l1,
l2, ...), c1, l2, ..., distance, position, a, b, radius, length,
bending_stiffness

exit codes:
  0  the fit ended well
  1  it did not: the reason is printed, and there are no standard errors
  2  an option or the data are wrong, or a file cannot be written

example:
  jaxwhisker identify examples/measured.csv --model FBFBR \\
      --guess stiffness=100,distance=0.25 --free stiffness,distance
"""
RECONSTRUCT = f"""\
Find where the whiskers touched the object, from measured support reactions
and what is known of the sensor; then fit a contour to all signals at once.

{DATA}"""
RECONSTRUCT_END = """\
exit codes:
  0  contacts were found, and the fit, if one was asked for, ended well
  1  no contact was found, or the fit did not end well
  2  an option or the data are wrong, or a file cannot be written

example:
  jaxwhisker reconstruct examples/measured.csv --model FBFBR \\
      --stiffness 60,80,70 --sigma fx=0.05,fy=0.1,mz=0.045 --plot contour.png
"""


def add(commands) -> None:
    """Add the commands."""
    command = _command(commands, "identify", "fit a scene's parameters to measured signals", IDENTIFY, IDENTIFY_END)
    add_sensor(command)
    add_object(command, number)
    add = command.add_argument_group("fit").add_argument
    add("--free", required=True, metavar="NAME[,NAME...]", help="what is fitted")
    add("--guess", type=_named, default={}, metavar="NAME=X[,...]", help="where to start")
    add("--sigma", type=_sigma, metavar="X | fx=X,fy=X,mz=X", help="standard deviation of the noise (default: unknown)")
    add("--offsets", action="store_true", help="each channel is off by an unknown constant")
    add("--shift", action="store_true", help="the control is off by an unknown constant")
    _add_output(command, "estimates and standard errors")
    command.set_defaults(run=_identify)

    command = _command(
        commands, "reconstruct", "find the object's contour in measured signals", RECONSTRUCT, RECONSTRUCT_END
    )
    add_sensor(command)
    add = command.add_argument_group("contour").add_argument
    add("--sigma", type=_sigma, metavar="X | fx=X,fy=X,mz=X", help="standard deviation of the noise (default: none)")
    add(
        "--family",
        choices=("points", "parabola", "circle", "ellipse", "free"),
        default="points",
        help="points only, or a shape fitted to them; free: any convex contour, to all signals (default: %(default)s)",
    )
    add("--knots", type=int, default=11, metavar="N", help="of a free contour (default: %(default)s)")
    _add_output(command, "points with slope, phase and standard error")
    command.set_defaults(run=_reconstruct)


def _command(commands, name: str, short: str, description: str, epilog: str) -> argparse.ArgumentParser:
    command = commands.add_parser(
        name, help=short, description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    command.add_argument("data", type=Path, metavar="DATA.csv", help="measured signals")
    return command


def _add_output(command: argparse.ArgumentParser, what: str) -> None:
    add = command.add_argument_group("output").add_argument
    add("--plot", type=Path, metavar="FILE", help="picture: .png, .pdf, .svg, ...")
    add("--csv", type=Path, metavar="FILE", help=what)


def _named(text: str) -> dict[str, float]:
    found = {}
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if not equals:
            raise argparse.ArgumentTypeError(f"must be NAME=VALUE, but is {part!r}")
        found[name.strip().replace("-", "_")] = number(value)
    return found


def _sigma(text: str) -> float | dict[str, float]:
    return _named(text) if "=" in text else number(text)


def _springs(args: argparse.Namespace) -> Support:
    check_springs(args)
    stiffness = 70.0 if args.stiffness is None else args.stiffness
    return Support.named(args.model, stiffness, 0.2 if args.rest_length is None else args.rest_length)


def _parameters(args: argparse.Namespace) -> tuple[dict[str, float], Callable[..., Scene]]:
    """Every number of the scene by name, and the function that makes it from them."""
    ends = [spring.between for spring in _springs(args).springs]
    values: dict[str, float] = {f"c{k + 1}": float(s.softness**-1) for k, s in enumerate(_springs(args).springs)}
    values |= {f"l{k + 1}": float(s.rest_length) for k, s in enumerate(_springs(args).springs)}
    shape = {name: float(value) for name, value in shape_of(args).items()}
    values |= {name: float(getattr(args, name)) for name in ("distance", "position", "length", "bending_stiffness")}
    values |= shape

    def build(**v) -> Scene:
        stiffness, rest = ([v[f"{name}{k + 1}"] for k in range(len(ends))] for name in "cl")
        support = Support.named(args.model, stiffness, rest) if ends else Support()
        of_profile = {name: v[name] for name in ("distance", "position", *shape)}
        return Scene(Whisker(v["length"], v["bending_stiffness"]), PROFILES[args.profile][0](**of_profile), support)

    return values, build


def _expanded(name: str, values: dict[str, float]) -> list[str]:
    """The parameters that a name of the command line stands for."""
    letter = {"stiffness": "c", "rest_length": "l"}.get(name)
    found = [n for n in values if n == name or (letter is not None and n[0] == letter and n[1:].isdigit())]
    if not found:
        raise UsageError(f"{name} is no parameter of this scene, which has {', '.join(values)}")
    return found


def _identify(args: argparse.Namespace) -> int:
    from jaxwhisker._inverse.identify import identify

    for path in (args.plot, args.csv):
        check_writable(path)
    check_picture(args.plot)
    try:
        values, whole = _parameters(args)
        free = [n for name in args.free.split(",") for n in _expanded(name.strip().replace("-", "_"), values)]
        for name, value in args.guess.items():
            values.update(dict.fromkeys(_expanded(name, values), float(value)))
        fixed = {name: value for name, value in values.items() if name not in free}

        def build(**sought) -> Scene:
            return whole(**fixed, **sought)

        guess = {name: values[name] for name in dict.fromkeys(free)}
        print(f"fitting {', '.join(guess)} to {args.data}", flush=True)
        fit = identify(build, guess, args.data, sigma=args.sigma, offsets=args.offsets, shift=args.shift)
    except ValueError as error:
        raise UsageError(str(error)) from None
    print(f"\n{fit}")
    if args.csv is not None:
        rows = [
            [n, repr(fit.estimates[n]), _cell(fit.standard_error[n]), *map(_cell, fit.interval[n])] for n in fit.names
        ]
        write_rows([["parameter", "estimate", "standard_error", "low", "high"], *rows], args.csv)
        print(f"wrote {args.csv}")
    if args.plot is not None:
        from jaxwhisker import plot

        _save(plot.fit(fit)[0], args.plot)
    return OK if fit.status == FitStatus.ok else NOT_ALL_OK


def _cell(value: float) -> str:
    return repr(float(value)) if np.isfinite(value) else "-"


def _save(ax: Any, path: Path) -> None:
    from jaxwhisker import plot

    plot.save(ax, path, dpi=130)
    print(f"wrote {path}")


def _reconstruct(args: argparse.Namespace) -> int:
    from jaxwhisker._inverse.fit_contour import fit_contour
    from jaxwhisker._inverse.fit_profile import fit_profile
    from jaxwhisker._inverse.reconstruct import reconstruct
    from jaxwhisker._model.scene import Sensor

    for path in (args.plot, args.csv):
        check_writable(path)
    check_picture(args.plot)
    try:
        sensor = Sensor(Whisker(args.length, args.bending_stiffness), _springs(args))
        found = reconstruct(args.data, sensor, sigma=args.sigma)
        print(found)
        shape, joint, good = None, None, bool(np.isfinite(np.asarray(found.x)).any())
        if good and args.family == "free":
            joint = fit_contour(args.data, sensor, sigma=args.sigma, knots=args.knots)
            print(f"\n{joint}")
            good = joint.fit.status == FitStatus.ok
        elif good and args.family != "points":
            shape = fit_profile(found, PROFILES[args.family][0])
            print(f"\n{shape}")
            good = shape.status == FitStatus.ok
    except ValueError as error:
        raise UsageError(str(error)) from None
    if args.csv is not None:
        columns = {"control": np.asarray(found.control)}
        for k in range(found.x.shape[1]):
            for name in ("x", "y", "slope", "arc", "force", "normal_error", "phase", "status"):
                columns[f"{name}_{k + 1}"] = np.asarray(getattr(found, name))[:, k]
        write_columns(columns, args.csv, "contact points; normal_error: standard error across the contour")
        print(f"wrote {args.csv}")
    if args.plot is not None:
        from jaxwhisker import plot

        ax = plot.contour(found, profile=None if shape is None else shape.profile)
        if joint is not None:
            plot.contour(joint, ax=ax)
        _save(ax, args.plot)
    return OK if good else NOT_ALL_OK
