"""Cost of each part of a scene: operations, compilation and run time, from a clamped whisker to derivatives.

python benchmarks/ladder.py
"""

import subprocess
import sys
import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import interleaved, summary, write
from operations import operations, rods, traced

STEPS, LANES = 800, 32
DISTANCE = np.linspace(0.18, 0.22, LANES)


def scene(model: str, distance) -> jw.Scene:
    """A named model before a parabola."""
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.named(model, 70.0, 0.2))


def with_events(model: str, control):
    """Reactions and events as a function of the distance."""

    def scan(q):
        result = jw.scan(scene(model, q), control)
        return result.fx, result.fy, result.mz, result.events

    return scan


def signals(model: str, control):
    """Reactions as a function of the distance."""
    scan = with_events(model, control)
    return lambda q: scan(q)[:3]


def with_derivatives(model: str, control):
    """Reactions, events and derivatives of the reactions as a function of the distance."""
    scan = with_events(model, control)
    return lambda q: (scan(q), jax.jacfwd(lambda q: scan(q)[:3])(q))


RUNGS = {
    "clamped": ("clamped", signals, 1.6),
    "+ a spring (FB)": ("FB", signals, 1.6),
    "+ a second whisker (FBFB)": ("FBFB", signals, 2.2),
    "+ feedback (FBFBR)": ("FBFBR", signals, 2.2),
    "+ a third whisker (FBFBFBR)": ("FBFBFBR", signals, 2.4),
    "+ states at events": ("FBFBFBR", with_events, 2.4),
    "+ derivatives": ("FBFBFBR", with_derivatives, 2.4),
}


def import_time() -> float:
    """Seconds of `import jaxwhisker` with its libraries already imported, median of new processes."""
    needs = "import jax, equinox, diffrax, optimistix, lineax"
    code = f"import time; {needs}; t = time.perf_counter(); import jaxwhisker; print(time.perf_counter() - t)"
    runs = (subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True) for _ in range(3))
    return summary([float(run.stdout) for run in runs])["median"]


def main() -> None:
    """Measure and store."""
    rows, calls = [], {}
    for rung, (model, make, end) in RUNGS.items():
        scan = make(model, np.linspace(0.8, -end, STEPS))
        jaxpr = traced(scan, jnp.asarray(0.2))
        distance = jnp.asarray(DISTANCE)
        start = time.perf_counter()
        lowered = jax.jit(jax.vmap(scan)).lower(distance)
        middle = time.perf_counter()
        run = lowered.compile()
        calls[rung] = lambda run=run, distance=distance: jax.block_until_ready(run(distance))
        rows.append(
            {
                "scene": rung,
                "operations": operations(jaxpr),
                "rod integrations": rods(jaxpr),
                "trace, s": middle - start,
                "compile, s": time.perf_counter() - middle,
            }
        )
        print(rows[-1], flush=True)
    for row, times in zip(rows, interleaved(calls, 7).values(), strict=True):
        row["us per step"] = 1e6 * times["median"] / STEPS / LANES
    rows.append({"scene": "import jaxwhisker (its libraries already loaded)", "import, s": import_time()})
    write("ladder", rows)


if __name__ == "__main__":
    main()
