"""The thesis's claims on where in the scan things happen."""

import dataclasses

import numpy as np

from jaxwhisker.thesis.claim import MAXIMA, MAXIMA_NAMES, MODELS, Claim, cell, measured, monotone, shown, varied
from jaxwhisker.thesis.scans import REST_LENGTHS, STIFFNESSES, Case, Scans, event

EXACT = 1e-6  # in u


def common_point(scans: Scans) -> Claim:
    """Where the curves of all stiffnesses cross."""
    rows = [["model", "stiffness", "u at vertex 1", "fx", "fy", "mz"]]
    passed: dict[str, list[float]] = {model: [] for model in MODELS}
    for case in (case for family in varied("stiffness", STIFFNESSES).values() for case in family):
        vertex = event(scans(case), "vertex", 1)
        if vertex is None:
            rows.append([case.model, shown(case.stiffness), *["-"] * 4])
            continue
        passed[case.model].append(vertex.control)
        forces = [cell(float(np.asarray(getattr(vertex.before, name))[0])) for name in ("fx", "fy", "mz")]
        rows.append([case.model, shown(case.stiffness), cell(vertex.control, 6), *forces])
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
    names = (*(f"control_of_{name}" for name in MAXIMA), "last_contact")
    rows, found = measured(
        varied("stiffness", STIFFNESSES),
        "stiffness",
        lambda case, whisker: [scans.summary(case, name, whisker) for name in names],
    )
    early = [monotone(u, 1.0) for _, numbers in found for u in numbers.T[:-1]]
    late = all(monotone(numbers[:, -1], -1.0) for _, numbers in found)
    return Claim(
        "Softer springs shift the maxima towards -x",
        f"""holds {"" if all(early) else f"in {sum(early)} of {len(early)} families "}for min fx, max fy and max mz,
        which lie before the vertex: with every softer spring they come at smaller u. The snap-off
        {"moves" if late else "does not always move"} the other way.""",
        """Before the vertex the object pushes the whisker back (Fx > 0): a base on a soft spring lags behind, and the
        drive is further when it gets there. After the vertex the object pulls it forward (Fx < 0): the base is ahead of
        the drive, and what happens there is seen earlier.""",
        [["model", "stiffness", "whisker", *(f"u of {name}" for name in MAXIMA_NAMES), "u of letting go"], *rows],
    )


def longer_rest_lengths(scans: Scans) -> Claim:
    """Shift of the signal with rest length."""

    def measure(case: Case, whisker: int) -> list[float]:
        shortest = dataclasses.replace(case, rest_length=REST_LENGTHS[0])
        alone = -whisker * (case.rest_length - shortest.rest_length)  # of the unloaded base
        there, before = (
            np.array([scans.summary(c, name, whisker) for name in ("control_of_max_mz", "last_contact")])
            for c in (case, shortest)
        )
        shift = there - before
        return [there[0], shift[0], there[1], shift[1], *abs(shift - alone)]

    rows, found = measured(varied("rest_length", REST_LENGTHS), "rest_length", measure)
    worst = {model: max(np.max(numbers[:, 4:]) for name, numbers in found if name == model) for model in MODELS}
    towards = [monotone(numbers[:, k], -1.0) for _, numbers in found for k in (0, 2)]
    return Claim(
        "Longer rest lengths shift the signal towards -x, and do nothing else",
        f"""{"holds" if worst["FB"] < EXACT else "FAILS"} exactly for one whisker: the whole signal moves by the added
        rest length (within {worst["FB"]:.0e}). Coupled whiskers {"shift" if all(towards) else "mostly shift"} towards
        -x too, but not rigidly: maxima and letting go move by up to {worst["FBFB"]:.3f} (FBFB) and
        {worst["FBFBR"]:.3f} (FBFBR) more or less than the unloaded bases, so the signal changes its shape, though not
        its maxima.""",
        """The rest length only says where the unloaded base stands relative to the drive. With two whiskers it also
        sets their distance, hence when one is on the steep part while the other strains the common spring.""",
        [
            ["model", "rest length", "whisker", "u of max mz", "shift", "u of letting go", "shift"],
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

    rows, found = measured(varied("stiffness", STIFFNESSES), "stiffness", widths)
    shrinks = [monotone(width, 1.0) for _, numbers in found for width in numbers.T]
    return Claim(
        "Softer springs make the signal narrower",
        "holds: every width of every whisker's signal shrinks with every softer spring."
        if all(shrinks)
        else f"holds for {sum(shrinks)} of {len(shrinks)} widths (contact, fx, mz of every whisker); see the table.",
        """Softer springs shift what is before the vertex towards -x, and what is after it towards +x: the signal
        narrows from both sides.""",
        [["model", "stiffness", "whisker", "contact, in u", "min to max of fx, in u", "mz above half, in u"], *rows],
    )
