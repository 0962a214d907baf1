# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # Stiffness from a measured scan
#
# After this notebook you can identify spring stiffnesses from a file of measured
# signals, judge the result, and compute what such a file can and cannot determine.
#
# The file contains the noisy reactions at the bases of two coupled whiskers. Which
# stiffnesses do the springs have, how accurate are they, and which parameters cannot be
# identified? The file is `examples/measured.csv`. The script `make_measured.py` in the
# same folder simulated it, so the true values are known. Everything is dimensionless:
# lengths in L, forces in EI/L², moments in EI/L, stiffnesses in EI/L³. The notebook
# takes one to two minutes.

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
# There is one row per step, with the position of the drive and fx, fy, mz of both
# whiskers.

# %%
ax = data.plot("control", ["mz_1", "mz_2"], xlabel="$u/L$", ylabel=r"$m_z\,L/EI$")

# %% [markdown]
# The moments. The drive moves from right to left; whisker 1 touches first and whisker 2
# follows. When whisker 1 snaps off, at -1.3, the moment of whisker 2 jumps a little,
# because springs couple the whiskers.
#
# ## The fit
#
# A function builds the scene from the unknown parameters: the springs drive-base 1,
# base 1-base 2 and drive-base 2, and the distance of the object. Arguments with a
# default are known. The guess may be wrong by a factor of two or three.


# %%
def build(c1, c2, c3, q, rest=0.2, position=0.0):
    support = jw.Support.fbfbr((c1, c2, c3), rest_length=(rest, 0.2, rest + 0.2))
    return jw.Scene(
        jw.Whisker(), jw.Parabola(q, position=position), support, rod=jw.ClosedForm()
    )


fit = jw.identify(build, guess=dict(c1=100.0, c2=50.0, c3=90.0, q=0.25), measured=FILE)
print(fit)

# %% [markdown]
# No noise was given, so it is estimated from the residuals. The true values, 60, 80, 70
# and 0.3, are within two or three standard errors:

# %%
truth = dict(c1=60.0, c2=80.0, c3=70.0, q=0.3)
deviation = {
    name: (fit.estimates[name] - truth[name]) / fit.standard_error[name]
    for name in truth
}
print(
    "estimate minus truth, in standard errors:",
    {name: round(value, 2) for name, value in deviation.items()},
)
assert fit.status == jw.FitStatus.ok
assert max(map(abs, deviation.values())) < 3

# %%
axs = jw.plot.fit(fit)

# %% [markdown]
# Dots are measured, lines are fitted. A snap contributes through its position, because
# the size of signals on the wrong side of it contains no information.
#
# Does noise explain the residuals on the right? If so, they look like noise everywhere,
# including near the snaps.

# %%
print(
    f"standard deviation: {np.nanstd(fit.residuals[:, :, 2]):.4f};",
    "the noise was 0.045",
)

# %% [markdown]
# ## How accurate is the result?
#
# Standard errors assume that the misfit is a parabola. The profile likelihood does not:
# for each value of one parameter it fits all others again.

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
    "95 % interval from the profile:",
    np.round(profile.interval, 2),
    "from standard errors:",
    np.round(fit.interval["c2"], 2),
)

# %% [markdown]
# Both agree: with 441 samples the parabola is accurate enough. (The notebook
# `posterior` shows a case in which it is not.)
#
# ## Information in the signals
#
# The Fisher information shows before an experiment what it can determine: how
# accurately, from which channel, and where along the scan. Here there are two more
# parameters, the rest length of the first spring and the position of the object along
# x. Both are known at first.

# %%
noise = dict(fx=0.05, fy=0.1, mz=0.045)
everything = jw.information(
    build,
    at=truth | dict(rest=0.2, position=0.0),
    sigma=noise,
    control=data.control.to_numpy(),
)
known = everything.known("rest", "position")
print(known)
ax = jw.plot.information(known)

# %% [markdown]
# Signals contain most information where a line is steep; grey lines are events. The
# peaks determine the distance. The springs are determined on the way to the peaks,
# where they are loaded, and just before whiskers snap off. The spring between the
# whiskers, c2, has the largest error, and most information about it comes from there.
#
# ## Parameters that are not identifiable
#
# What if these two parameters are unknown?

# %%
print(everything)

# %% [markdown]
# A longer rest length and an object shifted to the right by the same length change no
# signal: one of the two has to be measured in another way. A fit reports the same,
# gives neither a standard error, and continues. Forces in units of EI/L² cannot
# determine EI either; forces in newtons can.

# %%
assert everything.rank == 5
assert {
    name for name, error in everything.standard_error.items() if np.isnan(error)
} == {"rest", "position"}
assert all(
    np.isclose(known.standard_error[name], fit.standard_error[name], rtol=0.3)
    for name in truth
)

# %% [markdown]
# ## Something to try
#
# - Use only the moments: `measured=data[["control", "mz_1", "mz_2"]]`. How much
#   accuracy is lost?
# - Use only whisker 1, `["control", "fx_1", "fy_1", "mz_1"]`. Is c2 still identifiable?
# - Use a wrong model, `jw.Support.fbfb((c1, c2))`. How does the fit show that it is
#   wrong?
