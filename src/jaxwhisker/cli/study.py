"""The command `study`: one model over ranges of parameters."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.report import table
from jaxwhisker._scan.scan import STEP
from jaxwhisker.cli.options import (
    MODELS,
    NOT_ALL_OK,
    OK,
    PROFILES,
    UsageError,
    add_drive,
    add_object,
    check_drive,
    check_picture,
    check_springs,
    check_writable,
    model,
    number,
    positions,
    shape_of,
)

HELP = """\
Scan the scenes of one model at every combination of parameters. Each takes a
range start:stop:count, values a,b,c or one number. A summary goes to the
screen, the scans to --store, a map of the largest moment to --plot.
"""
END = """\
Units and signs are those of `jaxwhisker scan`. A study that was interrupted
goes on where it was when the same line is given again.

The store is read with xarray.open_zarr(store).

exit codes:
  0  every scan is ok
  1  some scans failed: they hold NaN, and the status says why
  2  an option or a parameter is wrong, or a file cannot be written

examples:
  jaxwhisker study --model FBFBR --stiffness 30:200:64 \\
      --distance 0.1:0.4:16 --store out.zarr --plot map.png
  jaxwhisker study --stiffness 30,50,70,inf --summary --store small.zarr
"""
AXES = ("stiffness", "rest_length", "length", "bending_stiffness", "distance", "position", "a", "b", "radius")


def axis(text: str) -> tuple[float, ...]:
    """Values of a parameter: start:stop:count, or numbers with commas between."""
    if ":" not in text:
        return tuple(number(part) for part in text.split(","))
    parts = text.split(":")
    if len(parts) != 3 or not parts[2].isdecimal() or int(parts[2]) < 2:
        raise argparse.ArgumentTypeError(f"must be start:stop:count, count 2 or more, but is {text!r}")
    return tuple(np.linspace(number(parts[0]), number(parts[1]), int(parts[2])).tolist())


def add(commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "study",
        help="scan many scenes: one model over ranges of parameters",
        description=HELP,
        epilog=END,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = command.add_argument_group("whiskers and springs").add_argument
    add("--model", type=model, default="FB", metavar="NAME", help=f"{', '.join(MODELS)} (default: %(default)s)")
    add("--stiffness", type=axis, metavar="C", help="stiffness of all springs; inf is a rigid link (default: 70)")
    add(
        "--rest-length",
        type=axis,
        metavar="L",
        help="rest length of each spring of the row; a feedback spring has the sum of those that it spans "
        "(default: 0.2)",
    )
    add("--length", type=axis, default="1.0", metavar="L", help="length of the whiskers (default: %(default)s)")
    add("--bending-stiffness", type=axis, default="1.0", metavar="EI", help="of the whiskers (default: %(default)s)")
    add_object(command, axis)
    add_drive(command)
    add = command.add_argument_group("output").add_argument
    add("--store", type=Path, metavar="FOLDER", help="zarr store of the results")
    add("--summary", action="store_true", help="keep peaks, events' positions and widths only, not the signals")
    add("--plot", type=Path, metavar="FILE", help="picture: .png, .pdf, .svg, ...; for one or two ranges")
    command.set_defaults(run=_run)


def build(*, model: str, profile: str, shape: tuple[str, ...], **numbers) -> Scene:
    """The scene of a model before a profile, whose shape takes the named ones of the numbers."""
    whisker = Whisker(numbers["length"], numbers["bending_stiffness"])
    own = {name: numbers[name] for name in ("distance", "position", *shape)}
    springs = [] if model == "clamped" else [numbers["stiffness"], numbers["rest_length"]]
    return Scene(whisker, PROFILES[profile][0](**own), Support.named(model, *(springs or [1.0])))


def _builder(args: argparse.Namespace) -> tuple[Callable[..., Scene], dict[str, Any]]:
    """The function that builds scenes from what varies, and what varies."""
    check_springs(args)
    shape = shape_of(args)
    given = {name: getattr(args, name) for name in AXES} | shape
    if args.model != "clamped":
        given = {"stiffness": (70.0,), "rest_length": (0.2,)} | {k: v for k, v in given.items() if v is not None}
    given = {
        name: np.atleast_1d(np.asarray(values, dtype=float)) for name, values in given.items() if values is not None
    }
    axes = {name: values for name, values in given.items() if values.size > 1}
    if not axes:
        raise ValueError("a study needs a range, as in --stiffness 30:200:64; `jaxwhisker scan` scans one scene.")
    fixed = {name: float(values[0]) for name, values in given.items() if values.size == 1}
    chosen = partial(build, model=args.model, profile=args.profile, shape=tuple(shape), **fixed)
    # What is the same everywhere has to be right; what varies may fail at some points.
    for name, values in axes.items():
        fixed[name] = float(values[np.isfinite(values) & (values > 0)][0]) if np.any(values > 0) else 1.0
    chosen(**{name: fixed[name] for name in axes})
    return chosen, axes


def _control(args: argparse.Namespace) -> np.ndarray | None:
    """Positions of the drive, None for the default ones."""
    check_drive(args)
    given = [option for option in ("start", "stop", "step") if getattr(args, option) is not None]
    if not given:
        return None
    for option in ("start", "stop"):
        if option not in given:
            raise ValueError(f"--{option} must be given with --{given[0]}: all scans of a study share their control.")
    step = STEP * max(args.length) if args.step is None else args.step
    return positions(args.start, args.stop, step)


def _run(args: argparse.Namespace) -> int:
    from jaxwhisker._study.study import SUMMARISED, study
    from jaxwhisker._study.summary import summary

    check_writable(args.plot)
    check_picture(args.plot)
    if args.store is not None and not args.store.absolute().parent.is_dir():
        raise UsageError(f"cannot write {args.store}: there is no folder {args.store.parent}")
    try:
        chosen, axes = _builder(args)
        if args.plot is not None and len(axes) > 2:
            raise ValueError(f"--plot shows one or two ranges, but there are {len(axes)}: {', '.join(axes)}.")
        control = _control(args)
        small = args.summary or args.store is None
        kept = () if small else SUMMARISED
        data = study(chosen, control=control, summary=small, outputs=kept, store=args.store, **axes)
    except (ValueError, ImportError) as error:
        raise UsageError(str(error)) from None
    found = data if small else summary(data)
    print(data.attrs["scene"])
    print()
    rows = _rows(found)
    print(table(rows[0], rows[1:]))
    print()
    print(f"scans: {data.attrs['points']}")
    if args.store is not None:
        print(f"wrote {args.store}")
    if args.plot is not None:
        from jaxwhisker import plot
        from jaxwhisker._study.critical import steepness

        axes = plot.study(found, critical=steepness(chosen, found))
        axes[0].figure.suptitle(data.attrs["scene"], fontsize="medium")
        plot.save(axes, args.plot, dpi=130)
        print(f"wrote {args.plot}")
    return OK if bool((found.steps_failed == 0).all()) else NOT_ALL_OK


def _rows(found) -> list[list[str]]:
    """Header and one row per peak and whisker: how it ranges over the study."""
    rows = [["whisker", "quantity", "smallest", "median", "largest"]]
    for whisker in found.whisker.values:
        for name in ("min_fx", "max_fx", "max_fy", "max_mz", "contact_width"):
            values = found[name].sel(whisker=whisker).values
            values = values[np.isfinite(values)]
            cells = [f"{f(values):.5g}" for f in (np.min, np.median, np.max)] if values.size else ["-"] * 3
            rows.append([str(whisker), name.replace("_", " "), *cells])
    return rows
