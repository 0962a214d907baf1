"""How cost grows with steps, lanes, whiskers and springs: times, memory, and exponents fitted to them.

python benchmarks/growth.py

Exponents: the slope of log time over log size, by least squares over the upper half of the sizes, where what does not
grow (the march of a scan with few steps, the dispatch of a batch with few lanes) has become small.
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
    return lambda c: jw.Support.named(model, c, 0.2)


def chain(whiskers):
    """Whiskers in a row, 0.05 apart, each on a spring to the last one and one home."""
    ends = [(i, i + 1) for i in range(whiskers)] + [(0, i) for i in range(2, whiskers + 1)]
    return lambda c: jw.Support(tuple(jw.Spring(e, 5 * c, 0.05 * (e[1] - e[0])) for e in ends))


def meshed(springs):
    """Four whiskers and that many springs of the ten that there can be."""
    ends = [(i, i + 1) for i in range(4)] + [(i, j) for i in range(5) for j in range(i + 2, 5)]
    return lambda c: jw.Support(tuple(jw.Spring(e, 5 * c, 0.05 * (e[1] - e[0])) for e in ends[:springs]))


def compiled(support, rod, lanes: int, steps: int, end: float):
    """The compiled batch, its compile time and the memory that it needs, in bytes."""
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
    """Slope of log value over log size in the upper half."""
    half = len(sizes) // 2
    return float(np.polyfit(np.log(sizes[half:]), np.log(values[half:]), 1)[0])


def main() -> None:
    default = RODS["integrated"]
    groups = {
        "steps": [(n, named("FB"), default, 1, n, -1.6) for n in (200, 800, 3200, 12800)],
        "lanes": [(n, named("FB"), default, n, 400, -1.6) for n in (1, 8, 64, 256, 1024)],
        "whiskers": [(n, chain(n), default, 8, 400, -2.4) for n in (1, 2, 4, 8, 16)],
        "springs (4 whiskers)": [(n, meshed(n), default, 8, 400, -2.4) for n in (4, 7, 10)],
        "steps of a rod": [(n, named("FB"), jw.Shooting(steps=n), 64, 400, -1.6) for n in (2, 4, 8, 16, 32)],
    }
    rows = []
    for group, cases in groups.items():
        jax.clear_caches()  # a process may not map too many compiled scans
        made = {n: compiled(*case) for n, *case in cases}
        times = interleaved({n: call for n, (call, *_) in made.items()}, 7)
        each, memory = [times[n]["median"] for n in made], [made[n][2] for n in made]
        for (n, _, _, lanes, steps, _), t, bytes_ in zip(cases, each, memory, strict=True):
            rows.append(
                {
                    "grows": group,
                    "size": n,
                    "batch": lanes,
                    "steps": steps,
                    "time, ms": 1e3 * t,
                    "us per step": 1e6 * t / lanes / steps,
                    "compile, s": made[n][1],
                    "memory, MB": bytes_ / 1e6,
                    "failed": made[n][3],
                    "exponent of time": exponent(list(made), each),
                    "exponent of memory": exponent(list(made), memory),
                }
            )
            print(rows[-1], flush=True)
    for lanes in (1, 1024):
        jax.clear_caches()
        kinds = [(model, rod) for rod in RODS for model in ENDS]
        made = {k: compiled(named(k[0]), RODS[k[1]], lanes, 1600 if lanes == 1 else 800, ENDS[k[0]]) for k in kinds}
        times = interleaved({k: call for k, (call, *_) in made.items()}, 9 if lanes == 1 else 3)
        for (model, rod), (_, taken, bytes_, failed) in made.items():
            t, steps = times[model, rod]["median"], 1600 if lanes == 1 else 800
            rows.append(
                {
                    "grows": f"model, {rod}",
                    "size": model,
                    "batch": lanes,
                    "steps": steps,
                    "time, ms": 1e3 * t,
                    "us per step": 1e6 * t / lanes / steps,
                    "compile, s": taken,
                    "memory, MB": bytes_ / 1e6,
                    "failed": failed,
                    "to FB": t / times["FB", rod]["median"],
                }
            )
            print(rows[-1], flush=True)
    write("growth", rows)


if __name__ == "__main__":
    main()
