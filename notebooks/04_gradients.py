# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # Gradients, and their meaning at a fold
#
# After this notebook you can differentiate any result of a scan with respect to any
# number of the scene, and you know which derivatives to use near a snap.
#
# Every result has exact derivatives with respect to every input. This notebook computes
# some of them, compares them with finite differences, and examines the one place where
# a derivative can mislead: next to a snap. There the derivative of the signal grows
# without bound, while that of the snap position stays smooth. This matters when a
# stiffness is identified from signals.
#
# Everything is dimensionless: lengths in L, forces in EI/L², moments in EI/L,
# stiffnesses in EI/L³. The notebook takes one to two minutes, mostly for compilation.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw


def build(stiffness, distance):
    return jw.Scene(
        jw.Whisker(),
        jw.Parabola(distance),
        jw.Support.fb(stiffness, 0.2),
        rod=jw.ClosedForm(),
    )


# %% [markdown]
# ## Forward mode
#
# One whisker on a spring has two results here: the moment along the scan, and the
# position of the snap-off. The positions of the drive are denser towards the snap-off.

# %%
scene = build(70.0, 0.2)
snap_off = jw.scan(scene).events[-1].control
remaining = np.geomspace(0.3, 1e-8, 150)  # remaining distance to the snap-off
along = jnp.asarray(
    np.sort(np.concatenate([np.linspace(0.75, -1.45, 441), snap_off + remaining]))[::-1]
)


def moment_and_snap_off(scene):
    result = jw.scan(scene, along)
    return result.mz[:, 0], result.events.control[result.events.count - 1]


at = jnp.array([70.0, 0.2])  # stiffness, distance
slopes = jax.jit(jax.jacfwd(lambda x: moment_and_snap_off(build(*x))))
by_moment, by_snap_off = slopes(at)
moment, _ = moment_and_snap_off(scene)
by_peak = by_moment[moment.argmax()]
print("derivatives by:  stiffness, distance")
print("largest moment:", np.round(by_peak, 5))
print("snap-off:      ", np.round(by_snap_off, 5))

# %% [markdown]
# The distance changes the peak, by -31 per unit of length; the stiffness does not
# change it. Both move the snap-off.
#
# ## Reverse mode and finite differences
#
# Reverse mode, `jax.grad`, suits many inputs: one pass computes the derivatives with
# respect to all numbers of the scene, and returns them as a scene. Both modes agree
# with each other and with the difference of two scans.

# %%
backward = jax.jit(jax.grad(lambda scene: moment_and_snap_off(scene)[1]))(scene)
print("by stiffness:  ", backward.support.springs[0].stiffness)
print("by rest length:", backward.support.springs[0].rest_length)
print("by distance:   ", backward.profile.distance)
print("by length L:   ", backward.whisker.length)

step = 1e-2
softer, stiffer = (moment_and_snap_off(build(70.0 + h, 0.2)) for h in (-step, step))
print("by stiffness, finite differences:", (stiffer[1] - softer[1]) / (2 * step))
assert np.isclose(by_snap_off[0], backward.support.springs[0].stiffness, rtol=1e-8)
assert np.isclose(by_snap_off[1], backward.profile.distance, rtol=1e-8)
assert np.isclose(by_snap_off[0], (stiffer[1] - softer[1]) / (2 * step), rtol=1e-4)
assert np.isclose(backward.support.springs[0].rest_length, -1.0)

# %% [markdown]
# (A longer rest length moves the whole signal of a single whisker by the same length.)
#
# ## Next to the fold

# %%
left = np.asarray(along) - snap_off
near = (left > 0) & (left < 0.3)
figure, (whole, beside) = pyplot.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
whole.plot(along, by_moment[:, 0])
whole.set(xlabel="$u/L$", ylabel=r"$\partial m_z/\partial c$", ylim=(-0.01, 0.04))
beside.loglog(
    left[near],
    np.abs(by_moment[near, 0]),
    label=r"$|\partial m_z/\partial c|$ at fixed $u$",
)
beside.axhline(
    abs(by_snap_off[0]),
    color="C1",
    label=r"$|\partial u_s/\partial c|$ of the snap-off",
)
beside.set(xlabel="distance to the snap-off, $(u - u_s)/L$")
beside.legend(frameon=False)
last = np.log(left[near])[-100:], np.log(by_moment[near, 0])[-100:]
exponent, _ = np.polyfit(*last, 1)
print(f"exponent next to the snap-off: {exponent:.3f}")
assert abs(exponent + 0.5) < 0.02

