"""The claims of chapter 6 of the thesis in their order, after the critical stiffness, which bounds them.

Every claim is a function: its docstring states and explains the claim, and its result says what the scans show.
"""

import dataclasses
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import NamedTuple

import numpy as np

from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.report import fixed
from jaxwhisker._scan.result import Result
from jaxwhisker.thesis.scans import (
    BRACKET,
    VALUES,
    WHISKERS,
    Case,
    Scans,
    critical_bracket,
    critical_cases,
    first_event,
    snap_through,
    softness,
    steepest_slope,
    vary,
)

PEAKS = ("min_fx", "max_fy", "max_mz")
PEAK_NAMES = tuple(name.replace("_", " ") for name in PEAKS)
CLAMPED_CASE = Case(stiffness=math.inf)
CLAMPED_CASES = {"clamped": vary("distance", CLAMPED_CASE)}
COUPLINGS = ("FB", "FBFB", "FBFBR")
UNCHANGED = 1e-6  # relative difference below which peaks count as unchanged
SAME_PLACE = 1e-6  # largest difference in u of positions that count as equal
NO_JUMP = 1e-6  # largest change of fy that does not count as a jump
# The model with three whiskers is scanned at one distance only.
CRITICAL = [(m, q) for q in VALUES["distance"] for m in WHISKERS if m in COUPLINGS or q == Case().distance]


@dataclass(frozen=True)
class Claim:
    """A statement of the thesis and what the scans show."""

    statement: str
    figures: str  # figures that show it; empty if the thesis does not make the statement
    holds: str  # "yes", "in part", "no", or "new" for what the thesis does not state
    result: str
    explanation: str
    rows: Sequence[Sequence[str]]

    def in_short(self) -> str:
        """The first sentence of the result, for a table whose other column says whether the claim holds."""
        first = " ".join(self.result.split()).split(". ")[0].rstrip(".")
        return first.removeprefix("The claim holds").lstrip(": ")


class Findings(NamedTuple):
    """What the scans show."""

    checks: Sequence[bool]  # all are true if the claim holds
    result: str  # in words, if the claim holds
    rows: Sequence[Sequence[str]]


CLAIMS: list[Callable[[Scans], Claim]] = []


def _claim(figures: str, holds: str = "yes") -> Callable[[Callable[[Scans], Findings]], Callable[[Scans], Claim]]:
    """Make a claim of a function; `holds` is the verdict if all checks are true."""

    def register(find: Callable[[Scans], Findings]) -> Callable[[Scans], Claim]:
        statement, _, explanation = inspect.cleandoc(find.__doc__ or "").partition("\n\n")

        @wraps(find)
        def claim(scans: Scans) -> Claim:
            checks, result, rows = find(scans)
            if not all(checks):
                result = f"The claim holds for {sum(checks)} of {len(checks)} comparisons."
            verdict = holds if all(checks) else "in part" if any(checks) else "no"
            return Claim(statement.rstrip("."), figures, verdict, result, explanation, rows)

        CLAIMS.append(claim)
        return claim

    return register


def needed() -> list[Case]:
    """The cases of all claims, apart from those around critical stiffnesses."""
    groups = [family.values() for field in VALUES for family in families(field).values()]
    return [case for group in (*groups, CLAMPED_CASES["clamped"].values(), [Case("FBFBFBR")]) for case in group]


def families(field: str) -> dict[str, dict[str, Case]]:
    """Cases with one field varied, by label, of every model."""
    return {model: vary(field, Case(model)) for model in COUPLINGS}


def cell(value: float, digits: int = 4) -> str:
    """A number in a table."""
    return "-" if math.isnan(value) else fixed(value, digits)


def deviation_from_clamped(scans: Scans, peaks: Sequence[float]) -> float:
    """Largest relative deviation of `peaks`, in the order of PEAKS, from those of the clamped whisker."""
    expected = scans.summary(CLAMPED_CASE, 1, *PEAKS)
    return max(abs(value / reference - 1) for value, reference in zip(peaks, expected, strict=True))


