"""The thesis's claims on where in the scan things happen."""

import numpy as np

from jaxwhisker.reproduce.claim import (
    MAXIMA,
    MAXIMA_NAMES,
    MODELS,
    Claim,
    cases,
    cell,
    control_of,
    monotone,
    shown,
    whiskers,
)
from jaxwhisker.reproduce.scans import REST_LENGTHS, STIFFNESSES, Case, Scans, event, lets_go

EXACT = 1e-6  # in u


def common_point(scans: Scans) -> Claim:
    """Where the curves of all stiffnesses cross."""
    rows = [["model", "stiffness", "u at vertex 1", "fx", "fy", "mz"]]
    passed: dict[str, list[float]] = {model: [] for model in MODELS}
    for case in (case for model in MODELS for case in cases(model, "stiffness", STIFFNESSES)):
        vertex = event(scans(case), "vertex", 1)
        if vertex is None:
            rows.append([case.model, shown(case, "stiffness"), *["-"] * 4])
            continue
        passed[case.model].append(vertex.control)
        forces = [cell(float(np.asarray(getattr(vertex.before, name))[0])) for name in ("fx", "fy", "mz")]
        rows.append([case.model, shown(case, "stiffness"), cell(vertex.control, 6), *forces])
    spread = {model: float(np.ptp(u)) for model, u in passed.items()}
    return Claim(
        "For every stiffness the curves have a common point at u = -0.534, where the force is vertical",
        f"""{"holds" if spread["FB"] < EXACT else "FAILS"} for one whisker: all curves cross at u =
        {np.mean(passed["FB"]):.6f} (spread {spread["FB"]:.0e}). It does not hold for coupled whiskers: u of whisker 1
        spreads by {spread["FBFB"]:.3f} (FBFB) and {spread["FBFBR"]:.3f} (FBFBR).""",
        """Where the contact force is vertical nothing pulls at the spring, which then has its rest length: the base
        stands at x0 = -0.33385 and the drive at x0 - 0.2, whatever c is. Coupled whiskers reach that state one after
        the other: while one force is vertical, the other one still strains the springs.""",
        rows,
    )


def softer_springs(scans: Scans) -> Claim:
    """Shift of maxima and snap-off with stiffness."""
    rows = [["model", "stiffness", "whisker", *(f"u of {name}" for name in MAXIMA_NAMES), "u of letting go"]]
    early: list[bool] = []
    late: list[bool] = []
    for model in MODELS:
        for whisker in whiskers(model):
            where = []
            for case in cases(model, "stiffness", STIFFNESSES):
                at = [scans.peak(case, quantity, whisker, sign)[1] for quantity, sign, _ in MAXIMA]
                where.append([*at, control_of(lets_go(scans(case), whisker))])
                rows.append([model, shown(case, "stiffness"), str(whisker), *map(cell, where[-1])])
            *maxima, gone = np.array(where).T
            early += [monotone(u, 1.0) for u in maxima]
            late.append(monotone(gone, -1.0))
    return Claim(
        "Softer springs shift the maxima towards -x",
        f"""holds {"" if all(early) else f"in {sum(early)} of {len(early)} families "}for min fx, max fy and max mz,
        which lie before the vertex: with every softer spring they come at smaller u. The snap-off
        {"moves" if all(late) else "does not always move"} the other way.""",
        """Before the vertex the object pushes the whisker back (Fx > 0): a base on a soft spring lags behind, and the
        drive is further when it gets there. After the vertex the object pulls it forward (Fx < 0): the base is ahead of
        the drive, and what happens there is seen earlier.""",
        rows,
    )


def longer_rest_lengths(scans: Scans) -> Claim:
    """Shift of the signal with rest length."""
    rows = [["model", "rest length", "whisker", "u of max mz", "shift", "u of letting go", "shift"]]
    beyond: dict[str, list[float]] = {model: [] for model in MODELS}
    towards: list[bool] = []
    for model in MODELS:
        for whisker in whiskers(model):
            where = []
            for case in cases(model, "rest_length", REST_LENGTHS):
                where.append([scans.peak(case, "mz", whisker)[1], control_of(lets_go(scans(case), whisker))])
                alone = -whisker * (case.rest_length - REST_LENGTHS[0])  # of the unloaded base
                shift = np.subtract(where[-1], where[0])
                beyond[model] += list(np.abs(shift - alone))
                numbers = (where[-1][0], shift[0], where[-1][1], shift[1])
                rows.append([model, shown(case, "rest_length"), str(whisker), *map(cell, numbers)])
            towards += [monotone(column, -1.0) for column in np.array(where).T]
    worst = {model: max(values) for model, values in beyond.items()}
    return Claim(
        "Longer rest lengths shift the signal towards -x, and do nothing else",
        f"""{"holds" if worst["FB"] < EXACT else "FAILS"} exactly for one whisker: the whole signal moves by the added
        rest length (within {worst["FB"]:.0e}). Coupled whiskers {"shift" if all(towards) else "mostly shift"} towards
        -x too, but not rigidly: maxima and letting go move by up to {worst["FBFB"]:.3f} (FBFB) and
        {worst["FBFBR"]:.3f} (FBFBR) more or less than the unloaded bases, so the signal changes its shape, though not
        its maxima.""",
        """The rest length only says where the unloaded base stands relative to the drive. With two whiskers it also
        sets their distance, hence when one is on the steep part while the other strains the common spring.""",
        rows,
    )


def _half_width(scans: Scans, case: Case, whisker: int) -> float:
    """Range of u in which mz is above half its maximum."""
    result = scans(case)
    control, moment = np.asarray(result.control), np.asarray(result.mz)[:, whisker - 1]
    above = np.flatnonzero(moment >= scans.peak(case, "mz", whisker)[0] / 2)
    return float(control[above[0]] - control[above[-1]])


def narrower(scans: Scans) -> Claim:
    """Width of the signal with stiffness."""
    rows = [["model", "stiffness", "whisker", "contact, in u", "min to max of fx, in u", "mz above half, in u"]]
    shrinks: list[bool] = []
    for model in MODELS:
        for whisker in whiskers(model):
            widths = []
            for case in cases(model, "stiffness", STIFFNESSES):
                result = scans(case)
                contact = control_of(event(result, "touch", whisker)) - control_of(lets_go(result, whisker))
                between = scans.peak(case, "fx", whisker, -1.0)[1] - scans.peak(case, "fx", whisker)[1]
                widths.append((contact, between, _half_width(scans, case, whisker)))
                rows.append([model, shown(case, "stiffness"), str(whisker), *(cell(w, 3) for w in widths[-1])])
            shrinks += [monotone(column, 1.0) for column in np.array(widths).T]
    return Claim(
        "Softer springs make the signal narrower",
        "holds: every width of every whisker's signal shrinks with every softer spring."
        if all(shrinks)
        else f"holds for {sum(shrinks)} of {len(shrinks)} widths (contact, fx, mz of every whisker); see the table.",
        """Softer springs shift what is before the vertex towards -x, and what is after it towards +x: the signal
        narrows from both sides.""",
        rows,
    )
