# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # Grooves and textures
#
# After this notebook you can scan objects that are not convex, read the signals of a
# whisker that touches in two places, and tell which valleys of a texture it feels. The
# notebook takes about a minute, most of it for compilation.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw


class Waves(eqx.Module):
    """A wave on a parabola, with a valley at x = 0. The object is above it."""

    distance: float
    depth: float  # of the valleys
    wavelength: float
    bend: float

    def __call__(self, x):
        valley = (1 + jnp.cos(2 * jnp.pi * x / self.wavelength)) / 2
        return self.distance + self.depth * valley + self.bend * x**2


def build(distance, depth, wavelength, bend):
    """A clamped whisker with room for two contacts."""
    waves = Waves(distance, depth, wavelength, bend)
    return jw.Scene(jw.Whisker(), jw.Graph(waves), contacts=2)


# %% [markdown]
# All scenes of this notebook differ in numbers only, and share their programs.
#
# ## A groove
#
# The object has two bumps with a groove between them. The drive moves to the left.

# %%
result = jw.scan(build(0.15, 0.2, 0.5, 0.8))
print(result)
jw.plot.shapes(result, [0.75, 0.18, -0.45])
# %% [markdown]
# The whisker crosses the groove as a bridge: it touches both bumps, and then only the
# second one. The groove itself is not felt. There is a strip for each contact:

# %%
jw.plot.phases(result)
both = np.asarray(result.phase[:, 0] > 0).all(axis=-1)
print(f"two contacts in {both.mean():.0%} of the steps")
assert np.all(np.asarray(result.status) == jw.Status.ok)

# %% [markdown]
# ## The forces of both contacts
#
# The support carries the sum of the contact forces.

# %%
force, slope = np.asarray(result.contact_force), np.asarray(result.contact_slope)
assert np.allclose(result.fx, -np.sum(force * np.sin(slope), axis=-1), atol=1e-7)
assert np.allclose(result.fy, np.sum(force * np.cos(slope), axis=-1), atol=1e-7)
jw.plot.signal(result, "contact_force")
# %% [markdown]
# ## A jump
#
# A jump has a state before it and one after it, at the same position of the drive.

# %%
SNAPS = jw.EventKind.snap_through, jw.EventKind.snap_off
for event in result.events:
    if event.kind in SNAPS:
        contacts = [int(np.sum(side.phase > 0)) for side in (event.before, event.after)]
        mz = [float(side.mz[0]) for side in (event.before, event.after)]
        print(f"u = {event.control:.4f}: contacts {contacts}, mz {np.round(mz, 3)}")

# %% [markdown]
# ## Textures
#
# Small waves on a flat parabola, equally steep at all wavelengths. The first figure shows
# the places of both contacts; lines mark the crests, which are nearest to the bases.

# %%
CONTROL = np.linspace(1.2, -1.6, 1401)
WAVELENGTHS = [0.1, 0.2, 0.3]
scans = {
    wavelength: jw.scan(build(0.4, 0.2 * wavelength, wavelength, 0.5), CONTROL)
    for wavelength in WAVELENGTHS
}
figure, axes = pyplot.subplots(
    1, len(scans), figsize=(11, 3.4), sharey=True, layout="constrained"
)
for ax, (wavelength, one) in zip(axes, scans.items(), strict=True):
    touching = np.asarray(one.phase[:, 0]) > 0
    x = np.where(touching, np.asarray(one.contact_x[:, 0]), np.nan)
    for crest in np.arange(-20, 20) + 0.5:
        ax.axhline(crest * wavelength, color="0.85", linewidth=0.8)
    ax.plot(CONTROL, x)
    ax.set(title=f"wavelength {wavelength} L", xlabel="drive $u / L$", ylim=(-1, 1.1))
    ax.invert_xaxis()
axes[0].set_ylabel("contacts $x / L$")
# %% [markdown]
# On the way in, the shaft lies on the crests and passes from each one to the next: it
# never touches the bottom of a valley. On the way out, the tip slides down from each
# crest and jumps into the next valley, or over it.

# %%
for wavelength, one in scans.items():
    x = np.asarray(one.contact_x[one.phase > 0])
    depth = (1 + np.cos(2 * np.pi * x / wavelength)) / 2  # 1 at the bottom of a valley
    valleys = sorted({int(k) for k in np.round(x / wavelength)[depth > 0.5]})
    snaps = [event.control for event in one.events if event.kind in SNAPS]
    print(
        f"{wavelength}: valleys {valleys}, jumps at {np.round(snaps, 3)}, "
        f"mean distance {-np.diff(snaps).mean():.3f}"
    )

# %% [markdown]
# ## The moment
#
# The signals have the rhythm of the texture, but not its wavelength: the bent whisker
# slides along the object, and the drive moves farther or less far than the contact.

# %%
figure, ax = pyplot.subplots(figsize=(8, 3.2), layout="constrained")
for wavelength, one in scans.items():
    ax.plot(CONTROL, np.asarray(one.mz[:, 0]), label=f"{wavelength} L")
ax.set(xlabel="drive $u / L$", ylabel="$m_z L / EI$")
ax.invert_xaxis()
ax.legend(title="wavelength")
# %% [markdown]
# ## Something to try
#
# - Put the whisker on a spring: `jw.Support.fb(70.0)`. Does it jump earlier?
# - Deepen the waves. At which depth does the whisker feel every valley?
# - Let the whisker curve: `jw.Whisker(intrinsic_curvature=1.0)`.
# - Press a whisker against two circles: `jw.Scene(jw.Whisker(), (jw.Circle(0.5, 0.2),
#   jw.Circle(0.25, 0.12, position=-0.55)), contacts=2)`.
