"""The claims of the thesis's chapter 6, each with the numbers that confirm it, or the range where it fails and why."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jaxwhisker.report import number
from jaxwhisker.reproduce import page
from jaxwhisker.reproduce.critical import RELATIVE, critical, softest, steepest
from jaxwhisker.reproduce.scans import (
    DISTANCES,
    REST_LENGTHS,
    STIFFNESSES,
    WHISKERS,
    Case,
    Scans,
    event,
    lets_go,
    snap_through,
)

SAME = 1e-4  # relative: maxima closer than this are called unchanged; they are read from steps of 0.001
MAXIMA = (("fx", -1.0, "min fx"), ("fy", 1.0, "max fy"), ("mz", 1.0, "max mz"))
CLAMPED = Case(stiffness=math.inf)
MODELS = ("FB", "FBFB", "FBFBR")


@dataclass(frozen=True)
class Claim:
    """What the thesis says, what was found, and the numbers."""

    says: str
    verdict: str
    blocks: tuple[page.Block, ...]

    def page(self, number: int) -> list[page.Block]:
        """The claim as part of a page."""
        return [page.Heading(3, f"{number}. {self.says}"), page.Paragraph(self.verdict, strong="Found:"), *self.blocks]


def claims(scans: Scans) -> Iterator[Claim]:
    """All claims, in the order of the page; the first one prints the critical stiffness that others refer to."""
    slopes = {q: steepest(scans, q) for q in DISTANCES}
    scanned = [(model, q) for q in DISTANCES for model in WHISKERS if model in MODELS or q == Case().distance]
    brackets = {(model, q): critical(model, q, slopes[q][0]) for model, q in scanned}
    yield _critical_stiffness(slopes, brackets)
    for claim in _CLAIMS:
        yield claim(scans)


def _name(case: Case, field: str) -> str:
    value = getattr(case, field)
    return "inf" if value == math.inf else f"{value:g}"


def _cell(value: float, digits: int = 4) -> str:
    return "-" if math.isnan(value) else number(value, digits)


def _cases(model: str, field: str, values: Sequence[float]) -> list[Case]:
    return [Case(**{"model": model, field: value}) for value in values]


def _whiskers(case: Case) -> range:
    return range(1, WHISKERS[case.model] + 1)


def _paragraph(text: str) -> page.Paragraph:
    return page.Paragraph(" ".join(text.split()))


def _critical_stiffness(slopes, brackets) -> Claim:
    rows = [["q", "max dFx/dx0", "at x0", *(f"c of {model}" for model in WHISKERS)]]
    for q, (slope, at) in slopes.items():
        middles = [sum(brackets.get((model, q), (math.nan,) * 2)) / 2 for model in WHISKERS]
        rows.append([f"{q:g}", _cell(slope, 3), _cell(at), *(_cell(c, 2) for c in middles)])
    factors = ", ".join(f"{softest(model):.3f} ({model})" for model in WHISKERS)
    agree = all(
        low * (1 - RELATIVE) <= slope <= high * (1 + RELATIVE)
        for q, (slope, _) in slopes.items()
        for low, high in [brackets["FB", q]]
    )
    why = f"""A base is stable while its spring is stiffer than the object's force is steep: c > dFx/dx0 of the clamped
        whisker (Fx = -fx is the force of the object on the whisker, x0 the position of the base). The steepest slope
        near the vertex is therefore the critical stiffness of FB. For coupled whiskers it would be that slope times the
        compliance of the softest base, {factors}, if the forces on the others stayed as they are; they don't, so the
        last columns were found by scans: stiffness of all springs (rest length 0.2) at which the first snap through the
        vertex appears, within {RELATIVE / 2:.2%} (three whiskers: only for the q used with them). Below it the drive pulls
        a whisker over the steep part in a snap, and whatever maxima lie on the way are never measured."""
    verdict = (
        "yes: for one whisker the scans snap just below the steepest slope and nowhere above it."
        if agree
        else "NOT confirmed: the scans of FB do not snap where the slope says."
    )
    title = "Below a critical stiffness the scan snaps through the vertex (not in the thesis; it bounds what follows)"
    return Claim(title, verdict, (_paragraph(why), page.Table(rows)))


def _maxima_rows(scans: Scans, cases: Sequence[Case], field: str) -> tuple[list[list[str]], float, list[str]]:
    """Rows of maxima; largest relative deviation from the clamped whisker without a snap; the cases with one."""
    rows, deviation, snapped = [], 0.0, []
    for case in cases:
        result = scans(case)
        snap = snap_through(result)
        if snap is not None:
            snapped.append(f"{case.model} {field.replace('_', ' ')} {_name(case, field)}")
        for whisker in _whiskers(case):
            values = [scans.peak(case, quantity, whisker, sign)[0] for quantity, sign, _ in MAXIMA]
            if snap is None:
                wanted = [scans.peak(CLAMPED, quantity, 1, sign)[0] for quantity, sign, _ in MAXIMA]
                deviation = max(deviation, *(abs(v / w - 1) for v, w in zip(values, wanted)))
            last, _ = scans.peak(case, "fx", whisker)
            snap_at = "-" if snap is None else _cell(snap.control)
            rows.append([case.model, _name(case, field), str(whisker), *map(_cell, values), _cell(last), snap_at])
    return rows, deviation, snapped


def _unchanged(scans: Scans, field: str, values: Sequence[float], word: str) -> Claim:
    cases = [case for model in MODELS for case in _cases(model, field, values)]
    rows, deviation, snapped = _maxima_rows(scans, cases, field)
    holds = deviation < SAME
    verdict = f"{'holds' if holds else 'FAILS'} for fx before the vertex, fy and mz wherever the scan does not snap "
    verdict += f"through the vertex (largest relative deviation from the clamped whisker {deviation:.1e}). "
    if snapped:
        verdict += f"It fails below the critical stiffness: {'; '.join(snapped)}. "
    verdict += "It does not hold for the largest fx after the vertex, which is cut off by the snap-off."
    why = """The reactions depend on the base position x0 alone, whatever holds the base: every scan runs along the same
        curves, but not at the same pace of the drive. A maximum is unchanged as long as the scan passes it. fx after
        the vertex has none: it grows up to the snap-off, which comes the earlier the softer the base is held."""
    header = ["model", word, "whisker", *(name for _, _, name in MAXIMA), "max fx", "snaps through at u"]
    return Claim(f"The maxima are unchanged by the {word}", verdict, (_paragraph(why), page.Table([header, *rows])))


def _maxima_and_stiffness(scans: Scans) -> Claim:
    return _unchanged(scans, "stiffness", STIFFNESSES, "stiffness")


def _maxima_and_rest_length(scans: Scans) -> Claim:
    return _unchanged(scans, "rest_length", REST_LENGTHS, "rest length")


def _common_point(scans: Scans) -> Claim:
    rows = [["model", "stiffness", "u at vertex 1", "fx", "fy", "mz"]]
    spread: dict[str, list[float]] = {}
    for model in MODELS:
        for case in _cases(model, "stiffness", STIFFNESSES):
            passed = event(scans(case), "vertex", 1)
            if passed is None:
                rows.append([model, _name(case, "stiffness"), *["-"] * 4])
                continue
            spread.setdefault(model, []).append(passed.control)
            forces = [float(np.asarray(getattr(passed.before, name))[0]) for name in ("fx", "fy", "mz")]
            rows.append([model, _name(case, "stiffness"), _cell(passed.control, 6), *map(_cell, forces)])
    width = {model: max(u) - min(u) for model, u in spread.items()}
    holds = width["FB"] < 1e-6
    verdict = (
        f"{'holds' if holds else 'FAILS'} for one whisker: all curves cross at u = {np.mean(spread['FB']):.6f} (spread "
        f"{width['FB']:.0e}). It does not hold for coupled whiskers: u spreads by "
        f"{width['FBFB']:.3f} (FBFB) and {width['FBFBR']:.3f} (FBFBR)."
    )
    why = """Where the contact force is vertical nothing pulls at the spring, which then has its rest length: the base
        stands at x0 = -0.33385 and the drive at x0 - 0.2, whatever c is. Coupled whiskers reach that state one after
        the other: while one force is vertical, the other one still strains the springs."""
    return Claim(
        "For every stiffness the curves have a common point at u = -0.534, where the force is vertical",
        verdict,
        (_paragraph(why), page.Table(rows)),
    )


def _is_monotone(values: Sequence[float], sign: float) -> bool:
    return bool(np.all(sign * np.diff(values) > 0))


def _softer_shifts(scans: Scans) -> Claim:
    rows = [["model", "stiffness", "whisker", *(f"u of {name}" for _, _, name in MAXIMA), "u of letting go"]]
    early: list[bool] = []
    late: list[bool] = []
    for model in MODELS:
        for whisker in range(1, WHISKERS[model] + 1):
            where = []
            for case in _cases(model, "stiffness", STIFFNESSES):
                result = scans(case)
                gone = lets_go(result, whisker)
                u = [scans.peak(case, quantity, whisker, sign)[1] for quantity, sign, _ in MAXIMA]
                where.append([*u, math.nan if gone is None else gone.control])
                rows.append([model, _name(case, "stiffness"), str(whisker), *map(_cell, where[-1])])
            *maxima, gone_at = np.array(where).T
            early += [_is_monotone(u, 1.0) for u in maxima]
            late.append(_is_monotone(gone_at, -1.0))
    verdict = (
        f"{'holds' if all(early) else 'FAILS for some'} for the maxima, which lie before the vertex: each of them moves "
        "towards -x with every softer spring. "
        f"{'The snap-off moves the other way' if all(late) else 'The snap-off does not always move the other way'}."
    )
    why = """Before the vertex the object pushes the whisker back (Fx > 0): a base on a soft spring lags behind, and the
        drive is further when it gets there. After the vertex the object pulls it forward (Fx < 0): the base is ahead of
        the drive, and what happens there is seen earlier."""
    return Claim("Softer springs shift the maxima towards -x", verdict, (_paragraph(why), page.Table(rows)))


def _longer_shifts(scans: Scans) -> Claim:
    rows = [["model", "rest length", "whisker", "u of max mz", "shift", "u of letting go", "shift"]]
    error, relative = 0.0, {}
    for model in MODELS:
        for whisker in range(1, WHISKERS[model] + 1):
            first = None
            for case in _cases(model, "rest_length", REST_LENGTHS):
                result = scans(case)
                gone = lets_go(result, whisker)
                here = np.array([scans.peak(case, "mz", whisker)[1], math.nan if gone is None else gone.control])
                first = here if first is None else first
                shift = here - first
                alone = -whisker * (case.rest_length - REST_LENGTHS[0])  # of the unloaded base
                if model == "FB":
                    error = max(error, float(np.max(np.abs(shift - alone))))
                else:
                    relative[model] = max(relative.get(model, 0.0), float(np.max(np.abs(shift - alone))))
                cells = [_cell(here[0]), _cell(shift[0]), _cell(here[1]), _cell(shift[1])]
                rows.append([model, _name(case, "rest_length"), str(whisker), *cells])
    verdict = (
        f"{'holds' if error < 1e-6 else 'FAILS'} exactly for one whisker: the whole signal moves by the added rest length "
        f"(within {error:.0e}). Coupled whiskers shift towards -x too, but not rigidly: their signals also change in "
        "shape, by up to "
        + " and ".join(f"{value:.3f} in u ({model})" for model, value in relative.items())
        + " beyond the shift of the unloaded bases."
    )
    why = """The rest length only says where the unloaded base stands relative to the drive. With two whiskers it also
        sets their distance, hence when one is on the steep part while the other strains the common spring."""
    return Claim(
        "Longer rest lengths shift the signal towards -x, and do nothing else", verdict, (_paragraph(why), page.Table(rows))
    )


def _half_width(scans: Scans, case: Case, whisker: int) -> float:
    """Range of u in which mz is above half its maximum."""
    result = scans(case)
    control, moment = np.asarray(result.control), np.asarray(result.mz)[:, whisker - 1]
    above = np.flatnonzero(moment >= scans.peak(case, "mz", whisker)[0] / 2)
    return float(control[above[0]] - control[above[-1]])


def _narrower(scans: Scans) -> Claim:
    rows = [["model", "stiffness", "whisker", "contact, in u", "min to max of fx, in u", "mz above half, in u"]]
    narrower: list[bool] = []
    for model in MODELS:
        for whisker in range(1, WHISKERS[model] + 1):
            widths = []
            for case in _cases(model, "stiffness", STIFFNESSES):
                result = scans(case)
                touch, gone = event(result, "touch", whisker), lets_go(result, whisker)
                contact = math.nan if touch is None or gone is None else touch.control - gone.control
                between = scans.peak(case, "fx", whisker, -1.0)[1] - scans.peak(case, "fx", whisker)[1]
                widths.append((contact, between, _half_width(scans, case, whisker)))
                rows.append([model, _name(case, "stiffness"), str(whisker), *(_cell(w, 3) for w in widths[-1])])
            narrower += [_is_monotone(column, 1.0) for column in np.array(widths).T]
    verdict = (
        "holds: every width of every whisker's signal shrinks with every softer spring."
        if all(narrower)
        else f"holds for {sum(narrower)} of {len(narrower)} widths (contact, fx, mz of every whisker); see the table."
    )
    why = """Softer springs shift what is before the vertex towards -x, and what is after it towards +x: the signal
        narrows from both sides."""
    return Claim("Softer springs make the signal narrower", verdict, (_paragraph(why), page.Table(rows)))


def _distance(scans: Scans) -> Claim:
    rows = [["model", "q", "whisker", *(name for _, _, name in MAXIMA), "u of letting go", "snaps through at u"]]
    falls: list[bool] = []
    families = {model: _cases(model, "distance", DISTANCES) for model in MODELS}
    families["clamped"] = [dataclasses.replace(CLAMPED, distance=q) for q in DISTANCES]
    for model, cases in families.items():
        for whisker in _whiskers(cases[0]):
            columns = []
            for case in cases:
                result = scans(case)
                gone, snap = lets_go(result, whisker), snap_through(result)
                values = [scans.peak(case, quantity, whisker, sign)[0] for quantity, sign, _ in MAXIMA]
                columns.append([*map(abs, values), math.nan if gone is None else -gone.control])
                snap_at = "-" if snap is None else _cell(snap.control)
                cells = [_cell(math.nan if gone is None else gone.control), snap_at]
                rows.append([model, _name(case, "distance"), str(whisker), *map(_cell, values), *cells])
            falls += [_is_monotone(column, -1.0) for column in np.array(columns).T]
    verdict = (
        "holds: with a growing distance q all maxima fall, and every whisker lets go earlier (at larger u)."
        if all(falls)
        else "holds for the maxima and snap-offs of most whiskers; see the table."
    )
    why = """Of what was varied only q (and the object's shape) changes the curves of reactions over base position. At q =
        0.1 the base value c = 70 is below the critical stiffness: fy and mz printed there are what the snap leaves of
        the maxima, which the clamped whisker shows whole."""
    return Claim("Only the object distance q changes the maxima; it moves the snap-off", verdict, (
        _paragraph(why), page.Table(rows)))


def _jump(result, gone, whisker: int) -> tuple[float, float]:
    before, after = (float(np.asarray(state.fy)[whisker - 1]) for state in (gone.before, gone.after))
    return before, after


def _detachment(scans: Scans) -> Claim:
    rows = [["stiffness", "whisker 1 lets go at u", "fy of whisker 2 before", "after", "jump"]]
    jumps = []
    for case in _cases("FBFB", "stiffness", STIFFNESSES):
        gone = lets_go(scans(case), 1)
        if gone is None:
            continue
        before, after = _jump(scans(case), gone, 2)
        jumps.append(abs(after - before))
        rows.append([_name(case, "stiffness"), _cell(gone.control), _cell(before), _cell(after), _cell(after - before)])
    seen = _is_monotone(jumps, -1.0) and jumps[-1] < 1e-6
    verdict = (
        "holds: fy of whisker 2 jumps when whisker 1 lets go, the more the softer the springs; with rigid ones it does not."
        if seen
        else "see the table: the jump does not fall with the stiffness throughout."
    )
    why = """Whisker 1 in contact pulls both bases along; when it lets go the springs relax and base 2 moves within one
        step of the drive (figure 6.10)."""
    return Claim("The detachment of whisker 1 is visible in the signal of whisker 2", verdict, (
        _paragraph(why), page.Table(rows)))


def _feedback(scans: Scans) -> Claim:
    rows = [["stiffness", "jump of fy 2, FBFB", "FBFBR", "u of max mz 2 - rigid, FBFB", "FBFBR"]]
    weaker: list[bool] = []
    for c in STIFFNESSES:
        cells = []
        for model in ("FBFB", "FBFBR"):
            case, rigid = Case(model, c), Case(model, math.inf)
            before, after = _jump(scans(case), lets_go(scans(case), 1), 2)
            shift = scans.peak(case, "mz", 2)[1] - scans.peak(rigid, "mz", 2)[1]
            cells.append((abs(after - before), abs(shift)))
        if c < math.inf:
            weaker += [with_ < without for without, with_ in zip(*cells)]
        (jump, shift), (jump_r, shift_r) = cells
        rows.append(["inf" if c == math.inf else f"{c:g}", *map(_cell, (jump, jump_r, shift, shift_r))])
    verdict = (
        "holds: at every stiffness both the jump of whisker 2 at the detachment of whisker 1 and the shift of its maximum "
        "are smaller with feedback than without."
        if all(weaker)
        else f"holds for {sum(weaker)} of {len(weaker)} comparisons; see the table."
    )
    why = """The feedback spring holds base 2 directly: a force on one base moves the other one less, and its own base
        too."""
    return Claim("Feedback (FBFBR) weakens all of it", verdict, (_paragraph(why), page.Table(rows)))


def _third(scans: Scans) -> Claim:
    three, two = Case("FBFBFBR"), Case("FBFBR")
    rows = [["model", "whisker", *(name for _, _, name in MAXIMA), "lets go at u", "jump of fy of the next"]]
    deviation = 0.0
    for case in (two, three):
        result = scans(case)
        for whisker in _whiskers(case):
            values = [scans.peak(case, quantity, whisker, sign)[0] for quantity, sign, _ in MAXIMA]
            wanted = [scans.peak(CLAMPED, quantity, 1, sign)[0] for quantity, sign, _ in MAXIMA]
            deviation = max(deviation, *(abs(v / w - 1) for v, w in zip(values, wanted)))
            gone = lets_go(result, whisker)
            jump = "-"
            if gone is not None and whisker < WHISKERS[case.model]:
                before, after = _jump(result, gone, whisker + 1)
                jump = _cell(after - before)
            rows.append([case.model, str(whisker), *map(_cell, values), "-" if gone is None else _cell(gone.control), jump])
    kinds = [{e.kind for e in scans(case).events} for case in (two, three)]
    new = sorted(kind.name for kind in kinds[1] - kinds[0])
    holds = deviation < SAME and not new
    verdict = (
        f"{'holds' if holds else 'FAILS'}: the maxima are those of the clamped whisker (within {deviation:.1e}), and "
        f"{'no kind of event is new' if not new else 'new kinds of events are ' + ', '.join(new)}. Each whisker is "
        "disturbed by the detachment of the one before it, as with two."
    )
    return Claim("A third whisker brings no new effect", verdict, (page.Table(rows),))


_CLAIMS: tuple[Callable[[Scans], Claim], ...] = (
    _maxima_and_stiffness,
    _maxima_and_rest_length,
    _common_point,
    _softer_shifts,
    _longer_shifts,
    _narrower,
    _distance,
    _detachment,
    _feedback,
    _third,
)
