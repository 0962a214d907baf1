"""Writes docs/thesis.md and its pictures: the thesis's tables, figures and claims, computed (some minutes).

The same as `jaxwhisker reproduce`, on one page without the curves' data.
"""

import re
import textwrap
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from jaxwhisker.thesis import CHOSEN, TABLES_ABOUT
from jaxwhisker.thesis.catalogue import FIGURES
from jaxwhisker.thesis.claims import all_claims, needed
from jaxwhisker.thesis.figures import draw
from jaxwhisker.thesis.page import Table, markdown
from jaxwhisker.thesis.scans import Scans
from jaxwhisker.thesis.tables import TABLES, rows

HERE = Path(__file__).parent
SHOWN = ("6.2", "6.10", "7.4")
WHERE = (  # figures that show it, in the order of the claims
    "not in the thesis",
    "6.2, 6.11, 6.19",
    "6.6, 6.15, 6.23",
    "6.2, 6.3",
    "6.2, 6.11, 6.19",
    "6.6, 6.15, 6.23",
    "6.2, 6.11, 6.19",
    "6.4, 6.13, 6.21",
    "6.10",
    "6.18",
    "7.4",
)
ROUNDED = 0.5e-4 + 1e-9  # the thesis prints four decimals
TITLE = """
# The thesis

A master's thesis on elastically coupled vibrissae (TU Ilmenau and PUCP) is the source of the models here: whiskers on
springs, by name clamped, FB, FBFB, FBFBR and three whiskers. This page holds its tables, figures and claims against
what jaxwhisker computes; `python docs/thesis.py` writes it. `make demo` or `jaxwhisker reproduce` makes all of it with
pictures and data in `out/`.
"""
CLAIMS = """
## Claims

Claims of chapter 6 in the thesis's order, preceded by what bounds them. "In part": where it ends is told below, with
the numbers.
"""


def one_line(text: str) -> str:
    return " ".join(text.split())


def paragraph(text: str) -> str:
    return textwrap.fill(one_line(text), 120, break_on_hyphens=False)


def holds(claim) -> str:
    """What became of a claim."""
    verdict = one_line(claim.verdict)
    if "not in the thesis" in claim.says:
        return "found here"
    limited = "does not hold" in verdict or "not rigidly" in verdict
    return "no" if not verdict.startswith("holds") else "in part" if limited else "yes"


def short(claim) -> str:
    """The claim without what is said about it in brackets."""
    return claim.says.split(" (not in")[0]


def claims_table(claims) -> str:
    cells = [["", "claim", "figures", "holds", "found"]]
    for number, (claim, where) in enumerate(zip(claims, WHERE, strict=True), 1):
        found = one_line(claim.verdict).removeprefix("holds").lstrip(": ").split(". ")[0].rstrip(".")
        anchor = re.sub(r"[^\w\s-]", "", f"{number}. {short(claim)}").strip().lower()
        anchor = re.sub(r"[-\s]+", "-", anchor)
        cells.append([f"[{number}](#{anchor})", short(claim), where, holds(claim), found])
    lines = ["| " + " | ".join(row) + " |" for row in cells]
    return "\n".join([lines[0], "|" + " --- |" * len(cells[0]), *lines[1:]])


def tables_part() -> str:
    cells = [["table", "what", "printed values", "within half a digit", "largest difference"]]
    for name, table in TABLES.items():
        differences = [float(row[4]) for row in rows(table)[1:] if row[4] != "-"]
        right = sum(abs(d) <= ROUNDED for d in differences)
        worst = f"{max(map(abs, differences)):.6f}"
        cells.append([name, table.title, str(len(differences)), str(right), worst])
    lines = ["| " + " | ".join(row) + " |" for row in cells]
    notes = [note for table in TABLES.values() for note in table.notes]
    folded = [folded_table(f"Table {name}: {table.title}", rows(table)) for name, table in TABLES.items()]
    return "\n\n".join([
        "## Tables A.1 to A.4: forces on a clamped whisker",
        "\n".join([lines[0], "|" + " --- |" * len(cells[0]), *lines[1:]]),
        *notes,
        paragraph(TABLES_ABOUT),
        *folded,
    ])  # fmt: skip


def folded_table(title: str, cells) -> str:
    return f"<details markdown><summary>{title}</summary>\n\n{markdown([Table(cells)])}\n</details>"


def figures_part(scans: Scans) -> str:
    cells = ["| figure | what it shows |", "| --- | --- |"]
    cells += [f"| {number} | {figure.title} |" for number, figure in FIGURES.items()]
    parts = ["## Figures", paragraph(CHOSEN)]
    for name in SHOWN:
        picture, data = draw(FIGURES[name], scans, HERE)
        data.unlink()
        picture = picture.rename(HERE / f"thesis_{picture.name}")
        parts.append(f"![Figure {name}: {FIGURES[name].title}]({picture.name})\n\nFigure {name}: {FIGURES[name].title}")
    return "\n\n".join([*parts, "All that are reproduced:", "\n".join(cells)])


def claims_part(claims) -> str:
    parts = ["## Claims in full"]
    for number, claim in enumerate(claims, 1):
        parts += [f"### {number}. {short(claim)}", paragraph(f"**Found:** {claim.verdict}"), paragraph(claim.why)]
        parts += [folded_table("Numbers", claim.rows)]
    return "\n\n".join(parts)


def main() -> None:
    cases = [*needed(), *(case for name in SHOWN for case in FIGURES[name].cases)]
    with Scans(cases) as scans:
        claims = list(all_claims(scans))
        figures = figures_part(scans)
    parts = [TITLE.strip(), CLAIMS.strip(), claims_table(claims), tables_part(), figures, claims_part(claims)]
    (HERE / "thesis.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
