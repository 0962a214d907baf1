"""Soak test: random scenes of every kind, checked with elliptic integrals that share no code with the package.

python benchmarks/soak.py [scenes]     default 100,000; half an hour on two cores
"""

import os
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import jax
import numpy as np

import jaxwhisker as jw
from common import write
from random_scenes import NETWORKS, PROFILES, drawn, mechanics, scans

# isort: split
# After common, which puts the oracles on the search path.
from independent import violations

jax.config.update("jax_enable_x64", True)

ROD = jw.ClosedForm()
KINDS = [(network, profile) for network in NETWORKS for profile in PROFILES]
# Relative number of scenes of each network: scenes with more whiskers take longer.
SHARES = {"clamped": 14, "FB": 12, "FBFB": 4, "FBFBR": 2, "FBFBFBR": 1, "four": 0.75}
BLOCK = 128  # scenes per batch; a batch takes as long as its slowest scene
TOLERANCE = 1e-7  # largest relative residual of a correct state


def report(what, network, profile, p, lane, why, step) -> None:
    """Print the parameters of a wrong or failed scene, to reproduce it."""
    numbers = jax.tree.map(lambda leaf: leaf[lane].tolist(), p._replace(control=p.control[:, [0, step, -1]]))
    print(f"{what}: {network}, {profile}, {why} at step {step}: {numbers}", file=sys.stderr, flush=True)


def soaked(number: int, scenes: int) -> dict:
    """Scan random scenes of one kind; return a row of the table."""
    network, profile = KINDS[number]
    rng, run = np.random.default_rng(number), scans(network, profile, ROD)
    statuses, worst, wrong, seconds = Counter(), {}, 0, 0.0
    for _ in range(-(-scenes // BLOCK)):
        p = drawn(network, profile, BLOCK, rng)
        start = time.perf_counter()
        result = jax.block_until_ready(run(p))
        seconds += time.perf_counter() - start
        residuals = violations(mechanics(network, profile, p), p.control, result)
        for equation, residual in residuals.items():
            worst[equation] = max(worst.get(equation, 0.0), float(np.max(residual)))
        bad = np.any([residual > TOLERANCE for residual in residuals.values()], axis=(0, 2))
        wrong += int(np.sum(bad))
        for lane in np.flatnonzero(bad):
            here = {equation: residual[lane] for equation, residual in residuals.items()}
            large = {equation: float(np.max(each)) for equation, each in here.items() if np.max(each) > TOLERANCE}
            report("wrong", network, profile, p, lane, large, np.argmax(np.max(list(here.values()), axis=0)))
        status = np.asarray(result.status)
        for lane in np.flatnonzero(np.max(status, axis=1)):
            step = np.argmax(status[lane] != jw.Status.ok)
            report("failed", network, profile, p, lane, jw.Status(status[lane, step]).name, step)
        statuses.update(jw.Status(s).name for s in np.max(status, axis=1))
    count = sum(statuses.values())
    return {
        "network": network,
        "profile": profile,
        "scenes": count,
        "failed": ", ".join(f"{n} {name}" for name, n in sorted(statuses.items()) if name != "ok"),
        "wrong": wrong,
        "ms per scene": 1e3 * seconds / count,
        "equation": max(worst, key=worst.__getitem__),
        "largest residual": max(worst.values()),
    }


def main(scenes: int) -> None:
    """Scan all kinds on all cores and store the table."""
    rows, all_shares = [], sum(SHARES[network] for network, _ in KINDS)
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        each = [round(scenes * SHARES[network] / all_shares) for network, _ in KINDS]
        for row in pool.map(soaked, range(len(KINDS)), each):
            rows.append(row)
            print(row, flush=True)
    write("soak", rows)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100_000)
