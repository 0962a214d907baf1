# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # Error against run time
#
# After this notebook you can choose how a rod is computed, with a known error and run
# time.
#
# A scan solves for thousands of equilibria, and each of them contains the shape of a
# rod. How accurate should it be, and what does it cost? This notebook measures a few
# methods on this machine. It then shows stored results that compare more methods and
# other simulators. It takes one to two minutes, nearly all of it for compilation; the
# measured times are microseconds.

# %%
import json
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import diffrax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from matplotlib import pyplot

import jaxwhisker as jw

# %% [markdown]
# ## Methods for a rod
#
# `Shooting` integrates the rod from the contact to the base in constant steps, with any
# solver of diffrax. Its default, `Splitting`, is made for rods: order 4 with 6 stages
# per step, order 6 with 11. `ClosedForm` uses elliptic functions for uniform straight
# whiskers. It is exact to rounding and serves as the reference here.

# %%
rods = {
    "splitting, order 4, 4 steps": jw.Shooting(4, jw.Splitting(6)),
    "splitting, order 4, 16 steps": jw.Shooting(16, jw.Splitting(6)),
    "splitting, order 6, 3 steps": jw.Shooting(3),
    "splitting, order 6, 8 steps (default)": jw.Shooting(),
    "Tsit5, 8 steps": jw.Shooting(8, diffrax.Tsit5()),
    "elliptic functions": jw.ClosedForm(),
}
control = np.linspace(0.69, -1.33, 4096)  # in contact all the way


def scan(rod):
    return jw.scan(
        jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0), rod), control
    )


# %% [markdown]
# The first scan with each method compiles. The time is the fastest of five more scans.
# The error is the largest difference of fx, fy and mz from the closed form, as a
# fraction of the peaks.

# %%
rows = []
for name, rod in rods.items():
    begin = time.perf_counter()
    result = scan(rod)
    first, times = time.perf_counter() - begin, []
    for _ in range(5):
        begin = time.perf_counter()
        scan(rod)
        times.append(time.perf_counter() - begin)
    rows.append(
        {
            "rod": name,
            "us per step": 1e6 * min(times) / control.size,
            "first scan, s": first,
            "result": result,
        }
    )
measured = pd.DataFrame(rows).set_index("rod")
exact = measured.result["elliptic functions"]
measured["error"] = [
    max(
        float(abs((getattr(r, n) - getattr(exact, n)) / getattr(exact, n).max()).max())
        for n in ("fx", "fy", "mz")
    )
    for r in measured.result
]
measured[["us per step", "error", "first scan, s"]]

# %%
shown = measured[measured.error > 0]
figure, ax = pyplot.subplots(figsize=(8, 3.5), layout="constrained")
for name, row in shown.iterrows():
    ax.semilogy(row["us per step"], row.error, "o", label=name)
ax.axvline(
    measured["us per step"]["elliptic functions"],
    color="0.5",
    linewidth=1,
    label="elliptic functions",
)
ax.set(
    xlabel="us per step", ylabel="largest error, fraction of the peak", xlim=(0, None)
)
legend = ax.legend(fontsize="small", bbox_to_anchor=(1.0, 1.0), frameon=False)

# %% [markdown]
# Down and to the left is better. The line is the closed form, whose error is too small
# for this scale. (Other programs on the machine affect such times.)
#
# ## Batches
#
# Scans in a batch share the overhead of every operation. `jax.vmap` turns a scan into a
# batch, and `jw.study` does so internally.

# %%
stiffness, few = jnp.linspace(60.0, 200.0, 256), jnp.asarray(control[::16])


def moments(c):
    return jw.scan(
        jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(c), jw.ClosedForm()), few
    ).mz


batch = jax.jit(jax.vmap(moments))
together = batch(stiffness).block_until_ready()
begin = time.perf_counter()
batch(stiffness).block_until_ready()
each = 1e6 * (time.perf_counter() - begin) / together.size
print(f"{together.size:,} equilibria of {stiffness.size} scans: {each:.1f} us each")

# %% [markdown]
# Every equilibrium of the batch equals that of the single scan.

# %%
alone = jw.scan(
    jw.Scene(
        jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(stiffness[100]), jw.ClosedForm()
    ),
    few,
).mz
assert np.allclose(together[100], alone, rtol=1e-9)
assert measured.error["splitting, order 6, 8 steps (default)"] < 1e-8
assert (
    measured.error["splitting, order 4, 16 steps"]
    < measured.error["splitting, order 4, 4 steps"] / 50
)

# %% [markdown]
# ## Other simulators
#
# `make bench` measures more methods, with interleaved repetitions, and stores the
# results. These are the results in the repository; docs/numerics.md describes how they
# were measured.

# %%
stored = json.loads(Path("../benchmarks/results/work_precision.json").read_text())
print(
    {
        name: stored["environment"][name]
        for name in ("processor", "cores", "date", "jax")
    }
)
rows = pd.DataFrame(stored["rows"], columns=stored["columns"])
one = rows[(rows.batch == 1) & (rows.error < 1)]
figure, ax = pyplot.subplots(figsize=(8, 4.5), layout="constrained")
for method, own in one.groupby("method", sort=False):
    ax.loglog(own["us per equilibrium"], own.error, "o", label=method)
ax.set(xlabel="us per equilibrium", ylabel="largest error, fraction of the peak")
ax.legend(fontsize="small", bbox_to_anchor=(1.0, 1.0), frameon=False)
best = one[one.error < 1e-6].groupby("method")["us per equilibrium"].min().sort_values()
print(
    "\nus per equilibrium with an error below 1e-6:",
    best.round(1).to_string(),
    sep="\n",
)

# %% [markdown]
# One point per method and setting, for a single scan. General simulators (a chain of
# hinges, a Cosserat rod) compute much more than a scan needs, which takes time.
#
# ## Something to try
#
# - Which setting is accurate enough for a sensor with noise of 1 %? And for its
#   derivatives?
# - Use more or fewer steps of the drive. What does a scan of 100 steps cost? (The path
#   is followed in steps of its own size.)
# - Use a cone: `jw.Whisker.conical(...)` needs `Shooting` and twice as many steps.
