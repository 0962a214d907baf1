"""The command `explore`: sliders for one scene, on a local page."""

import argparse
import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial

from jaxwhisker._file.numbers import Number
from jaxwhisker._file.scene_file import SceneFile
from jaxwhisker._model.motion import Translation
from jaxwhisker._model.scene import Scene, units_of
from jaxwhisker._rod.elastica import ClosedForm
from jaxwhisker._study.layout import kind_of_axis
from jaxwhisker.cli import options
from jaxwhisker.cli.scene_file import add_scene_file, file_of

Range = tuple[float, ...]  # (start,), (low, high) or (low, high, start)

# Default ranges of parameters for which no range is given, in the units of their defaults; other parameters without a
# range have no slider.
RANGES = {
    "stiffness": (10.0, 500.0),
    "rest_length": (0.0, 0.5),
    "distance": (0.05, 0.95),
    "a": (0.2, 5.0),
    "b": (0.2, 5.0),
    "radius": (0.2, 5.0),
}
DIGITS = 4  # of the ends of these ranges
FACTOR = 3.0  # default ranges of numbers in a file go from a share of the number to a multiple of it
MOST_SLIDERS = 12  # by default
VARIED = ("objects", "support", "friction")  # parts of a scene whose numbers have sliders by default


def one(text: str) -> Range:
    """The value or range of a parameter: START, LOW:HIGH or LOW:HIGH:START."""
    parts = tuple(options.parse_number(part) for part in text.split(":"))
    if len(parts) > 3:
        raise argparse.ArgumentTypeError(f"must be START, LOW:HIGH or LOW:HIGH:START, got {text!r}")
    return parts


def each(text: str) -> Range | list[Range]:
    """A value or range for all springs, or one per spring."""
    parts = [one(part) for part in text.split(",")]
    return parts[0] if len(parts) == 1 else parts


def ranges(text: str) -> dict[str, Range]:
    """Values or ranges by the names of numbers in a file."""
    found = {}
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if not equals:
            raise argparse.ArgumentTypeError(f"must be NAME=RANGE, got {part!r}")
        found[name.strip().replace("-", "_")] = one(value)
    return found


def port(text: str) -> int:
    """The number of a port."""
    if not text.isdecimal() or int(text) > 65_535:
        raise argparse.ArgumentTypeError(f"must be a number from 0 to 65535, got {text!r}")
    return int(text)


def add_explore(commands) -> None:
    """Add the command `explore`."""
    command = options.add_command(commands, run_explore, "drag the parameters of a scene on a local page")
    add_scene_file(command)
    options.add_sensor(command, one, each, defaults=("10:500:70 EI/L^3", "0:0.5:0.2 L"))
    options.add_object(command, one)
    add = command.add_argument_group("page").add_argument
    text = "sliders of a scene in a file, by the keys of numbers (default: those of springs, objects and friction)"
    add("--range", type=ranges, metavar="NAME=RANGE[,...]", help=text)
    add("--port", type=port, default=0, metavar="N", help="of the page (default: any free port)")
    add("--no-browser", action="store_true", help="only print the address of the page")


def run_explore(args: argparse.Namespace) -> int:
    """Drag the parameters of a scene and its drive on a page in the browser; shapes,
    signals and events follow. Only this machine can open the page.

    A parameter is START or a range LOW:HIGH or LOW:HIGH:START; a slider is
    logarithmic if HIGH/LOW is above 20. Position, length and bending stiffness
    have a slider only if a range is given. A stiffness of inf has no slider.

    With a file of a scene, which may be in space, --range names its numbers by
    their keys: radius, or objects.2.radius if several numbers have this key. By
    default, ranges go from a third to three times the number.

    The first picture waits for the compiler unless the cache has its programs.
    Units and signs are those of `jaxwhisker scan`. A button shows Python code for
    the scene.

    exit codes:
      2    an option or a parameter is wrong, the port is taken, or the packages
           that the page needs are missing
      130  ended by Ctrl-C

    examples:
      jaxwhisker explore --model FBFBR
      jaxwhisker explore --model FBFB --stiffness 70,10:500:200 --port 8080
      jaxwhisker explore examples/sensor.toml --range distance=0.02:0.04
    """
    with options.usage_errors():
        from jaxwhisker._explore.hosts import serve
        from jaxwhisker._explore.session import Session

        if (file := file_of(args)) is not None:
            sliders = _sliders_of(file, args.range)
            session = Session(file.build, sliders, _kinds_of(file, sliders))
        elif args.range is not None:
            raise ValueError("--range needs a file of a scene: other options take ranges themselves.")
        else:
            build, sliders = _sliders(args)
            session = Session(build, sliders, _kinds(args, sliders))
    serve(session, port=args.port, browser=not args.no_browser)
    return options.OK


