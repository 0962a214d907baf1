"""Time from the start of a process to the first scan, split into import, tracing and compilation, and run.

python benchmarks/cold_start.py
"""

import os
import subprocess
import sys
import tempfile

from common import summary, write

FIRST = """
import time
start = time.perf_counter()
import jax
jax.config.update("jax_enable_x64", True)
import jaxwhisker as jw
imported = time.perf_counter()
scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.named("{model}", 70.0, 0.2))
jw.scan(scene).mz.block_until_ready()
first = time.perf_counter()
jw.scan(scene).mz.block_until_ready()
print(imported - start, first - imported, time.perf_counter() - first)
"""


def measure(model: str, cache: str) -> list[float]:
    """Seconds for import, first scan and second scan in a new process."""
    settings = {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2"}
    out = subprocess.run(
        [sys.executable, "-c", FIRST.format(model=model)],
        env={**os.environ, **settings, "TF_CPP_MIN_LOG_LEVEL": "3"},
        check=True,
        capture_output=True,
        text=True,
    )
    return [float(word) for word in out.stdout.split()]


def main() -> None:
    rows = []
    for model in ("FB", "FBFBR"):
        runs: dict[str, list[list[float]]] = {"empty": [], "warm": []}
        for _ in range(3):
            with tempfile.TemporaryDirectory() as cache:
                for measured in runs.values():  # the first of the two runs fills the cache
                    measured.append(measure(model, cache))
        for kind, measured in runs.items():
            imported, first, again = (summary(list(column))["median"] for column in zip(*measured, strict=True))
            rows.append(
                {
                    "model": model,
                    "compilation cache": kind,
                    "import, s": imported,
                    "trace, compile and first scan, s": first - again,
                    "a scan, s": again,
                    "import to first result, s": imported + first,
                }
            )
    write("cold_start", rows)


if __name__ == "__main__":
    main()
