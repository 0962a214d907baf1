"""The commands `identify` and `reconstruct`: from measured signals to sensor and object."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from jaxwhisker._file.scene_file import SceneFile, save_scene
from jaxwhisker._inverse.features import noise_of
from jaxwhisker._inverse.fit_contour import fit_contour
from jaxwhisker._inverse.fit_profile import fit_profile
from jaxwhisker._inverse.identify import identify
from jaxwhisker._inverse.observations import read_observations
from jaxwhisker._inverse.reconstruct import reconstruct
from jaxwhisker._inverse.statistics import FitStatus
from jaxwhisker._model.scene import Sensor
from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker._scan.report import write_columns, write_rows
from jaxwhisker.cli import options
from jaxwhisker.cli.scene_file import add_scene_file, file_of

SIGNALS = """\
The file has a header with the names control and any of fx, fy, mz (fx_1,
fx_2, ... for several whiskers), and one row per drive position, in the order
in which the drive moved. Columns are separated by commas, semicolons or tabs;
other columns are ignored, as are lines that begin with #. Numbers may have
decimal commas, and the file may be compressed (.gz). Signs and units are
those of `jaxwhisker scan --csv`, whose files can be used as they are."""


def add_identify(commands) -> None:
    """Add the command `identify`."""
    command = options.add_command(commands, run_identify, "fit the parameters of a scene to measured signals")
    add_scene_file(command)
    _add_signals(command)
    options.add_object(command)
    add = command.add_argument_group("fit").add_argument
    add("--free", required=True, metavar="NAME[,NAME...]", help="parameters to fit")
    add("--guess", type=_named, default={}, metavar="NAME=X[,...]", help="initial values")
    _add_sigma(add, "estimated from the residuals")
    add("--offsets", action="store_true", help="fit an unknown constant offset of each channel")
    add("--gains", action="store_true", help="fit an unknown factor of each channel: signals in any unit")
    add("--shift", action="store_true", help="fit an unknown constant offset of the control")
    add = options.add_output(command, csv="estimates and standard errors")
    add("--save", type=Path, metavar="SCENE.toml", help="file of the scene with the estimates")


def add_reconstruct(commands) -> None:
    """Add the command `reconstruct`."""
    short = "reconstruct the contour of the object from measured signals"
    command = options.add_command(commands, run_reconstruct, short)
    _add_signals(command)
    add = command.add_argument_group("contour").add_argument
    _add_sigma(add, "estimated from the scatter between neighbouring samples")
    options.add_friction(add)
    families = ("points", "parabola", "circle", "ellipse", "free")
    text = (
        "points only, or a shape fitted to them; free: any convex contour, fitted to all signals (default: %(default)s)"
    )
    add("--family", choices=families, default="points", help=text)
    add("--knots", type=int, default=11, metavar="N", help="knots of a free contour (default: %(default)s)")
    options.add_output(command, csv="points with slope, phase and standard error")


def _add_signals(command: argparse.ArgumentParser) -> None:
    add = command.add_argument_group("measured signals", SIGNALS).add_argument
    add("data", type=Path, metavar="DATA.csv", help="table of the signals")
    options.add_sensor(command)


def _add_sigma(add: Callable, default: str) -> None:
    text = f"standard deviation of the noise (default: {default})"
    add("--sigma", type=_sigma, metavar="X | fx=X,fy=X,mz=X", help=text)


def _named(text: str) -> dict[str, float]:
    """Numbers by name."""
    values = {}
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if not equals:
            raise argparse.ArgumentTypeError(f"must be NAME=VALUE, got {part!r}")
        values[_name(name)] = options.parse_number(value)
    return values


def _name(text: str) -> str:
    return text.strip().replace("-", "_")


def _sigma(text: str) -> float | dict[str, float]:
    return _named(text) if "=" in text else options.parse_number(text)


def run_identify(args: argparse.Namespace) -> int:
    r"""Estimate stiffnesses, rest lengths, the distance and shape of the object, ...
    from measured support reactions. The options describe the scene. Parameters
    named by --free are fitted, starting from --guess or from the option's value.

    parameters: stiffness (of all springs, each on its own: c1, c2, ...),
    rest_length (l1, l2, ...), c1, l2, ..., distance, position, a, b, radius,
    length, bending_stiffness, and friction if --friction is given; with a file of a
    scene, every number in it, by its key: radius, or objects.2.radius if several
    numbers have this key. A key stands for all numbers that have it.

    exit codes:
      0  the fit is ok
      1  the fit failed: the reason is printed, and there are no standard errors
      2  an option or the data are wrong, or a file cannot be written

    example:
      jaxwhisker identify examples/measured.csv --model FBFBR \
          --guess stiffness=100,distance=0.25 --free stiffness,distance
      jaxwhisker identify sensor.toml measured.csv --free stiffness,radius \
          --save fitted.toml
    """
    options.check_outputs(args.plot, args.csv)
    options.check_writable(args.save)
    with options.usage_errors():
        file = file_of(args)
        values, expanded, make = _of_options(args) if file is None else _of_file(file)
        free = [n for name in args.free.split(",") for n in expanded(_name(name))]
        for name, value in args.guess.items():
            values |= dict.fromkeys(expanded(name), float(value))
        guess = {name: values.pop(name) for name in dict.fromkeys(free)}
        print(f"fitting {', '.join(guess)} to {args.data}", flush=True)
        build = partial(make, **values)
        unknown = {"offsets": args.offsets, "gains": args.gains, "shift": args.shift}
        fit = identify(build, guess, args.data, sigma=args.sigma, **unknown)
    print(f"\n{fit}")
    if args.csv is not None:
        rows = [
            [n, repr(fit.estimates[n]), _csv_cell(fit.standard_error[n]), *map(_csv_cell, fit.interval[n])]
            for n in fit.names
        ]
        write_rows([["parameter", "estimate", "standard_error", "low", "high"], *rows], args.csv)
        print(f"wrote {args.csv}")
    if args.save is not None:
        estimates = {name: fit.estimates[name] for name in guess}
        if file is None:
            save_scene(build(**estimates), args.save)
        else:
            file.save(args.save, values | estimates)
        print(f"wrote {args.save}")
    options.save_picture(args.plot, lambda plot: plot.fit(fit)[0])
    return options.OK if fit.status == FitStatus.ok else options.NOT_ALL_OK


def _of_options(args: argparse.Namespace) -> tuple[dict[str, float], Callable, Callable]:
    """Parameters of the scene of the options, what a name stands for, and the function that makes the scene."""
    values = _parameters(args)
    return values, lambda name: _expanded(name, values), partial(options.make_scene, args)


def _of_file(file: SceneFile) -> tuple[dict[str, float], Callable, Callable]:
    """The same of the scene in a file."""
    return {name: number.value for name, number in file.numbers.items()}, file.chosen, file.build


def _parameters(args: argparse.Namespace) -> dict[str, float]:
    """All parameters of the scene by name, with those of each spring."""
    values = options.with_defaults(args, options.given_values(args))
    springs = options.support_of(args, values).springs
    own = {f"c{k}": float(spring.softness**-1) for k, spring in enumerate(springs, 1)}
    own |= {f"l{k}": float(spring.rest_length) for k, spring in enumerate(springs, 1)}
    return own | {name: value for name, value in values.items() if name not in options.SPRINGS}


def _expanded(name: str, values: dict[str, float]) -> list[str]:
    """The parameters that a name in --free or --guess stands for."""
    names = [n for n in values if name in (n, options.option_of(n))]
    if not names:
        known = ", ".join(values)
        raise options.UsageError(f"--free and --guess must name parameters of the scene ({known}), got {name}.")
    return names


def _csv_cell(value: float) -> str:
    return repr(float(value)) if np.isfinite(value) else "-"


def run_reconstruct(args: argparse.Namespace) -> int:
    r"""Reconstruct the points at which the whiskers touched the object, from measured
    support reactions and the known sensor; then fit a contour to all signals.

    exit codes:
      0  contact points were reconstructed, and the fit, if any, is ok
      1  there is no contact, or the fit failed
      2  an option or the data are wrong, or a file cannot be written

    example:
      jaxwhisker reconstruct examples/measured.csv --model FBFBR \
          --stiffness 60,80,70 --sigma fx=0.05,fy=0.1,mz=0.045 --plot contour.png
    """
    options.check_outputs(args.plot, args.csv)
    shape, joint = None, None
    with options.usage_errors():
        values = options.with_defaults(args, options.given_values(args))
        sensor = Sensor(options.whisker_of(values), options.support_of(args, values), friction=args.friction)
        observations = read_observations(args.data, args.sigma, whiskers=len(sensor.whiskers))
        points = reconstruct(observations, sensor, sigma=args.sigma)
        if args.sigma is None and (noise := noise_of(observations)) is not None:
            each = ", ".join(f"{name}={value:.2g}" for name, value in zip(REACTIONS, noise, strict=True))
            print(f"noise estimated from the scatter between neighbouring samples: {each}")
        print(points)
        good = bool(np.isfinite(np.asarray(points.x)).any())
        if good and args.family == "free":
            joint = fit_contour(observations, sensor, sigma=args.sigma, knots=args.knots)
            print(f"\n{joint}")
            good = joint.fit.status == FitStatus.ok
        elif good and args.family != "points":
            shape = fit_profile(points, options.PROFILES[args.family][0])
            print(f"\n{shape}")
            good = shape.status == FitStatus.ok
    if args.csv is not None:
        _write_points(points, args.csv)

    def draw(plot: ModuleType) -> Any:
        ax = plot.contour(points, profile=None if shape is None else shape.profile)
        return ax if joint is None else plot.contour(joint, ax=ax)

    options.save_picture(args.plot, draw)
    return options.OK if good else options.NOT_ALL_OK


def _write_points(points, path: Path) -> None:
    """Write the reconstructed points as CSV."""
    columns = {"control": np.asarray(points.control)}
    for k in range(points.x.shape[1]):
        for name in ("x", "y", "slope", "arc", "force", "normal_error", "phase", "status"):
            columns[f"{name}_{k + 1}"] = np.asarray(getattr(points, name))[:, k]
    write_columns(columns, path, "contact points; normal_error: standard error across the contour")
    print(f"wrote {path}")
