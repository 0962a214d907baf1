# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # A scan in space
#
# After this notebook you can scan an object in three dimensions: from a wire and a ball
# to six signals, pictures, a tactile image, and back from the signals to the ball. The
# notebook takes less than two minutes, most of it for compilation.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw

RADIUS, HEIGHT = 0.04, 0.06  # of the ball, m
wire = jw.Whisker.from_material(length=0.05, youngs_modulus=2.1e11, diameter=2e-4)
ball = jw.Sphere(RADIUS, (0.0, HEIGHT, 0.0))


def build(surface, offset):
    """The wire on a drive that passes below an object at a lateral offset."""
    drive = jw.LinearDrive(direction=(1.0, 0.0, 0.0), origin=(0.0, 0.0, offset))
    return jw.SpaceScene(wire, surface, motion=drive)


# %% [markdown]
# The drive moves along $x$, the wire stands upright along $y$, and the ball is above. At
# an offset of 10 mm along $z$, the wire passes beside the middle of the ball.

# %%
OFFSET = 0.01
result = jw.scan(build(ball, OFFSET))
print(result)

# %% [markdown]
# ## Six signals
#
# The support feels three forces and three moments.

# %%
jw.plot.reactions(result)
# %% [markdown]
# The moment about the wire's own axis, $m_y$, vanishes: the force of the ball bends a
# straight round wire, but does not twist it. Without friction, this force points along
# the normal of the ball, and it pushes the wire aside.

# %%
touching = np.asarray(result.phase[:, 0]) > 0
force, moment = (
    np.asarray(reaction)[touching, 0] for reaction in (result.force, result.moment)
)
contact = np.stack(
    [np.asarray(getattr(result, f"contact_{axis}"))[touching, 0] for axis in "xyz"],
    axis=1,
)
outwards = (contact - np.array([0.0, HEIGHT, 0.0])) / RADIUS
largest = np.abs(force).max()
assert np.abs(moment[:, 1]).max() < 1e-6 * np.abs(moment).max()
assert np.allclose(np.cross(force, outwards), 0.0, atol=1e-6 * largest)

# %% [markdown]
# ## Pictures
#
# A camera shows the wire, the directors of its base and the contact force. The dotted
# line is the way of the contact. What the ball hides is paler.

# %%
PLACES = [-0.03, -0.015, 0.01]  # of the drive, m
jw.plot.shapes(result, PLACES)
jw.plot.shapes(result, PLACES, view="xz")
# %% [markdown]
# The second figure shows the same from below: the wire bends away from the middle of the
# ball. With sliders, and turned by the mouse, the scene is
# `jw.explore(lambda offset: build(ball, offset), offset=(0.002, 0.03))`.
#
# ## The offset changes the signals
#
# Closer to the middle of the ball, the wire bends more, and swings aside later.

# %%
figure, axes = pyplot.subplots(1, 2, figsize=(8, 2.8), layout="constrained")
offsets = [0.02, 0.01, 0.005, 0.002]
scans = {offset: jw.scan(build(ball, offset)) for offset in offsets}
for offset, one in scans.items():
    label = f"{1e3 * offset:.0f} mm"
    axes[0].plot(1e3 * one.control, 1e3 * one.fy[:, 0], label=label)
    z = np.where(one.phase[:, 0] > 0, 1e3 * one.contact_z[:, 0], np.nan)
    axes[1].plot(1e3 * one.control, z, label=label)
axes[0].set(xlabel="drive $u$ (mm)", ylabel="$f_y$ (mN)")
axes[1].set(xlabel="drive $u$ (mm)", ylabel="contact $z$ (mm)")
axes[1].legend(title="offset")
peaks = [float(one.fy.max()) for one in scans.values()]
assert peaks == sorted(peaks)

# %% [markdown]
# ## A plane scan is not stable
#
# At an offset of exactly 0, wire and ball are symmetric, and the wire stays in the plane
# at first. When the drive is below the middle of the ball, the wire may swing to either
# side, and nothing tells to which. Here the scan ends. The slightest offset decides.

