"""The thesis's claims on what one whisker does to another."""

import math

from jaxwhisker.thesis.claim import (
    MAXIMA_NAMES,
    SAME,
    Claim,
    cell,
    from_clamped,
    jump,
    maxima,
    monotone,
    shown,
    whiskers,
)
from jaxwhisker.thesis.scans import STIFFNESSES, Case, Scans, vary

NO_JUMP = 1e-6  # of fy


def detachment(scans: Scans) -> Claim:
    """What whisker 2 feels when whisker 1 lets go."""
    rows = [["stiffness", "whisker 1 lets go at u", "fy of whisker 2 before", "after", "jump"]]
    jumps = []
    for case in vary("stiffness", STIFFNESSES, Case("FBFB")).values():
        gone, (before, after) = scans.summary(case, "last_contact", 1), jump(scans(case), 1, 2)
        jumps.append(abs(after - before))
        rows.append([shown(case.stiffness), *map(cell, (gone, before, after, after - before))])
    seen = monotone(jumps, -1.0) and jumps[-1] < NO_JUMP
    return Claim(
        "The detachment of whisker 1 is visible in the signal of whisker 2",
        "holds: fy of whisker 2 jumps when whisker 1 lets go, the more the softer the springs; with rigid ones it does "
        "not."
        if seen
        else "see the table: the jump does not fall with the stiffness throughout.",
        """Until then the object pulls base 1, and through the springs base 2, ahead of the drive; when whisker 1 lets
        go, base 2 springs back at once (figure 6.10).""",
        rows,
    )


def feedback(scans: Scans) -> Claim:
    """FBFBR against FBFB."""
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
        rows.append([shown(c), *map(cell, in_order)])
    return Claim(
        "Feedback (FBFBR) weakens all of it",
        """holds: at every stiffness both the jump of whisker 2 at the detachment of whisker 1 and the shift of its
        maximum (in u, from where it is with rigid springs) are smaller with feedback than without."""
        if all(weaker)
        else f"holds for {sum(weaker)} of {len(weaker)} comparisons; see the table.",
        """The feedback spring ties base 2 to the drive: a force on one base moves the other one less, and its own base
        too.""",
        rows,
    )


def third_whisker(scans: Scans) -> Claim:
    """FBFBFBR against FBFBR."""
    rows = [["model", "whisker", *MAXIMA_NAMES, "lets go at u", "jump of fy of the next"]]
    deviation = 0.0
    two, three = Case("FBFBR"), Case("FBFBFBR")
    for case in (two, three):
        for whisker in whiskers(case.model):
            peaks = maxima(scans, case, whisker)
            deviation = max(deviation, from_clamped(scans, peaks))
            gone = scans.summary(case, "last_contact", whisker)
            before, after = jump(scans(case), whisker, whisker + 1)
            rows.append([case.model, str(whisker), *map(cell, (*peaks, gone, after - before))])
    kinds = [{e.kind for e in scans(case).events} for case in (two, three)]
    new = sorted(kind.name for kind in kinds[1] - kinds[0])
    return Claim(
        "A third whisker brings no new effect",
        f"""{"holds" if deviation < SAME and not new else "FAILS"}: the maxima are those of the clamped whisker (within
        {deviation:.0e}), and {"no kind of event is new" if not new else "new kinds of events: " + ", ".join(new)}.""",
        "Each whisker is disturbed by the detachment of the one before it, as with two.",
        rows,
    )