def monotone(values: Sequence[float] | np.ndarray, sign: float) -> bool:
    """Whether all differences between neighbours are positive (sign = 1) or negative (-1)."""
    return bool(np.all(sign * np.diff(values) > 0))


def measure_all(
    field: str, measure: Callable[[Case, int], Sequence[float]], more: Mapping[str, Mapping[str, Case]] = {}
) -> tuple[list[list[str]], list[tuple[str, np.ndarray]]]:
    """Apply `measure` to every whisker of cases that differ in one field.

    Returns:
        The rows of a table; and for every whisker the name of its family and an array (cases, numbers).
    """
    rows, measured = [], []
    for name, family in {**families(field), **more}.items():
        cases = list(family.values())
        for whisker in cases[0].whiskers:
            numbers = np.array([measure(case, whisker) for case in cases])
            rows += [
                [name, f"{getattr(case, field):g}", str(whisker), *map(cell, values)]
                for case, values in zip(cases, numbers, strict=True)
            ]
            measured.append((name, numbers))
    return rows, measured


def jump(result: Result, whisker: int, other: int) -> tuple[float, float]:
    """fy of whisker `other` before and after the last detachment of `whisker`; NaN if either is missing."""
    detached = [e for kind in (EventKind.snap_off, EventKind.release) for e in result.events.of(kind, whisker)]
    if not detached or other > result.scene.support.whiskers:
        return math.nan, math.nan
    last = min(detached, key=lambda e: e.control)
    return float(last.before.fy[other - 1]), float(last.after.fy[other - 1])


def _snap_control(scans: Scans, case: Case) -> float:
    """Drive position at which a scan snaps through the vertex; NaN if it does not."""
    snap = snap_through(scans.events(case))
    return math.nan if snap is None else snap.control


@_claim(figures="", holds="new")
def critical_stiffness(scans: Scans) -> Findings:
    """Below a critical stiffness the scan snaps through the vertex.

    The thesis does not mention this limit, which bounds the other claims. A base is stable while its spring is stiffer
    than the slope of the contact force: c > dFx/dx0 of the clamped whisker, where Fx = -fx is the force of the object
    on the whisker and x0 the position of the base. The steepest slope near the vertex is therefore the critical
    stiffness of FB. For coupled whiskers the critical stiffness would be this slope times the compliance of the softest
    base (last row) if the forces on the other whiskers stayed constant. They do not, so the last columns come from
    scans: the stiffness of all springs (rest length 0.2) at which the first snap before the vertex appears (three
    whiskers: only for the q used with them). Below it the whisker snaps over the steep part, and the scan never
    measures the maxima that lie there.
    """
    rows, checks = [["q", "max dFx/dx0", "at x0", *(f"c of {model}" for model in WHISKERS)]], []
    for q in VALUES["distance"]:
        slope, base_x = steepest_slope(q)
        brackets = {m: critical_bracket(scans, critical_cases(m, q)) for m in WHISKERS if (m, q) in CRITICAL}
        checks.append(brackets["FB"][0] <= slope <= brackets["FB"][1])
        middles = [sum(brackets.get(model, (math.nan, math.nan))) / 2 for model in WHISKERS]
        rows.append([f"{q:g}", cell(slope, 3), cell(base_x), *(cell(c, 2) for c in middles)])
    rows.append(["compliance", "-", "-", *(f"{softness(model):.3f}" for model in WHISKERS)])
    result = f"""One whisker snaps through if and only if its spring is softer than the steepest slope of the clamped
    whisker's force. The scans determine the critical stiffness within {BRACKET / 2:.2%}."""
    return Findings(checks, result, rows)


