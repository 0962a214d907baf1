"""Options that commands share, the scenes and controls that they describe, and checks of output files."""

import argparse
import inspect
import math
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.conic import Circle, Ellipse, Parabola
from jaxwhisker._model.motion import Translation
from jaxwhisker._model.scene import DETECTABLE, Scene, Units, units_of
from jaxwhisker._model.spring import SPACING
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import AbstractRod, Shooting
from jaxwhisker._scan.quantities import KINDS, UNITS, unit_in_words
from jaxwhisker._scan.route import MOST_STEPS, STEP
from jaxwhisker._scan.scan import default_control
from jaxwhisker.cli.given import note_options

MODEL_NAMES = ("clamped", "FB", "FBFB", "FBFBR", "FBFBFBR")


class Default(NamedTuple):
    """Default of an option, in units formed from the whiskers' length L and bending stiffness EI."""

    number: float
    kind: str  # of quantities.KINDS

    def size(self, unit: Units) -> Any:
        """Its unit, in the units of the other options."""
        force, length = KINDS[self.kind]
        return unit.force**force * unit.length**length

    def value(self, unit: Units) -> Any:
        """The value in the units of the other options."""
        return self.number * self.size(unit)

    def __str__(self) -> str:
        words = unit_in_words(self.kind, dimensionless=True)
        return words if self.number == 1 else f"{self.number:g} {words}"


