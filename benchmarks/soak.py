"""A soak: random scenes of every kind, their states checked by elliptic integrals that share nothing with the engine.

python benchmarks/soak.py [scenes]     default 100,000; half an hour on two cores
"""

import os
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import jax
import numpy as np

import jaxwhisker as jw
from common import write

TESTS = Path(__file__).parents[1] / "tests"
sys.path.extend([str(TESTS), str(TESTS / "oracles")])
from independent import violations

from random_scenes import NETWORKS, PROFILES, drawn, mechanics, scans

jax.config.update("jax_enable_x64", True)

ROD = jw.ClosedForm()
KINDS = [(network, profile) for network in NETWORKS for profile in PROFILES]
# How many scenes of a network among all: the more whiskers, the longer each takes.
SHARES = {"clamped": 14, "FB": 12, "FBFB": 4, "FBFBR": 2, "FBFBFBR": 1, "four": 0.75}
BLOCK = 128  # scenes scanned at once: all wait for the slowest
SOUND = 1e-7  # by how much a state may miss a law, relative to its size


def told(what, network, profile, p, lane, why, step) -> None:
    """Print a scene that did not go well, so that it can be run again."""
    numbers = jax.tree.map(lambda leaf: leaf[lane].tolist(), p._replace(control=p.control[:, [0, step, -1]]))
    print(f"{what}: {network}, {profile}, {why} at step {step}: {numbers}", file=sys.stderr, flush=True)


def soaked(number: int, scenes: int) -> dict:
    """One kind of scenes: a row of the table."""
    network, profile = KINDS[number]
    rng, run = np.random.default_rng(number), scans(network, profile, ROD)
    statuses, worst, wrong, seconds = Counter(), {}, 0, 0.0
    for _ in range(-(-scenes // BLOCK)):
        p = drawn(network, profile, BLOCK, rng)
        start = time.perf_counter()
        result = jax.block_until_ready(run(p))
        seconds += time.perf_counter() - start
        missed = violations(mechanics(network, profile, p), p.control, result)
        for law, amount in missed.items():
            worst[law] = max(worst.get(law, 0.0), float(np.max(amount)))
        bad = np.any([amount > SOUND for amount in missed.values()], axis=(0, 2))
        wrong += int(np.sum(bad))
        for lane in np.flatnonzero(bad):
            amounts = {law: amount[lane] for law, amount in missed.items()}
            laws = {law: float(np.max(amount)) for law, amount in amounts.items() if np.max(amount) > SOUND}
            told("wrong", network, profile, p, lane, laws, np.argmax(np.max(list(amounts.values()), axis=0)))
        status = np.asarray(result.status)
        for lane in np.flatnonzero(np.max(status, axis=1)):
            step = np.argmax(status[lane] != jw.Status.ok)
            told("refused", network, profile, p, lane, jw.Status(status[lane, step]).name, step)
        statuses.update(jw.Status(s).name for s in np.max(status, axis=1))
    count = sum(statuses.values())
    return {
        "network": network,
        "profile": profile,
        "scenes": count,
        "refused": ", ".join(f"{n} {name}" for name, n in sorted(statuses.items()) if name != "ok"),
        "wrong": wrong,
        "ms a scene": 1e3 * seconds / count,
        "worst law": max(worst, key=worst.__getitem__),
        "missed by": max(worst.values()),
    }


def main(scenes: int) -> None:
    rows, all_shares = [], sum(SHARES[network] for network, _ in KINDS)
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        each = [round(scenes * SHARES[network] / all_shares) for network, _ in KINDS]
        for row in pool.map(soaked, range(len(KINDS)), each):
            rows.append(row)
            print(row, flush=True)
    write("soak", rows)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100_000)
