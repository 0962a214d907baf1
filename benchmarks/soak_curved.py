"""Soak test of curved whiskers: no shaft passes into an object unnoticed.

python benchmarks/soak_curved.py [scenes]     default 10,000; five minutes on two cores

Ordinary scenes of uniform and conical whiskers with intrinsic curvature on FB, past parabolas, circles and ellipses,
with the default of `detect`. The points of every shaft with the status ok are compared with the outline itself.
"""

import sys
import time
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import write

jax.config.update("jax_enable_x64", True)

BLOCK = 64  # scenes per batch
STEPS = 96  # of the control
POINTS = 129  # of a shaft
DEPTH = 1e-4  # lengths: deeper shafts have a second contact
PROFILES = ("parabola", "circle", "ellipse")
WHISKERS = ("uniform", "cone")


def scene(profile: str, whisker: str, p: dict[str, jax.Array]) -> jw.Scene:
    """One scene; all lengths are those of the whisker."""
    objects = {
        "parabola": lambda: jw.Parabola(p["distance"], p["a"]),
        "circle": lambda: jw.Circle(p["distance"], p["radius"]),
        "ellipse": lambda: jw.Ellipse(p["distance"], p["radius"], p["b"]),
    }
    rod = jw.Whisker(intrinsic_curvature=p["curvature"])
    if whisker == "cone":
        rod = jw.Whisker.conical(1.0, 64e4 / np.pi, 0.1, 0.1 * p["taper"], intrinsic_curvature=p["curvature"])
    return jw.Scene(rod, objects[profile](), jw.Support.fb(p["stiffness"], 0.2))


def drawn(count: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Random ordinary parameters."""
    uniform = rng.uniform
    return {
        "distance": uniform(0.05, 0.6, count),
        "a": 10 ** uniform(-0.5, 0.7, count),
        "radius": 10 ** uniform(-1.0, 0.3, count),
        "b": 10 ** uniform(-1.0, 0.0, count),
        "curvature": uniform(-1.2, 1.2, count),
        "taper": uniform(0.1, 0.9, count),
        "stiffness": 10 ** uniform(0.5, 3.0, count),
    }


def depth(profile: str, p: dict[str, np.ndarray], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """How deep points (scenes, steps, points) are inside, to first order; negative outside."""
    p = {name: values[:, None, None] for name, values in p.items()}
    if profile == "parabola":
        return (y - p["distance"] - p["a"] * x**2) / np.sqrt(1 + (2 * p["a"] * x) ** 2)
    a, b = p["radius"], p["b"] if profile == "ellipse" else p["radius"]
    right, up = x / a, (y - p["distance"] - b) / b
    size = np.sqrt((right / a) ** 2 + (up / b) ** 2)
    return (1 - right**2 - up**2) / (2 * np.maximum(size, 1e-12))


def soaked(profile: str, whisker: str, scenes: int, seed: int) -> dict:
    """Scan random scenes of one kind; return a row of the table."""
    rng, control = np.random.default_rng(seed), jnp.linspace(1.9, -2.7, STEPS)

    @jax.vmap
    def run(p):
        result = jw.scan(scene(profile, whisker, p), control)
        line = jw.shapes(result, points=POINTS)
        return result.status, line.x[:, 0], line.y[:, 0], result.phase[:, 0]

    statuses, inside, deepest, seconds = Counter(), 0, 0.0, 0.0
    for _ in range(-(-scenes // BLOCK)):
        p, start = drawn(BLOCK, rng), time.perf_counter()
        status, x, y, phase = map(np.asarray, run(jax.tree.map(jnp.asarray, p)))
        seconds += time.perf_counter() - start
        known = (status == jw.Status.ok) & (phase != jw.Phase.free)
        found = np.where(known, np.max(np.nan_to_num(depth(profile, p, x, y), nan=-1.0), axis=2), 0.0)
        for lane in np.flatnonzero(np.max(found, axis=1) > DEPTH):
            numbers = {name: float(values[lane]) for name, values in p.items()}
            print(f"inside by {np.max(found[lane]):.2g}: {profile}, {whisker}, {numbers}", file=sys.stderr, flush=True)
        inside += int(np.sum(np.max(found, axis=1) > DEPTH))
        deepest = max(deepest, float(np.max(found)))
        statuses.update(jw.Status(s).name for s in np.max(status, axis=1))
    count = sum(statuses.values())
    return {
        "profile": profile,
        "whisker": whisker,
        "scenes": count,
        "not ok": ", ".join(f"{n} {name}" for name, n in sorted(statuses.items()) if name != "ok"),
        "inside, ok": inside,
        "deepest, L": deepest,
        "ms per scene": 1e3 * seconds / count,
    }


def main(scenes: int) -> None:
    """Scan all kinds and store the table."""
    kinds = [(profile, whisker) for profile in PROFILES for whisker in WHISKERS]
    rows = []
    for seed, kind in enumerate(kinds):
        rows.append(soaked(*kind, -(-scenes // len(kinds)), seed))
        print(rows[-1], flush=True)
    write("soak_curved", rows)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