# %%
symmetric = jw.scan(build(ball, 0.0))
print(symmetric)
*_, last = symmetric.events
assert last.kind == jw.EventKind.bifurcation
assert abs(last.control) < 0.02

# %%
figure, ax = pyplot.subplots(figsize=(6.5, 3), layout="constrained")
for offset in (1e-3, 1e-4, 1e-5, 0.0, -1e-5, -1e-4, -1e-3):
    one = jw.scan(build(ball, offset))
    touches = one.phase[:, 0] > 0
    x, z = 1e3 * one.contact_x[touches, 0], 1e3 * one.contact_z[touches, 0]
    style = {"color": "black", "linewidth": 2.5} if offset == 0.0 else {}
    ax.plot(x, z, label=f"{1e6 * offset:.0f} µm", **style)
ax.set(xlabel="contact $x$ (mm)", ylabel="contact $z$ (mm)")
ax.legend(title="offset", loc="center left", bbox_to_anchor=(1.02, 0.5))
# %% [markdown]
# ## A tactile image
#
# Scans along parallel lines give an image for each signal, here of an oblique ellipsoid.

# %%
straight = jw.Ellipsoid((0.04, 0.02, 0.025), (0.0, 0.045, 0.0))
stone = straight.rotated((0.0, 0.5, 0.0))
image = jw.tactile_image(
    lambda offset: build(stone, offset),
    offset=np.linspace(-0.024, 0.024, 9),
    control=np.linspace(-0.05, 0.05, 61),
)
print(image.attrs["points"])
jw.plot.tactile_image(image)
# %% [markdown]
# ## Back from the signals to the ball
#
# Six signals determine the contact: where it is, and the force there. With noise of 1 %
# of the peaks, points come with their uncertainty.

# %%
rng = np.random.default_rng(0)
NAMES = ("fx", "fy", "fz", "mx", "my", "mz")


def reconstructed(offset):
    """Points from the noisy signals of one scan."""
    scanned = jw.scan(build(ball, offset), np.linspace(-0.036, 0.036, 121))
    sigma = {
        name: 0.01
        * float(abs(scanned.force if name[0] == "f" else scanned.moment).max())
        for name in NAMES
    }
    noisy = {
        name: getattr(scanned, name) + sigma[name] * rng.standard_normal((121, 1))
        for name in NAMES
    }
    signals = {"control": scanned.control} | noisy
    return jw.reconstruct(signals, build(ball, offset), sigma=sigma)


sweeps = [reconstructed(offset) for offset in (-0.012, 0.006, 0.02)]
print(sweeps[0])

# %% [markdown]
# The object of the scene that `reconstruct` takes is ignored. All points together, and
# the directions of the forces, are those of a ball, whose radius and place were unknown.

# %%
fit = jw.fit_contour(sweeps, family=jw.Sphere)
for name, value in fit.estimates.items():
    print(f"{name}: {1e3 * value:.2f} ± {1e3 * fit.standard_error[name]:.2f} mm")
assert fit.status == jw.FitStatus.ok
assert abs(fit.estimates["radius"] - RADIUS) < 4 * fit.standard_error["radius"]

# %%
figure, ax = pyplot.subplots(figsize=(5, 4), layout="constrained")
for points in sweeps:
    x, y = 1e3 * points.x[points.clear], 1e3 * points.y[points.clear]
    z = 1e3 * points.z[points.clear]
    seen = ax.scatter(x, z, c=y, s=8, vmin=30, vmax=52)
ax.set(xlabel="$x$ (mm)", ylabel="$z$ (mm)", aspect="equal")
figure.colorbar(seen, label="height $y$ (mm)")
# %% [markdown]
# ## Something to try
#
# - Let the wire rub: `jw.SpaceScene(wire, ball, motion=drive, friction=0.3)`. How far does it
#   stay in the plane at an offset of 0?
# - Put the wire on springs: `jw.Support.follicle(x=40.0, z=20.0)`. How does $f_z$ change?
# - Scan a cylinder: `jw.Cylinder(0.04, (0.0, 0.06, 0.0), (0.3, 0.0, 1.0))`. Where does the
#   wire slide?
