# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # When is statics enough?
#
# After this notebook you can tell whether a quasi-static scan describes your
# experiment, and what inertia and damping change if it does not.
#
# It compares `jw.scan` with `jw.simulate`: for a steel wire that sweeps across a
# parabola at 0.25 m/s, over a range of speeds, and for a whisker of a rat that whisks at
# 2 to 20 Hz. The page docs/numerics_statics.md has the complete results. The notebook
# takes one to two minutes.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw

# %% [markdown]
# ## A wire at 0.25 m/s
#
# The wire is 100 mm long and 0.5 mm thick. Lengths are in L and times in T, so that all
# wires share one scene. T follows from the first frequency of the clamped wire,
# omega = 3.516 / T.

# %%
wire = jw.Whisker.from_material(0.1, 210e9, 0.5e-3, density=7850.0)
frequency = float(jw.modes(wire, 1).frequency[0])
unit = 3.51601527 / (2 * np.pi * frequency)
speed = 0.25 / (0.1 / unit)
print(f"f1 = {frequency:.1f} Hz, T = {1e3 * unit:.2f} ms, 0.25 m/s = {speed:.4f} L/T")

scene = jw.Scene(
    jw.Whisker(mass_per_length=1.0), jw.Parabola(0.2), jw.Support.fb(stiffness=70.0)
)
start, stop, samples = 0.8, -1.9, 2000
control = np.linspace(start, stop, samples + 1)
statics = jw.scan(scene, control)
touch = statics.events.of(jw.EventKind.touch)[0].control
fold = statics.events.of(jw.EventKind.snap_off)[0].control
peak = float(statics.mz.max())


@jax.vmap
def sweep(speed, damping):
    """Moment at the base, and the phase of the contact, for the same drive positions."""
    motion = jw.simulate(
        scene,
        jnp.array([start, stop]),
        (start - stop) / speed,
        steps=8 * samples,
        every=8,
        stiffness_damping=damping,
    )
    return motion.mz[:, 0], motion.phase[:, 0]


# %% [markdown]
# One batch contains everything that follows: three dampings at 0.25 m/s, and six
# speeds. The damping is the time constant of a Kelvin-Voigt material.

# %%
dampings, speeds = [0.005, 0.02, 0.3], np.geomspace(0.01, 0.32, 6)
mz, phase = sweep(
    jnp.concatenate([jnp.full(3, speed), speeds]),
    jnp.concatenate([jnp.array(dampings), jnp.full(6, 0.02)]),
)
figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
difference = 100 * (mz - statics.mz[:, 0]) / peak
for k, damping in enumerate(dampings):
    left.plot(control, difference[k], linewidth=0.9, label=f"damping {damping:g} T")
    right.plot(control, mz[k], linewidth=0.9)
right.plot(control, statics.mz[:, 0], "k--", linewidth=1, label="scan")
left.set(
    xlim=(0.72, 0.58), ylim=(-0.6, 0.9), xlabel="u", ylabel="mz - scan, % of the peak"
)
right.set(xlim=(-1.25, -1.65), ylim=(-3, 3), xlabel="u", ylabel="mz")
left.legend()
_ = right.legend()

# %% [markdown]
# Left: the touch adds a vibration of a few thousandths of the peak. Right: at the
# snap-off the difference is as large as the signal. The contact is lost late, the moment
# falls gradually, and the free whisker rings down.
#
# Which vibration does the touch excite? Just before, every point of the whisker moves
# with the drive. Statics prescribe other velocities right after. Their difference is
# the initial velocity of the modes of the touching whisker.

# %%
h = 1e-4
near = jw.scan(scene, touch - h * np.array([1.0, 2.0]))
modes = jw.modes(near, 4, step=0, points=101)
lines = jw.shapes(near, points=101)
rate = (
    np.stack([np.diff(lines.x, axis=0)[0, 0], np.diff(lines.y, axis=0)[0, 0]], -1) / h
)
velocity = np.array([-1.0, 0.0]) - rate
momentum = np.trapezoid((modes.shape[:, 0] * velocity).sum(-1), dx=0.01, axis=1)
amplitude = np.abs(speed * momentum * modes.mz[:, 0] / modes.omega)
for omega, a in zip(modes.omega, amplitude, strict=True):
    print(f"omega {omega:6.2f} / T, {omega / (2 * np.pi * unit):6.0f} Hz: mz {a:.4f}")

since = (touch - control) / speed
window = (since > 0.3) & (since < 3.0)
y = np.asarray(mz[0] - statics.mz[:, 0])[window]
y = y - np.polyval(np.polyfit(since[window], y, 2), since[window])
(zeros,) = np.nonzero(np.diff(np.sign(y)))
observed = np.pi * (len(zeros) - 1) / np.ptp(since[window][zeros])
decay = dampings[0] * modes.omega[0] ** 2 / 2
envelope = np.sqrt(np.mean(np.exp(-2 * decay * since[window])))
seen = np.sqrt(2) * y.std() / envelope
print(f"simulated: omega {observed:.2f}, mz {seen:.4f} without its decay")

