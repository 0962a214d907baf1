"""Soak test of scans in space: random scenes of every kind, checked by laws that share no code with the package.

python benchmarks/soak_space.py [scenes]           default 20,000; about an hour on one core
python benchmarks/soak_space.py objects [scenes]   default 1,000; capsules, boxes and planes, and two objects at once
python benchmarks/soak_space.py KIND SCENE         scans one of these scenes again, and shows it

Random states of each scene and those at its events are checked, and the second variation of one state in ten. Wrong
scenes and those with a step that is not ok are listed with the command's arguments that show them, and with what the
laws say about the last state before: how far the contact is from the base, how fast shaft and object part there, and
how near they are elsewhere.
"""

import sys
import time
from collections import Counter

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw
from common import write

# isort: split
# After common, which puts the tests on the search path.
from random_space import EVERYDAY, KINDS, Drawn, drawn, drawn_before_two
from space_laws import Plain, State, shaft, shafts, spread, stability, state_of, violations

ROUND = 40  # scenes of a kind in a round; results are stored after every round
TOLERANCE = 1e-7  # largest violation of a correct state
DEEP = 2e-6  # twice the depth inside an object at which a scan ends with a second contact
STATES = 5  # steps of each scene that are checked
STABLE = -1e-3  # least eigenvalue of a stable state, computed with ELEMENTS; at a fold it is zero
ELEMENTS = 30
LIGHT = 1e-3  # force below which the second variation is not resolved
LIES = 1e-6  # g_ss of a whisker that lies on a face, where the second variation has a factor 1 / g_ss
# Ends of scans for which there is no equilibrium of the model: the laws must show why.
AT_BASE = 0.02  # lengths from the base
FLAT = 0.3  # g_ss of a contact that is about to become two
FOLD = 0.1  # least eigenvalue of a state a step before a fold, from where contacts slide
BESIDE, NEAR = 0.1, 0.8  # lengths from the contact; share of the gap that g_ss alone gives there

SCALARS = [*(f"{f}{a}" for f in "fm" for a in "xyz"), *(f"{r}_{a}" for r in ("base", "contact") for a in "xyz")]
FIELDS = [*SCALARS, "base_rotation", "contact_force", "contact_arc", "phase"]


def everyday(kind: str, rng: np.random.Generator) -> Drawn:
    """A random scene with a capsule, a box or a plane."""
    return drawn(kind, rng, EVERYDAY)


# Kinds of scenes, their names in the table, and how they are drawn.
SOAKED = [
    *((kind, kind, drawn) for kind in KINDS),
    *((kind, f"{kind}, everyday object", everyday) for kind in KINDS),
    *((kind, f"{kind}, two objects", drawn_before_two) for kind in KINDS if kind.endswith("linear")),
]


class Row:
    """One row of the fields of a result."""

    def __init__(self, fields, row):
        self.fields, self.row = fields, row

    def __getattr__(self, name):
        return self.fields[name][self.row]


def scene_of(kind: int, number: int) -> Drawn:
    """A scene of the soak test."""
    name, _, draw = SOAKED[kind]
    return draw(name, np.random.default_rng([kind, number]))


def rows_of(states, control, rows) -> list[State]:
    """Some states of a result, or at its events."""
    fields = {name: np.asarray(getattr(states, name)) for name in FIELDS}
    return [state_of(Row(fields, k), float(control[k])) for k in rows]


def states_of(result: jw.SpaceResult, rng) -> tuple[list[State], list[State]]:
    """Random steps in contact and states after snaps, which must be stable, and states before events."""
    touching = np.flatnonzero((np.asarray(result.status) == 0) & (np.asarray(result.phase)[:, 0] > 0))
    steps = rng.choice(touching, min(STATES, touching.size), replace=False)
    events, count = result.events, len(result.events)
    snaps = [k for k in range(count) if events[k].kind in (jw.EventKind.snap_through, jw.EventKind.snap_off)]
    # The state before a bifurcation is that of the node before, at the control of the loss.
    exact = [k for k in range(count) if events[k].kind != jw.EventKind.bifurcation]
    at = np.asarray(events.control)
    stable = rows_of(result, np.asarray(result.control), sorted(steps)) + rows_of(events.after, at, snaps)
    return stable, rows_of(events.before, at, exact)


def broken_laws(plain: Plain, stable: list[State], others: list[State], rng) -> tuple[dict[str, float], float]:
    """Largest violation of each law, and the least eigenvalue of some states."""
    worst, states = {}, stable + others
    for state, whole in zip(states, shafts(plain, states) if states else [], strict=True):
        for law, value in violations(plain, state, whole).items():
            worst[law] = max(worst.get(law, 0.0), float(value))
    tried = [
        state
        for state in stable
        if state.contact_force > LIGHT
        and rng.random() < 0.1 * len(states) / len(stable)
        and spread(plain, state, shaft(plain, state)) > LIES
    ]
    return worst, min((stability(plain, state, ELEMENTS) for state in tried), default=np.inf)


def first_touch(plain: Plain, first: float, last: float) -> tuple[float, float]:
    """Arc length and control at which an unloaded whisker first touches the object on a way of the drive, or nearly."""
    zero, arc = np.zeros(3), np.nan
    for _ in range(4):
        controls = np.linspace(first, last, 41)
        frames = [plain.placement(control) for control in controls]
        states = [
            State(control, 0, zero, zero, base, rotation, 0.0, 0.0, zero)
            for control, (base, _, rotation) in zip(controls, frames, strict=True)
        ]
        found = shafts(plain, states)
        distances = np.array([plain.surface.off(whole.points) for whole in found])
        inside = np.flatnonzero(np.min(distances, axis=1) < 0)
        if not inside.size:  # it is on its way to where it is nearest
            arc = arc if np.isfinite(arc) else found[-1].arc[np.argmin(distances[-1])]
            break
        k = inside[0]
        arc = found[k].arc[np.argmin(distances[k])]
        first, last = float(controls[max(k - 1, 0)]), float(controls[k])
    return float(arc), last


