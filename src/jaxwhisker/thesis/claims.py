"""The claims of chapter 6 of the thesis in their order, after the critical stiffness, which bounds them."""

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from jaxwhisker._model.support import Support
from jaxwhisker._study.critical import softest
from jaxwhisker.thesis.claim import (
    CLAMPED,
    MAXIMA,
    MAXIMA_NAMES,
    MODELS,
    SAME,
    Claim,
    cell,
    deviation_from_clamped,
    jump,
    maxima,
    measure_all,
    monotone,
    varied,
    varied_value,
    verdict,
    whiskers,
)
from jaxwhisker.thesis.scans import (
    BRACKET,
    DISTANCES,
    REST_LENGTHS,
    STIFFNESSES,
    WHISKERS,
    Case,
    Scans,
    critical_bracket,
    critical_cases,
    first_event,
    snap_through,
    steepest_slope,
    vary,
)

EXACT = 1e-6  # largest difference in u of positions that count as equal
NO_JUMP = 1e-6  # largest change of fy that does not count as a jump
# The model with three whiskers is scanned at one distance only.
CRITICAL = [(model, q) for q in DISTANCES for model in WHISKERS if model in MODELS or q == Case().distance]


def needed() -> list[Case]:
    """The cases of all claims."""
    fields = {"stiffness": STIFFNESSES, "distance": DISTANCES, "rest_length": REST_LENGTHS}
    families = [family for field, values in fields.items() for family in varied(field, values).values()]
    families += [critical_cases(model, q) for model, q in CRITICAL]
    return [case for family in [*families, _clamped(), [Case("FBFBFBR")]] for case in family]


def all_claims(scans: Scans) -> Iterator[Claim]:
    """All claims, in the order of the page."""
    for claim in _CLAIMS:
        yield claim(scans)


def _clamped() -> list[Case]:
    return [dataclasses.replace(CLAMPED, distance=q) for q in DISTANCES]


def critical_stiffness(scans: Scans) -> Claim:
    """Critical stiffness, which limits the other claims."""
    brackets = {key: critical_bracket(scans, critical_cases(*key)) for key in CRITICAL}
    rows = [["q", "max dFx/dx0", "at x0", *(f"c of {model}" for model in WHISKERS)]]
    for q in DISTANCES:
        slope, base_x = steepest_slope(q)
        middles = [sum(brackets.get((model, q), (math.nan, math.nan))) / 2 for model in WHISKERS]
        rows.append([f"{q:g}", cell(slope, 3), cell(base_x), *(cell(c, 2) for c in middles)])
    agree = all(brackets["FB", q][0] <= steepest_slope(q).slope <= brackets["FB", q][1] for q in DISTANCES)
    factors = ", ".join(f"{softest(Support.named(model, 1.0)):.3f} ({model})" for model in WHISKERS)
    return Claim(
        "Below a critical stiffness the scan snaps through the vertex",
        figures="",
        holds="new" if agree else "no",
        result="""One whisker snaps through if and only if its spring is softer than the steepest slope of the clamped
        whisker's force."""
        if agree
        else "The scans of FB do not snap at the stiffness that the slope predicts.",
        explanation=f"""The thesis does not mention this limit, which bounds the other claims. A base is stable while
        its spring is stiffer than the slope of the contact force: c > dFx/dx0 of the clamped whisker, where Fx = -fx is
        the force of the object on the whisker and x0 the position of the base. The steepest slope near the vertex is
        therefore the critical stiffness of FB. For coupled whiskers the critical stiffness would be this slope times
        the compliance of the softest base, {factors}, if the forces on the other whiskers stayed constant. They do not,
        so the last columns come from scans: the stiffness of all springs (rest length 0.2) at which the first snap
        before the vertex appears, within {BRACKET / 2:.2%} (three whiskers: only for the q used with them). Below it
        the whisker snaps over the steep part, and the scan never measures the maxima that lie there.""",
        rows=rows,
    )


def _snap_control(scans: Scans, case: Case) -> float:
    """Drive position at which a scan snaps through the vertex; NaN if it does not."""
    snap = snap_through(scans(case))
    return math.nan if snap is None else snap.control


