# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # The contour of an object, and how well it is known
#
# The support reactions tell where a whisker touches: the base is where drive and spring put it, from there the rod is
# known, and the contact is where its moment vanishes. This notebook takes the signals of one scan to points of the
# object, to a shape, and to a contour with a band in which it lies. Signals are in SI units: `examples/stone.csv` holds
# the drive's position in m, forces in N and a moment in N m, with noise of 1 % of the peaks, as a steel wire of 60 mm
# on a spring of 5 N/m might record them. The object is a stone; its shape is shown at the end. About a minute.

# %%
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
import pandas as pd
from matplotlib import pyplot

import jaxwhisker as jw

FILE = Path("../examples/stone.csv")
data = pd.read_csv(FILE, comment="#")
figure, axs = pyplot.subplots(3, 1, sharex=True, layout="constrained")
for ax, (name, unit) in zip(
    axs, {"fx": "mN", "fy": "mN", "mz": "mN m"}.items(), strict=True
):
    ax.plot(1e3 * data.control, 1e3 * data[name], linewidth=0.8)
    ax.set(xlabel="position of the drive (mm)", ylabel=f"{name} ({unit})")
    ax.label_outer()

# %% [markdown]
# The measured signals; the drive moves from right to left.
#
# ## Points, one by one
#
# What has to be known is the sensor: the wire, and its support. `sigma` is the standard deviation of the noise, here
# read from the beginning of the scan, where nothing touches yet.

# %%
wire = jw.Whisker.from_material(length=0.06, youngs_modulus=210e9, diameter=0.2e-3)
sensor = jw.Sensor(wire, jw.Support.fb(5.0, rest_length=0.012))
sigma = data[["fx", "fy", "mz"]].head(100).std().to_dict()
points = jw.reconstruct(data, sensor, sigma=sigma)
print(points)

# %%
ax = jw.plot.contour(points)

# %% [markdown]
# Every step in which the signals stand out of the noise is one point, with a bar across the contour that holds 95 %.
# Points are sharp below the stone, where the force is large and acts near the base, and blur to both sides, where the
# tip touches. Whether tip or shaft touches is decided on the way.
#
# ## A shape
#
# `fit_profile` fits a shape to the points. Which one?

# %%
for family in (jw.Circle, jw.Parabola, jw.Ellipse):
    print(jw.fit_profile(points, family), "\n")

# %% [markdown]
# The sum of squares tells that none of them is right: it should be about as large as the degrees of freedom. A fit that
# is no good says so, and has no standard errors.
#
# ## A contour
#
# `fit_contour` asks for less and takes more: any strictly convex shape, and all signals at once, which have to be the
# scan of that one contour. Its parameters are radii of curvature at some slopes.

# %%
fit = jw.fit_contour(data, sensor, sigma=sigma, knots=9)
print(fit)

# %%
ax = jw.plot.contour(fit)
band = fit.band()
print(
    "standard error across the contour:",
    f"{1e3 * np.nanmedian(band.error):.4f} mm in the middle",
)

# %% [markdown]
# The contour with its 95 % band, which is hardly wider than the line: the points share one noise, and a contour that is
# smooth averages over hundreds of them. Now for the stone: an ellipse with half axes of 60 and 40 mm, turned by 0.3
# rad.

# %%
stone = jw.Tilted(jw.Ellipse(0.02, 0.06, 0.04), 0.3, about=(0.0, 0.06))
border = jax.vmap(stone.point)(jnp.linspace(-1.5, 1.5, 20001))
away = np.hypot(band.x[:, None] - border.x, band.y[:, None] - border.y).min(axis=1)
inside = away < 1.96 * band.error
figure, ax = pyplot.subplots(figsize=(6.4, 2.6), layout="constrained")
ax.fill_between(1e3 * band.x, 1e3 * 1.96 * band.error, alpha=0.25, label="95 % band")
ax.plot(1e3 * band.x, 1e3 * away, label="distance to the stone")
ax.set(xlabel="x (mm)", ylabel="mm")
ax.legend(frameon=False)
print(
    f"{np.mean(inside):.0%} of the contour lies within its band;",
    f"largest distance {1e3 * np.nanmax(away):.3f} mm",
)
assert fit.fit.status == jw.FitStatus.ok
assert np.nanmax(away / band.error) < 4

# %% [markdown]
# ## What if the sensor is not what it is believed to be?
#
# A band holds noise, not wrong beliefs. With a spring that is 10 % softer than it is believed to be:

# %%
believed = jw.Sensor(wire, jw.Support.fb(5.5, rest_length=0.012))
wrong = jw.reconstruct(data, believed, sigma=sigma)
shift = np.hypot(wrong.x - points.x, wrong.y - points.y)[points.clear]
print(
    f"points move by up to {1e3 * shift.max():.2f} mm,",
    f"{1e3 * np.median(shift):.2f} mm in the middle",
)

# %% [markdown]
# One whisker can hardly tell; several whiskers disagree on the contour (`points.consistency()`). What has to be known,
# and how exactly, is the question of a page of its own, docs/known.md.
#
# ## Something to try
#
# - Two whiskers: `examples/measured.csv` with `jw.Sensor(jw.Whisker(), jw.Support.fbfbr((60.0, 80.0, 70.0)))`. Do they
#   agree? And with a stiffness of 50 in place of 60?
# - Fewer knots, or more: when does the band no longer hold the stone?
# - A stiffness that is not known: `jw.fit_contour(data, lambda c: jw.Sensor(wire, jw.Support.fb(c, 0.012)),
#   parameters=dict(c=8.0), unknown=("c",), sigma=sigma)`.
