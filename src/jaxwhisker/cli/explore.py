"""The command `explore`: sliders for one scene, on a local page."""

import argparse
from collections.abc import Callable
from typing import Any

from jaxwhisker._model.scene import Scene
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import ClosedForm
from jaxwhisker.cli.options import MODELS, OK, PROFILES, UsageError, check_springs, model, number, shape_of

HELP = """\
Drag the parameters of a scene, and its drive, on a page in the browser; its
shapes, signals and events follow. The page is served to this machine alone.
"""
END = """\
A parameter is START or a range LOW:HIGH or LOW:HIGH:START; a slider whose
HIGH/LOW is above 20 is logarithmic. Position, length and bending stiffness
have sliders where a range is given.

The first picture waits for the compiler, 10 to 30 seconds. Units and signs are
those of `jaxwhisker scan`. A button shows the Python code of the scene.

exit codes:
  2    an option or a parameter is wrong, or the port is taken
  130  ended by Ctrl-C

examples:
  jaxwhisker explore --model FBFBR
  jaxwhisker explore --model FBFB --stiffness 70,10:500:200 --port 8080
"""

Range = tuple[float, ...]  # (start,), (low, high) or (low, high, start)

# Ranges of parameters of which at most a start is told; those without one have no slider then.
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
    """A parameter: START, LOW:HIGH or LOW:HIGH:START."""
    parts = tuple(number(part) for part in text.split(":"))
    if len(parts) > 3:
        raise argparse.ArgumentTypeError(f"must be START, LOW:HIGH or LOW:HIGH:START, but is {text!r}")
    return parts


def each(text: str) -> tuple[Range, ...]:
    """A parameter of all springs, or of each."""
    return tuple(one(part) for part in text.split(","))


def port(text: str) -> int:
    """A port's number."""
    if not text.isdecimal() or int(text) > 65_535:
        raise argparse.ArgumentTypeError(f"must be a number from 0 to 65535, but is {text!r}")
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
    add = command.add_argument_group("object").add_argument
    add("--profile", choices=tuple(PROFILES), default="parabola", help="shape of the object (default: %(default)s)")
    add("--distance", type=one, default="0.2", metavar="Q", help="height of its lowest point (default: %(default)s)")
    add("--position", type=one, default="0.0", metavar="X", help="x of its lowest point (default: %(default)s)")
    add(
        "--a",
        type=one,
        metavar="A",
        help="parabola y = q + A x^2: half the curvature at the vertex; ellipse: horizontal half axis (default: 1)",
    )
    add("--b", type=one, metavar="B", help="ellipse: vertical half axis (default: 0.8)")
    add("--radius", type=one, metavar="R", help="circle: radius (default: 1)")
    add = command.add_argument_group("page").add_argument
    add("--port", type=port, default=0, metavar="N", help="of the page (default: any that is free)")
    add("--no-browser", action="store_true", help="print the page's address only")
    command.set_defaults(run=_run)


def _given(args: argparse.Namespace) -> dict[str, Range]:
    """Every parameter of the scene, springs numbered if each has its own."""
    found: dict[str, Range] = {}
    for name, letter in (("stiffness", "c"), ("rest_length", "l")) if args.model != "clamped" else ():
        ranges = getattr(args, name) or ((STARTS[name],),)
        numbered = {f"{letter}{k + 1}": value for k, value in enumerate(ranges)}
        found |= {name: ranges[0]} if len(ranges) == 1 else numbered
    shape = {name: value if isinstance(value, tuple) else (value,) for name, value in shape_of(args).items()}
    plain = {name: getattr(args, name) for name in ("distance", "position", "length", "bending_stiffness")}
    return found | plain | shape


def _range(name: str, given: Range) -> Range | None:
    """A parameter's slider; None if it has none."""
    usual = RANGES.get({"c": "stiffness", "l": "rest_length"}.get(name[:1], name) if name[1:].isdecimal() else name)
    *_, start = given
    if len(given) > 1:
        return given
    if usual is None or start == float("inf"):
        return None
    # It reaches out for where it starts.
    return (min(usual[0], start), max(usual[1], start), start)


def _builder(args: argparse.Namespace) -> tuple[Callable[..., Scene], dict[str, Range]]:
    """The function that builds scenes from the sliders' values, and the sliders' ranges."""
    check_springs(args)
    given = _given(args)
    ranges = {name: found for name, value in given.items() if (found := _range(name, value)) is not None}
    fixed = {name: value[0] for name, value in given.items() if name not in ranges}
    shape = tuple(shape_of(args))

    def springs(values: dict[str, float], name: str, letter: str) -> Any:
        own = [values[key] for key in given if key[0] == letter and key[1:].isdecimal()]
        return own or values[name]

    def build(**sliders: float) -> Scene:
        values = fixed | sliders
        whisker = Whisker(values["length"], values["bending_stiffness"])
        profile = PROFILES[args.profile][0](**{name: values[name] for name in ("distance", "position", *shape)})
        if args.model == "clamped":
            return Scene(whisker, profile, rod=ClosedForm())
        both = springs(values, "stiffness", "c"), springs(values, "rest_length", "l")
        return Scene(whisker, profile, Support.named(args.model, *both), rod=ClosedForm())

    return build, ranges


def _run(args: argparse.Namespace) -> int:
    from jaxwhisker._explore.code import code_of_scene
    from jaxwhisker._explore.page import serve
    from jaxwhisker._explore.session import Session

    try:
        build, ranges = _builder(args)
        session = Session(build, ranges, code_of_scene)
    except ValueError as error:
        raise UsageError(str(error)) from None
    serve(session, port=args.port, browser=not args.no_browser)
    return OK
