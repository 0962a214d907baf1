# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # A first scan in five minutes
#
# A whisker sensor is a slender elastic rod whose base sits on a spring. A drive drags it past an object: the whisker
# touches, bends, slides along the object and snaps off. What is measured are the forces fx, fy and the moment mz with
# which the support holds the base. This notebook scans a parabola with one whisker, and shows everything that comes out
# of it. Needs `pip install 'jaxwhisker[notebooks]'`; takes about a minute, most of it for the compiler.
#
# Everything is computed in float64, which JAX has to be told first.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw

# %% [markdown]
# ## The scene
#
# Without units everything is dimensionless: lengths in L, the whisker's length, forces in EI/L², moments in EI/L,
# spring stiffnesses in EI/L³. The spring here has the stiffness 70 and the rest length 0.2. The object is the parabola
# y = 0.2 + x²: its lowest point, the vertex, is 0.2 L above the line along which the base moves.
#
# `ClosedForm` computes straight uniform whiskers by elliptic functions, faster than the default, which integrates rods
# of all kinds.

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
# The grey square is the drive, the zigzag the spring, the dot the base. The drive moves to the left, towards -x, and
# pulls the whisker behind it.
#
# ## The scan
#
# By default it begins just before the first touch, ends when the whisker is free again, and goes in steps of 0.001 L.

# %%
result = jw.scan(scene)
print(result)

# %% [markdown]
# Every step is `ok`, and these are the events, by the position u of the drive. The whisker touches with its tip; then
# it lies against the object with a part of its shaft (tangential contact); it passes the vertex, where the force is
# vertical; it slides on to its tip again, and snaps off.

# %%
ax = jw.plot.shapes(result)

# %% [markdown]
# Five states of the scan, the earlier the paler. The arrow is the force of the object in the last one: contact is
# frictionless, so it is normal to the object.

# %%
axs = jw.plot.reactions(result)

# %% [markdown]
# The signal. Time runs from right to left, as the drive does; thin lines are the events. fy and mz are largest a little
# before the vertex, where fx changes its sign, and everything drops to zero at once where the whisker snaps off.

# %%
ax = jw.plot.phases(
    result, ax=pyplot.figure(figsize=(6.4, 1.7), layout="constrained").subplots()
)

# %% [markdown]
# What the whisker does where: contact of the tip is hatched, contact of the shaft is solid.
#
# ## As a table
#
# `result.fx`, `result.mz` and so on are arrays with one row a step and one column a whisker. `to_dataframe` puts all of
# it into a table for pandas, `jw.to_csv(result, "scan.csv")` into a file, and `result.to_xarray()` into a Dataset.

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
# ## As a film
#
# The snap takes no time in a quasi-static scan; the film shows it in slow motion.

# %%
jw.animate(result, seconds=4, fps=15, width=720, progress=False)

# %% [markdown]
# ## In units
#
# With L in metres and Young's modulus in pascals everything is in SI units: forces in newtons, moments in newton
# metres. A steel wire 60 mm long and 0.2 mm thick, with its base on a spring of 5.35 N/m, is the same scene as above.
# It has the same structure, so nothing is compiled again.

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
# ## What has to be so
#
# The contact force is what the support holds, and the wire's signal is that of the dimensionless scene in other units.

# %%
assert np.all(result.status == jw.Status.ok)
assert np.allclose(np.hypot(result.fx, result.fy), result.contact_force, rtol=1e-12)
assert np.isclose(
    of_wire.mz.max() * wire.length / wire.bending_stiffness, result.mz.max(), rtol=1e-4
)

# %% [markdown]
# ## Something to try
#
# - Two whiskers: `jw.Support.fbfbr(70.0)`. What does the second one feel when the first one lets go?
# - A softer spring, `jw.Support.fb(10.0)`: it snaps to the far side of the object before it is free.
# - `jw.Circle(distance=0.2, radius=0.5)` for the object, or `jw.Whisker(length=0.8)` for the whisker.
# - Drag all of it with the mouse: `jw.explore(lambda c, q: jw.Scene(jw.Whisker(), jw.Parabola(q), jw.Support.fb(c),
#   rod=jw.ClosedForm()), c=(20, 500, 70), q=(0.1, 0.6, 0.2))`.
