"""Soak test of several contacts: random scenes whose states are checked by laws that share no code with the package.

python benchmarks/several_contacts.py [scenes] [seed] [part]     default 42, 0 and both; twenty minutes of compilation

Scenes with two and three circles, two ellipses, parabolas with waves, one and two boxes, convex polygons, and roofs
with an inner corner; straight, curved and conical whiskers; clamped, on FB and on FBFB. Checked are every tenth step,
the states after all events, and that contacts begin and end at events. The part `friction` has coefficients between
0.1 and 0.5 and drives of which every second one turns back for a while; its contacts must not move against their slip.
"""

import sys
import time
from collections import Counter

import jax
import numpy as np

import jaxwhisker as jw
from common import write

# isort: split
# After common, which puts the helpers of the tests on the search path.
from random_several import KINDS, checked, drawn

jax.config.update("jax_enable_x64", True)

PARTS = {"without": None, "friction": (0.1, 0.5)}  # limits of the coefficients
EVERY = 10  # steps between two that are checked
TOLERANCE = 1e-7  # in L, EI/L^2 per total contact force, and rad: a hundred times the accuracy of states


def soaked(number: int, kind: str, scenes: int, seed: int, friction: tuple[float, float] | None) -> dict:
    """Scan random scenes of one kind; return a row of the table."""
    statuses, worst, wrong, events, seconds = Counter(), {}, 0, 0, []
    for k in range(scenes):
        one = drawn(kind, np.random.default_rng((seed, number, k)), friction=friction, turns=k % 2 == 0)
        start = time.perf_counter()
        result = jax.block_until_ready(jw.scan(one.scene, one.control))
        events += len(result.events)
        seconds.append(time.perf_counter() - start)
        here: dict[str, tuple[float, float]] = {}
        for law, control, _, value in checked(one, result, EVERY):
            here[law] = max(here.get(law, (0.0, 0.0)), (value, control))
            worst[law] = max(worst.get(law, 0.0), value)
        large = {law: found for law, found in here.items() if found[0] > TOLERANCE}
        status = jw.Status(int(np.max(result.status))).name
        statuses[status] += 1
        wrong += bool(large)
        if large or status != "ok":
            text = ", ".join(f"{law} {value:.2g} at u = {u:.6f}" for law, (value, u) in large.items())
            at = float(one.control[np.argmax(np.asarray(result.status) != jw.Status.ok)])
            text += f" {status} at u = {at:.6f}" if status != "ok" else ""
            print(f"{kind}, seed {(seed, number, k)}: {text}", file=sys.stderr, flush=True)
    return {
        "kind": kind,
        "scenes": scenes,
        "events": events,
        "not ok": ", ".join(f"{n} {name}" for name, n in sorted(statuses.items()) if name != "ok"),
        "wrong": wrong,
        "law": max(worst, key=worst.__getitem__),
        "largest residual": max(worst.values()),
        "s per scene": float(np.median(seconds)),
    }


def main(numbers: list[int], *parts: str) -> None:
    """Scan all kinds and store the tables; the numbers are those of scenes and the seed."""
    scenes, seed = [*numbers, *(42, 0)[len(numbers) :]]
    for part in parts or PARTS:
        rows = []
        for number, kind in enumerate(KINDS):
            rows.append(soaked(number, kind, -(-scenes // len(KINDS)), seed, PARTS[part]))
            print(rows[-1], flush=True)
            # A run that is cut short leaves the kinds that it has come to.
            write("several_contacts_friction" if PARTS[part] else "several_contacts", rows)


if __name__ == "__main__":
    numbers, parts = sys.argv[1:3], sys.argv[3:]
    main([*map(int, numbers)], *parts)