# %% [markdown]
# The noise after a touch is the first mode of the touching whisker, with the amplitude
# that its change of velocity predicts.
#
# ## How slow is quasi-static?

# %%
before = control > -1.2
rms = np.sqrt(np.mean((difference[3:, before] / 100) ** 2, axis=1))
lost = [
    fold - control[(control < fold) & (np.asarray(row) == jw.Phase.free)][0]
    for row in phase[3:]
]
figure, ax = pyplot.subplots(figsize=(6, 3.6), layout="constrained")
ax.loglog(speeds, rms, "o-", label="rms error of mz before the snap-off")
ax.loglog(speeds, lost, "s-", label="delay of the snap-off, L")
ax.loglog(speeds, 0.7 * 0.02 * speeds + 0.1 * speeds**2, "k:", label="rule of thumb")
ax.loglog(speeds, 0.3 * speeds ** (2 / 3), "k--", label="0.3 (v T / L)^(2/3)")
ax.set(xlabel="speed, L/T")
ax.legend()
for v, error, delay in zip(speeds, rms, lost, strict=True):
    print(
        f"{v:.3f} L/T = {0.1 * v / unit:.3f} m/s: error {error:.1e}, {delay:.3f} L late"
    )

# %% [markdown]
# The error of the signal grows with the speed times the damping, and in fast sweeps with
# the square of the speed. It stays below one per cent up to more than 1 m/s. The delay
# of the snap-off grows more slowly, with speed^(2/3), and is one per cent of the length
# at a few centimetres per second.
#
# ## A whisking rat
#
# Whisker C2, rotated about its base by 10 degrees to both sides. Its damping ratio is
# 0.14, in the middle of the published range.

# %%
rat = jw.Whisker.rat("C", 2, density=1300.0)
first = float(jw.modes(rat, 3).frequency[0])
sensor = jw.Sensor(rat, motion=jw.Rotation())
frequencies = jnp.array([2.0, 5.0, 10.0, 20.0])
tau = 0.14 / (np.pi * first)


@jax.vmap
def whisk(f):
    """Amplitude of the moment at the base in the fourth cycle."""
    drive = jw.Whisking(np.deg2rad(10.0), f, phase=-jnp.pi / 2)
    motion = jw.simulate(
        sensor, drive, 4 / f, steps=3200, every=8, stiffness_damping=tau
    )
    turn = jnp.exp(-2j * jnp.pi * f * motion.time[-100:])
    return jnp.abs(2 * jnp.mean(motion.mz[-100:, 0] * turn))


moments = whisk(frequencies)
for f, moment in zip(frequencies, moments, strict=True):
    print(f"{f:4.0f} Hz, (f/f1)^2 = {(f / first) ** 2:.4f}: {1e9 * moment:6.2f} nN m")

# %% [markdown]
# Statics have no moment in air. The inertial moment grows with the square of the
# frequency.
#
# ## Damping
#
# Damping proportional to stiffness makes the ratio grow with the frequency, and damping
# proportional to mass makes it fall. Published first resonances of rats' whiskers (27 to
# 260 Hz, Hartmann et al. 2003) have ratios of 0.11 to 0.17. A sum of both can have that
# at all frequencies:

# %%
law = {"mass_damping": 55.0, "stiffness_damping": 0.198e-3}
for place in (("A", 0), ("C", 2), ("C", 4)):
    whisker = jw.Whisker.rat(*place, density=1300.0)
    found = jw.modes(whisker, 2, **law)
    print(place, "Hz:", np.round(found.frequency, 0), np.round(found.damping_ratio, 3))

# %% [markdown]
# A ring-down has the damping ratio that `modes` predicts. It follows from the decrease of
# the swings of the tip, after the second mode has died out.

# %%
bent = jw.deflect(rat, jw.PointForce(1e-6, position=0.5 * rat.length))
free = jw.simulate(jw.Sensor(rat), 0.0, 0.12, start=bent, steps=6000, **law)
tip = np.asarray(free.tip_x[:, 0])
(zeros,) = np.nonzero(np.diff(np.sign(tip)))
swings = [np.abs(part).max() for part in np.split(tip, zeros)]
decrement = np.log(swings[5] / swings[11]) / (6 * np.pi)
ratio = decrement / np.sqrt(1 + decrement**2)
predicted = float(jw.modes(rat, 3, **law).damping_ratio[0])
print(f"damping ratio: ring-down {ratio:.4f}, modes {predicted:.4f}")

# %%
assert abs(observed / float(modes.omega[0]) - 1) < 0.03
assert abs(seen / amplitude[0] - 1) < 0.15
assert np.all(np.diff(rms) > 0) and rms[0] < 1e-3
assert 1.9 < np.log(moments[1] / moments[0]) / np.log(2.5) < 2.1
assert abs(ratio / predicted - 1) < 0.05

# %% [markdown]
# ## Something to try
#
# - Your own wire: which speed gives an error of one per cent?
# - Let the whisker of the rat touch a `Circle` in each cycle. Compare with a scan over
#   the same angles. How does the error grow with the frequency?
# - Damp the wire strongly, with `stiffness_damping` of 1 T. What does the snap-off look
#   like now?
