"""The command `explore`: sliders for one scene, on a local page."""

import argparse
from collections.abc import Callable
from typing import Any

from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import ClosedForm
from jaxwhisker.cli.options import MODELS, OK, PROFILES, UsageError, add_object, check_springs, model, number, shape_of

HELP = """\
Drag the parameters of a scene and its drive on a page in the browser; shapes,
signals and events follow. Only this machine can open the page.
"""
END = """\
A parameter is START or a range LOW:HIGH or LOW:HIGH:START; a slider is
logarithmic if HIGH/LOW is above 20. Position, length and bending stiffness
have a slider only if a range is given.

The first picture waits for the compiler, 10 to 30 seconds. Units and signs are
those of `jaxwhisker scan`. A button shows Python code for the scene.

exit codes:
  2    an option or a parameter is wrong, the port is taken, or the packages
       that the page needs are missing
  130  ended by Ctrl-C

examples:
  jaxwhisker explore --model FBFBR
  jaxwhisker explore --model FBFB --stiffness 70,10:500:200 --port 8080
"""

Range = tuple[float, ...]  # (start,), (low, high) or (low, high, start)

# Default ranges of parameters for which no range is given; other parameters without a range have no slider.
RANGES = {
    "stiffness": (10.0, 500.0),
    "rest_length": (0.0, 0.5),
    "distance": (0.05, 0.95),
    "a": (0.2, 5.0),
    "b": (0.2, 5.0),
    "radius": (0.2, 5.0),
}
STARTS = {"stiffness": 70.0, "rest_length": 0.2}


def one(text: str) -> Range:
    """The value or range of a parameter: START, LOW:HIGH or LOW:HIGH:START."""
    parts = tuple(number(part) for part in text.split(":"))
    if len(parts) > 3:
        raise argparse.ArgumentTypeError(f"must be START, LOW:HIGH or LOW:HIGH:START, got {text!r}")
    return parts


def each(text: str) -> tuple[Range, ...]:
    """A value or range for all springs, or one per spring."""
    return tuple(one(part) for part in text.split(","))


def port(text: str) -> int:
    """The number of a port."""
    if not text.isdecimal() or int(text) > 65_535:
        raise argparse.ArgumentTypeError(f"must be a number from 0 to 65535, got {text!r}")
    return int(text)


def add(commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "explore",
        help="drag the parameters of a scene on a local page",
        description=HELP,
        epilog=END,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = command.add_argument_group("whiskers and springs").add_argument
    add("--model", type=model, default="FB", metavar="NAME", help=f"{', '.join(MODELS)} (default: %(default)s)")
    add(
        "--stiffness",
        type=each,
        metavar="C[,C...]",
        help="stiffness of all springs, or of each, in the order c1, c2, ...; inf is a rigid link, without a slider "
        "(default: 10:500:70)",
    )
    add(
        "--rest-length",
        type=each,
        metavar="L[,L...]",
        help="rest length of each spring of the row, or one per spring, feedback included; one number gives a feedback "
        "spring the sum of those that it spans (default: 0:0.5:0.2)",
    )
    add("--length", type=one, default="1.0", metavar="L", help="length of the whiskers (default: %(default)s)")
    add("--bending-stiffness", type=one, default="1.0", metavar="EI", help="of the whiskers (default: %(default)s)")
    add_object(command, one)
    add = command.add_argument_group("page").add_argument
    add("--port", type=port, default=0, metavar="N", help="of the page (default: any free port)")
    add("--no-browser", action="store_true", help="only print the address of the page")
    command.set_defaults(run=_run)


def _values(args: argparse.Namespace) -> dict[str, Range]:
    """Every parameter of the scene; numbered ones if each spring has its own."""
    springs: dict[str, Range] = {}
    for name, letter in (("stiffness", "c"), ("rest_length", "l")) if args.model != "clamped" else ():
        ranges = getattr(args, name) or ((STARTS[name],),)
        numbered = {f"{letter}{k + 1}": value for k, value in enumerate(ranges)}
        springs |= {name: ranges[0]} if len(ranges) == 1 else numbered
    shape = {name: value if isinstance(value, tuple) else (value,) for name, value in shape_of(args).items()}
    others = {name: getattr(args, name) for name in ("distance", "position", "length", "bending_stiffness")}
    return springs | others | shape


def _range(name: str, value: Range) -> Range | None:
    """The range of a parameter's slider; None if it has no slider."""
    if name[1:].isdecimal():
        name = {"c": "stiffness", "l": "rest_length"}[name[0]]
    *_, start = value
    if len(value) > 1:
        return value
    if name not in RANGES or start == float("inf"):
        return None
    low, high = RANGES[name]
    return min(low, start), max(high, start), start


def _builder(args: argparse.Namespace) -> tuple[Callable[..., Scene], dict[str, Range]]:
    """The function that builds scenes from the sliders' values, and the sliders' ranges."""
    check_springs(args)
    given = _values(args)
    ranges = {name: limits for name, value in given.items() if (limits := _range(name, value)) is not None}
    fixed = {name: value[0] for name, value in given.items() if name not in ranges}
    shape = tuple(shape_of(args))

    def per_spring(values: dict[str, float], name: str, letter: str) -> Any:
        numbered = [values[key] for key in given if key[0] == letter and key[1:].isdecimal()]
        return numbered or values[name]

    def build(**sliders: float) -> Scene:
        values = fixed | sliders
        whisker = Whisker(values["length"], values["bending_stiffness"])
        profile = PROFILES[args.profile][0](**{name: values[name] for name in ("distance", "position", *shape)})
        if args.model == "clamped":
            return Scene(whisker, profile, rod=ClosedForm())
        springs = per_spring(values, "stiffness", "c"), per_spring(values, "rest_length", "l")
        return Scene(whisker, profile, Support.named(args.model, *springs), rod=ClosedForm())

    return build, ranges


def _run(args: argparse.Namespace) -> int:
    from jaxwhisker._explore.session import Session

    try:
        from jaxwhisker._explore.hosts import serve

        build, ranges = _builder(args)
        session = Session(build, ranges)
    except (ImportError, ValueError) as error:
        raise UsageError(str(error)) from None
    serve(session, port=args.port, browser=not args.no_browser)
    return OK