def _unchanged(scans: Scans, field: str) -> Findings:
    word = field.replace("_", " ")

    def measure(case: Case, whisker: int) -> list[float]:
        *peaks, largest_fx = scans.summary(case, whisker, *PEAKS, "max_fx")
        return [*peaks, largest_fx, _snap_control(scans, case), deviation_from_clamped(scans, peaks)]

    rows, measured = measure_all(field, measure)
    lost: dict[str, float] = {}  # largest deviation of each scan that snaps through
    kept = []  # deviations of all other scans
    for model, numbers in measured:
        for value, (*_, snap, off) in zip(VALUES[field], numbers, strict=True):
            if math.isnan(snap):
                kept.append(off)
            else:
                which = f"{model} at {word} {value:g}"
                lost[which] = max(off, lost.get(which, 0.0))
    snapped = ", ".join(f"{which} (by up to {off:.0%})" for which, off in lost.items())
    below = f"Maxima are smaller below the critical stiffness: {snapped}." * bool(lost)
    result = f"""The claim holds for fx before the vertex, fy and mz in every scan that does not snap through the vertex
    (largest relative deviation from the clamped whisker {max(kept):.0e}). {below} The claim does not hold for the
    largest fx after the vertex, because the snap-off ends the signal there."""
    header = ["model", word, "whisker", *PEAK_NAMES, "max fx", "snaps through at u"]
    return Findings([off < UNCHANGED for off in kept], result, [header, *(row[:-1] for row in rows)])


@_claim("6.2, 6.11, 6.19", holds="in part")
def unchanged_by_stiffness(scans: Scans) -> Findings:
    """The maxima are unchanged by the stiffness.

    The reactions depend only on the base position x0, not on what holds the base. Every scan follows the same curves,
    but at a different pace of the drive. A maximum is unchanged as long as the scan passes it. fx has no maximum after
    the vertex: it grows until the snap-off, and the softer the base is held, the earlier the snap-off comes.
    """
    return _unchanged(scans, "stiffness")


@_claim("6.6, 6.15, 6.23", holds="in part")
def unchanged_by_rest_length(scans: Scans) -> Findings:
    """The maxima are unchanged by the rest length.

    The reasons are those of claim 2: every scan follows the same curves at its own pace.
    """
    return _unchanged(scans, "rest_length")


@_claim("6.2, 6.3", holds="in part")
def common_point(scans: Scans) -> Findings:
    """For every stiffness the curves have a common point at u = -0.534, where the force is vertical.

    Where the contact force is vertical, it does not load the spring, which then has its rest length: the base is at
    x0 = -0.33385 and the drive at x0 - 0.2 for every c. Coupled whiskers reach this state one after the other. While
    the force on one of them is vertical, the force on the other still loads the springs.
    """
    rows = [["model", "stiffness", "u at vertex 1", "fx", "fy", "mz"]]
    passed: dict[str, list[float]] = {model: [] for model in COUPLINGS}
    for case in (case for family in families("stiffness").values() for case in family.values()):
        cells = ["-"] * 4
        if vertex := first_event(scans(case), "vertex", 1):
            passed[case.model].append(vertex.control)
            forces = (vertex.before.fx, vertex.before.fy, vertex.before.mz)
            cells = [cell(vertex.control, 6), *(cell(float(force[0])) for force in forces)]
        rows.append([case.model, f"{case.stiffness:g}", *cells])
    spread = {model: float(np.ptp(u)) for model, u in passed.items()}
    result = f"""The claim holds for one whisker: all curves cross at u = {np.mean(passed["FB"]):.6f} (spread
    {spread["FB"]:.0e}). It does not hold for coupled whiskers: the position u at which whisker 1 passes the vertex
    spreads by {spread["FBFB"]:.3f} (FBFB) and {spread["FBFBR"]:.3f} (FBFBR)."""
    return Findings([spread["FB"] < SAME_PLACE], result, rows)


