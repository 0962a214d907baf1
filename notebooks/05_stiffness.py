# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # Stiffness from a measured scan
#
# A file holds the reactions at the bases of two coupled whiskers, with noise. Which stiffnesses do the springs have,
# how well are they known, and what can such a file not tell? The file is `examples/measured.csv`; a script beside it,
# `make_measured.py`, simulated it, so that this time the truth is known. Everything is dimensionless: lengths in L,
# forces in EI/L², moments in EI/L, stiffnesses in EI/L³. One to two minutes.

# %%
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
import pandas as pd
from matplotlib import pyplot

import jaxwhisker as jw

FILE = Path("../examples/measured.csv")
data = pd.read_csv(FILE, comment="#")
data.head(3)

# %% [markdown]
# One row a step: the position of the drive, and fx, fy, mz of both whiskers.

# %%
ax = data.plot("control", ["mz_1", "mz_2"], xlabel="$u/L$", ylabel=r"$m_z\,L/EI$")

# %% [markdown]
# The moments. The drive moves from right to left; whisker 1 touches first, and whisker 2 follows. Where whisker 1 snaps
# off, at -1.3, the moment of whisker 2 jumps a little: the springs couple them.
#
# ## The fit
#
# A function makes the scene from what is sought: the springs drive-base 1, base 1-base 2 and drive-base 2, and the
# distance of the object. What has a default is taken as known. The guess may be off by a factor of two or three.


# %%
def build(c1, c2, c3, q, rest=0.2, position=0.0):
    support = jw.Support.fbfbr((c1, c2, c3), rest_length=(rest, 0.2, rest + 0.2))
    return jw.Scene(
        jw.Whisker(), jw.Parabola(q, position=position), support, rod=jw.ClosedForm()
    )


fit = jw.identify(build, guess=dict(c1=100.0, c2=50.0, c3=90.0, q=0.25), measured=FILE)
print(fit)

# %% [markdown]
# The noise was not told; it is estimated from what the fit leaves. The truth, 60, 80, 70 and 0.3, lies within two or
# three standard errors:

# %%
truth = dict(c1=60.0, c2=80.0, c3=70.0, q=0.3)
off = {
    name: (fit.estimates[name] - truth[name]) / fit.standard_error[name]
    for name in truth
}
print(
    "estimate - truth, in standard errors:",
    {name: round(value, 2) for name, value in off.items()},
)
assert fit.status == jw.FitStatus.ok
assert max(map(abs, off.values())) < 3

# %%
axs = jw.plot.fit(fit)

# %% [markdown]
# Dots were measured, lines are fitted; time runs to the right here. A snap counts by its position: signals on the wrong
# side of it would tell nothing by their size.
#
# Does noise explain what is left? If so, the residuals look like noise, also near the snaps.

# %%
figure, ax = pyplot.subplots(figsize=(6.4, 2.2), layout="constrained")
ax.plot(fit.measured.control, fit.residuals[:, :, 2], ".", markersize=2)
ax.set(xlabel="$u/L$", ylabel="measured $-$ fitted $m_z$")
print(
    f"standard deviation: {np.nanstd(fit.residuals[:, :, 2]):.4f};",
    "the noise was 0.045",
)

# %% [markdown]
# ## How well is it known?
#
# Standard errors take the misfit for a parabola. The profile likelihood does not: it fits all other parameters anew for
# each value of one.

# %%
profile = fit.profile("c2", points=9)
figure, ax = pyplot.subplots(figsize=(5, 3), layout="constrained")
ax.plot(profile.values, profile.misfit, ".-", label="profile")
from_estimate = (profile.values - fit.estimates["c2"]) / fit.standard_error["c2"]
ax.plot(profile.values, from_estimate**2, "--", label="parabola")
ax.axhline(3.84, color="0.6", linewidth=0.8)
ax.set(xlabel="$c_2$", ylabel=r"$\chi^2 - \chi^2_{min}$")
ax.legend(frameon=False)
print(
    "95 %:",
    np.round(profile.interval, 2),
    "by the profile,",
    np.round(fit.interval["c2"], 2),
    "by standard errors",
)

# %% [markdown]
# The two agree: with 441 samples the parabola is good enough. (Where it isn't, the notebook posterior tells more.)
#
# ## What the signals know
#
# The Fisher information tells beforehand what an experiment can tell: how well, by which channel, and where along the
# scan. Here with two more unknowns, the rest length of the first spring and the object's position along x; first taken
# as known.

# %%
noise = dict(fx=0.05, fy=0.1, mz=0.045)
everything = jw.information(
    build,
    at=truth | dict(rest=0.2, position=0.0),
    sigma=noise,
    control=data.control.to_numpy(),
)
told = everything.known("rest", "position")
print(told)
ax = jw.plot.information(told)

# %% [markdown]
# A steep line is where the signals tell most; grey lines are events. The distance is told by the peaks, the springs on
# the way there, where they are loaded, and just before whiskers snap off. The spring between the whiskers, c2, which is
# known worst, is told there most of all.
#
# ## What no signal tells
#
# And if the two are not known?

# %%
print(everything)

# %% [markdown]
# A longer rest length and an object that lies further to the right by as much change no signal: one of the two has to
# be measured otherwise. A fit would say the same, give both no standard error, and go on. Also never told by forces
# that are given in EI/L²: EI itself. In newtons and metres it is.

# %%
assert everything.rank == 5
assert {
    name for name, error in everything.standard_error.items() if np.isnan(error)
} == {"rest", "position"}
assert all(
    np.isclose(told.standard_error[name], fit.standard_error[name], rtol=0.3)
    for name in truth
)

# %% [markdown]
# ## Something to try
#
# - Moments only: `measured=data[["control", "mz_1", "mz_2"]]`. How much is lost?
# - Whisker 1 only, `["control", "fx_1", "fy_1", "mz_1"]`: is c2 still identified?
# - A wrong model: `jw.Support.fbfb((c1, c2))`. How does the fit tell that it is wrong?