def _unchanged(scans: Scans, field: str, values: Sequence[float], word: str, figures: str) -> Claim:
    def measure(case: Case, whisker: int) -> list[float]:
        peaks = maxima(scans, case, whisker)
        largest_fx, snap = scans.summary(case, "max_fx", whisker), _snap_control(scans, case)
        return [*peaks, largest_fx, snap, deviation_from_clamped(scans, peaks)]

    rows, measured = measure_all(varied(field, values), field, measure)
    lost: dict[str, float] = {}  # largest deviation of each scan that snaps through
    deviation = 0.0  # of all other scans
    for model, numbers in measured:
        for value, (*_, snap, off) in zip(values, numbers, strict=True):
            if math.isnan(snap):
                deviation = max(deviation, off)
            else:
                which = f"{model} at {word} {varied_value(value)}"
                lost[which] = max(off, lost.get(which, 0.0))
    snapped = [f"{which} (by up to {off:.0%})" for which, off in lost.items()]
    below = f"Maxima are smaller below the critical stiffness: {', '.join(snapped)}." if snapped else ""
    return Claim(
        f"The maxima are unchanged by the {word}",
        figures=figures,
        holds="in part" if deviation < SAME else "no",
        result=f"""{verdict(deviation < SAME)} for fx before the vertex, fy and mz in every scan that does not snap
        through the vertex (largest relative deviation from the clamped whisker {deviation:.0e}). {below} The claim does
        not hold for the largest fx after the vertex, because the snap-off ends the signal there.""",
        explanation="""The reactions depend only on the base position x0, not on what holds the base. Every scan follows
        the same curves, but at a different pace of the drive. A maximum is unchanged as long as the scan passes it. fx
        has no maximum after the vertex: it grows until the snap-off, and the softer the base is held, the earlier the
        snap-off comes.""",
        rows=[
            ["model", word, "whisker", *MAXIMA_NAMES, "max fx", "snaps through at u"],
            *(row[:-1] for row in rows),
        ],
    )


def unchanged_by_stiffness(scans: Scans) -> Claim:
    """Maxima and stiffness."""
    return _unchanged(scans, "stiffness", STIFFNESSES, "stiffness", "6.2, 6.11, 6.19")


def unchanged_by_rest_length(scans: Scans) -> Claim:
    """Maxima and rest length."""
    return _unchanged(scans, "rest_length", REST_LENGTHS, "rest length", "6.6, 6.15, 6.23")


def common_point(scans: Scans) -> Claim:
    """The point at which the curves of all stiffnesses cross."""
    rows = [["model", "stiffness", "u at vertex 1", "fx", "fy", "mz"]]
    passed: dict[str, list[float]] = {model: [] for model in MODELS}
    for case in (case for family in varied("stiffness", STIFFNESSES).values() for case in family):
        vertex = first_event(scans(case), "vertex", 1)
        if vertex is None:
            rows.append([case.model, varied_value(case.stiffness), *["-"] * 4])
            continue
        passed[case.model].append(vertex.control)
        forces = [cell(float(np.asarray(getattr(vertex.before, name))[0])) for name in ("fx", "fy", "mz")]
        rows.append([case.model, varied_value(case.stiffness), cell(vertex.control, 6), *forces])
    spread = {model: float(np.ptp(u)) for model, u in passed.items()}
    return Claim(
        "For every stiffness the curves have a common point at u = -0.534, where the force is vertical",
        figures="6.2, 6.3",
        holds="in part" if spread["FB"] < EXACT else "no",
        result=f"""{verdict(spread["FB"] < EXACT)} for one whisker: all curves cross at u = {np.mean(passed["FB"]):.6f}
        (spread {spread["FB"]:.0e}). It does not hold for coupled whiskers: the position u at which whisker 1 passes the
        vertex spreads by {spread["FBFB"]:.3f} (FBFB) and {spread["FBFBR"]:.3f} (FBFBR).""",
        explanation="""Where the contact force is vertical, it does not load the spring, which then has its rest length:
        the base is at x0 = -0.33385 and the drive at x0 - 0.2 for every c. Coupled whiskers reach this state one after
        the other. While the force on one of them is vertical, the force on the other still loads the springs.""",
        rows=rows,
    )


def softer_springs(scans: Scans) -> Claim:
    """Shift of maxima and detachment with stiffness."""
    names = (*(f"control_of_{name}" for name in MAXIMA), "last_contact")
    rows, measured = measure_all(
        varied("stiffness", STIFFNESSES),
        "stiffness",
        lambda case, whisker: [scans.summary(case, name, whisker) for name in names],
    )
    early = [monotone(u, 1.0) for _, numbers in measured for u in numbers.T[:-1]]
    late = all(monotone(numbers[:, -1], -1.0) for _, numbers in measured)
    return Claim(
        "Softer springs shift the maxima towards -x",
        figures="6.2, 6.11, 6.19",
        holds="yes" if all(early) else "in part",
        result=f"""The claim holds {"" if all(early) else f"in {sum(early)} of {len(early)} families "}for min fx, max
        fy and max mz, which lie before the vertex: with every softer spring they come at smaller u. The snap-off
        {"moves" if late else "does not always move"} the other way.""",
        explanation="""Before the vertex the object pushes the whisker back (Fx > 0). A base on a soft spring lags
        behind, so the drive is further when the base reaches the maximum. After the vertex the object pulls the whisker
        forward (Fx < 0). The base is then ahead of the drive, and events come earlier.""",
        rows=[["model", "stiffness", "whisker", *(f"u of {name}" for name in MAXIMA_NAMES), "u of detachment"], *rows],
    )