@_claim("6.2, 6.11, 6.19")
def softer_springs(scans: Scans) -> Findings:
    """Softer springs shift the maxima towards -x.

    Before the vertex the object pushes the whisker back (Fx > 0). A base on a soft spring lags behind, so the drive is
    further when the base reaches the maximum. After the vertex the object pulls the whisker forward (Fx < 0). The base
    is then ahead of the drive, and events come earlier.
    """
    names = (*(f"control_of_{name}" for name in PEAKS), "last_contact")
    rows, measured = measure_all("stiffness", lambda case, whisker: scans.summary(case, whisker, *names))
    checks = [monotone(u, sign) for _, numbers in measured for u, sign in zip(numbers.T, (1, 1, 1, -1), strict=True)]
    result = """The claim holds for min fx, max fy and max mz, which lie before the vertex: with every softer spring
    they come at smaller u. The snap-off moves the other way."""
    header = ["model", "stiffness", "whisker", *(f"u of {name}" for name in PEAK_NAMES), "u of detachment"]
    return Findings(checks, result, [header, *rows])


@_claim("6.6, 6.15, 6.23", holds="in part")
def longer_rest_lengths(scans: Scans) -> Findings:
    """Longer rest lengths shift the signal towards -x, and do nothing else.

    The rest length only sets where the unloaded base is relative to the drive. With two whiskers it also sets the
    distance between them, and with it when one whisker is on the steep part while the other loads the common spring.
    """
    names = ("control_of_max_mz", "last_contact")

    def measure(case: Case, whisker: int) -> list[float]:
        shortest = dataclasses.replace(case, rest_length=VALUES["rest_length"][0])
        unloaded = -whisker * (case.rest_length - shortest.rest_length)  # shift of the unloaded base
        here, there = (np.array(scans.summary(c, whisker, *names)) for c in (case, shortest))
        shift = here - there
        return [here[0], shift[0], here[1], shift[1], *abs(shift - unloaded)]

    rows, measured = measure_all("rest_length", measure)
    worst = {model: max(np.max(numbers[:, 4:]) for name, numbers in measured if name == model) for model in COUPLINGS}
    towards = [monotone(numbers[:, k], -1.0) for _, numbers in measured for k in (0, 2)]
    result = f"""The claim holds exactly for one whisker: the whole signal moves by the added rest length (within
    {worst["FB"]:.0e}). The signals of coupled whiskers shift towards -x, too, but not rigidly: maxima and detachments
    move by up to {worst["FBFB"]:.3f} (FBFB) and {worst["FBFBR"]:.3f} (FBFBR) more or less than the unloaded bases. The
    signal changes its shape, but not its maxima."""
    header = ["model", "rest length", "whisker", "u of max mz", "shift", "u of detachment", "shift"]
    return Findings([worst["FB"] < SAME_PLACE, *towards], result, [header, *(row[:7] for row in rows)])


@_claim("6.2, 6.11, 6.19")
def narrower(scans: Scans) -> Findings:
    """Softer springs make the signal narrower.

    Softer springs shift the part before the vertex towards -x and the part after it towards +x, so the signal narrows
    from both sides.
    """
    names = ("contact_width", "half_width_mz", "control_of_min_fx", "control_of_max_fx")

    def widths(case: Case, whisker: int) -> list[float]:
        contact, half, lowest, highest = scans.summary(case, whisker, *names)
        return [contact, lowest - highest, half]

    rows, measured = measure_all("stiffness", widths)
    checks = [monotone(width, 1.0) for _, numbers in measured for width in numbers.T]
    header = ["model", "stiffness", "whisker", "contact, in u", "min to max of fx, in u", "mz above half, in u"]
    result = "The claim holds: every width of every whisker's signal shrinks with every softer spring."
    return Findings(checks, result, [header, *rows])


