# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # Real whiskers: taper, curvature, follicles, whisking
#
# After this notebook you can model conical and curved whiskers, bases that yield in all
# directions, and drives that rotate.
#
# Vibrissae are conical and curved. Their bases yield in all directions, and the drive
# rotates about the follicle instead of moving along a line. This notebook adds these
# features one by one and ends with a rat's whisker in SI units. Until then everything
# is dimensionless: lengths in L, forces in EI/L², moments in EI/L, with EI at the base.
# It takes two minutes, mostly for compilation: each new kind of scene is compiled once.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw

# %% [markdown]
# ## Taper and curvature
#
# The diameter of `Whisker.conical` decreases linearly from base to tip. Positive
# `intrinsic_curvature` bends the unloaded whisker towards -x, the direction of the
# scan. With E = 64e4/pi and a base diameter of 0.1, the bending stiffness at the base
# is 1.


# %%
def clamped(taper, curvature):
    cone = jw.Whisker.conical(
        1.0, youngs_modulus=64e4 / np.pi, base_diameter=0.1, tip_diameter=0.1 * taper
    )
    return jw.Scene(
        jw.Whisker(1.0, cone.bending_stiffness, curvature), jw.Parabola(0.2)
    )


scans = {
    "uniform, straight": jw.scan(clamped(1.0, 0.0)),
    "cone 2:1": jw.scan(clamped(0.5, 0.0)),
    "cone 5:1": jw.scan(clamped(0.2, 0.0)),
    "cone 2:1, curved forwards": jw.scan(clamped(0.5, 0.5)),
    "cone 2:1, curved backwards": jw.scan(clamped(0.5, -0.5)),
}
ax = jw.plot.compare(scans, "mz")
legend = ax.legend(fontsize="small", frameon=False)

# %% [markdown]
# The moment over the position of the drive, which moves from right to left. A taper
# makes the signal lower and shorter, because the slender end slips off earlier. A
# whisker that is curved forwards touches earlier and has a larger signal; one that is
# curved backwards has a smaller signal.

# %%
for name, result in scans.items():
    events = ", ".join(
        f"{event.kind.name} at {event.control:.3f}"
        for event in list(result.events)[-2:]
    )
    print(f"{name:27} peak of mz {float(result.mz.max()):.3f}; {events}")
uniform = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), rod=jw.ClosedForm()))
assert np.isclose(scans["uniform, straight"].mz.max(), uniform.mz.max(), rtol=1e-5)

# %% [markdown]
# The uniform whisker is compared with elliptic functions. The 5:1 cone loses its stable
# equilibrium while a part of the shaft still extends beyond the contact. Its unloaded
# shape would intersect the object, so it swings to the far side. There it leans on the
# object, bent in the opposite direction (mz < 0), until it is released:

# %%
ax = jw.plot.shapes(scans["cone 5:1"], [-0.70, -0.80])

# %% [markdown]
# ## A base that yields
#
# `Support.follicle` has a spring for each direction in which the base can yield: across
# the whisker (x), along it (y), and in angle (phi). These scans vary a torsion spring,
# from soft to rigid, in EI/L.


# %%
def turning_base(phi):
    return jw.Scene(
        jw.Whisker(),
        jw.Parabola(0.2),
        jw.Support.follicle(phi=phi),
        rod=jw.ClosedForm(),
    )


by_torsion = {
    f"phi = {phi:g}": jw.scan(turning_base(phi)) for phi in (5.0, 10.0, 30.0, 300.0)
}
ax = jw.plot.compare(by_torsion, "mz")
legend = ax.legend(fontsize="small", frameon=False)

# %% [markdown]
# With springs across the whisker, the height of the signal does not depend on the
# stiffness (notebook 03_studies). With a torsion spring it does, because the load that
# makes the peak also tilts the base.

# %%
peaks = np.array([result.mz.max() for result in by_torsion.values()])
print(
    ", ".join(
        f"{name}: {peak:.3f}" for name, peak in zip(by_torsion, peaks, strict=True)
    )
)
assert np.all(np.diff(peaks) > 0)

# %% [markdown]
# ## A rat's whisker
#
# `Whisker.rat` has the average length and diameters for each position in the array, in
# SI units. The support yields across and in angle, and the drive rotates about the
# follicle: the control is its angle in rad. (The stiffnesses of follicles are hardly
# known; these two are for comparison.)

# %%
rat = jw.Whisker.rat("C", 2, intrinsic_curvature=10.0)
stiffness = float(rat.base_stiffness)
print(
    f"length {1e3 * rat.length:.1f} mm,",
    f"bending stiffness at the base {stiffness:.2e} N m²",
)


def whisking(across, torsion):
    support = jw.Support.follicle(x=across, phi=torsion)
    post = jw.Circle(distance=0.6 * rat.length, radius=0.15 * rat.length)
    return jw.Scene(rat, post, support, motion=jw.Rotation())


soft, firm = jw.scan(whisking(0.1, 1e-5)), jw.scan(whisking(10.0, 1e-3))
print(soft)

# %%
ax = jw.plot.shapes(soft)

# %% [markdown]
# The whisker rotates counter-clockwise about its base, from the right. It touches a
# post 10 mm thick and 20 mm away, bends, and slips past it. Lengths are in mm; the
# zigzag and the coil are the two springs.

# %%
ax = jw.plot.compare({"firm follicle": firm, "soft follicle": soft}, "mz")
ax.legend(fontsize="small", frameon=False)
tilt = {}
for name, result in {"firm": firm, "soft": soft}.items():
    tilt[name] = np.degrees(np.abs(result.base_angle[:, 0] - result.control).max())
    moment, force = (
        1e6 * float(result.mz.max()),
        1e6 * float(result.contact_force.max()),
    )
    print(
        f"{name}: up to {moment:.2f} µN m and {force:.0f} µN;",
        f"the base tilts by up to {tilt[name]:.1f} degrees",
    )
assert tilt["soft"] > tilt["firm"]
assert soft.events[-1].control > firm.events[-1].control
assert np.all(soft.status == jw.Status.ok) and np.all(firm.status == jw.Status.ok)

# %% [markdown]
# The soft follicle tilts back under the load, so the whisker touches and slips off
# later. The angle of the drive during contact therefore contains information about the
# stiffness of the follicle.
#
# ## Something to try
#
# - Use other whiskers of the array: rows "A" to "E", columns 0 to 5. Which one touches
#   the post first?
# - Move the post closer, or to the side: `jw.Circle(..., position=0.1 * rat.length)`.
#   Is the moment still a measure of the distance?
# - Mount two whiskers at different angles: `jw.Support(springs=(...),
#   mount=(jw.Mount(...), jw.Mount(...)))`, see docs/supports.md.
