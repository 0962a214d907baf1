# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # A rat's whiskers
#
# After this notebook you can let a whole array of whiskers whisk against an object, and
# tell which whiskers touch it, when, with which forces, and how well their signals tell
# where the object is. The notebook takes four minutes, most of it for compilation.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw

rat = jw.Array.rat(["right"])
print(rat)

# %% [markdown]
# The rat looks along $-x$, $z$ points upwards, and its right side is at $+y$. Every
# whisker is a cone with the shape of a parabola. It turns about its own base point, and
# its elevation and roll change as it protracts.

# %%
lengths = 1e3 * np.array([whisker.length for whisker in rat.whiskers])
figure, ax = pyplot.subplots(figsize=(8, 2.5), layout="constrained")
ax.bar(rat.names, lengths)
ax.tick_params(axis="x", rotation=90)
ax.set_ylabel("length (mm)")
# %% [markdown]
# ## Whisking against a peg
#
# A vertical peg stands beside the snout. The control is the angle by which all whiskers
# protract from rest.

# %%
RADIUS = 5e-3


def peg(x, y):
    return jw.Cylinder(RADIUS, (x, y, 0.0), (0.0, 0.0, 1.0))


control = np.linspace(0.0, 1.0, 101)
data = rat.scan(peg(-0.025, 0.025), control)
touching = (data.phase > 0).any("control")
print(data.attrs["points"])
print("whiskers that touch:", *data.whisker[touching].values)
assert {"RC3", "RD3", "RE3"} <= set(data.whisker[touching].values)

# %% [markdown]
# Where a tip is curved more than the peg, one contact point becomes two, and the scan of
# this whisker ends with the status `not_convex`. All other whiskers go on.

# %%
figure, axes = pyplot.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
for name in data.whisker[touching].values:
    one = data.sel(whisker=name)
    force = np.sqrt(one.fx**2 + one.fy**2 + one.fz**2)
    moment = np.sqrt(one.mx**2 + one.my**2 + one.mz**2)
    axes[0].plot(np.degrees(control), 1e6 * force, label=name)
    axes[1].plot(np.degrees(control), 1e9 * moment)
axes[0].set_ylabel("force (µN)")
axes[0].legend(ncols=4, fontsize=8)
axes[1].set(xlabel="protraction from rest (degrees)", ylabel="moment (nN m)")
# %% [markdown]
# ## Which whiskers tell where the peg is?
#
# The moments at the base change with the place of the peg. Derivatives come with every
# scan: here by the place $(x, y)$ of the peg, for three whiskers of one row.

# %%
chosen = ["RC2", "RD2", "RE2"]
scenes = [rat.scene(name, peg(-0.025, 0.025)) for name in chosen]
row = jax.tree.map(
    lambda *leaves: jnp.stack([jnp.asarray(leaf, dtype=float) for leaf in leaves]),
    *scenes,
)


def moments(place, scene):
    """Moments of one whisker, (steps, 3), with the peg at a place."""
    moved = scene.surface.moved((place[0], place[1], 0.0))
    scene = jw.SpaceScene(scene.whisker, moved, scene.support, motion=scene.motion)
    return jw.scan(scene, control[::2]).moment[:, 0]


slopes = jax.vmap(lambda scene: jax.jacfwd(moments)(jnp.zeros(2), scene))(row)
figure, axes = pyplot.subplots(
    1, 2, figsize=(8, 2.8), sharey=True, layout="constrained"
)
for axis, k, name in zip(axes, (0, 1), "xy", strict=True):
    for whisker, slope in zip(chosen, slopes, strict=True):
        size = np.linalg.norm(slope[:, :, k], axis=1)
        axis.plot(np.degrees(control[::2]), 1e6 * size, label=whisker)
    axis.set(xlabel="protraction (degrees)", title=f"by the peg's {name}")
axes[0].set_ylabel("change of the moment (nN m / mm)")
axes[0].legend()
# %% [markdown]
# With noise of 1 nN m in every moment, the places that the three whiskers together tell
# have these standard errors:

# %%
NOISE = 1e-9
every = np.nan_to_num(np.asarray(slopes)).reshape(-1, 2)
covariance = NOISE**2 * np.linalg.inv(every.T @ every)
print(
    "standard errors of x and y:", np.round(1e6 * np.sqrt(np.diag(covariance)), 2), "µm"
)

# %% [markdown]
# ## Something to try
#
# - Move the peg backwards, or away from the snout. Which whiskers touch it first?
# - Tilt the peg: `jw.Cylinder(RADIUS, (x, y, 0.0), (0.3, 0.0, 1.0))`.
# - Let both sides whisk: `jw.Array.rat()`, with a peg at $-y$ for the left side.
