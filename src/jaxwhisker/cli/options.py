"""Options that commands share, the scenes and controls that they describe, and checks of output files."""

import argparse
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jaxwhisker._model.profiles import Circle, Ellipse, Parabola
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.quantities import UNITS
from jaxwhisker._scan.scan import MOST_STEPS, STEP, default_control

MODELS = ("clamped", "FB", "FBFB", "FBFBR", "FBFBFBR")
SPRINGS = {"stiffness": 70.0, "rest_length": 0.2}  # defaults of the options of springs
# Options of each profile with their defaults; options of another profile are rejected.
PROFILES = {
    "parabola": (Parabola, {"a": 1.0}),
    "circle": (Circle, {"radius": 1.0}),
    "ellipse": (Ellipse, {"a": 1.0, "b": 0.8}),
}
OK, NOT_ALL_OK, USAGE, NO_CONTACT, INTERRUPTED = 0, 1, 2, 3, 130  # exit codes


class UsageError(Exception):
    """An error that the user can correct; its message is printed on one line."""


@contextmanager
def usage_errors() -> Iterator[None]:
    """Convert errors about arguments and missing packages into usage errors."""
    try:
        yield
    except (ValueError, ImportError) as error:
        raise UsageError(str(error).replace("`control`", "control (--start, --stop and --step)")) from None


# Types of option values


