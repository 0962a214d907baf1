# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # A first scan in five minutes
#
# After this notebook you can scan an object with a whisker, plot the result, and export
# it as a table, a film, or in SI units.
#
# A whisker sensor is a slender elastic rod whose base sits on a spring. A drive drags
# it past an object: the whisker touches the object, bends, slides along it and snaps
# off. The sensor measures the forces fx, fy and the moment mz that the support exerts
# on the base. This notebook scans a parabola with one whisker.
#
# It needs `pip install 'jaxwhisker[notebooks]'` and takes about a minute, mostly for
# compilation. Everything is computed in float64, which JAX must be asked for first.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw

# %% [markdown]
# ## The scene
#
# Without units everything is dimensionless: lengths in the whisker's length L, forces
# in EI/L², moments in EI/L, spring stiffnesses in EI/L³. The spring has stiffness 70
# and rest length 0.2. The object is the parabola y = 0.2 + x²; its lowest point, the
# vertex, is 0.2 L above the line on which the base moves.
#
# `ClosedForm` computes straight uniform whiskers with elliptic functions. It is faster
# than the default, which integrates any kind of rod.

# %%
scene = jw.Scene(
    jw.Whisker(),
    jw.Parabola(distance=0.2),
    jw.Support.fb(70.0, rest_length=0.2),
    rod=jw.ClosedForm(),
)
print(scene)
ax = jw.plot.scene(scene)

# %% [markdown]
# The grey square is the drive, the zigzag the spring, the dot the base. The drive moves
# to the left, towards -x, and pulls the whisker behind it.
#
# ## The scan
#
# By default the scan begins just before the first touch, ends when the whisker is free
# again, and has steps of 0.001 L.

# %%
result = jw.scan(scene)
print(result)

# %% [markdown]
# Every step is `ok`. The list shows the events and the drive position u of each. The
# whisker touches the object with its tip; then a part of its shaft lies against the
# object (tangential contact); it passes the vertex, where the force is vertical; it
# slides back to its tip, and snaps off.

# %%
ax = jw.plot.shapes(result)

# %% [markdown]
# Five states of the scan; earlier ones are paler. The arrow is the contact force in the
# last state. Contact is frictionless, so the force is normal to the object.

# %%
axs = jw.plot.reactions(result)

# %% [markdown]
# These are the signals. Time runs from right to left, like the drive; thin lines mark
# events. fy and mz are largest a little before the vertex, where fx changes sign. All
# signals drop to zero at the snap-off.

# %%
ax = jw.plot.phases(
    result, ax=pyplot.figure(figsize=(6.4, 1.7), layout="constrained").subplots()
)

# %% [markdown]
# The phase of the whisker along the scan: tip contact is hatched, tangential contact is
# solid.
#
# ## Export as a table
#
# `result.fx`, `result.mz` and all other signals are arrays with one row per step and
# one column per whisker. `to_dataframe` puts them into a pandas table.
# `jw.to_csv(result, "scan.csv")` writes a file, and `result.to_xarray()` returns a
# Dataset.

# %%
table = jw.to_dataframe(result)
table.loc[
    ::250,
    [
        "control",
        "base_x_1",
        "fx_1",
        "fy_1",
        "mz_1",
        "contact_arc_1",
        "spring_1",
        "phase_1",
    ],
]

# %% [markdown]
# ## Export as a film
#
# In a quasi-static scan the snap takes no time; the film shows it in slow motion.

# %%
jw.animate(result, seconds=4, fps=15, width=720, progress=False)

# %% [markdown]
# ## SI units
#
# With L in metres and Young's modulus in pascals, all results are in SI units: forces
# in newtons, moments in newton metres. A steel wire 60 mm long and 0.2 mm thick on a
# spring of 5.35 N/m is the same scene as above. It has the same structure, so nothing
# is compiled again.

# %%
wire = jw.Whisker.from_material(length=0.06, youngs_modulus=210e9, diameter=0.2e-3)
in_units = jw.Scene(
    wire,
    jw.Parabola(distance=0.012, a=1 / 0.06),
    jw.Support.fb(5.345, rest_length=0.012),
    rod=jw.ClosedForm(),
)
of_wire = jw.scan(in_units)
print(f"EI = {wire.bending_stiffness:.3g} N m²")
print(
    f"largest fy: {1e3 * of_wire.fy.max():.1f} mN,",
    f"largest mz: {1e3 * of_wire.mz.max():.3f} mN m",
)
print(f"dimensionless: {result.fy.max():.2f} EI/L², {result.mz.max():.3f} EI/L")

# %% [markdown]
# ## Checks
#
# The contact force equals the force of the support, and the signal of the wire is that
# of the dimensionless scene in other units.

# %%
assert np.all(result.status == jw.Status.ok)
assert np.allclose(np.hypot(result.fx, result.fy), result.contact_force, rtol=1e-12)
assert np.isclose(
    of_wire.mz.max() * wire.length / wire.bending_stiffness, result.mz.max(), rtol=1e-4
)

# %% [markdown]
# ## Something to try
#
# - Use two whiskers, `jw.Support.fbfbr(70.0)`. What does the second one measure when
#   the first one snaps off?
# - Use a softer spring, `jw.Support.fb(10.0)`. The whisker snaps to the far side of the
#   object before it is free.
# - Change the object to `jw.Circle(distance=0.2, radius=0.5)`, or the whisker to
#   `jw.Whisker(length=0.8)`.
# - Drag the parameters with sliders: `jw.explore(lambda c, q: jw.Scene(jw.Whisker(),
#   jw.Parabola(q), jw.Support.fb(c), rod=jw.ClosedForm()), c=(20, 500, 70), q=(0.1,
#   0.6, 0.2))`.
