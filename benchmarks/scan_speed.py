"""Warm scans: one alone, a vmapped batch, and what each further whisker costs.

Errors are the largest over a whole scan against exact scans by elliptic integrals (tests/data), relative to the peak.
"""

import json
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import interleaved, write

EXACT = Path(__file__).parents[1] / "tests" / "data" / "scans.json"
STEPS, LANES = 1600, 256
RODS = {"integrated": jw.Shooting(), "closed form": jw.ClosedForm()}
CLOSED = [("FB", "closed form"), ("FBFBR", "closed form"), ("FBFBFBR", "closed form")]
SINGLE = [*((m, "integrated") for m in ("clamped", "FB", "FBFB", "FBFBR", "FBFBFBR")), *CLOSED]
BATCHES = [*((m, "integrated") for m in ("FB", "FBFBR", "FBFBFBR")), *CLOSED]


def scene(model: str, rod: str, stiffness=70.0, distance=0.2) -> jw.Scene:
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.named(model, stiffness, 0.2), RODS[rod])


def error(model: str, rod: str) -> float | None:
    """Largest error of fx, fy, mz over the stored exact scan of this model with c = 70, q = 0.2."""
    cases = {c["name"]: c for c in json.loads(EXACT.read_text())["cases"]}
    case = cases.get(f"{model} c=70")
    if case is None:
        return None
    result = jw.scan(scene(model, rod), np.array(case["control"]))
    worst = 0.0
    for i, whisker in enumerate(case["whiskers"]):
        for name in ("fx", "fy", "mz"):
            exact = np.array(whisker[name])
            worst = max(worst, np.max(np.abs(np.asarray(getattr(result, name))[:, i] - exact)) / np.max(np.abs(exact)))
    return float(worst)


def batch(model: str, rod: str, lanes: int):
    """A compiled scan of many scenes with random stiffness and distance, and its scenes."""
    rng = np.random.default_rng(0)
    stiffness, distance = jnp.asarray(rng.uniform(30, 200, lanes)), jnp.asarray(rng.uniform(0.1, 0.4, lanes))
    control = jnp.linspace(0.8, -1.6 if model in ("clamped", "FB") else -2.2, STEPS)
    scenes = jax.vmap(lambda c, q: scene(model, rod, c, q))(stiffness, distance)
    scanned = jax.jit(jax.vmap(lambda s: jw.scan(s, control)))
    assert np.all(np.asarray(scanned(scenes).status) == jw.Status.ok)
    return lambda: jax.block_until_ready(scanned(scenes).mz)


def main() -> None:
    control = np.linspace(0.8, -1.6, 1900)
    rows = []

    def report(times, lanes, steps):
        for (model, rod), t in times.items():
            rows.append(
                {
                    "model": model,
                    "rods": rod,
                    "batch": lanes,
                    "steps": steps,
                    "scan, s": t["median"],
                    "quartiles, s": f"{t['lower']:.4f} to {t['upper']:.4f}",
                    "us per step": t["median"] / lanes / steps * 1e6,
                    "to FB": t["median"] / times["FB", rod]["median"],
                    "error": error(model, rod) or "",
                }
            )

    single = {k: (lambda k=k: jax.block_until_ready(jw.scan(scene(*k), control).mz)) for k in SINGLE}
    report(interleaved(single, repeats=11), 1, control.size)
    for lanes in (32, LANES):
        report(interleaved({k: batch(*k, lanes) for k in BATCHES}, repeats=5), lanes, STEPS)
    write("scan_speed", rows)


if __name__ == "__main__":
    main()
