"""The figures of the thesis: what each of them shows, in the order of the thesis."""

from collections.abc import Mapping
from dataclasses import dataclass

from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker.thesis.scans import DISTANCES, REST_LENGTHS, STIFFNESSES, WHISKERS, Case, vary

EventOf = tuple[str, int]  # kind of event, whisker


@dataclass(frozen=True)
class Deflections:
    """Whiskers bent by the loads of a table."""

    table: str


@dataclass(frozen=True)
class States:
    """Four states of a scan, each midway between two events."""

    case: Case
    between: tuple[tuple[EventOf, EventOf], ...]


@dataclass(frozen=True)
class Signals:
    """Quantities of several scans over the drive position: one row per quantity, one column per whisker or spring."""

    cases: Mapping[str, Case]
    quantities: tuple[str, ...]
    indices: tuple[int, ...]
    overlay: bool = False  # one column, in which each panel shows every whisker of a single scan


@dataclass(frozen=True)
class Detail:
    """One quantity of one whisker around an event of each of several scans."""

    cases: Mapping[str, Case]
    quantity: str
    index: int
    around: EventOf


@dataclass(frozen=True)
class Figure:
    """A figure of the thesis."""

    number: str
    title: str
    shows: Deflections | States | Signals | Detail

    @property
    def cases(self) -> tuple[Case, ...]:
        """The scans that the figure needs."""
        if isinstance(self.shows, States):
            return (self.shows.case,)
        return tuple(getattr(self.shows, "cases", {}).values())

    @property
    def file(self) -> str:
        """File name without suffix; names sort in the order of the figures."""
        chapter, number = self.number.split(".")
        return f"figure_{chapter}.{int(number):02d}"


_BASE = "c = 70, q = 0.2, λ = 0.2"
_VARIED = {
    "stiffness": (STIFFNESSES, "stiffness c", "q = 0.2, λ = 0.2"),
    "distance": (DISTANCES, "object distance q", "c = 70, λ = 0.2"),
    "rest_length": (REST_LENGTHS, "rest length λ", "c = 70, q = 0.2"),
}
_SPRINGS = {"FB": 1, "FBFB": 2, "FBFBR": 3, "FBFBFBR": 5}
_NAMES = {"FB": "one whisker (FB)", "FBFB": "two whiskers (FBFB)", "FBFBR": "two whiskers with feedback (FBFBR)"}


def _count(n: int) -> tuple[int, ...]:
    return tuple(range(1, n + 1))


def _family(model: str, first: int) -> list[Figure]:
    """Reactions and spring lengths for varied stiffness, distance and rest length: six figures, starting at `first`."""
    figures = []
    for varied, (values, name, fixed) in _VARIED.items():
        cases = vary(varied, values, Case(model))
        for kind, quantities, n in (
            ("Reactions", REACTIONS, WHISKERS[model]),
            ("Spring lengths" if model != "FB" else "Spring length", ("spring_length",), _SPRINGS[model]),
        ):
            title = f"{kind} of {_NAMES[model]} for varied {name} ({fixed})"
            figures.append(Figure(f"6.{first + len(figures)}", title, Signals(cases, quantities, _count(n))))
    return figures


_ONE = (
    (("touch", 1), ("tip_to_tangential", 1)),
    (("tip_to_tangential", 1), ("vertex", 1)),
    (("vertex", 1), ("tangential_to_tip", 1)),
    (("tangential_to_tip", 1), ("snap_off", 1)),
)
_TWO = (
    (("touch", 1), ("touch", 2)),
    (("tip_to_tangential", 2), ("vertex", 1)),
    (("vertex", 2), ("snap_off", 1)),
    (("snap_off", 1), ("snap_off", 2)),
)
_CLAMPED = Case(stiffness=float("inf"), semicircle=True)
_SPRUNG = Case(semicircle=True)

FIGURES = {
    figure.number: figure
    for figure in (
        Figure("5.10", "Whisker bent by a follower force at its tip (loads of table A.1)", Deflections("A.1")),
        Figure("5.11", "Whisker bent by a follower force along it (loads of table A.2)", Deflections("A.2")),
        Figure("5.12", "Whisker bent by a force of fixed direction at its tip (table A.3)", Deflections("A.3")),
        Figure("5.13", "Whisker bent by a force of fixed direction along it (table A.4)", Deflections("A.4")),
        Figure("5.14", "Semicircle: four states of the clamped whisker (r = 1, q = 0.2)", States(_CLAMPED, _ONE)),
        Figure(
            "5.15",
            "Semicircle: reactions of the clamped whisker (r = 1, q = 0.2)",
            Signals({"clamped": _CLAMPED}, REACTIONS, (1,)),
        ),
        Figure(
            "5.16",
            "Semicircle: reactions with a spring, c = 70, and without (r = 1, q = 0.2, λ = 0.2)",
            Signals({"c = 70": _SPRUNG, "clamped": _CLAMPED}, REACTIONS, (1,)),
        ),
        Figure("6.1", f"Four states of one whisker (FB, {_BASE})", States(Case("FB"), _ONE)),
        *_family("FB", 2),
        Figure("6.8", f"Four states of two whiskers (FBFB, {_BASE})", States(Case("FBFB"), _TWO)),
        Figure(
            "6.9",
            f"Reactions of two whiskers (FBFB, {_BASE})",
            Signals({"FBFB": Case("FBFB")}, REACTIONS, (1, 2), overlay=True),
        ),
        Figure(
            "6.10",
            "Detail: fy of whisker 2 when whisker 1 detaches (FBFB, q = 0.2, λ = 0.2)",
            Detail(vary("stiffness", STIFFNESSES, Case("FBFB")), "fy", 2, around=("snap_off", 1)),
        ),
        *_family("FBFB", 11),
        Figure(
            "6.17",
            f"Four states of two whiskers with feedback (FBFBR, {_BASE})",
            States(Case("FBFBR"), _TWO),
        ),
        Figure(
            "6.18",
            f"Reactions of two whiskers with feedback (FBFBR) and without (FBFB); {_BASE}",
            Signals(vary("model", ("FBFB", "FBFBR")), REACTIONS, (1, 2)),
        ),
        *_family("FBFBR", 19),
        Figure(
            "7.4",
            f"Reactions of three whiskers with feedback (FBFBFBR, {_BASE})",
            Signals({"FBFBFBR": Case("FBFBFBR")}, REACTIONS, (1, 2, 3), overlay=True),
        ),
    )
}