def number(text: str) -> float:
    """A number."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}") from None


def numbers(text: str) -> float | tuple[float, ...]:
    """One number, or several separated by commas."""
    parts = tuple(number(part) for part in text.split(","))
    return parts[0] if len(parts) == 1 else parts


def model(text: str) -> str:
    """The name of a model, in upper or lower case."""
    for name in MODELS:
        if text.lower() == name.lower():
            return name
    raise argparse.ArgumentTypeError(f"must be one of {', '.join(MODELS)}, got {text!r}")


# Groups of options


def add_command(
    commands, name: str, run: Callable[[argparse.Namespace], int], *, short: str, about: str, details: str = ""
) -> argparse.ArgumentParser:
    """Add a command with its line in the list of commands, and the help before and after its options."""
    style = argparse.RawDescriptionHelpFormatter
    command = commands.add_parser(name, help=short, description=about, epilog=details, formatter_class=style)
    command.set_defaults(run=run)
    return command


def add_sensor(
    command: argparse.ArgumentParser,
    kind: Callable = number,
    springs: Callable = numbers,
    *,
    several: bool = True,
    defaults: Sequence[str] = tuple(f"{value:g}" for value in SPRINGS.values()),
) -> None:
    """Add the options of whiskers and springs.

    Args:
        command: the parser to which the options are added.
        kind: converts the value of an option of the whiskers.
        springs: converts the value of an option of the springs.
        several: whether each spring may have its own value.
        defaults: defaults of stiffness and rest length, as the help shows them.
    """
    stiffness, rest_length = "stiffness of all springs", "rest length of each spring in the row"
    feedback = "a feedback spring gets the sum of those that it spans"
    if several:
        stiffness += ", or one value per spring in the order c1, c2, ..."
        feedback += "; or one length per spring, feedback included"
    more = "[,...]" * several
    add = command.add_argument_group("whiskers and springs").add_argument
    add("--model", type=model, default="FB", metavar="NAME", help=f"{', '.join(MODELS)} (default: %(default)s)")
    text = f"{stiffness}; inf is a rigid link (default: {defaults[0]})"
    add("--stiffness", type=springs, metavar=f"C{more}", help=text)
    text = f"{rest_length}; {feedback} (default: {defaults[1]})"
    add("--rest-length", type=springs, metavar=f"L{more}", help=text)
    add("--length", type=kind, default="1.0", metavar="L", help="length of the whiskers (default: %(default)s)")
    text = "bending stiffness of the whiskers (default: %(default)s)"
    add("--bending-stiffness", type=kind, default="1.0", metavar="EI", help=text)


def add_object(command: argparse.ArgumentParser, kind: Callable = number) -> None:
    """Add the options of the object, whose values `kind` converts."""
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
    """Add the options of the drive positions."""
    add = command.add_argument_group("drive").add_argument
    add("--start", type=number, metavar="U", help="first position (default: just before the first touch)")
    add("--stop", type=number, metavar="U", help="last position (default: just after the last whisker is free)")
    add("--step", type=number, metavar="DU", help=f"distance between positions (default: {STEP:g} whisker lengths)")


def add_output(command: argparse.ArgumentParser, csv: str) -> Callable:
    """Add the options of output files, and return the function that adds further options to their group."""
    add = command.add_argument_group("output").add_argument
    add("--plot", type=Path, metavar="FILE", help="picture: .png, .pdf, .svg, ...")
    add("--csv", type=Path, metavar="FILE", help=csv)
    return add


def add_units(add: Callable) -> None:
    """Add the option that selects the units of tables and pictures."""
    text = "units shown; auto: SI, such as mm and mN, unless L = EI = 1 (default: %(default)s)"
    add("--units", choices=UNITS, default="auto", help=text)


# Scenes and controls


def shape_of(args: argparse.Namespace) -> dict:
    """Options of the chosen profile, with defaults.

    Raises:
        ValueError: if an option of another profile is given.
    """
    _, defaults = PROFILES[args.profile]
    for option in ("a", "b", "radius"):
        if getattr(args, option) is not None and option not in defaults:
            raise ValueError(f"--{option} does not belong to --profile {args.profile}.")
    return {k: default if getattr(args, k) is None else getattr(args, k) for k, default in defaults.items()}


def check_springs(args: argparse.Namespace) -> None:
    """Reject options of springs for a model without springs."""
    if args.model == "clamped":
        for option in SPRINGS:
            if getattr(args, option) is not None:
                raise ValueError(f"--{option.replace('_', '-')} does not belong to --model clamped: it has no springs.")


def springs_of(args: argparse.Namespace) -> dict[str, Any]:
    """Options of the springs, with defaults; empty for a model without springs."""
    check_springs(args)
    given = {name: getattr(args, name) for name in SPRINGS if getattr(args, name) is not None}
    return {} if args.model == "clamped" else SPRINGS | given


def support_of(args: argparse.Namespace) -> Support:
    """The support that the options describe."""
    springs = springs_of(args)
    return Support.named(args.model, *springs.values()) if springs else Support()


def parameters_of(args: argparse.Namespace) -> dict[str, Any]:
    """Values of all parameters of the scene by name."""
    others = {name: getattr(args, name) for name in ("length", "bending_stiffness", "distance", "position")}
    return springs_of(args) | others | shape_of(args)


def make_scene(args: argparse.Namespace, values: Mapping[str, Any]) -> Scene:
    """The scene of the chosen model and profile with these values of its parameters."""
    shape = PROFILES[args.profile][1]
    profile = PROFILES[args.profile][0](**{name: values[name] for name in ("distance", "position", *shape)})
    springs = [values[name] for name in SPRINGS if name in values]
    support = Support.named(args.model, *springs) if springs else Support()
    return Scene(Whisker(values["length"], values["bending_stiffness"]), profile, support)


def scene_of(args: argparse.Namespace) -> Scene:
    """The scene that the options describe."""
    return make_scene(args, parameters_of(args))


def check_drive(args: argparse.Namespace) -> None:
    """Reject invalid drive positions before the missing ends are computed."""
    for option in ("start", "stop", "step"):
        value = getattr(args, option)
        if value is not None and not math.isfinite(value):
            raise ValueError(f"--{option} must be a finite number, got {value}.")
    if args.step is not None and not args.step > 0:
        raise ValueError(f"--step must be positive, got {args.step}; for a scan towards +x set --stop above --start.")
    if args.start is not None and args.stop is not None:
        positions(args.start, args.stop, step_of(args))


def step_of(args: argparse.Namespace) -> float:
    """Distance between drive positions."""
    return STEP * float(np.max(args.length)) if args.step is None else args.step


def positions(start: float, stop: float, step: float) -> np.ndarray:
    """Drive positions from start to stop."""
    steps = abs(stop - start) / step
    if steps > MOST_STEPS:
        raise ValueError(f"--step must leave at most {MOST_STEPS:,} positions, got {step:g}, which leaves {steps:.3g}.")
    # The tolerance keeps a last position that lies beyond --stop only by rounding.
    return start + np.sign(stop - start) * step * np.arange(int(steps + 1e-9) + 1)


def control_of(args: argparse.Namespace, scene: Scene) -> np.ndarray | None:
    """Drive positions of a scan; None for the default ones."""
    if args.start is None and args.stop is None and args.step is None:
        return None
    start, stop = args.start, args.stop
    if start is None or stop is None:
        default = default_control(scene)
        start, stop = (default[0] if start is None else start), (default[-1] if stop is None else stop)
    return positions(start, stop, step_of(args))


# Output files


def check_writable(*paths: Path | None) -> None:
    """Check that files can be written before anything is computed."""
    for path in paths:
        if path is None:
            continue
        if path.is_dir():
            raise UsageError(f"cannot write {path}: it is a folder")
        if not path.absolute().parent.is_dir():
            raise UsageError(f"cannot write {path}: there is no folder {path.parent}")
        if path.exists() and not path.is_file():  # a device or a pipe
            continue
        new = not path.exists()
        try:
            path.open("ab").close()
            if new:
                path.unlink()
        except OSError as error:
            raise UsageError(f"cannot write {path}: {error.strerror}") from None


def check_folder(path: Path | None) -> None:
    """Check that a folder, which need not exist yet, can be written."""
    if path is None:
        return
    parent = path if path.is_dir() else path.absolute().parent
    if not parent.is_dir():
        raise UsageError(f"cannot write {path}: there is no folder {path.parent}")
    if path.exists() and not path.is_dir():
        raise UsageError(f"cannot write {path}: it is a file")
    try:
        tempfile.TemporaryDirectory(dir=parent).cleanup()
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from None


def check_picture(path: Path | None) -> None:
    """Check that matplotlib can write the format of a picture."""
    if path is None:
        return
    from matplotlib.backend_bases import FigureCanvasBase

    if path.suffix.lstrip(".").lower() not in FigureCanvasBase.get_supported_filetypes():
        raise UsageError(f"--plot must end with .png, .pdf, .svg or another format of matplotlib, got {path}.")


def save_picture(drawn: Any, path: Path) -> None:
    """Write a picture and report it."""
    from jaxwhisker import plot

    plot.save(drawn, path, dpi=130)
    print(f"wrote {path}")