LENGTH, PER_LENGTH = Default(1.0, "length"), Default(1.0, "curvature")
SPRINGS = {"stiffness": Default(70.0, "stiffness"), "rest_length": Default(SPACING, "length")}
DISTANCE = Default(0.2, "length")
LETTERS = {"stiffness": "c", "rest_length": "l"}  # of the parameters of single springs: c1, c2, ..., l1, l2, ...
PARAMETERS = (*SPRINGS, "length", "bending_stiffness", "distance", "position", "a", "b", "radius")
# Options of each profile with their defaults; options of another profile are rejected.
PROFILES = {
    "parabola": (Parabola, {"a": PER_LENGTH}),
    "circle": (Circle, {"radius": LENGTH}),
    "ellipse": (Ellipse, {"a": LENGTH, "b": Default(0.8, "length")}),
}
# Arguments of functions whose options have other names.
OPTIONS = {
    "control": "control (--start, --stop and --step)",
    "drive": "the drive (--start)",
    "speed": "--playback-speed",
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
        message = str(error)
        for argument, option in OPTIONS.items():
            message = message.replace(f"`{argument}`", option)
        raise UsageError(message) from None


@contextmanager
def short_warnings() -> Iterator[None]:
    """Print the text of warnings, without the line of code that raised them."""
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: print(f"jaxwhisker: warning: {message}", file=sys.stderr)
        yield


# Types of option values


def parse_number(text: str) -> float:
    """A number."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}") from None


def parse_numbers(text: str) -> float | tuple[float, ...]:
    """One number, or several separated by commas."""
    parts = tuple(parse_number(part) for part in text.split(","))
    return parts[0] if len(parts) == 1 else parts


def model(text: str) -> str:
    """The name of a model, in upper or lower case."""
    for name in MODEL_NAMES:
        if text.lower() == name.lower():
            return name
    raise argparse.ArgumentTypeError(f"must be one of {', '.join(MODEL_NAMES)}, got {text!r}")


# Groups of options


def add_command(commands, run: Callable[[argparse.Namespace], int], short: str) -> argparse.ArgumentParser:
    """Add the command that a function runs, with its line in the list of commands.

    The function's docstring is the help: its first paragraph above the options, the others below them.
    """
    about, _, details = (inspect.getdoc(run) or "").partition("\n\n")
    style = argparse.RawDescriptionHelpFormatter
    name = run.__name__.removeprefix("run_")
    command = commands.add_parser(name, help=short, description=about, epilog=details, formatter_class=style)
    command.set_defaults(run=run)
    note_options(command)
    return command


def add_sensor(
    command: argparse.ArgumentParser,
    kind: Callable = parse_number,
    springs: Callable = parse_numbers,
    *,
    several: bool = True,
    defaults: Sequence[Any] = tuple(SPRINGS.values()),
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
    add("--model", type=model, default="FB", metavar="NAME", help=f"{', '.join(MODEL_NAMES)} (default: %(default)s)")
    text = f"{stiffness}; inf is a rigid link (default: {defaults[0]})"
    add("--stiffness", type=springs, metavar=f"C{more}", help=text)
    text = f"{rest_length}; {feedback} (default: {defaults[1]})"
    add("--rest-length", type=springs, metavar=f"L{more}", help=text)
    add("--length", type=kind, default="1.0", metavar="L", help="length of the whiskers (default: %(default)s)")
    text = "bending stiffness of the whiskers (default: %(default)s)"
    add("--bending-stiffness", type=kind, default="1.0", metavar="EI", help=text)


def add_object(command: argparse.ArgumentParser, kind: Callable = parse_number) -> None:
    """Add the options of the object, whose values `kind` converts."""
    add = command.add_argument_group("object").add_argument
    add("--profile", choices=tuple(PROFILES), default="parabola", help="shape of the object (default: %(default)s)")
    add("--distance", type=kind, metavar="Q", help=f"height of its lowest point (default: {DISTANCE})")
    add("--position", type=kind, default="0.0", metavar="X", help="x of its lowest point (default: %(default)s)")
    add(
        "--a",
        type=kind,
        metavar="A",
        help=f"parabola y = q + A x^2: half the curvature at the vertex (default: {PER_LENGTH}); ellipse: horizontal "
        f"half axis (default: {LENGTH})",
    )
    add("--b", type=kind, metavar="B", help=f"ellipse: vertical half axis (default: {PROFILES['ellipse'][1]['b']})")
    add("--radius", type=kind, metavar="R", help=f"circle: radius (default: {LENGTH})")
    add_friction(add, kind)


def add_friction(add: Callable, kind: Callable = parse_number) -> None:
    """Add the option of the friction coefficient."""
    add("--friction", type=kind, metavar="MU", help="friction coefficient of whiskers and object (default: none)")


def add_detect(command: argparse.ArgumentParser) -> None:
    """Add the option that ends scans at contacts that are not modelled."""
    text = f"end a scan where this happens (default: second_contact with friction): {' or '.join(DETECTABLE)}"
    command.add_argument("--detect", action="append", choices=DETECTABLE, help=text)


def add_drive(command: argparse.ArgumentParser) -> None:
    """Add the options of the drive positions."""
    add = command.add_argument_group("drive").add_argument
    add("--start", type=parse_number, metavar="U", help="first position (default: just before the first touch)")
    add("--stop", type=parse_number, metavar="U", help="last position (default: just after the last whisker is free)")
    text = f"distance between positions (default: {STEP:g} whisker lengths)"
    add("--step", type=parse_number, metavar="DU", help=text)


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


def _given(args: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    """Values of the options that are given."""
    return {name: value for name in names if (value := getattr(args, name, None)) is not None}


def defaults_of(args: argparse.Namespace) -> dict[str, Default]:
    """Defaults of the parameters of the chosen model and, if there is an object, of the chosen profile."""
    shape = {"distance": DISTANCE} | PROFILES[args.profile][1] if "profile" in args else {}
    return ({} if args.model == "clamped" else SPRINGS) | shape


def given_values(args: argparse.Namespace) -> dict[str, Any]:
    """Values of the parameters of the scene, or of the sensor, that are given or do not depend on the others.

    Raises:
        ValueError: if an option of another profile, or of springs that the model does not have, is given.
    """
    known, belongs = defaults_of(args), dict.fromkeys(SPRINGS, "--model clamped: it has no springs")
    belongs |= dict.fromkeys(("a", "b", "radius"), f"--profile {getattr(args, 'profile', None)}")
    for name in _given(args, belongs):
        if name not in known:
            raise ValueError(f"--{name.replace('_', '-')} does not belong to {belongs[name]}.")
    return _given(args, (*PARAMETERS, "friction", "mass_per_length"))


def whisker_of(values: Mapping[str, Any]) -> Whisker:
    """The whisker with these values of its parameters."""
    return Whisker(values["length"], values["bending_stiffness"], mass_per_length=values.get("mass_per_length"))


def with_defaults(args: argparse.Namespace, values: Mapping[str, Any]) -> dict[str, Any]:
    """The values with the defaults of those that are missing, which follow from length and bending stiffness."""
    unit = units_of(whisker_of(values), Translation())
    known = {name: default.value(unit) for name, default in defaults_of(args).items()} | dict(values)
    return {name: known[name] for name in (*PARAMETERS, *known) if name in known}


def option_of(name: str) -> str:
    """The option that sets a parameter: `stiffness` for c1, c2, ..., `rest_length` for l1, l2, ..., else its name."""
    return next((option for option, letter in LETTERS.items() if name[0] == letter and name[1:].isdecimal()), name)


def support_of(args: argparse.Namespace, values: Mapping[str, Any]) -> Support:
    """The support of the chosen model with these stiffnesses and rest lengths, of all springs or of each one."""
    if args.model == "clamped":
        return Support()
    own = {name: [values[n] for n in sorted(values) if name == option_of(n) != n] for name in SPRINGS}
    return Support.named(args.model, *(own[name] or values[name] for name in SPRINGS))


def make_scene(args: argparse.Namespace, rod: AbstractRod | None = None, /, **values: Any) -> Scene:
    """The scene of the chosen model and profile with these values of its parameters."""
    values, (kind, shape) = with_defaults(args, values), PROFILES[args.profile]
    profile = kind(**{name: values[name] for name in ("distance", "position", *shape)})
    friction, detect = values.get("friction"), getattr(args, "detect", None)
    support, whisker = support_of(args, values), whisker_of(values)
    return Scene(whisker, profile, support, rod or Shooting(), friction=friction, detect=detect)


def scene_of(args: argparse.Namespace) -> Scene:
    """The scene that the options describe."""
    return make_scene(args, **given_values(args))


def check_drive(args: argparse.Namespace) -> None:
    """Reject invalid drive positions before the missing ends are computed."""
    for option in ("start", "stop", "step"):
        value = getattr(args, option)
        if value is not None and not math.isfinite(value):
            raise ValueError(f"--{option} must be a finite number, got {value}.")
    if args.step is not None and not args.step > 0:
        raise ValueError(f"--step must be positive, got {args.step}; for a scan towards +x set --stop above --start.")
    if args.start is not None and args.stop is not None:
        positions(args.start, args.stop, _step_of(args))


def _step_of(args: argparse.Namespace) -> float:
    return STEP * float(np.max(args.length)) if args.step is None else args.step


def positions(start: float, stop: float, step: float) -> np.ndarray:
    """Drive positions from start to stop."""
    steps = abs(stop - start) / step
    if steps > MOST_STEPS:
        raise ValueError(f"--step must leave at most {MOST_STEPS:,} positions, got {step:g}, which leaves {steps:.3g}.")
    # The tolerance keeps a last position that lies beyond --stop only by rounding.
    return start + np.sign(stop - start) * step * np.arange(int(steps + 1e-9) + 1)


def control_of(args: argparse.Namespace, scene: AbstractScene | None, *, further: float = 0.0) -> np.ndarray | None:
    """Drive positions of the scan of a scene, or of all scans of a study; None for the default ones.

    Args:
        args: the options.
        scene: the scene, or None for a study.
        further: how far the drive moves beyond the default end of a scan, which is towards -x.
    """
    given = {option: value for option in ("start", "stop", "step") if (value := getattr(args, option)) is not None}
    if not given and not further:
        return None
    missing = [option for option in ("start", "stop") if option not in given]
    if missing and scene is None:
        with_one = next(iter(given))
        raise ValueError(f"--{missing[0]} must be given with --{with_one}: all scans of a study share their control.")
    if scene is not None and missing:
        first, *_, last = default_control(scene)
        given = {"start": first, "stop": last - further} | given
    return positions(given["start"], given["stop"], _step_of(args))


# Output files


def check_outputs(plot: Path | None, csv: Path | None = None) -> None:
    """Check that a picture and a table can be written before anything is computed."""
    check_writable(plot, csv)
    if plot is None:
        return
    from matplotlib.backend_bases import FigureCanvasBase

    if plot.suffix.lstrip(".").lower() not in FigureCanvasBase.get_supported_filetypes():
        raise UsageError(f"--plot must end with .png, .pdf, .svg or another format of matplotlib, got {plot}.")


def check_writable(*paths: Path | None, folder: bool = False) -> None:
    """Check that files, or folders that need not exist yet, can be written before anything is computed."""
    for path in paths:
        reason = None if path is None else _why_not_writable(path, folder)
        if reason is not None:
            raise UsageError(f"cannot write {path}: {reason}")


def _why_not_writable(path: Path, folder: bool) -> str | None:
    place, new = path if path.is_dir() else path.absolute().parent, not path.exists()
    if not place.is_dir():
        return f"there is no folder {path.parent}"
    if path.is_dir() and not folder:
        return "it is a folder"
    if folder and place != path and not new:
        return "it is a file"
    try:
        if folder:
            tempfile.TemporaryDirectory(dir=place).cleanup()
        elif new or path.is_file():  # else it is a device or a pipe
            path.open("ab").close()
            if new:
                path.unlink()
    except OSError as error:
        return error.strerror
    return None


def save_picture(path: Path | None, draw: Callable[[ModuleType], Any]) -> None:
    """Write what is drawn with `jaxwhisker.plot`, and report it; without a path, do nothing."""
    if path is not None:
        from jaxwhisker import plot

        plot.save(draw(plot), path, dpi=130)
        print(f"wrote {path}")