def longer_rest_lengths(scans: Scans) -> Claim:
    """Shift of the signal with rest length."""

    def measure(case: Case, whisker: int) -> list[float]:
        shortest = dataclasses.replace(case, rest_length=REST_LENGTHS[0])
        unloaded = -whisker * (case.rest_length - shortest.rest_length)  # shift of the unloaded base
        here, there = (
            np.array([scans.summary(c, name, whisker) for name in ("control_of_max_mz", "last_contact")])
            for c in (case, shortest)
        )
        shift = here - there
        return [here[0], shift[0], here[1], shift[1], *abs(shift - unloaded)]

    rows, measured = measure_all(varied("rest_length", REST_LENGTHS), "rest_length", measure)
    worst = {model: max(np.max(numbers[:, 4:]) for name, numbers in measured if name == model) for model in MODELS}
    towards = [monotone(numbers[:, k], -1.0) for _, numbers in measured for k in (0, 2)]
    return Claim(
        "Longer rest lengths shift the signal towards -x, and do nothing else",
        figures="6.6, 6.15, 6.23",
        holds="in part" if worst["FB"] < EXACT else "no",
        result=f"""{verdict(worst["FB"] < EXACT)} exactly for one whisker: the whole signal moves by the added rest
        length (within {worst["FB"]:.0e}). The signals of coupled whiskers {"" if all(towards) else "mostly "}shift
        towards -x, too, but not rigidly: maxima and detachments move by up to {worst["FBFB"]:.3f} (FBFB) and
        {worst["FBFBR"]:.3f} (FBFBR) more or less than the unloaded bases. The signal changes its shape, but not its
        maxima.""",
        explanation="""The rest length only sets where the unloaded base is relative to the drive. With two whiskers it
        also sets the distance between them, and with it when one whisker is on the steep part while the other loads the
        common spring.""",
        rows=[
            ["model", "rest length", "whisker", "u of max mz", "shift", "u of detachment", "shift"],
            *(row[:7] for row in rows),
        ],
    )


def narrower(scans: Scans) -> Claim:
    """Width of the signal with stiffness."""

    def widths(case: Case, whisker: int) -> list[float]:
        contact, half, lowest, highest = (
            scans.summary(case, name, whisker)
            for name in ("contact_width", "half_width_mz", "control_of_min_fx", "control_of_max_fx")
        )
        return [contact, lowest - highest, half]

    header = ["model", "stiffness", "whisker", "contact, in u", "min to max of fx, in u", "mz above half, in u"]
    rows, measured = measure_all(varied("stiffness", STIFFNESSES), "stiffness", widths)
    shrinks = [monotone(width, 1.0) for _, numbers in measured for width in numbers.T]
    return Claim(
        "Softer springs make the signal narrower",
        figures="6.2, 6.11, 6.19",
        holds="yes" if all(shrinks) else "in part",
        result="The claim holds: every width of every whisker's signal shrinks with every softer spring."
        if all(shrinks)
        else f"The claim holds for {sum(shrinks)} of {len(shrinks)} widths (contact, fx, mz of every whisker).",
        explanation="""Softer springs shift the part before the vertex towards -x and the part after it towards +x, so
        the signal narrows from both sides.""",
        rows=[header, *rows],
    )


def changed_by_distance(scans: Scans) -> Claim:
    """Maxima, detachment and object distance."""

    def measure(case: Case, whisker: int) -> list[float]:
        last = scans.summary(case, "last_contact", whisker)
        return [*maxima(scans, case, whisker), last, _snap_control(scans, case)]

    rows, measured = measure_all(varied("distance", DISTANCES) | {"clamped": _clamped()}, "distance", measure)
    # min fx and u of the detachment are negative: their size falls while they rise.
    falls = [monotone(s * c, -1.0) for _, n in measured for s, c in zip((-1, 1, 1, -1), n.T[:-1], strict=True)]
    return Claim(
        "Only the object distance q changes the maxima; it moves the snap-off",
        figures="6.4, 6.13, 6.21",
        holds="yes" if all(falls) else "in part",
        result="The claim holds: as q grows, all maxima fall, and every whisker detaches earlier (at larger u)."
        if all(falls)
        else f"The claim holds for {sum(falls)} of {len(falls)} maxima and detachments.",
        explanation="""Of the varied parameters only q changes the reactions as functions of the base position. At
        q = 0.1 the base value c = 70 is below the critical stiffness: the snap cuts off the maxima of fy and mz. The
        rows of the clamped whisker show the full maxima.""",
        rows=[["model", "q", "whisker", *MAXIMA_NAMES, "u of detachment", "snaps through at u"], *rows],
    )


