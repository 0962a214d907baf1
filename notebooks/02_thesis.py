# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # The thesis, chapter by chapter
#
# After this notebook you can reproduce tables, figures and claims of the thesis from
# which the models come: a master's thesis on elastically coupled vibrissae (TU Ilmenau
# and PUCP). The notebook computes some of them; `jaxwhisker reproduce` computes all.
#
# Everything is dimensionless: lengths in L, forces in EI/L², moments in EI/L,
# stiffnesses in EI/L³. u is the position of the drive, which moves towards -x, so
# curves over u run from right to left. The notebook takes about two minutes.

# %%
import tempfile
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from IPython.display import Image, Markdown

from jaxwhisker.thesis import claims
from jaxwhisker.thesis.catalogue import FIGURES
from jaxwhisker.thesis.figures import draw
from jaxwhisker.thesis.page import markdown_table
from jaxwhisker.thesis.scans import Scans
from jaxwhisker.thesis.tables import TABLES, table_rows

# %% [markdown]
# All scans are computed in the background from here on, with one study for each kind of
# scene.

# %%
shown = ("6.1", "6.2", "6.3", "6.10", "6.18", "7.4")
cases = [case for name in shown for case in FIGURES[name].cases]
cases += [
    case for family in claims.families("stiffness").values() for case in family.values()
]
scans, folder = Scans(cases), Path(tempfile.mkdtemp())

# %% [markdown]
# ## Chapter 5: one clamped whisker under a given force
#
# Table A.1 lists the reactions to a follower force, which rotates with the tip of the
# whisker. (Mz is the bending moment at the base, our -mz.) The last column is the
# multi-body model of the thesis.

# %%
table = table_rows(TABLES["A.1"])
Markdown(markdown_table(table))

# %%
assert all(
    abs(float(difference)) <= 0.5e-4 for *_, difference, _ in table[1:]
)  # half a printed digit
Image(filename=draw(FIGURES["5.10"], scans, folder)[0])

# %% [markdown]
# The whisker under these loads. A strong follower force bends the tip back on itself
# and pulls the base in the opposite direction.
#
# ## Chapter 6: whiskers on springs
#
# ### One whisker
#
# A scan has four states: tip contact, tangential contact before and after the vertex,
# and tip contact again.

# %%
Image(filename=draw(FIGURES["6.1"], scans, folder)[0])

# %% [markdown]
# Reactions for springs of different stiffness; black is the clamped whisker. All curves
# cross where the force is vertical and the spring has no load.

# %%
Image(filename=draw(FIGURES["6.2"], scans, folder)[0])

# %%
crossing = claims.common_point(scans)
Markdown(f"**{crossing.statement}.** {crossing.result}")

# %% [markdown]
# The main claim of the thesis: stiffness shifts and narrows the signal, but leaves its
# maxima unchanged.

# %%
unchanged = claims.unchanged_by_stiffness(scans)
Markdown(f"**{unchanged.statement}.** {unchanged.result} {unchanged.explanation}")

# %% [markdown]
# The claim ends at a critical stiffness. With a softer spring the scan snaps through
# the vertex and skips the maximum (see the notebook 03_studies).
#
# ### Two whiskers
#
# A second spring couples whisker 2 to whisker 1. When whisker 1 detaches, the signal
# of whisker 2 jumps, and the jump is larger with softer springs.

# %%
Image(filename=draw(FIGURES["6.10"], scans, folder)[0])

# %%
detachment = claims.detachment(scans)
Markdown(f"**{detachment.statement}.** {detachment.result} {detachment.explanation}")

# %% [markdown]
# ### Two whiskers with feedback
#
# A third spring couples whisker 2 to the drive.

# %%
Image(filename=draw(FIGURES["6.18"], scans, folder)[0])

# %%
feedback = claims.feedback(scans)
Markdown(
    markdown_table(feedback.rows)
    + f"\n\n**{feedback.statement}.** {feedback.result} {feedback.explanation}"
)

# %% [markdown]
# ## Chapter 7: three whiskers

# %%
Image(filename=draw(FIGURES["7.4"], scans, folder)[0])

# %%
third = claims.third_whisker(scans)
Markdown(f"**{third.statement}.** {third.result}")

# %% [markdown]
# All claims above hold as far as the thesis makes them:

# %%
for claim in (crossing, unchanged, detachment, feedback, third):
    print(f"{claim.holds}: {claim.statement}")
    assert claim.holds in ("yes", "in part")

# %% [markdown]
# ## Something to try
#
# - Draw the other figures: `FIGURES` contains them by number. `FIGURES["6.4"].cases`
#   are the scans of a figure; add them to the cases above.
# - Look at the data of a figure: `draw` writes a CSV file next to the picture and
#   returns both paths.
# - Read all claims with their numbers and their limits: the page docs/thesis.md, or
#   `jaxwhisker reproduce --only claims`.
