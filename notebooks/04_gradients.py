# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # Gradients, and what they mean at a fold
#
# Every number that a scan returns has exact derivatives by every number that goes in. This notebook takes some, checks
# them by differences, and looks at the one place where a derivative can mislead: beside a snap. There the signal's
# derivative grows without bound, while that of the snap's position stays smooth, which matters when a stiffness is to
# be found from signals. Everything is dimensionless: lengths in L, forces in EI/L², moments in EI/L, stiffnesses in
# EI/L³. A minute or two, most of it for the compiler.

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
# ## Forwards
#
# One whisker on a spring, and two things to look at: the moment along the scan, and where the whisker snaps off. The
# positions of the drive are denser towards the snap-off.

# %%
scene = build(70.0, 0.2)
snap_off = jw.scan(scene).events[-1].control
way = np.geomspace(0.3, 1e-8, 150)  # that is left to the snap-off
along = jnp.asarray(
    np.sort(np.concatenate([np.linspace(0.75, -1.45, 441), snap_off + way]))[::-1]
)


def moment_and_snap_off(scene):
    result = jw.scan(scene, along)
    return result.mz[:, 0], result.events.control[result.events.count - 1]


at = jnp.array([70.0, 0.2])  # stiffness, distance
slopes = jax.jit(jax.jacfwd(lambda x: moment_and_snap_off(build(*x))))
by_moment, by_snap_off = slopes(at)
moment, _ = moment_and_snap_off(scene)
by_peak = by_moment[moment.argmax()]
print("                by stiffness, by distance")
print("largest moment:", np.round(by_peak, 5))
print("snap-off:      ", np.round(by_snap_off, 5))

# %% [markdown]
# The distance changes the peak, by -31 a length; the stiffness does not. Both move the snap-off.
#
# ## Backwards, and by differences
#
# Reverse mode, `jax.grad`, is for many inputs: one pass gives the derivative by every number of the scene, as a scene
# that holds them. Both modes agree, and so do differences of two scans.

# %%
backward = jax.jit(jax.grad(lambda scene: moment_and_snap_off(scene)[1]))(scene)
print("by stiffness:  ", backward.support.springs[0].stiffness)
print("by rest length:", backward.support.springs[0].rest_length)
print("by distance:   ", backward.profile.distance)
print("by length L:   ", backward.whisker.length)

step = 1e-2
softer, stiffer = (moment_and_snap_off(build(70.0 + h, 0.2)) for h in (-step, step))
print("by stiffness, from differences:", (stiffer[1] - softer[1]) / (2 * step))
assert np.isclose(by_snap_off[0], backward.support.springs[0].stiffness, rtol=1e-8)
assert np.isclose(by_snap_off[1], backward.profile.distance, rtol=1e-8)
assert np.isclose(by_snap_off[0], (stiffer[1] - softer[1]) / (2 * step), rtol=1e-4)
assert np.isclose(backward.support.springs[0].rest_length, -1.0)

# %% [markdown]
# (A longer rest length moves the whole signal of a single whisker, by as much.)
#
# ## Beside the fold

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
beside.set(xlabel="$(u - u_s)/L$, way to the snap-off")
beside.legend(frameon=False)
last = np.log(left[near])[-100:], np.log(by_moment[near, 0])[-100:]
exponent, _ = np.polyfit(*last, 1)
print(f"exponent beside the snap-off: {exponent:.3f}")
assert abs(exponent + 0.5) < 0.02

# %% [markdown]
# Left: the derivative of the moment by the stiffness along the scan. A stiffer spring shifts the signal to and fro and
# keeps its height, so the derivative is zero at the peak and at the vertex. Right: towards the snap-off it grows with
# the inverse square root of the way that is left, while the position of the snap-off has one finite derivative.
#
# It is no fault of the numerics. A snap-off is a fold: two equilibria, a stable and an unstable one, meet there and
# vanish. Beside it the base moves with the square root of the way that is left; so does the signal at a fixed position
# of the drive when the stiffness moves the fold.
#
# ## What that means for a fit
#
# Suppose the moment was measured at 441 positions with a stiffness of 70, and take other stiffnesses for the model.
# Left is the usual misfit: the sum of squares of what the moments differ by. Right is how far the snap-off is from the
# measured one.

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
# The misfit has steps: whenever the model's snap-off passes a position of the drive, one sample changes between free
# and in contact. Between the steps its derivative is exact, and knows nothing of them. The position of the snap-off is
# smooth. `jw.identify` therefore leaves out the samples between the two snaps, and the last one before them, and
# compares the positions of the snaps in their place.
#
# ## What tells the stiffness
#
# The standard error of a stiffness is that of a measured value over its derivative. Say moments have an error of 0.065,
# 1 % of the peak, and the snap-off lies anywhere between two samples, h apart: an error of h over the square root of
# 12.

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
# A finer scan makes the error of the moments smaller with the square root of the step, that of the snap-off in
# proportion to it: in the end a single position knows more than a whole signal. It also needs no calibration, as a
# wrong gain of the sensor does not move it. The peak knows nothing of the stiffness at all.
#
# ## Something to try
#
# - Which stiffness moves the snap-off most? Differentiate at `build(30.0, 0.2)`, near the critical stiffness, and at
#   `build(300.0, 0.2)`.
# - The derivative of the vertex's position by the stiffness is zero. Why? (`result.events.of(jw.EventKind.vertex)`)
# - `jax.jacfwd(jax.jacfwd(...))` of the snap-off: the curve on the right is not quite straight.
