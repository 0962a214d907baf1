"""Soak test of friction: random scenes with reversals, checked by laws that share no code with the package.

python benchmarks/soak_friction.py [scenes]     default 20,000; about 20 minutes on one core
python benchmarks/soak_friction.py NETWORK PROFILE BATCH SCENE     scans one of these scenes again, and shows it

Coefficients are log-uniform from 0.01 to 2. The drive reverses four times. Wrong and failed scenes are listed with the
command that shows them. A scene is wrong if it violates a law at a step with status ok, or at an event.
"""

import sys
import time
from collections import Counter

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import write

# isort: split
# After common, which puts the oracles on the search path.
from independent_friction import all_laws

from random_scenes import LEG, NETWORKS, PROFILES, Drawn, mechanics, reversing, scene_of

# Relative number of scenes of each network: scenes with more whiskers take longer.
SHARES = {"clamped": 10, "FB": 12, "FBFB": 4, "FBFBR": 2}
BLOCK = 16  # scenes per batch
LEVEL = 1  # of XLA's optimisation: more takes longer to compile than it saves
TOLERANCE = 1e-7  # largest relative residual of a correct state
LISTED = 3  # laws that are listed for a wrong scene, worst first


def batch_of(network: str, profile: str, batch: int) -> Drawn:
    """Parameters of a batch of scenes."""
    seed = [list(NETWORKS).index(network), list(PROFILES).index(profile), batch]
    return reversing(network, profile, BLOCK, np.random.default_rng(seed))


def scans(network: str, profile: str):
    """Compiled function: all scans of drawn parameters, one after the other."""

    # Under vmap, all would wait for the few that run into a limit, which take a hundred times as long as the others.
    def one(p: Drawn):
        return jw.scan(scene_of(network, profile, p, jw.ClosedForm()), p.control)

    options = {"xla_backend_optimization_level": LEVEL}
    return jax.jit(lambda p: jax.lax.map(one, jax.tree.map(jnp.asarray, p)), compiler_options=options)


def laws(network: str, profile: str, p: Drawn, result: jw.Result) -> dict[str, np.ndarray]:
    """Residual of each law, (scenes, states)."""
    assert p.friction is not None
    return all_laws(mechanics(network, profile, p), p.friction, p.control, result)


def soaked(network: str, profile: str, scenes: int) -> dict:
    """Scan random scenes of one kind; return a row of the table."""
    run = scans(network, profile).lower(batch_of(network, profile, 0)).compile()
    statuses, worst, broken, wrong, seconds = Counter(), {}, Counter(), 0, 0.0
    events = Counter()
    for batch in range(-(-scenes // BLOCK)):
        p = batch_of(network, profile, batch)
        assert p.friction is not None
        start = time.perf_counter()
        result = jax.block_until_ready(run(p))
        seconds += time.perf_counter() - start
        missed = laws(network, profile, p, result)
        largest = {law: np.max(amount, axis=1) for law, amount in missed.items()}
        for law, amount in largest.items():
            worst[law] = max(worst.get(law, 0.0), float(np.max(amount)))
        bad = np.any([amount > TOLERANCE for amount in largest.values()], axis=0)
        wrong += int(np.sum(bad))
        status = np.max(np.asarray(result.status), axis=1)
        for lane in np.flatnonzero(bad | (status != jw.Status.ok)):
            here = {law: float(amount[lane]) for law, amount in largest.items() if amount[lane] > TOLERANCE}
            listed = sorted(here, key=here.__getitem__, reverse=True)
            broken.update(listed)
            which = {law: (f"{here[law]:.1e}", int(np.argmax(missed[law][lane]))) for law in listed[:LISTED]}
            name = jw.Status(int(status[lane])).name
            print(f"{name}: {network} {profile} {batch} {lane}  mu = {p.friction[lane]:.3g}  {which}", flush=True)
        statuses.update(jw.Status(int(s)).name for s in status)
        kinds, counts = np.unique(np.asarray(result.events.kind), return_counts=True)
        events.update({jw.EventKind(int(k)).name: int(n) for k, n in zip(kinds, counts, strict=True) if k >= 0})
    count = sum(statuses.values())
    return {
        "network": network,
        "profile": profile,
        "scenes": count,
        "sticks": events["stick"],
        "snaps": events["snap_through"] + events["snap_off"],
        "failed": ", ".join(f"{n} {name}" for name, n in sorted(statuses.items()) if name != "ok"),
        "wrong": wrong,
        "laws violated": ", ".join(f"{law} ({n})" for law, n in broken.most_common()),
        "ms per scene": 1e3 * seconds / count,
        "equation": max(worst, key=worst.__getitem__),
        "largest residual": max(worst.values()),
    }


def show(network: str, profile: str, batch: int, lane: int) -> None:
    """Scan one scene and print its parameters, its events and the laws that it violates."""
    p = jax.tree.map(lambda leaf: leaf[lane : lane + 1], batch_of(network, profile, batch))
    one = jax.tree.map(lambda leaf: leaf[0], p)
    scene = scene_of(network, profile, one, jw.ClosedForm())
    scan = jw.scan(scene, one.control)
    print(scene, f"control: {one.control[::LEG].tolist()}", sep="\n")
    for number, event in enumerate(scan.events):
        print(f"{number}: {event}")
        for when, state in (("before", event.before), ("after", event.after)):
            fields = ("phase", "slip", "normal_force", "friction_force", "contact_slope", "contact_arc", "base_x")
            print(f"    {when}:", *(f"{name} {np.asarray(getattr(state, name))}" for name in fields))
    status = np.asarray(scan.status)
    print("status:", {jw.Status(int(s)).name: int(np.argmax(status == s)) for s in np.unique(status)})
    result = jax.tree.map(lambda leaf: np.asarray(leaf)[None], scan)
    for law, amount in laws(network, profile, p, result).items():
        if np.max(amount) > TOLERANCE:
            where = np.flatnonzero(amount[0] > TOLERANCE)
            print(f"{law}: {np.max(amount):.3e} at {np.argmax(amount)}; all at {where.tolist()}")


def main(scenes: int) -> None:
    """Scan all kinds and store the table."""
    all_shares = len(PROFILES) * sum(SHARES.values())
    rows = []
    for network, share in SHARES.items():
        for profile in PROFILES:
            rows.append(soaked(network, profile, round(scenes * share / all_shares)))
            print(rows[-1], flush=True)
            jax.clear_caches()
    write("soak_friction", rows)


if __name__ == "__main__":
    if len(sys.argv) > 2:
        show(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 20_000)