def detachment(scans: Scans) -> Claim:
    """The signal of whisker 2 when whisker 1 detaches."""
    rows = [["stiffness", "whisker 1 detaches at u", "fy of whisker 2 before", "after", "jump"]]
    jumps = []
    for case in vary("stiffness", STIFFNESSES, Case("FBFB")).values():
        last, (before, after) = scans.summary(case, "last_contact", 1), jump(scans(case), 1, 2)
        jumps.append(abs(after - before))
        rows.append([varied_value(case.stiffness), *map(cell, (last, before, after, after - before))])
    visible = monotone(jumps, -1.0) and jumps[-1] < NO_JUMP
    return Claim(
        "The detachment of whisker 1 is visible in the signal of whisker 2",
        figures="6.10",
        holds="yes" if visible else "no",
        result="""The claim holds: fy of whisker 2 jumps when whisker 1 detaches, and the softer the springs, the larger
        the jump. Rigid springs show no jump."""
        if visible
        else "The claim does not hold: the jump does not fall with the stiffness throughout.",
        explanation="""Before the detachment the object pulls base 1, and through the springs base 2, ahead of the
        drive. When whisker 1 detaches, base 2 springs back at once (figure 6.10).""",
        rows=rows,
    )


def feedback(scans: Scans) -> Claim:
    """FBFBR compared with FBFB."""
    rows = [["stiffness", "jump of fy 2, FBFB", "FBFBR", "shift of max mz 2, FBFB", "FBFBR"]]
    weaker: list[bool] = []
    for c in STIFFNESSES:
        numbers: dict[str, tuple[float, float]] = {}
        for model in ("FBFB", "FBFBR"):
            before, after = jump(scans(Case(model, c)), 1, 2)
            here, rigid = (scans.summary(Case(model, s), "control_of_max_mz", 2) for s in (c, math.inf))
            numbers[model] = abs(after - before), abs(here - rigid)
        if c < math.inf:
            pairs = zip(numbers["FBFB"], numbers["FBFBR"], strict=True)
            weaker += [with_feedback < without for without, with_feedback in pairs]
        in_order = (numbers[model][k] for k in range(2) for model in ("FBFB", "FBFBR"))
        rows.append([varied_value(c), *map(cell, in_order)])
    return Claim(
        "Feedback (FBFBR) weakens all of these effects",
        figures="6.18",
        holds="yes" if all(weaker) else "in part",
        result="""The claim holds: at every stiffness the jump of whisker 2 at the detachment of whisker 1 is smaller
        with feedback than without, and so is the shift of its maximum (in u, relative to rigid springs)."""
        if all(weaker)
        else f"The claim holds for {sum(weaker)} of {len(weaker)} comparisons.",
        explanation="""The feedback spring ties base 2 to the drive. A force on one base then moves the other base less,
        and its own base, too.""",
        rows=rows,
    )


def third_whisker(scans: Scans) -> Claim:
    """FBFBFBR compared with FBFBR."""
    rows = [["model", "whisker", *MAXIMA_NAMES, "detaches at u", "jump of fy of the next"]]
    deviation = 0.0
    two, three = Case("FBFBR"), Case("FBFBFBR")
    for case in (two, three):
        for whisker in whiskers(case.model):
            peaks = maxima(scans, case, whisker)
            deviation = max(deviation, deviation_from_clamped(scans, peaks))
            last = scans.summary(case, "last_contact", whisker)
            before, after = jump(scans(case), whisker, whisker + 1)
            rows.append([case.model, str(whisker), *map(cell, (*peaks, last, after - before))])
    kinds = [{event.kind for event in scans(case).events} for case in (two, three)]
    new = sorted(kind.name for kind in kinds[1] - kinds[0])
    holds = deviation < SAME and not new
    return Claim(
        "A third whisker brings no new effect",
        figures="7.4",
        holds="yes" if holds else "no",
        result=f"""{verdict(holds)}: the maxima are those of the clamped whisker (within {deviation:.0e}), and
        {"no new kind of event occurs" if not new else "new kinds of events occur: " + ", ".join(new)}.""",
        explanation="The detachment of one whisker disturbs the next one, as with two whiskers.",
        rows=rows,
    )


_CLAIMS = (
    critical_stiffness,
    unchanged_by_stiffness,
    unchanged_by_rest_length,
    common_point,
    softer_springs,
    longer_rest_lengths,
    narrower,
    changed_by_distance,
    detachment,
    feedback,
    third_whisker,
)
