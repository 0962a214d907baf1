"""The claims of the thesis's chapter 6 in their order, and those on maxima."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from jaxwhisker.critical import softest, steepest
from jaxwhisker.profile import Parabola
from jaxwhisker.reproduce import coupling, shifts
from jaxwhisker.reproduce.claim import (
    CLAMPED,
    MAXIMA_NAMES,
    MODELS,
    SAME,
    Claim,
    cases,
    cell,
    control_of,
    from_clamped,
    maxima,
    monotone,
    shown,
    whiskers,
)
from jaxwhisker.reproduce.critical import RELATIVE, critical
from jaxwhisker.reproduce.scans import (
    DISTANCES,
    REST_LENGTHS,
    STIFFNESSES,
    WHISKERS,
    Case,
    Scans,
    lets_go,
    snap_through,
)
from jaxwhisker.support import Support
from jaxwhisker.whisker import Whisker


def all_claims(scans: Scans) -> Iterator[Claim]:
    """All claims, in the order of the page."""
    yield critical_stiffness(scans)
    for claim in _CLAIMS:
        yield claim(scans)


def critical_stiffness(scans: Scans) -> Claim:
    """Where the other claims end."""
    slopes = {q: steepest(Whisker(), Parabola(q)) for q in DISTANCES}
    # Three whiskers are scanned at one distance only.
    scanned = [(model, q) for q in DISTANCES for model in WHISKERS if model in MODELS or q == Case().distance]
    brackets = {(model, q): critical(model, q, slopes[q][0]) for model, q in scanned}
    rows = [["q", "max dFx/dx0", "at x0", *(f"c of {model}" for model in WHISKERS)]]
    for q, (slope, at) in slopes.items():
        middles = [sum(brackets.get((model, q), (math.nan, math.nan))) / 2 for model in WHISKERS]
        rows.append([f"{q:g}", cell(slope, 3), cell(at), *(cell(c, 2) for c in middles)])
    ends = [(slope, *brackets["FB", q]) for q, (slope, _) in slopes.items()]
    agree = all(low * (1 - RELATIVE) <= slope <= high * (1 + RELATIVE) for slope, low, high in ends)
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


def _unchanged(scans: Scans, field: str, values: Sequence[float], word: str) -> Claim:
    rows = [["model", word, "whisker", *MAXIMA_NAMES, "max fx", "snaps through at u"]]
    deviation, snapped = 0.0, []
    for case in (case for model in MODELS for case in cases(model, field, values)):
        snap = snap_through(scans(case))
        if snap is not None:
            worst = max(from_clamped(scans, maxima(scans, case, whisker)) for whisker in whiskers(case.model))
            snapped.append(f"{case.model} at {word} {shown(case, field)} (up to {worst:.0%} less)")
        for whisker in whiskers(case.model):
            peaks = maxima(scans, case, whisker)
            if snap is None:
                deviation = max(deviation, from_clamped(scans, peaks))
            last, _ = scans.peak(case, "fx", whisker)
            numbers = [cell(value) for value in (*peaks, last, control_of(snap))]
            rows.append([case.model, shown(case, field), str(whisker), *numbers])
    below = f"It fails below the critical stiffness: {'; '.join(snapped)}." if snapped else ""
    return Claim(
        f"The maxima are unchanged by the {word}",
        f"""{"holds" if deviation < SAME else "FAILS"} for fx before the vertex, fy and mz wherever the scan does not
        snap through the vertex (largest relative deviation from the clamped whisker {deviation:.0e}). {below} It does
        not hold for the largest fx after the vertex, which is cut off by the snap-off.""",
        """The reactions depend on the base position x0 alone, whatever holds the base: every scan runs along the same
        curves, but not at the same pace of the drive. A maximum is unchanged as long as the scan passes it. fx after
        the vertex has none: it grows up to the snap-off, which comes the earlier the softer the base is held.""",
        rows,
    )


def unchanged_by_stiffness(scans: Scans) -> Claim:
    """Maxima and stiffness."""
    return _unchanged(scans, "stiffness", STIFFNESSES, "stiffness")


def unchanged_by_rest_length(scans: Scans) -> Claim:
    """Maxima and rest length."""
    return _unchanged(scans, "rest_length", REST_LENGTHS, "rest length")


def changed_by_distance(scans: Scans) -> Claim:
    """Maxima, snap-off and distance."""
    rows = [["model", "q", "whisker", *MAXIMA_NAMES, "u of letting go", "snaps through at u"]]
    falls: list[bool] = []
    families = {model: cases(model, "distance", DISTANCES) for model in MODELS}
    families["clamped"] = [dataclasses.replace(CLAMPED, distance=q) for q in DISTANCES]
    for model, family in families.items():
        for whisker in whiskers(family[0].model):
            columns = []
            for case in family:
                peaks = maxima(scans, case, whisker)
                gone, snap = control_of(lets_go(scans(case), whisker)), control_of(snap_through(scans(case)))
                columns.append([*map(abs, peaks), -gone])
                numbers = [cell(value) for value in (*peaks, gone, snap)]
                rows.append([model, shown(case, "distance"), str(whisker), *numbers])
            falls += [monotone(column, -1.0) for column in np.array(columns).T]
    return Claim(
        "Only the object distance q changes the maxima; it moves the snap-off",
        "holds: with a growing distance q all maxima fall, and every whisker lets go earlier (at larger u)."
        if all(falls)
        else f"holds for {sum(falls)} of {len(falls)} maxima and snap-offs; see the table.",
        """Of what was varied only q changes the curves of reactions over base position. At q = 0.1 the base value c =
        70 is below the critical stiffness: fy and mz printed there are what the snap leaves of the maxima, which the
        clamped whisker shows whole.""",
        rows,
    )


_CLAIMS: tuple[Callable[[Scans], Claim], ...] = (
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
