"""Write the results of the thesis: tables, figures and claims with their data, and a page that shows all of them."""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from jaxwhisker._base.announce import compiling_for
from jaxwhisker._scan.report import write_rows
from jaxwhisker.thesis.catalogue import FIGURES
from jaxwhisker.thesis.claims import CLAIMS, CRITICAL, needed
from jaxwhisker.thesis.figures import draw, draw_table
from jaxwhisker.thesis.page import claim_sections, claims_table, figure, html_page, markdown_table, paragraph
from jaxwhisker.thesis.scans import Scans, critical_cases
from jaxwhisker.thesis.tables import TABLES, table_rows

CLAIMS_NAME = "claims"
ALL_NAMES = "A.1 to A.4, 5.10 to 5.16, 6.1 to 6.24, 7.4 and claims"

TITLE = "# Elastically coupled tactile whiskers: results of the thesis"
INTRODUCTION = """
Whiskers whose bases sit on springs scan a rigid convex object quasi-statically. This page shows the tables, figures and
claims of the thesis as jaxwhisker computes them. All quantities are dimensionless: lengths in L, forces in EI/L^2,
moments in EI/L, spring stiffnesses in EI/L^3. u is the position of the drive, which moves towards -x, so curves over u
run from right to left. fx, fy and mz are the reactions of the support on the whisker.
"""
PARAMETERS = """
The thesis does not print all values of the parameters that it varies. These were chosen here: stiffness c in {30, 50,
70, 100, 200, infinity}, object distance q in {0.1, 0.2, 0.3, 0.4} and rest length λ in {0.1, 0.2, 0.3, 0.4} (of every
spring in the row; the rest length of a feedback spring is the sum over those that it spans). The base values are c =
70, q = 0.2 and λ = 0.2, with the parabola y = x^2 + q. All springs have the same stiffness. The semicircle of figures
5.14 to 5.16 has the radius 1. Figures 6.9 and 6.18 show the scans with the base values, figure 6.10 varies the
stiffness. Infinite stiffness is the clamped whisker. At q = 0.1 the base value c = 70 is below the critical stiffness,
so a whisker snaps through the vertex: these curves jump and miss their maximum.
"""
TABLES_ABOUT = """
The tables list the reactions of a clamped whisker under a given force. A follower force turns with the whisker. Fx and
Fy are fx and fy; Mz is the bending moment at the base, -mz. The last column repeats the values of the multi-body model
(ALASKA) of the thesis.
"""


def available() -> list[str]:
    """Names of all results."""
    return [*TABLES, *FIGURES, CLAIMS_NAME]


def parse_names(text: str) -> list[str]:
    """The names in a comma-separated list; "6.02" is the same as "6.2".

    Raises:
        ValueError: for a name that is not available.
    """
    names = {name.lower(): name for name in available()}
    wanted = []
    for word in (part.strip() for part in text.split(",")):
        name = names.get(re.sub(r"\.0+", ".", word.lower()))
        if name is None:
            raise ValueError(f"--only must name some of {ALL_NAMES}, got {word!r}.")
        wanted.append(name)
    return wanted


def reproduce(out: Path, only: Sequence[str] | None = None) -> None:
    """Write tables, figures and claims with their data into a folder, and one page that shows all of them.

    The page is written as index.html and as README.md.

    Args:
        out: the folder; it is created if it does not exist.
        only: some of `available()`. Default: everything.

    Raises:
        ImportError: if a package of `jaxwhisker[study]` is missing.
    """
    wanted = available() if only is None else list(only)
    out.mkdir(parents=True, exist_ok=True)
    html_page(TITLE)  # reports a missing package before anything is computed
    parts = [TITLE, paragraph(INTRODUCTION), paragraph(PARAMETERS)]

    cases = [case for name in wanted if name in FIGURES for case in FIGURES[name].cases]
    claimed = CLAIMS_NAME in wanted
    # A generator, because the choice of these cases compiles programs.
    around = (case for critical in CRITICAL * claimed for case in critical_cases(*critical))
    with (
        Scans(cases + needed() * claimed, around) as scans,
        tqdm(total=len(wanted), unit="result", disable=not sys.stderr.isatty()) as bar,
    ):
        scans.start()
        for heading, write, group in SECTIONS:
            chosen = [name for name in group if name in wanted]
            parts += [f"## {heading}"] * bool(chosen)
            for name in chosen:
                bar.set_description(name)
                with compiling_for("table " * (name in TABLES) + "figure " * (name in FIGURES) + name):
                    file, text = write(name, scans, out)
                parts.append(text)
                bar.write(str(out / file))
                bar.update()
    page = "\n\n".join(parts) + "\n"
    (out / "README.md").write_text(page, encoding="utf-8")
    (out / "index.html").write_text(html_page(page), encoding="utf-8")
    print(f"wrote {len(wanted)} results to {out}; see {out / 'index.html'}")


def _table(name: str, _: Scans, out: Path) -> tuple[str, str]:
    table, rows = TABLES[name], table_rows(TABLES[name])
    title = f"Table {name}: {table.title}"
    files = [f"table_{name}.png", f"table_{name}.csv"]
    draw_table(title, rows, out / files[0])
    write_rows(rows, out / files[1])
    links = ", ".join(f"[{file}]({file})" for file in files)
    about = [paragraph(TABLES_ABOUT)] * (name == next(iter(TABLES)))
    return files[0], "\n\n".join([*about, f"### {title}", markdown_table(rows), links, *table.notes])


def _picture(name: str, scans: Scans, out: Path) -> tuple[str, str]:
    file, data = draw(FIGURES[name], scans, out)
    return file.name, figure(file.name, f"Figure {name}: {FIGURES[name].title}", data.name)


def _claims(_: str, scans: Scans, out: Path) -> tuple[str, str]:
    claims = [claim(scans) for claim in CLAIMS]
    text = f"{claims_table(claims)}\n\n{claim_sections(claims)}"
    title = "# Claims of chapter 6 with numbers"
    (out / "claims.md").write_text(f"{title}\n\n{paragraph(INTRODUCTION)}\n\n{text}\n", encoding="utf-8")
    return "claims.md", text


# Heading, writer and names of every section of the page.
SECTIONS = [
    ("Tables A.1 to A.4: reactions under given forces", _table, list(TABLES)),
    ("Chapter 5: one clamped whisker", _picture, [name for name in FIGURES if name.startswith("5.")]),
    ("Chapter 6: one and two whiskers on springs", _picture, [name for name in FIGURES if name.startswith("6.")]),
    ("Chapter 7: three whiskers", _picture, [name for name in FIGURES if name.startswith("7.")]),
    ("Claims", _claims, [CLAIMS_NAME]),
]
