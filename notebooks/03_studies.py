# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # Studies: many scans at once
#
# After this notebook you can scan all combinations of several parameters, summarise the
# signals, and find the critical stiffness below which a scan skips its peak.
#
# How does the signal change with the stiffness of the spring and with the distance of
# the object? `jw.study` scans every combination and returns one labelled Dataset. This
# notebook first varies the stiffness, then both parameters. Everything is
# dimensionless: lengths in L, stiffnesses in EI/L³, moments in EI/L. It takes about a
# minute.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw


def build(stiffness, distance=0.2):
    support = jw.Support.fb(stiffness, rest_length=0.2)
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), support, rod=jw.ClosedForm())


# %% [markdown]
# ## One parameter
#
# Every argument of `study` that `build` also has is an axis; the others keep their
# defaults. All scans have the same control. Besides reactions and events, this study
# stores the positions of bases and springs. With them, `summary` finds peaks between
# the steps, even where the base moves fast across them.

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
# The result is an `xarray.Dataset`: signals over stiffness, control and whisker, with
# units and names, and the events of every scan. (`data` contains more than is shown
# here.)

# %%
lines = (
    data.mz.sel(stiffness=[22, 30, 50, 100, 200])
    .isel(whisker=0, drop=True)
    .plot.line(x="control")
)

# %% [markdown]
# The moment, with one curve per stiffness; the drive moves from right to left. With a
# softer spring the base lags behind: the signal comes later and is narrower, but has
# the same height. The softest spring, however, skips the peak in a jump.

# %%
peaks = jw.summary(data)
peaks[
    ["max_mz", "control_of_max_mz", "contact_width", "snaps", "snap_work"]
].to_dataframe()

# %% [markdown]
# `summary` returns the peaks and their positions for each scan. (`snap_work` is the
# energy lost in snaps, in EI/L.)
#
# ## The critical stiffness
#
# A base is stable as long as its spring is stiffer than the slope of the force on the
# clamped whisker. The steepest slope is therefore the critical stiffness: with a softer
# spring, the base snaps past the states that contain the peak.

# %%
critical = float(jw.critical_stiffness(jw.Whisker(), jw.Parabola(0.2)))
print(f"critical stiffness {critical:.3f} EI/L³")
ax = jw.plot.study(peaks, critical=critical / peaks.stiffness)[0]

# %% [markdown]
# The largest moment over the stiffness. Right of the dashed line, it does not depend on
# the stiffness. Left of it the scan snaps through, and the remaining peak depends on
# the position of the snap.

# %%
above = peaks.stiffness > critical
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
# 24 stiffnesses and 12 distances make 288 scans. `summary=True` keeps only the peaks.
# `store="map.zarr"` would store them on disk, where an interrupted study resumes.

# %%
both = jw.study(
    build,
    stiffness=np.linspace(15, 180, 24),
    distance=np.linspace(0.1, 0.3, 12),
    control=np.linspace(0.8, -1.6, 481),
    summary=True,
)
print(both.attrs["points"])
relative = both.assign(fraction=both.max_mz / both.max_mz.isel(stiffness=-1))
relative.fraction.attrs = {
    "long_name": "largest mz, fraction of that with the stiffest spring",
    "units": "1",
}
of_distance = jax.vmap(lambda q: jw.critical_stiffness(jw.Whisker(), jw.Parabola(q)))
critical = both.distance.copy(data=of_distance(both.distance.values)) / both.stiffness
ax = jw.plot.study(relative, "fraction", critical=critical)[0]

# %% [markdown]
# The largest moment as a fraction of that with the stiffest spring. It is 1 right of
# the line, where nothing is skipped, and smaller left of it. A closer object needs a
# stiffer spring.
#
# ## Events as data
#
# Where does the whisker snap off? Events are part of the Dataset as well.

# %%
snap_off = data.event_control.where(data.event_kind == jw.EventKind.snap_off).min(
    "event"
)
snap_off.to_series()

# %% [markdown]
# With a stiffer spring the whisker snaps off later. With an infinitely stiff one it
# snaps off with the base at -1.222, the drive at -1.422. This position determines the
# stiffness, which the height of the peak does not. The notebook 04_gradients continues
# from here.
#
# ## Something to try
#
# - Use two whiskers, `jw.Support.fbfbr(stiffness)`. The map has one panel per whisker,
#   and the critical line is an estimate.
# - Give `build` the rest length as another argument, and vary it. How does it change
#   `max_mz` and `control_of_max_mz`?
# - Add `derivatives="stiffness"` to the first study: the Dataset then contains the
#   derivative of every signal with respect to the stiffness.
