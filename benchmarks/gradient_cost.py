"""Cost of derivatives: run time as a multiple of the scan, and memory per step.

python benchmarks/gradient_cost.py

The jitted scalar is a weighted sum of all fx and mz of a scan of 1,900 steps, also in a batch of 32. Forward mode is
jax.jacfwd, reverse mode jax.grad, with respect to the first 1, 3, 6 or 12 of these parameters: stiffnesses and rest
lengths of the three springs, object distance and shape, whisker length, bending stiffnesses of both whiskers, object
position. Their order is that of `AT`.
"""

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import interleaved, write

STEPS, LANES = 1900, 32
AT = jnp.array([70.0, 0.2, 0.2, 1.0, 1.0, 1.0, 60.0, 80.0, 0.2, 0.4, 1.0, 0.0])
CONTROL = {"FB": (0.8, -1.6), "FBFBR": (0.8, -2.2)}


def scene(model: str, p) -> jw.Scene:
    """Scene of all twelve parameters."""
    c1, q, rest1, length, bending1, a, c2, c3, rest2, rest3, bending2, position = p
    profile = jw.Parabola(q, a, position)
    if model == "FB":
        return jw.Scene(jw.Whisker(length, bending1), profile, jw.Support.fb(c1, rest1))
    pair = (jw.Whisker(length, bending1), jw.Whisker(length, bending2))
    return jw.Scene(pair, profile, jw.Support.fbfbr([c1, c2, c3], [rest1, rest2, rest3]))


def scalar(model: str, steps: int):
    """Function from the first parameters to the weighted sum."""
    control = jnp.linspace(*CONTROL[model], steps)
    weights = jnp.asarray(np.random.default_rng(0).normal(size=(steps, 1)))

    def total(some):
        result = jw.scan(scene(model, AT.at[: some.size].set(some)), control)
        return jnp.sum(weights * (result.fx + result.mz))

    return total


def compiled(model: str, count: int, lanes: int | None, steps: int = STEPS) -> tuple[dict, jax.Array]:
    """Compile scan, forward and reverse mode for this many parameters."""
    total = scalar(model, steps)
    some = AT[:count]
    if lanes is not None:
        some = some * jnp.linspace(1.0, 1.2, lanes)[:, None]
    kinds = {"scan": total, "forward": jax.jacfwd(total), "reverse": jax.grad(total)}
    kinds = {name: kind if lanes is None else jax.vmap(kind) for name, kind in kinds.items()}
    return {name: jax.jit(kind).lower(some).compile() for name, kind in kinds.items()}, some


def memory(executable) -> int:
    """Bytes of temporary memory."""
    return executable.memory_analysis().temp_size_in_bytes


def main() -> None:
    """Measure and store."""
    rows = []
    for model, lanes, counts in (("FB", None, (1, 3, 6)), ("FBFBR", None, (1, 12)), ("FB", LANES, (6,))):
        for count in counts:
            executables, some = compiled(model, count, lanes)
            calls = {k: (lambda e=e, at=some: jax.block_until_ready(e(at))) for k, e in executables.items()}
            times = {k: t["median"] for k, t in interleaved(calls, repeats=9).items()}
            row = {"model": model, "batch": lanes or 1, "parameters": count, "scan, s": times["scan"]}
            for kind in ("forward", "reverse"):
                row[f"{kind}, scans"] = times[kind] / times["scan"]
            each = STEPS * (lanes or 1)
            row |= {f"{kind}, bytes per step": memory(e) / each for kind, e in executables.items()}
            rows.append(row)
            print(row, flush=True)
    write("gradient_cost", rows)


if __name__ == "__main__":
    main()
