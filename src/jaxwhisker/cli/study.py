"""The command `study`: one model over ranges of parameters."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxwhisker._model.scene import Scene
from jaxwhisker._scan.dataset import in_shown_units
from jaxwhisker._scan.report import table
from jaxwhisker._study.critical import steepness
from jaxwhisker._study.study import SUMMARISED, study
from jaxwhisker._study.summary import summary
from jaxwhisker.cli import options

if TYPE_CHECKING:
    import xarray as xr

PRINTED = ("min_fx", "max_fx", "max_fy", "max_mz", "contact_width")


def axis(text: str) -> tuple[float, ...]:
    """Values of a parameter: start:stop:count, or numbers separated by commas."""
    if ":" not in text:
        return tuple(options.parse_number(part) for part in text.split(","))
    parts = text.split(":")
    if len(parts) != 3 or not parts[2].isdecimal() or int(parts[2]) < 2:
        raise argparse.ArgumentTypeError(f"must be start:stop:count with a count of at least 2, got {text!r}")
    return tuple(np.linspace(options.parse_number(parts[0]), options.parse_number(parts[1]), int(parts[2])).tolist())


def add_study(commands) -> None:
    """Add the command `study`."""
    command = options.add_command(commands, run_study, "scan many scenes: one model over ranges of parameters")
    options.add_sensor(command, axis, axis, several=False)
    options.add_object(command, axis)
    options.add_detect(command)
    options.add_drive(command)
    add = command.add_argument_group("output").add_argument
    add("--store", type=Path, metavar="FOLDER", help="zarr store of the results")
    add("--summary", action="store_true", help="keep only peaks, positions of events and widths, not the signals")
    add("--plot", type=Path, metavar="FILE", help="picture: .png, .pdf, .svg, ...; for one or two ranges")


def run_study(args: argparse.Namespace) -> int:
    r"""Scan the scenes of one model at every combination of parameters. Each parameter
    takes a range start:stop:count, values a,b,c or one number. The command prints a
    summary. It writes the scans to --store and a map of the largest moment to
    --plot.

    Units and signs are those of `jaxwhisker scan`: the table and the map show SI
    units with prefixes unless L = EI = 1. The same command line resumes a study
    that was interrupted. xarray.open_zarr(store) reads the store.

    exit codes:
      0  at least one scan is ok; the number of failed scans is printed
      1  all scans failed: they contain NaN and a status with the reason
      2  an option or a parameter is wrong, or a file cannot be written
      3  no whisker touches the object in any scan

    examples:
      jaxwhisker study --model FBFBR --stiffness 30:200:64 \
          --distance 0.1:0.4:16 --store out.zarr --plot map.png
      jaxwhisker study --stiffness 30,50,70,inf --summary --store small.zarr
    """
    options.check_outputs(args.plot)
    options.check_writable(args.store, folder=True)
    with options.usage_errors():
        build, axes = _builder(args)
        if args.plot is not None and len(axes) > 2:
            raise ValueError(f"--plot shows one or two ranges, got {len(axes)}: {', '.join(axes)}.")
        options.check_drive(args)
        control = options.control_of(args, None)
        ranges = [f"{name} {v.min():g} to {v.max():g} ({v.size} values)" for name, v in axes.items()]
        scans = int(np.prod([values.size for values in axes.values()]))
        print(f"{args.model}, {args.profile}: {scans:,} scans; {', '.join(ranges)}", flush=True)
        small = args.summary or args.store is None
        kept = () if small else SUMMARISED
        data = study(build, control=control, summary=small, outputs=kept, store=args.store, **axes)
    peaks = data if small else summary(data)
    rows = _table_rows(in_shown_units(peaks, peaks.attrs))
    print(f"\n{table(rows[0], rows[1:])}\n\nscans: {data.attrs['points']}")
    if args.store is not None:
        print(f"wrote {args.store}")

    def draw(plot: ModuleType) -> np.ndarray:
        axs = plot.study(peaks, critical=steepness(build, peaks))
        axs[0].figure.suptitle(data.attrs["scene"], fontsize="medium")
        return axs

    options.save_picture(args.plot, draw)
    return _exit_code(peaks)


def _builder(args: argparse.Namespace) -> tuple[Callable[..., Scene], dict[str, Any]]:
    """The function that builds scenes from the varied parameters, and their values."""
    given = {name: np.atleast_1d(np.asarray(v, dtype=float)) for name, v in options.given_values(args).items()}
    axes = {name: values for name, values in given.items() if values.size > 1}
    if not axes:
        raise ValueError("a study needs a range, such as --stiffness 30:200:64; `jaxwhisker scan` scans one scene.")
    fixed = {name: float(values[0]) for name, values in given.items() if values.size == 1}
    build = partial(options.make_scene, args, **fixed)
    # Fixed parameters must be valid; varied ones may fail at some points.
    usable = {name: values[np.isfinite(values) & (values > 0)] for name, values in axes.items()}
    build(**{name: float(values[0]) if values.size else 1.0 for name, values in usable.items()})
    return build, axes


def _exit_code(peaks: "xr.Dataset") -> int:
    """The exit code; print the number of scans without contact if there are any."""
    if bool((peaks.steps_failed > 0).all()):
        return options.NOT_ALL_OK
    without = int((peaks.max_fy == 0).all("whisker").sum())  # the object only pushes, so fy > 0 in every contact
    if without == peaks.steps_failed.size:
        print("No whisker touches the object in any scan: all reactions are zero.")
        return options.NO_CONTACT
    if without:
        print(f"No whisker touches the object in {without:,} of {peaks.steps_failed.size:,} scans.")
    return options.OK


def _table_rows(peaks: "xr.Dataset") -> list[list[str]]:
    """Header and one row per peak and whisker: its range over the study."""
    rows = [["whisker", "quantity", "smallest", "median", "largest"]]
    for whisker in peaks.whisker.values:
        for name in PRINTED:
            values = peaks[name].sel(whisker=whisker).values
            values = values[np.isfinite(values)]
            unit = peaks[name].attrs["units"]
            cells = [f"{f(values):.5g}" for f in (np.min, np.median, np.max)] if values.size else ["-"] * 3
            rows.append([str(whisker), f"{name.replace('_', ' ')} ({unit})", *cells])
    return rows
