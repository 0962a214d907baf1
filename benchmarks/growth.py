"""Growth of time and memory with steps, batch size, whiskers and springs.

python benchmarks/growth.py

An exponent is the slope of log time over log size, fitted by least squares to the upper half of the sizes, where
constant costs (path following of a short scan, dispatch of a small batch) are small. "growth" stores these; "models"
stores the cost of each model relative to FB.
"""

import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import interleaved, write

RODS = {"integrated": jw.Shooting(), "closed form": jw.ClosedForm()}
ENDS = {"FB": -1.6, "FBFBR": -2.2, "FBFBFBR": -2.4}


def named(model):
    """Support of a named model as a function of the stiffness."""
    return lambda c: jw.Support.named(model, c, 0.2)


def chain(whiskers):
    """A row of whiskers 0.05 apart, each with a spring to its neighbour and one to the drive."""
    ends = [(i, i + 1) for i in range(whiskers)] + [(0, i) for i in range(2, whiskers + 1)]
    return lambda c: jw.Support(tuple(jw.Spring(e, 5 * c, 0.05 * (e[1] - e[0])) for e in ends))


def meshed(springs):
    """Four whiskers with the first of their ten possible springs."""
    ends = [(i, i + 1) for i in range(4)] + [(i, j) for i in range(5) for j in range(i + 2, 5)]
    return lambda c: jw.Support(tuple(jw.Spring(e, 5 * c, 0.05 * (e[1] - e[0])) for e in ends[:springs]))


def compiled(support, rod, lanes: int, steps: int, end: float):
    """Compile a batch; return the call, compile time in s, memory in bytes, and the fraction of failed steps."""
    control = np.linspace(0.9, end, steps)

    def scan(c):
        result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), support(c), rod), control)
        return result.fx, result.fy, result.mz, result.status

    stiffness = jnp.linspace(60.0, 200.0, lanes) if lanes > 1 else jnp.asarray([70.0])
    start = time.perf_counter()
    run = jax.jit(jax.vmap(scan)).lower(stiffness).compile()
    taken = time.perf_counter() - start
    memory = run.memory_analysis()
    bytes_ = memory.temp_size_in_bytes + memory.output_size_in_bytes if memory else float("nan")
    failed = float(np.mean(np.asarray(run(stiffness)[3]) != jw.Status.ok))
    return lambda: jax.block_until_ready(run(stiffness)), taken, bytes_, failed


def exponent(sizes, values) -> float:
    """Slope of log value over log size in the upper half of the sizes."""
    half = len(sizes) // 2
    return float(np.polyfit(np.log(sizes[half:]), np.log(values[half:]), 1)[0])


def cost(seconds: float, lanes: int, steps: int, compile_time: float, memory: float, failed: float) -> dict:
    """Columns that both tables share."""
    return {
        "batch": lanes,
        "steps": steps,
        "time, ms": 1e3 * seconds,
        "us per step": 1e6 * seconds / lanes / steps,
        "compile, s": compile_time,
        "memory, MB": memory / 1e6,
        "failed": failed,
    }


def growth_rows() -> list[dict]:
    """Cost over the size of one thing at a time."""
    default = RODS["integrated"]
    groups = {
        "steps": [(n, named("FB"), default, 1, n, -1.6) for n in (200, 800, 3200, 12800)],
        "lanes": [(n, named("FB"), default, n, 400, -1.6) for n in (1, 8, 64, 256, 1024)],
        "whiskers": [(n, chain(n), default, 8, 400, -2.4) for n in (1, 2, 4, 8, 16)],
        "springs (4 whiskers)": [(n, meshed(n), default, 8, 400, -2.4) for n in (4, 7, 10)],
        "steps per rod": [(n, named("FB"), jw.Shooting(steps=n), 64, 400, -1.6) for n in (2, 4, 8, 16, 32)],
    }
    rows = []
    for group, cases in groups.items():
        jax.clear_caches()  # a process can map only a limited number of compiled scans
        made = {n: compiled(*case) for n, *case in cases}
        times = interleaved({n: call for n, (call, *_) in made.items()}, 7)
        each, memory = [times[n]["median"] for n in made], [made[n][2] for n in made]
        exponents = {
            "exponent of time": exponent(list(made), each),
            "exponent of memory": exponent(list(made), memory),
        }
        for (n, _, _, lanes, steps, _), seconds in zip(cases, each, strict=True):
            rows.append({"varied": group, "size": n} | cost(seconds, lanes, steps, *made[n][1:]) | exponents)
            print(rows[-1], flush=True)
    return rows


def model_rows() -> list[dict]:
    """Cost of each model, alone and in a batch."""
    rows = []
    for lanes, steps, repeats in ((1, 1600, 9), (1024, 800, 3)):
        jax.clear_caches()
        kinds = [(model, rod) for rod in RODS for model in ENDS]
        made = {k: compiled(named(k[0]), RODS[k[1]], lanes, steps, ENDS[k[0]]) for k in kinds}
        times = interleaved({k: call for k, (call, *_) in made.items()}, repeats)
        for (model, rod), (_, *others) in made.items():
            seconds = times[model, rod]["median"]
            row = {"model": model, "rods": rod} | cost(seconds, lanes, steps, *others)
            rows.append(row | {"relative to FB": seconds / times["FB", rod]["median"]})
            print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure and store."""
    write("growth", growth_rows())
    write("models", model_rows())


if __name__ == "__main__":
    main()
