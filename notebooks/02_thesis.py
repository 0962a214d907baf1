# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # The thesis, chapter by chapter
#
# A master's thesis on elastically coupled vibrissae (TU Ilmenau and PUCP) is where the models here come from. This
# notebook computes some of its tables, figures and claims; `jaxwhisker reproduce` makes all of them. Everything is
# dimensionless: lengths in L, forces in EI/L², moments in EI/L, stiffnesses in EI/L³; u is the position of the drive,
# which moves towards -x, so that curves over u run from right to left. About two minutes.

# %%
import tempfile
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from IPython.display import Image, Markdown

from jaxwhisker.thesis import coupling, shifts
from jaxwhisker.thesis.catalogue import FIGURES
from jaxwhisker.thesis.claim import varied
from jaxwhisker.thesis.claims import unchanged_by_stiffness
from jaxwhisker.thesis.figures import draw
from jaxwhisker.thesis.page import Table, markdown
from jaxwhisker.thesis.scans import STIFFNESSES, Scans
from jaxwhisker.thesis.tables import TABLES, rows

# %% [markdown]
# The scans behind what is shown are computed in the background from here on, one study for each kind of scene.

# %%
shown = ("6.1", "6.2", "6.3", "6.10", "6.18", "7.4")
cases = [case for name in shown for case in FIGURES[name].cases]
cases += [
    case for family in varied("stiffness", STIFFNESSES).values() for case in family
]
scans, folder = Scans(cases), Path(tempfile.mkdtemp())

# %% [markdown]
# ## Chapter 5: one clamped whisker under a given force
#
# Table A.1: the reactions to a follower force, which turns with the whisker's tip. (Mz is the bending moment at the
# base, our -mz.) The last column is the thesis's multi-body model.

# %%
table = rows(TABLES["A.1"])
Markdown(markdown([Table(table)]))

# %%
assert all(
    abs(float(difference)) <= 0.5e-4 for *_, difference, _ in table[1:]
)  # half a printed digit
Image(filename=draw(FIGURES["5.10"], scans, folder)[0])

# %% [markdown]
# The whisker under these loads. A strong follower force bends the tip back below itself, and pulls at the base the
# other way.
#
# ## Chapter 6: whiskers on springs
#
# ### One whisker
#
# The four states of a scan: tip contact, tangential contact before and after the vertex, tip contact again.

# %%
Image(filename=draw(FIGURES["6.1"], scans, folder)[0])

# %% [markdown]
# The reactions for springs of different stiffness; black is the clamped whisker. All curves cross where the force is
# vertical and the spring has no load.

# %%
Image(filename=draw(FIGURES["6.2"], scans, folder)[0])

# %%
crossing = shifts.common_point(scans)
Markdown(f"**{crossing.says}.** {crossing.verdict}")

# %% [markdown]
# The thesis's main claim is that stiffness shifts and narrows the signal, but leaves its maxima unchanged.

# %%
unchanged = unchanged_by_stiffness(scans)
Markdown(f"**{unchanged.says}.** {unchanged.verdict} {unchanged.why}")

# %% [markdown]
# It ends where the springs are softer than a critical stiffness: the scan then snaps through the vertex and skips the
# maximum (see the notebook 03_studies).
#
# ### Two whiskers
#
# A second spring ties whisker 2 to whisker 1. When whisker 1 lets go, whisker 2 feels it, the more the softer the
# springs.

# %%
Image(filename=draw(FIGURES["6.10"], scans, folder)[0])

# %%
letting_go = coupling.detachment(scans)
Markdown(f"**{letting_go.says}.** {letting_go.verdict} {letting_go.why}")

# %% [markdown]
# ### ... with feedback
#
# A third spring ties whisker 2 to the drive.

# %%
Image(filename=draw(FIGURES["6.18"], scans, folder)[0])

# %%
feedback = coupling.feedback(scans)
Markdown(
    markdown([Table(feedback.rows)])
    + f"\n\n**{feedback.says}.** {feedback.verdict} {feedback.why}"
)

# %% [markdown]
# ## Chapter 7: three whiskers

# %%
Image(filename=draw(FIGURES["7.4"], scans, folder)[0])

# %%
third = coupling.third_whisker(scans)
Markdown(f"**{third.says}.** {third.verdict}")

# %% [markdown]
# What was asserted along the way holds, as far as the thesis says it does:

# %%
for claim in (crossing, unchanged, letting_go, feedback, third):
    print(
        "holds" if claim.verdict.startswith("holds") else "DOES NOT HOLD",
        claim.says,
        sep=": ",
    )
    assert claim.verdict.startswith("holds")

# %% [markdown]
# ## Something to try
#
# - The other figures: `FIGURES` has them by number. What a figure's scans are tells `FIGURES["6.4"].cases`; they have
#   to be among the cases above.
# - Which data are behind a picture? `draw` writes a CSV file beside it and returns both paths.
# - All claims with their numbers, and where they end: the page docs/thesis.md, or `jaxwhisker reproduce --only claims`.