@_claim("6.4, 6.13, 6.21")
def changed_by_distance(scans: Scans) -> Findings:
    """Only the object distance q changes the maxima; it moves the snap-off.

    Of the varied parameters only q changes the reactions as functions of the base position. At q = 0.1 the base value
    c = 70 is below the critical stiffness: the snap cuts off the maxima of fy and mz. The rows of the clamped whisker
    show the full maxima.
    """

    def measure(case: Case, whisker: int) -> list[float]:
        return [*scans.summary(case, whisker, *PEAKS, "last_contact"), _snap_control(scans, case)]

    rows, measured = measure_all("distance", measure, CLAMPED_CASES)
    # min fx and u of the detachment are negative: their size falls while they rise.
    checks = [monotone(c, sign) for _, n in measured for sign, c in zip((1, -1, -1, 1), n.T[:-1], strict=True)]
    result = "The claim holds: as q grows, all maxima fall, and every whisker detaches earlier (at larger u)."
    header = ["model", "q", "whisker", *PEAK_NAMES, "u of detachment", "snaps through at u"]
    return Findings(checks, result, [header, *rows])


@_claim("6.10")
def detachment(scans: Scans) -> Findings:
    """The detachment of whisker 1 is visible in the signal of whisker 2.

    Before the detachment the object pulls base 1, and through the springs base 2, ahead of the drive. When whisker 1
    detaches, base 2 springs back at once (figure 6.10).
    """
    rows = [["stiffness", "whisker 1 detaches at u", "fy of whisker 2 before", "after", "jump"]]
    jumps = []
    for case in vary("stiffness", Case("FBFB")).values():
        before, after = jump(scans(case), 1, 2)
        jumps.append(abs(after - before))
        numbers = (*scans.summary(case, 1, "last_contact"), before, after, after - before)
        rows.append([f"{case.stiffness:g}", *map(cell, numbers)])
    result = """The claim holds: fy of whisker 2 jumps when whisker 1 detaches, and the softer the springs, the larger
    the jump. Rigid springs show no jump."""
    return Findings([monotone(jumps, -1.0), jumps[-1] < NO_JUMP], result, rows)


@_claim("6.18")
def feedback(scans: Scans) -> Findings:
    """Feedback (FBFBR) weakens all of these effects.

    The feedback spring ties base 2 to the drive. A force on one base then moves the other base less, and its own base,
    too.
    """
    rows = [["stiffness", "jump of fy 2, FBFB", "FBFBR", "shift of max mz 2, FBFB", "FBFBR"]]
    checks = []
    for c in VALUES["stiffness"]:
        jumps, shifts = [], []
        for model in ("FBFB", "FBFBR"):
            before, after = jump(scans(Case(model, c)), 1, 2)
            (here,), (rigid,) = (scans.summary(Case(model, s), 2, "control_of_max_mz") for s in (c, math.inf))
            jumps.append(abs(after - before))
            shifts.append(abs(here - rigid))
        checks += [with_feedback < without for without, with_feedback in (jumps, shifts) if c < math.inf]
        rows.append([f"{c:g}", *map(cell, (*jumps, *shifts))])
    result = """The claim holds: at every stiffness the jump of whisker 2 at the detachment of whisker 1 is smaller with
    feedback than without, and so is the shift of its maximum (in u, relative to rigid springs)."""
    return Findings(checks, result, rows)


@_claim("7.4")
def third_whisker(scans: Scans) -> Findings:
    """A third whisker brings no new effect.

    The detachment of one whisker disturbs the next one, as with two whiskers.
    """
    rows = [["model", "whisker", *PEAK_NAMES, "detaches at u", "jump of fy of the next"]]
    deviations, kinds = [], []
    for case in (Case("FBFBR"), Case("FBFBFBR")):
        for whisker in case.whiskers:
            *peaks, last = scans.summary(case, whisker, *PEAKS, "last_contact")
            deviations.append(deviation_from_clamped(scans, peaks))
            before, after = jump(scans(case), whisker, whisker + 1)
            rows.append([case.model, str(whisker), *map(cell, (*peaks, last, after - before))])
        kinds.append({event.kind for event in scans(case).events})
    result = f"""The claim holds: the maxima are those of the clamped whisker (within {max(deviations):.0e}), and no new
    kind of event occurs."""
    return Findings([max(deviations) < UNCHANGED, kinds[1] <= kinds[0]], result, rows)
