# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # The contour of an object, and its accuracy
#
# After this notebook you can reconstruct contact points from measured signals in SI
# units, fit a shape or a free contour to them, and see how errors of the sensor change
# the result.
#
# The support reactions determine where a whisker touches an object: drive and spring
# determine the position of the base, the reactions there determine the shape of the
# rod, and the contact is where its moment vanishes. This notebook goes from the signals
# of one scan to points of the object, to a shape, and to a contour with a confidence
# band.
#
# `examples/stone.csv` contains the position of the drive in m, forces in N and a moment
# in N m, with noise of 1 % of the peaks, like a recording with a steel wire of 60 mm on
# a spring of 5 N/m. The object is a stone; its true shape is shown at the end. The
# notebook takes about a minute.

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
# ## Contact points
#
# The sensor has to be known: the wire and its support. `sigma` is the standard
# deviation of the noise, computed here from the beginning of the scan, before the first
# touch.

# %%
wire = jw.Whisker.from_material(length=0.06, youngs_modulus=210e9, diameter=0.2e-3)
sensor = jw.Sensor(wire, jw.Support.fb(5.0, rest_length=0.012))
sigma = data[["fx", "fy", "mz"]].head(100).std().to_dict()
points = jw.reconstruct(data, sensor, sigma=sigma)
print(points)

# %%
ax = jw.plot.contour(points)

# %% [markdown]
# Every step whose signals are clear of the noise is one point, with a 95 % bar across
# the contour. Points are accurate below the stone, where the force is large and acts
# near the base. They are less accurate on both sides, where the tip touches.
# `reconstruct` also determines whether tip or shaft touches.
#
# ## A shape
#
# `fit_profile` fits a shape to the points. Which one fits?

# %%
for family in (jw.Circle, jw.Parabola, jw.Ellipse):
    print(jw.fit_profile(points, family), "\n")

# %% [markdown]
# The sum of squares shows that all three are wrong: it should be about as large as the
# degrees of freedom. A poor fit says so and has no standard errors.
#
# ## A contour
#
# `fit_contour` assumes less, any strictly convex shape, and uses more: all signals at
# once, as the scan of this one contour. Its parameters are radii of curvature at some
# slopes.

# %%
fit = jw.fit_contour(data, sensor, sigma=sigma, knots=9)
print(fit)

# %%
ax = jw.plot.contour(fit)
band = fit.band()
print(
    "standard error across the contour:",
    f"{1e3 * np.nanmedian(band.error):.4f} mm (median)",
)

# %% [markdown]
# The contour with its 95 % band, which is hardly wider than the line. Single points are
# noisy, but a smooth contour averages over hundreds of them. Now compare it with the
# stone: an ellipse with half axes of 60 and 40 mm, rotated by 0.3 rad.

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
    f"{np.mean(inside):.0%} of the band contains the stone;",
    f"largest distance {1e3 * np.nanmax(away):.3f} mm",
)
assert fit.fit.status == jw.FitStatus.ok
assert np.nanmax(away / band.error) < 4

# %% [markdown]
# ## Errors of the sensor
#
# The band contains the effect of noise, but not of wrong assumptions. Assume a
# stiffness that is 10 % too large:

# %%
assumed = jw.Sensor(wire, jw.Support.fb(5.5, rest_length=0.012))
wrong = jw.reconstruct(data, assumed, sigma=sigma)
shift = np.hypot(wrong.x - points.x, wrong.y - points.y)[points.clear]
print(
    f"points move by up to {1e3 * shift.max():.2f} mm,",
    f"{1e3 * np.median(shift):.2f} mm in the median",
)

# %% [markdown]
# A single whisker can hardly detect this error; several whiskers disagree about the
# contour (`points.consistency()`). The page docs/known.md shows which parameters have
# to be known, and how accurately.
#
# ## Something to try
#
# - Use two whiskers: `examples/measured.csv` with `jw.Sensor(jw.Whisker(),
#   jw.Support.fbfbr((60.0, 80.0, 70.0)))`. Do they agree? And with a stiffness of 50
#   instead of 60?
# - Use fewer or more knots. When does the band no longer contain the stone?
# - Fit an unknown stiffness as well: `jw.fit_contour(data, lambda c: jw.Sensor(wire,
#   jw.Support.fb(c, 0.012)), parameters=dict(c=8.0), unknown=("c",), sigma=sigma)`.
