"""The claims of the thesis's chapter 6 in their order, and those on maxima."""

import dataclasses
import math
from collections.abc import Iterator, Sequence

from jaxwhisker._model.support import Support
from jaxwhisker._study.critical import softest
from jaxwhisker.thesis import coupling, shifts
from jaxwhisker.thesis.claim import (
    CLAMPED,
    MAXIMA_NAMES,
    MODELS,
    SAME,
    Claim,
    cell,
    from_clamped,
    maxima,
    measured,
    monotone,
    shown,
    varied,
)
from jaxwhisker.thesis.critical import RELATIVE, bracket, slope, trials
from jaxwhisker.thesis.scans import DISTANCES, REST_LENGTHS, STIFFNESSES, WHISKERS, Case, Scans, snap_through

# Three whiskers are scanned at one distance only.
SCANNED = [(model, q) for q in DISTANCES for model in WHISKERS if model in MODELS or q == Case().distance]


def needed() -> list[Case]:
    """The cases that the claims are about."""
    fields = {"stiffness": STIFFNESSES, "distance": DISTANCES, "rest_length": REST_LENGTHS}
    families = [family for field, values in fields.items() for family in varied(field, values).values()]
    families += [trials(model, q) for model, q in SCANNED]
    return [case for family in [*families, _clamped(), [Case("FBFBFBR")]] for case in family]


def _clamped() -> list[Case]:
    return [dataclasses.replace(CLAMPED, distance=q) for q in DISTANCES]


def all_claims(scans: Scans) -> Iterator[Claim]:
    """All claims, in the order of the page."""
    for claim in _CLAIMS:
        yield claim(scans)


def critical_stiffness(scans: Scans) -> Claim:
    """Where the other claims end."""
    brackets = {key: bracket(scans, trials(*key)) for key in SCANNED}
    rows = [["q", "max dFx/dx0", "at x0", *(f"c of {model}" for model in WHISKERS)]]
    for q in DISTANCES:
        middles = [sum(brackets.get((model, q), (math.nan, math.nan))) / 2 for model in WHISKERS]
        rows.append([f"{q:g}", cell(slope(q).slope, 3), cell(slope(q).base_x), *(cell(c, 2) for c in middles)])
    agree = all(brackets["FB", q][0] <= slope(q).slope <= brackets["FB", q][1] for q in DISTANCES)
    factors = ", ".join(f"{softest(Support.named(model, 1.0)):.3f} ({model})" for model in WHISKERS)
    return Claim(
        "Below a critical stiffness the scan snaps through the vertex (not in the thesis: it bounds the other claims)",
        """one whisker snaps through where its spring is softer than the steepest slope of the clamped whisker's force,
        and nowhere above it."""
        if agree
        else "NOT confirmed: the scans of FB do not snap where the slope says.",
        f"""A base is stable while its spring is stiffer than the object's force is steep: c > dFx/dx0 of the clamped
        whisker (Fx = -fx is the force of the object on the whisker, x0 the position of the base). The steepest slope
        near the vertex is therefore the critical stiffness of FB. For coupled whiskers it would be that slope times the
        compliance of the softest base, {factors}, if the forces on the others stayed as they are; they don't, so the
        last columns were found by scans: stiffness of all springs (rest length 0.2) at which the first snap before the
        vertex appears, within {RELATIVE / 2:.2%} (three whiskers: only for the q used with them). Below it the drive
        pulls a whisker over the steep part in a snap, and whatever maxima lie on the way are never measured.""",
        rows,
    )


def _snap(scans: Scans, case: Case) -> float:
    """Where a scan snaps through the vertex; NaN if it does not."""
    found = snap_through(scans(case))
    return math.nan if found is None else found.control


def _unchanged(scans: Scans, field: str, values: Sequence[float], word: str) -> Claim:
    def measure(case: Case, whisker: int) -> list[float]:
        peaks = maxima(scans, case, whisker)
        return [*peaks, scans.summary(case, "max_fx", whisker), _snap(scans, case), from_clamped(scans, peaks)]

    rows, found = measured(varied(field, values), field, measure)
    worst: dict[str, float] = {}  # of the scans that snap
    deviation = 0.0
    for model, numbers in found:
        for value, (*_, snap, off) in zip(values, numbers, strict=True):
            if math.isnan(snap):
                deviation = max(deviation, off)
            else:
                which = f"{model} at {word} {shown(value)}"
                worst[which] = max(off, worst.get(which, 0.0))
    snapped = [f"{which} (up to {off:.0%} less)" for which, off in worst.items()]
    below = f"It fails below the critical stiffness: {'; '.join(snapped)}." if snapped else ""
    return Claim(
        f"The maxima are unchanged by the {word}",
        f"""{"holds" if deviation < SAME else "FAILS"} for fx before the vertex, fy and mz wherever the scan does not
        snap through the vertex (largest relative deviation from the clamped whisker {deviation:.0e}). {below} It does
        not hold for the largest fx after the vertex, which is cut off by the snap-off.""",
        """The reactions depend on the base position x0 alone, whatever holds the base: every scan runs along the same
        curves, but not at the same pace of the drive. A maximum is unchanged as long as the scan passes it. fx after
        the vertex has none: it grows up to the snap-off, which comes the earlier the softer the base is held.""",
        [["model", word, "whisker", *MAXIMA_NAMES, "max fx", "snaps through at u"], *(row[:-1] for row in rows)],
    )


def unchanged_by_stiffness(scans: Scans) -> Claim:
    """Maxima and stiffness."""
    return _unchanged(scans, "stiffness", STIFFNESSES, "stiffness")


def unchanged_by_rest_length(scans: Scans) -> Claim:
    """Maxima and rest length."""
    return _unchanged(scans, "rest_length", REST_LENGTHS, "rest length")


def changed_by_distance(scans: Scans) -> Claim:
    """Maxima, snap-off and distance."""

    def measure(case: Case, whisker: int) -> list[float]:
        gone = scans.summary(case, "last_contact", whisker)
        return [*maxima(scans, case, whisker), gone, _snap(scans, case)]

    rows, found = measured(varied("distance", DISTANCES) | {"clamped": _clamped()}, "distance", measure)
    # fx is negative there, and u falls.
    falls = [monotone(s * c, -1.0) for _, n in found for s, c in zip((-1, 1, 1, -1), n.T[:-1], strict=True)]
    return Claim(
        "Only the object distance q changes the maxima; it moves the snap-off",
        "holds: with a growing distance q all maxima fall, and every whisker lets go earlier (at larger u)."
        if all(falls)
        else f"holds for {sum(falls)} of {len(falls)} maxima and snap-offs; see the table.",
        """Of what was varied only q changes the curves of reactions over base position. At q = 0.1 the base value c =
        70 is below the critical stiffness: fy and mz printed there are what the snap leaves of the maxima, which the
        clamped whisker shows whole.""",
        [["model", "q", "whisker", *MAXIMA_NAMES, "u of letting go", "snaps through at u"], *rows],
    )


_CLAIMS = (
    critical_stiffness,
    unchanged_by_stiffness,
    unchanged_by_rest_length,
    shifts.common_point,
    shifts.softer_springs,
    shifts.longer_rest_lengths,
    shifts.narrower,
    changed_by_distance,
    coupling.detachment,
    coupling.feedback,
    coupling.third_whisker,
)
