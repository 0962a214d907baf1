"""The figures of the thesis: what each of them shows, in the order of the thesis."""

from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker.thesis.figures import Deflections, Detail, Figure, Signals, States
from jaxwhisker.thesis.scans import WHISKERS, Case, vary

_BASE = "c = 70, q = 0.2, λ = 0.2"
_VARIED = {
    "stiffness": "stiffness c (q = 0.2, λ = 0.2)",
    "distance": "object distance q (c = 70, λ = 0.2)",
    "rest_length": "rest length λ (c = 70, q = 0.2)",
}
_LENGTHS = ("spring_length",)
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
_SPRUNG = {"c = 70": Case(semicircle=True)}
_CLAMPED = {"clamped": Case(stiffness=float("inf"), semicircle=True)}
_FB, _FBFB, _FBFBR, _FBFBFBR = ({model: Case(model)} for model in WHISKERS)


def _family(case: Case, first: int, name: str, springs: int) -> dict[str, tuple[str, Signals]]:
    """Reactions and spring lengths for varied stiffness, distance and rest length: six figures, starting at `first`."""
    shown = []
    for field, words in _VARIED.items():
        cases, title = vary(field, case), f"of {name} ({case.model}) for varied {words}"
        shown.append((f"Reactions {title}", Signals(cases, REACTIONS, tuple(case.whiskers))))
        lengths = Signals(cases, _LENGTHS, tuple(range(1, springs + 1)))
        shown.append((f"Spring length{'s' * (springs > 1)} {title}", lengths))
    return {f"6.{number}": one for number, one in enumerate(shown, first)}


_CONTENT = {
    "5.10": ("Whisker bent by a follower force at its tip (loads of table A.1)", Deflections("A.1")),
    "5.11": ("Whisker bent by a follower force along it (loads of table A.2)", Deflections("A.2")),
    "5.12": ("Whisker bent by a force of fixed direction at its tip (table A.3)", Deflections("A.3")),
    "5.13": ("Whisker bent by a force of fixed direction along it (table A.4)", Deflections("A.4")),
    "5.14": ("Semicircle: four states of the clamped whisker (r = 1, q = 0.2)", States(_CLAMPED, _ONE)),
    "5.15": (
        "Semicircle: reactions of the clamped whisker (r = 1, q = 0.2)",
        Signals(_CLAMPED, REACTIONS, (1,)),
    ),
    "5.16": (
        "Semicircle: reactions with a spring, c = 70, and without (r = 1, q = 0.2, λ = 0.2)",
        Signals(_SPRUNG | _CLAMPED, REACTIONS, (1,)),
    ),
    "6.1": (f"Four states of one whisker (FB, {_BASE})", States(_FB, _ONE)),
    **_family(Case("FB"), 2, "one whisker", springs=1),
    "6.8": (f"Four states of two whiskers (FBFB, {_BASE})", States(_FBFB, _TWO)),
    "6.9": (f"Reactions of two whiskers (FBFB, {_BASE})", Signals(_FBFB, REACTIONS, (1, 2))),
    "6.10": (
        "Detail: fy of whisker 2 when whisker 1 detaches (FBFB, q = 0.2, λ = 0.2)",
        Detail(vary("stiffness", Case("FBFB")), "fy", 2, around=("snap_off", 1)),
    ),
    **_family(Case("FBFB"), 11, "two whiskers", springs=2),
    "6.17": (f"Four states of two whiskers with feedback (FBFBR, {_BASE})", States(_FBFBR, _TWO)),
    "6.18": (
        f"Reactions of two whiskers with feedback (FBFBR) and without (FBFB); {_BASE}",
        Signals(_FBFB | _FBFBR, REACTIONS, (1, 2)),
    ),
    **_family(Case("FBFBR"), 19, "two whiskers with feedback", springs=3),
    "7.4": (
        f"Reactions of three whiskers with feedback (FBFBFBR, {_BASE})",
        Signals(_FBFBFBR, REACTIONS, (1, 2, 3)),
    ),
}
FIGURES = {number: Figure(number, title, shows) for number, (title, shows) in _CONTENT.items()}
