"""What the commands share: exit codes, kinds of options, checks before the work."""

import argparse
import math
import os
from pathlib import Path

import numpy as np

from jaxwhisker._model.profiles import Circle, Ellipse, Parabola

MODELS = ("clamped", "FB", "FBFB", "FBFBR", "FBFBFBR")
MAX_STEPS = 1_000_000
OK, NOT_ALL_OK, USAGE, INTERRUPTED = 0, 1, 2, 130  # exit codes

# The options of each profile and their defaults; an option of another profile is refused.
PROFILES = {
    "parabola": (Parabola, {"a": 1.0}),
    "circle": (Circle, {"radius": 1.0}),
    "ellipse": (Ellipse, {"a": 1.0, "b": 0.8}),
}


class UsageError(Exception):
    """What the user has to change; its message goes to stderr as one line."""


def number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, but is {text!r}") from None


def numbers(text: str) -> float | tuple[float, ...]:
    parts = tuple(number(part) for part in text.split(","))
    return parts[0] if len(parts) == 1 else parts


def model(text: str) -> str:
    for name in MODELS:
        if text.lower() == name.lower():
            return name
    raise argparse.ArgumentTypeError(f"must be one of {', '.join(MODELS)}, but is {text!r}")


def check_writable(path: Path | None) -> None:
    # Before the work, not after it.
    if path is None:
        return
    if path.is_dir():
        raise UsageError(f"cannot write {path}: it is a folder")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"cannot write {path}: there is no folder {path.parent}")
    if not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
        raise UsageError(f"cannot write {path}: no permission")


def check_picture(path: Path | None) -> None:
    if path is None:
        return
    from matplotlib.backend_bases import FigureCanvasBase

    if path.suffix.lstrip(".").lower() not in FigureCanvasBase.get_supported_filetypes():
        raise UsageError(f"--plot must end with .png, .pdf, .svg or another format of matplotlib, but is {path}.")


def add_sensor(command: argparse.ArgumentParser) -> None:
    """Add the options of whiskers and springs."""
    add = command.add_argument_group("whiskers and springs").add_argument
    add("--model", type=model, default="FB", metavar="NAME", help=f"{', '.join(MODELS)} (default: %(default)s)")
    add(
        "--stiffness",
        type=numbers,
        metavar="C[,C...]",
        help="stiffness of all springs, or of each, in the order c1, c2, ...; inf is a rigid link (default: 70)",
    )
    add(
        "--rest-length",
        type=numbers,
        metavar="L[,L...]",
        help="rest length of each spring of the row, or one per spring, feedback included; one number gives a feedback "
        "spring the sum of those that it spans (default: 0.2)",
    )
    add("--length", type=number, default=1.0, metavar="L", help="length of the whiskers (default: %(default)s)")
    add("--bending-stiffness", type=number, default=1.0, metavar="EI", help="of the whiskers (default: %(default)s)")


def add_object(command: argparse.ArgumentParser, kind) -> None:
    """Add the options of the object, whose values are of some kind."""
    add = command.add_argument_group("object").add_argument
    add("--profile", choices=tuple(PROFILES), default="parabola", help="shape of the object (default: %(default)s)")
    add("--distance", type=kind, default="0.2", metavar="Q", help="height of its lowest point (default: %(default)s)")
    add("--position", type=kind, default="0.0", metavar="X", help="x of its lowest point (default: %(default)s)")
    add(
        "--a",
        type=kind,
        metavar="A",
        help="parabola y = q + A x^2: half the curvature at the vertex; ellipse: horizontal half axis (default: 1)",
    )
    add("--b", type=kind, metavar="B", help="ellipse: vertical half axis (default: 0.8)")
    add("--radius", type=kind, metavar="R", help="circle: radius (default: 1)")


def add_drive(command: argparse.ArgumentParser) -> None:
    """Add the options of the drive."""
    add = command.add_argument_group("drive").add_argument
    add("--start", type=number, metavar="U", help="first position (default: just before the first touch)")
    add("--stop", type=number, metavar="U", help="last position (default: just after the last whisker is free)")
    add("--step", type=number, metavar="DU", help="distance of the positions (default: 0.001 of a whisker's length)")


def shape_of(args: argparse.Namespace) -> dict:
    """The options of the profile that `args` name, defaults filled in; those of another one are refused."""
    _, defaults = PROFILES[args.profile]
    for option in ("a", "b", "radius"):
        if getattr(args, option) is not None and option not in defaults:
            raise ValueError(f"--{option} does not belong to --profile {args.profile}.")
    return {k: default if getattr(args, k) is None else getattr(args, k) for k, default in defaults.items()}


def check_springs(args: argparse.Namespace) -> None:
    """Refuse options of springs where there are none."""
    if args.model == "clamped":
        for option in ("stiffness", "rest_length"):
            if getattr(args, option) is not None:
                raise ValueError(f"--{option.replace('_', '-')} does not belong to --model clamped: it has no springs.")


def check_drive(args: argparse.Namespace) -> None:
    """Refuse positions and steps of the drive that are none."""
    for option in ("start", "stop", "step"):
        value = getattr(args, option)
        if value is not None and not math.isfinite(value):
            raise ValueError(f"--{option} must be a finite number, but is {value}.")
    if args.step is not None and not args.step > 0:
        raise ValueError(f"--step must be positive, but is {args.step}; a scan towards +x has --stop above --start.")


def positions(start: float, stop: float, step: float) -> np.ndarray:
    """Positions of the drive from start to stop."""
    steps = abs(stop - start) / step
    if steps > MAX_STEPS:
        raise ValueError(f"--step must leave at most {MAX_STEPS} positions, but is {step}: they would be {steps:.3g}.")
    # A last position that rounding alone puts beyond --stop is kept.
    return start + np.sign(stop - start) * step * np.arange(int(steps + 1e-9) + 1)
