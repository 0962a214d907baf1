"""Soak test of springs on the shaft: random scenes, checked by laws that share no code with the package.

python benchmarks/soak_shafts.py [scenes]     default 20,000; about half an hour on one core

A whisker is held by an axial spring above its base, a spring along x above or below it, and one at the base. They
disagree, and bend almost every whisker before it touches the object. A scene is wrong if it violates a law at a step
with status ok.
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
# After common, which puts the oracles on the search path.
from independent_shaft import violations

from random_shafts import CONTROL, drawn, scans

BLOCK = 64  # scenes per batch
TOLERANCE = 1e-7  # largest residual of a correct state
EXPECTED = (jw.Status.ok, jw.Status.second_contact, jw.Status.at_spring)


def main(scenes: int) -> None:
    """Scan random scenes and store the table."""
    run, statuses, worst, wrong, bent, seconds = scans(), Counter(), {}, 0, 0, 0.0
    for batch in range(-(-scenes // BLOCK)):
        held = drawn(BLOCK, np.random.default_rng([7, batch]))
        start = time.perf_counter()
        result = jax.block_until_ready(run(held))
        seconds += (time.perf_counter() - start) * (batch > 0)  # the first batch compiles
        missed = violations(held, np.broadcast_to(CONTROL, result.control.shape), result)
        largest = {law: np.max(amount, axis=1) for law, amount in missed.items()}
        worst |= {law: max(worst.get(law, 0.0), float(np.max(amount))) for law, amount in largest.items()}
        bad = np.any([amount > TOLERANCE for amount in largest.values()], axis=0)
        wrong += int(np.sum(bad))
        bent += int(np.sum(np.abs(np.asarray(result.mz)[:, 0, 0]) > 1e-6))
        status = np.max(np.asarray(result.status), axis=1)
        statuses.update(jw.Status(int(s)).name for s in status)
        for lane in np.flatnonzero(bad | ~np.isin(status, EXPECTED)):
            broken = {law: float(amount[lane]) for law, amount in largest.items() if amount[lane] > TOLERANCE}
            print(f"{jw.Status(int(status[lane])).name}: batch {batch}, scene {lane}  {broken}", flush=True)
    count = sum(statuses.values())
    row = {
        "scenes": count,
        "bent before touch": bent,
        "failed": ", ".join(f"{n} {name}" for name, n in sorted(statuses.items()) if name != "ok"),
        "wrong": wrong,
        "ms per scene": 1e3 * seconds / max(count - BLOCK, 1),
        "law with the largest residual": max(worst, key=worst.__getitem__),
        "largest residual": max(worst.values()),
    }
    print(row)
    write("soak_shafts", [row])


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20_000)
