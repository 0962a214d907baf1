# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # Studies: many scans at once
#
# How does the signal change with the stiffness of the spring, and with the distance of the object? `jw.study` scans
# every combination and returns one labelled Dataset. This notebook varies the stiffness first, then both, and finds the
# line below which the peak of the signal is skipped. Everything is dimensionless: lengths in L, stiffnesses in EI/L³,
# moments in EI/L. About a minute.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw
from jaxwhisker._study.critical import steepest, steepness


def build(stiffness, distance=0.2):
    support = jw.Support.fb(stiffness, rest_length=0.2)
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), support, rod=jw.ClosedForm())


# %% [markdown]
# ## One parameter
#
# Every argument of `study` that `build` has, too, is an axis; others keep their defaults. The control is the same for
# all scans. Next to the reactions and events we ask for the positions of bases and springs: over these, `summary` finds
# peaks between the steps even where the base darts across them.

# %%
control = np.linspace(0.75, -1.5, 451)  # steps of 0.005
stiffness = [20, 22, 24, 26, 28, 30, 32, 36, 40, 50, 70, 100, 140, 200]
data = jw.study(
    build,
    stiffness=stiffness,
    control=control,
    outputs=("reactions", "status", "events", "springs"),
)
print(data[["fx", "fy", "mz", "event_kind", "event_control"]])

# %% [markdown]
# An `xarray.Dataset`: signals over stiffness, control and whisker, with units and names, and the events of every scan.
# (`data` holds more than is shown here.)

# %%
lines = (
    data.mz.sel(stiffness=[22, 30, 50, 100, 200])
    .isel(whisker=0, drop=True)
    .plot.line(x="control")
)

# %% [markdown]
# The moment, one curve a stiffness; the drive moves from right to left. Softer springs let the base lag behind, so that
# the signal comes later and is narrower, but its height stays the same. The softest one, though, skips the peak in a
# jump.

# %%
peaks = jw.summary(data)
peaks[
    ["max_mz", "control_of_max_mz", "contact_width", "snaps", "snap_work"]
].to_dataframe()

# %% [markdown]
# `summary` has the peaks, and where they are, for each scan. (`snap_work` is the energy lost in snaps, in EI/L.)
#
# ## The critical stiffness
#
# A base is stable while its spring is stiffer than the object's force is steep. The steepest slope of a clamped
# whisker's force is therefore the critical stiffness: below it the base snaps past the states where the peak would be.

# %%
critical = steepest(jw.Whisker(), jw.Parabola(0.2))
print(
    f"critical stiffness {critical.slope:.3f} EI/L³,",
    f"reached with the base at x0 = {critical.base_x:.3f} L",
)
ax = jw.plot.study(peaks, critical=steepness(build, peaks))[0]

# %% [markdown]
# The largest moment over the stiffness. Right of the dashed line nothing changes it; left of it the scan snaps through,
# and what is left of the peak depends on where.

# %%
above = peaks.stiffness > critical.slope
unchanged, skipped = (
    peaks.max_mz.isel(whisker=0).sel(stiffness=which) for which in (above, ~above)
)
print(
    f"above: {float(unchanged.min()):.6f} to {float(unchanged.max()):.6f};",
    f"below: at most {float(skipped.max()):.3f}",
)
assert unchanged.max() - unchanged.min() < 1e-4  # with steps of 0.005
assert skipped.max() < unchanged.min() - 1e-3

# %% [markdown]
# ## Two parameters
#
# 24 stiffnesses and 12 distances, 288 scans. `summary=True` keeps the peaks only, and `store="map.zarr"` would keep
# them on disk, where an interrupted study goes on.

# %%
both = jw.study(
    build,
    stiffness=np.linspace(15, 180, 24),
    distance=np.linspace(0.1, 0.3, 12),
    control=np.linspace(0.8, -1.6, 481),
    summary=True,
)
print(both.attrs["points"])
left = both.assign(share=both.max_mz / both.max_mz.isel(stiffness=-1))
left.share.attrs = {
    "long_name": "largest mz, share of that with the stiffest spring",
    "units": "1",
}
ax = jw.plot.study(left, "share", critical=steepness(build, both))[0]

# %% [markdown]
# The largest moment, as a share of that with the stiffest spring: 1 right of the line, where nothing is skipped, and
# less left of it. The nearer the object, the stiffer the spring has to be.
#
# ## Events as data
#
# Where does the whisker let go? Events are in the Dataset, too.

# %%
let_go = data.event_control.where(data.event_kind == jw.EventKind.snap_off).min("event")
let_go.to_series()

# %% [markdown]
# The stiffer the spring, the later: an infinitely stiff one lets go with the base at -1.222, the drive at -1.422. This
# position tells the stiffness, which the height of the peak does not; the notebook 04_gradients takes that further.
#
# ## Something to try
#
# - Two whiskers: `jw.Support.fbfbr(stiffness)`. The map gets a panel each, and the critical line is an estimate.
# - The rest length as an axis: give `build` another argument. What does it do to `max_mz`, and to `control_of_max_mz`?
# - `derivatives="stiffness"` in the first study adds the derivative of every signal by the stiffness.