def reason(plain: Plain, result: jw.SpaceResult, status: str) -> tuple[str, str]:
    """Why a scan ends, as far as the laws tell from the last state that is ok, and numbers of that state."""
    fine = np.flatnonzero((np.asarray(result.status) == 0) & (np.asarray(result.phase)[:, 0] > 0))
    if not fine.size:
        arc, control = first_touch(plain, float(result.control[0]), float(result.control[-1]))
        return ("contact at the base" if arc < AT_BASE else ""), f"touches at arc {arc:.3f} u {control:.3f}"
    (state,) = rows_of(result, np.asarray(result.control), fine[-1:])
    (whole,) = shafts(plain, [state])
    flat, elsewhere = spread(plain, state, whole), np.abs(whole.arc - state.contact_arc) > BESIDE
    gap = float(np.min(plain.surface.off(whole.points[elsewhere])))
    numbers = f"arc {state.contact_arc:.3f} g_ss {flat:.3f} gap {gap:.4f} u {state.control:.3f}"
    if status == "lost" and state.contact_arc < AT_BASE:
        return "contact at the base", numbers
    if status in ("not_convex", "second_contact") and (flat < FLAT or gap < NEAR * flat * BESIDE**2 / 2):
        return "second contact", numbers
    if status == "not_convex" and stability(plain, state, ELEMENTS) < FOLD:
        return "second contact in a slide", numbers
    return "", numbers


def tolerance(law: str) -> float:
    """Largest violation of a law in a correct state."""
    return DEEP if law == "depth" else TOLERANCE


class Table:
    """Counts of a kind of scenes."""

    def __init__(self, kind: int):
        self.kind, self.scenes, self.states, self.wrong, self.seconds = kind, 0, 0, 0, 0.0
        self.statuses, self.worst, self.tried, self.least = Counter(), {}, 0, np.inf

    def scan(self, number: int) -> None:
        """Scan and check a scene."""
        scene, plain, text = scene_of(self.kind, number)
        rng = np.random.default_rng([self.kind, number, 1])
        start = time.perf_counter()
        result = jw.scan(scene)
        stable, others = states_of(result, rng)
        self.seconds += time.perf_counter() - start
        found, least = broken_laws(plain, stable, others, rng)
        broken = {law: f"{value:.1e}" for law, value in found.items() if not value < tolerance(law)}
        if not least > STABLE:
            broken["stability"] = f"{least:.1e}"
        self.worst |= {law: max(self.worst.get(law, 0.0), value) for law, value in found.items()}
        self.scenes, self.states, self.wrong = (
            self.scenes + 1,
            self.states + len(stable + others),
            self.wrong + bool(broken),
        )
        status = np.asarray(result.status)
        bad = np.flatnonzero(status)
        if bad.size:
            name = jw.Status(int(status[bad[0]])).name
            why, numbers = reason(plain, result, name)
            self.statuses[f"{name} ({why})" if why else name] += 1
            print(f"{name}: {self.kind} {number}  {why}; {numbers}; {bad.size} steps  {text}", flush=True)
        if broken:
            print(f"wrong: {self.kind} {number}  {broken}  {text}", flush=True)

    def row(self) -> dict:
        """The row of the table."""
        return {
            "kind": SOAKED[self.kind][1],
            "scenes": self.scenes,
            "states": self.states,
            "not ok": ", ".join(f"{n} {name}" for name, n in sorted(self.statuses.items())),
            "wrong": self.wrong,
            "ms per scene": 1e3 * self.seconds / self.scenes,
            "law": max(self.worst, key=self.worst.__getitem__),
            "largest violation": max(self.worst.values()),
        }


def show(kind: int, number: int) -> None:
    """Scan one scene and print it, its events, statuses and some states."""
    scene, plain, text = scene_of(kind, number)
    result = jw.scan(scene)
    print(text, result, sep="\n")
    status = np.asarray(result.status)
    for k in np.unique(status):
        at = np.asarray(result.control)[status == k]
        print(f"{jw.Status(int(k)).name}: {at.size} steps, u = {at[0]:+.6f} to {at[-1]:+.6f}")
    stable, others = states_of(result, np.random.default_rng([kind, number, 1]))
    for state in stable + others:
        broken = {law: f"{value:.1e}" for law, value in violations(plain, state).items() if not value < tolerance(law)}
        least = stability(plain, state, ELEMENTS) if state.contact_force > LIGHT else np.nan
        contact = f"phase {state.phase}, force {state.contact_force:.5f}, arc {state.contact_arc:.5f}"
        print(f"u = {state.control:+.6f}, {contact}, least eigenvalue {least:.3g} {broken or ''}")


def main(name: str, kinds: range, scenes: int) -> None:
    """Scan scenes of some kinds in turn, and store the table after every kind."""
    each = -(-scenes // len(kinds))
    tables = [Table(kind) for kind in kinds]
    for start in range(0, each, ROUND):
        for table in tables:
            for number in range(start, min(start + ROUND, each)):
                table.scan(number)
            write(name, [table.row() for table in tables if table.scenes])


if __name__ == "__main__":
    objects = sys.argv[1:2] == ["objects"]
    numbers = [int(argument) for argument in sys.argv[1 + objects :]]
    if objects:
        main("soak_objects", range(len(KINDS), len(SOAKED)), *numbers or [1000])
    elif len(numbers) > 1:
        show(*numbers)
    else:
        main("soak_space", range(len(KINDS)), *numbers or [20_000])