# %% [markdown]
# Left: the derivative of the moment with respect to the stiffness along the scan. A
# stiffer spring shifts the signal but keeps its height, so the derivative is zero at
# the peak and at the vertex. Right: towards the snap-off this derivative grows with the
# inverse square root of the remaining distance, while the position of the snap-off has
# a single finite derivative.
#
# This is not a numerical error. A snap-off is a fold: a stable and an unstable
# equilibrium meet there and vanish. Next to it, the base moves with the square root of
# the remaining distance. So does the signal at a fixed drive position when the
# stiffness moves the fold.
#
# ## Consequences for a fit
#
# Suppose the moment was measured at 441 positions with a stiffness of 70. Compare it
# with models of other stiffnesses. Left: the usual misfit, the sum of squared
# differences of the moments. Right: the distance between the snap-offs of model and
# measurement.

# %%
control = np.linspace(0.75, -1.45, 441)
measured = jw.scan(scene, control)
stiffness = np.linspace(55.0, 85.0, 121)
scans = [jw.scan(build(c, 0.2), control) for c in stiffness]
misfit = np.array([np.sum((scan.mz - measured.mz) ** 2) for scan in scans])
moved = np.array([scan.events[-1].control - snap_off for scan in scans])

figure, (usual, position) = pyplot.subplots(
    1, 2, figsize=(9, 3.4), layout="constrained"
)
usual.plot(stiffness, misfit, ".-", markersize=3)
usual.set(xlabel="$c$ of the model", ylabel=r"$\sum (m_z - m_z^{70})^2$")
position.plot(stiffness, moved)
position.set(xlabel="$c$ of the model", ylabel="$(u_s - u_s^{70})/L$")
steps, close = np.abs(np.diff(misfit)) > 1.0, np.abs(stiffness - 70.0) < 2.0
print(f"{steps.sum()} steps of the misfit")
assert steps.sum() >= 4
assert np.allclose(moved[close], by_snap_off[0] * (stiffness[close] - 70.0), atol=1e-4)

# %% [markdown]
# The misfit has steps: whenever the snap-off of the model passes a drive position, one
# sample changes between free and in contact. Between the steps its derivative is exact
# but contains no information about them. The position of the snap-off is smooth.
# Therefore `jw.identify` leaves out the samples between the two snaps and the last one
# before them, and compares the positions of the snaps instead.
#
# ## Information about the stiffness
#
# The standard error of a stiffness is the error of a measured value divided by its
# derivative. Suppose moments have an error of 0.065, 1 % of the peak, and the snap-off
# lies anywhere between two samples at distance h, which corresponds to a standard error
# of h / √12.

# %%
for h in (0.005, 0.0005):
    steps = np.arange(0.75, snap_off + h, -h)
    rates = np.interp(-steps, -np.asarray(along), by_moment[:, 0])
    by_moments = 0.065 / np.sqrt(np.sum(rates**2))
    by_position = h / np.sqrt(12) / abs(by_snap_off[0])
    print(
        f"h = {h} L: from all moments +- {by_moments:.2f} EI/L³,",
        f"from the snap-off alone +- {by_position:.2f} EI/L³",
    )
assert by_position < by_moments

# %% [markdown]
# With a finer scan, the error from the moments decreases with the square root of the
# step, and that from the snap-off in proportion to it. In the end a single position
# contains more information than a whole signal. It also needs no calibration, because a
# wrong gain of the sensor does not move it. The peak contains no information about the
# stiffness.
#
# ## Something to try
#
# - Which stiffness moves the snap-off most? Differentiate at `build(30.0, 0.2)`, near
#   the critical stiffness, and at `build(300.0, 0.2)`.
# - The derivative of the vertex position with respect to the stiffness is zero. Why?
#   (`result.events.of(jw.EventKind.vertex)`)
# - Compute `jax.jacfwd(jax.jacfwd(...))` of the snap-off: the curve on the right is not
#   quite straight.
