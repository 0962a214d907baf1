"""Write docs/thesis.md and its pictures: the tables, figures and claims of the thesis (some minutes of computation).

The page has the content of `jaxwhisker reproduce`, with three of its pictures and without the data of the curves.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from jaxwhisker.thesis.catalogue import FIGURES
from jaxwhisker.thesis.claims import CLAIMS, needed
from jaxwhisker.thesis.figures import draw
from jaxwhisker.thesis.page import claim_sections, claims_table, figure, folded, markdown_table, paragraph
from jaxwhisker.thesis.reproduce import PARAMETERS, TABLES_ABOUT
from jaxwhisker.thesis.scans import Scans
from jaxwhisker.thesis.tables import TABLES, table_rows

DOCS = Path(__file__).parents[1] / "docs"
SHOWN = ("6.2", "6.10", "7.4")
ROUNDED = 0.5e-4 + 1e-9  # half a unit of the last of the four printed decimals
INTRODUCTION = """
The models of jaxwhisker come from a master's thesis on elastically coupled vibrissae (TU Ilmenau and PUCP): a clamped
whisker, one whisker on a spring (FB), two coupled whiskers without feedback (FBFB) and with it (FBFBR), and three
whiskers (FBFBFBR). On this page you can compare the tables, figures and claims of the thesis with what jaxwhisker
computes. `python figures/thesis.py` writes it. `make demo` or `jaxwhisker reproduce` writes all results with pictures
and data to `out/`. [When is statics enough?](when_statics_is_enough.md) examines where the differences between its
quasi-static and its multi-body model come from.

All models are plane. A straight whisker past an object that is flat across the plane leaves it at the vertex, unless
something guides it ([out of the plane](mechanics.md#out-of-the-plane)). The thesis does not mention this. What needs
lateral guidance is shaded in the figures of reactions.
"""
CLAIMS_ABOUT = """
These are the claims of chapter 6 in the order of the thesis, after the limit that bounds them. A claim that holds "in
part" has limits, which the [last section](#claims-in-full) states with numbers.
"""


def tables_section() -> str:
    """How many printed values agree, and the tables themselves."""
    overview = [["table", "content", "printed values", "within half a digit", "largest difference"]]
    for name, table in TABLES.items():
        differences = [abs(float(row[4])) for row in table_rows(table)[1:] if row[4] != "-"]
        right = sum(difference <= ROUNDED for difference in differences)
        overview.append([name, table.title, str(len(differences)), str(right), f"{max(differences):.6f}"])
    parts = ["## Tables A.1 to A.4: forces on a clamped whisker", markdown_table(overview, align="---")]
    parts += [paragraph(note) for table in TABLES.values() for note in table.notes]
    parts.append(paragraph(TABLES_ABOUT))
    for name, table in TABLES.items():
        parts.append(folded(f"Table {name}: {table.title}", markdown_table(table_rows(table))))
    return "\n\n".join(parts)


def figures_section(scans: Scans) -> str:
    """Some figures, and the titles of all."""
    parts = ["## Figures", paragraph(PARAMETERS)]
    for name in SHOWN:
        picture, data = draw(FIGURES[name], scans, DOCS)
        data.unlink()
        picture = picture.rename(DOCS / f"thesis_{picture.name}")
        parts.append(figure(picture.name, f"Figure {name}: {FIGURES[name].title}"))
    titles = [["figure", "content"], *([number, entry.title] for number, entry in FIGURES.items())]
    return "\n\n".join(
        [*parts, "These are all figures that `jaxwhisker reproduce` draws:", markdown_table(titles, "---")]
    )


def main() -> None:
    with Scans([*needed(), *(case for name in SHOWN for case in FIGURES[name].cases)]) as scans:
        claims = [claim(scans) for claim in CLAIMS]
        figures = figures_section(scans)
    parts = ["# The thesis", paragraph(INTRODUCTION), "## Claims", paragraph(CLAIMS_ABOUT), claims_table(claims)]
    parts += [tables_section(), figures, "## Claims in full", claim_sections(claims, fold=True)]
    (DOCS / "thesis.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