def _sliders(args: argparse.Namespace) -> tuple[Callable[..., Scene], dict[str, Range]]:
    """The function that builds scenes from the sliders' values, and the sliders' ranges."""
    from jaxwhisker._explore.session import slider_of

    values, defaults = options.given_values(args), options.defaults_of(args)
    rod = {name: values[name] for name in ("length", "bending_stiffness")}
    starts = {name: value[0] if len(value) == 1 else slider_of(name, value).start for name, value in rod.items()}
    unit = units_of(options.whisker_of(starts), Translation())
    given: dict[str, Range] = {}
    for name, value in ({name: (default.value(unit),) for name, default in defaults.items()} | values).items():
        if isinstance(value, list):  # each spring has its own
            given |= {f"{options.LETTERS[name]}{k}": own for k, own in enumerate(value, 1)}
        else:
            given[name] = value if isinstance(value, tuple) else (value,)
    sizes = {name: default.size(unit) for name, default in defaults.items()}
    ranges = {name: limits for name, value in given.items() if (limits := _range(name, value, sizes)) is not None}
    fixed = {name: value[0] for name, value in given.items() if name not in ranges}
    return partial(options.make_scene, args, ClosedForm(), **fixed), ranges


def _kinds(args: argparse.Namespace, names: Iterable[str]) -> dict[str, str]:
    """Kinds of quantities of those parameters that have a default, also of single springs."""
    defaults = options.defaults_of(args)
    return {name: defaults[option].kind for name in names if (option := options.option_of(name)) in defaults}


def _range(name: str, value: Range, sizes: Mapping[str, float]) -> Range | None:
    """The range of a parameter's slider; None if it has no slider. The default ranges are in units of these sizes."""
    *_, start = value
    if len(value) > 1:
        return value
    option = options.option_of(name)
    if option not in RANGES or start == float("inf"):
        return None
    low, high = (float(f"{limit * sizes[option]:.{DIGITS}g}") for limit in RANGES[option])
    return min(low, start), max(high, start), start


def _sliders_of(file: SceneFile, asked: Mapping[str, Range] | None) -> dict[str, Range]:
    """The ranges of the sliders for the numbers of a file."""
    if asked is None:
        usual = {name: number.value for name, number in file.numbers.items() if _has_slider(number)}
        return {name: _around(value) for name, value in list(usual.items())[:MOST_SLIDERS]}
    found = {}
    for key, limits in asked.items():
        for name in file.chosen(key):
            value = file.numbers[name].value
            if len(limits) == 1:
                low, high, _ = _around(*limits)
                found[name] = low, high, *limits
            else:
                found[name] = (*limits, value) if len(limits) == 2 and limits[0] <= value <= limits[1] else limits
    return found


def _has_slider(number: Number) -> bool:
    return number.place[0] in VARIED and not number.listed and number.value != 0 and math.isfinite(number.value)


def _around(value: float) -> Range:
    """The default range of a number in a file; empty around zero."""
    low, high = sorted(float(f"{value * factor:.{DIGITS}g}") for factor in (1 / FACTOR, FACTOR))
    return low, high, value


def _kinds_of(file: SceneFile, names: Iterable[str]) -> dict[str, str]:
    """Kinds of quantities that names suggest; the stiffness of a spring may be one of torsion."""
    known = {name: kind_of_axis(name.rstrip(".0123456789")) for name in names}
    return {name: "number" if "springs" in file.numbers[name].place else kind for name, kind in known.items()}
