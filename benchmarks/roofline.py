"""Roofline: arithmetic operations of a rod and of an equilibrium, and how many of them the machine does per second.

python benchmarks/roofline.py

The ceiling is measured with a chain of fused multiply-adds on the same number of elements. Newton's method evaluates a
rod with two tangents; an equilibrium takes two such evaluations and one value.
"""

import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import interleaved, write
from operations import inner, traced

LANES, CHAIN = 65536, 256
ARITHMETIC = {"add", "sub", "mul", "div", "neg", "sqrt", "cos", "sin", "integer_pow", "square", "add_any", "max", "min"}


def flops(jaxpr) -> int:
    """Count arithmetic operations; those in loops count once per iteration."""
    total = 0
    for equation in jaxpr.eqns:
        numbers = int(np.prod(equation.outvars[0].aval.shape)) if equation.outvars else 0
        total += numbers * (equation.primitive.name in ARITHMETIC)
        times = equation.params.get("length", 1) if equation.primitive.name == "scan" else 1
        total += times * sum(map(flops, inner(equation)))
    return total


def chain(x):
    """Apply 2 CHAIN operations to every number."""
    y = x
    for _ in range(CHAIN):
        y = y * x + 0.5
    return y


def main() -> None:
    """Measure and store."""
    rng = np.random.default_rng(0)
    bend, arc, angle = (jnp.asarray(rng.uniform(*ends, LANES)) for ends in ((0.5, 6.0), (0.5, 1.0), (0.0, 1.0)))

    def with_tangents(rod):
        def one(bend, arc, angle):
            return jax.jacfwd(lambda at: (rod.end(at[0], arc, at[1]),) * 2, has_aux=True)(jnp.stack([bend, angle]))

        return one

    rods = {"closed form": jw.ClosedForm(), **{f"splitting, {n} steps": jw.Shooting(n) for n in (2, 4, 8)}}
    calls, counts = {}, {}
    for name, rod in rods.items():
        for kind, one in (("value", rod.end), ("value and two tangents", with_tangents(rod))):
            run = jax.jit(jax.vmap(one))
            calls[name, kind] = lambda run=run: jax.block_until_ready(run(bend, arc, angle))
            counts[name, kind] = flops(traced(one, 1.0, 1.0, 0.5))
    ceiling = jax.jit(chain)
    calls["multiply and add", "ceiling"] = lambda: jax.block_until_ready(ceiling(bend))
    counts["multiply and add", "ceiling"] = 2 * CHAIN
    times = interleaved(calls, 21)
    rows = []
    for (name, kind), t in times.items():
        each = t["median"] / LANES
        rows.append(
            {
                "rods": name,
                "computed": kind,
                "operations": counts[name, kind],
                "us each": 1e6 * each,
                "operations per second, 1e9": counts[name, kind] / each / 1e9,
            }
        )
    control = np.linspace(0.694, -1.3, 1600)
    stiffness = jnp.linspace(60.0, 200.0, 256)
    for name in ("closed form", "splitting, 8 steps"):

        def scan(c, rod=rods[name]):
            scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(c, 0.2), rod)
            result = jw.scan(scene, control)
            return result.fx, result.fy, result.mz

        run = jax.jit(jax.vmap(scan))
        jax.block_until_ready(run(stiffness))
        taken = []
        for _ in range(5):
            start = time.perf_counter()
            jax.block_until_ready(run(stiffness))
            taken.append(time.perf_counter() - start)
        count = 2 * counts[name, "value and two tangents"] + counts[name, "value"]
        each = float(np.median(taken)) / stiffness.size / control.size
        rows.append(
            {
                "rods": name,
                "computed": "an equilibrium of a batch of 256 scans",
                "operations": count,
                "us each": 1e6 * each,
                "operations per second, 1e9": count / each / 1e9,
                "share in rods": (2 * times[name, "value and two tangents"]["median"] + times[name, "value"]["median"])
                / LANES
                / each,
            }
        )
    write("roofline", rows)


if __name__ == "__main__":
    main()
