"""Studies: equilibria per second over block size, on one core and on two; memory over steps and block size.

python benchmarks/study_speed.py

Every row is measured in a separate process. Time runs from the call, after a small study that compiles the programs, to
the finished Dataset, with summary and store; memory is the peak of the process, with the compiler.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import write

POINTS = {"FB": 2048, "FBFBR": 512}  # for up to 1,600 steps; fewer points for more steps
STEPS = 1600


def run(kind: str, model: str = "FB", lanes: int = 128, cores: int = 2, steps: int = STEPS, points: int = 0) -> dict:
    """One case; the output is "reactions" in memory, a "store" on disk, or a "summary"."""
    points = points or POINTS[model] * STEPS // max(steps, STEPS)
    return {"output": kind, "model": model, "lanes": lanes, "cores": cores, "steps": steps, "points": points}


RUNS = [
    run("store", points=20_000),
    *(run("reactions", lanes=lanes) for lanes in (8, 32, 128, 256)),
    run("reactions", cores=1),
    run("store"),
    run("summary"),
    *(run("reactions", "FBFBR", lanes) for lanes in (32, 128)),
    run("reactions", "FBFBR", cores=1),
    *(run("store", steps=steps) for steps in (STEPS // 4, 4 * STEPS)),
]


def measure(output: str, model: str, lanes: int, cores: int, steps: int, points: int) -> dict:
    """Run one study in this process and return its time and memory."""
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    import jax

    jax.config.update("jax_enable_x64", True)
    import numpy as np

    import jaxwhisker as jw
    from jaxwhisker._study import parameters

    parameters.lanes_for = lambda total: lanes  # force the block size

    def build(stiffness, distance):
        return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.named(model, stiffness, 0.2))

    rng = np.random.default_rng(0)
    table = {"stiffness": rng.uniform(30, 200, points), "distance": rng.uniform(0.1, 0.4, points)}
    control = np.linspace(0.8, -1.6 if model == "FB" else -2.2, steps)
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "study.zarr" if output == "store" else None
        options = {"control": control, "summary": output == "summary", "memory": 8e9}
        jw.study(build, points={name: values[: 2 * lanes] for name, values in table.items()}, **options)  # compiles
        start = time.perf_counter()
        data = jw.study(build, points=table, store=store, **options)
        seconds = time.perf_counter() - start
    return {
        "time, s": seconds,
        "equilibria per second": points * steps / seconds,
        "peak memory, MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
        "points ok": data.attrs["points"].split(" ok")[0],
    }


def main() -> None:
    """Run all cases and store the table."""
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        settings = {"JAX_COMPILATION_CACHE_DIR": cache, "TF_CPP_MIN_LOG_LEVEL": "3"}
        for wanted in RUNS:
            command = [sys.executable, __file__, json.dumps(wanted)]
            out = subprocess.run(command, env=os.environ | settings, check=True, stdout=subprocess.PIPE, text=True)
            rows.append(wanted | json.loads(out.stdout))
            print(rows[-1], flush=True)
    write("study_speed", rows)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(measure(**json.loads(sys.argv[1]))))
    else:
        main()
