"""The thesis's results: tables, figures and claims, each with the data behind it, and all of it on one page."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from tqdm import tqdm

from jaxwhisker._scan.report import write_rows
from jaxwhisker.thesis import page
from jaxwhisker.thesis.catalogue import FIGURES
from jaxwhisker.thesis.claims import all_claims
from jaxwhisker.thesis.claims import needed as claimed
from jaxwhisker.thesis.figures import draw, table_picture
from jaxwhisker.thesis.scans import Case, Scans
from jaxwhisker.thesis.tables import TABLES, rows

CLAIMS = "claims"
ALL_NAMES = "A.1 to A.4, 5.10 to 5.16, 6.1 to 6.24, 7.4 and claims"

TITLE = "Elastically coupled tactile whiskers: results of the thesis"
ABOUT = """
Quasi-static scans of a rigid convex object by whiskers whose bases sit on springs: what jaxwhisker computes for the
tables, figures and claims of the thesis. All quantities are dimensionless: lengths in L, forces in EI/L^2, moments in
EI/L, spring stiffnesses in EI/L^3; u is the position of the drive, which moves towards -x: curves over u run from right
to left. fx, fy, mz are the reactions of the support on the whisker.
"""
CHOSEN = """
Where the thesis does not print the values that it varies, these were chosen: stiffness c in {30, 50, 70, 100, 200,
infinity}, object distance q in {0.1, 0.2, 0.3, 0.4}, rest length λ in {0.1, 0.2, 0.3, 0.4} (of every spring of the row;
a feedback spring rests at the sum of those that it spans), around c = 70, q = 0.2, λ = 0.2, with the parabola
y = x^2 + q. All springs have the same stiffness. The semicircle of figures 5.14-5.16 has the radius 1. Figures 6.9 and
6.18 show the scans with these base values, 6.10 the varied stiffness. Infinite stiffness is the clamped whisker. At
q = 0.1 the base value c = 70 is below the critical stiffness, where a whisker snaps through the vertex: such curves
jump and skip their maximum.
"""
TABLES_ABOUT = """
A force on a clamped whisker; follower forces turn with it. Fx and Fy are fx and fy, Mz is the bending moment at the
base, -mz. The last column repeats the values of the thesis's multi-body model (ALASKA) for the record.
"""


def _one_line(text: str) -> str:
    return " ".join(text.split())


def available() -> list[str]:
    """Names of everything that can be reproduced."""
    return [*TABLES, *FIGURES, CLAIMS]


def names(text: str) -> list[str]:
    """The names in a comma-separated list, "6.02" meaning "6.2".

    Raises:
        ValueError: for a name that is not available.
    """
    wanted = []
    for word in (part.strip() for part in text.split(",")):
        chapter, _, number = word.partition(".")
        name = f"{chapter}.{int(number)}" if number.isdigit() else word
        name = name.upper() if name.upper() in TABLES else name.lower() if name.lower() == CLAIMS else name
        if name not in available():
            raise ValueError(f"--only must name some of {ALL_NAMES}, but names {word!r}.")
        wanted.append(name)
    return wanted


def reproduce(out: Path, only: Sequence[str] | None = None) -> None:
    """Write tables, figures and claims with their data into the folder `out`, and the page that shows them.

    Args:
        out: the folder; made if it does not exist.
        only: some of `available()`; everything by default.
    """
    wanted = available() if only is None else list(only)
    out.mkdir(parents=True, exist_ok=True)
    blocks: dict[str, list[page.Block]] = {}
    interactive = sys.stderr.isatty()
    with Scans(_needed(wanted)) as scans, tqdm(total=len(wanted), unit="result", disable=not interactive) as bar:
        for heading, group, make in _groups(out, scans):
            for name in (name for name in group if name in wanted):
                bar.set_description(name)
                blocks.setdefault(heading, []).extend(make(name))
                bar.update()
            if heading in blocks and not interactive:
                print(f"done: {heading}", flush=True)
    parts = [page.Heading(1, TITLE), page.Paragraph(_one_line(ABOUT)), page.Paragraph(_one_line(CHOSEN))]
    for heading, part in blocks.items():
        parts += [page.Heading(2, heading), *part]
    (out / "README.md").write_text(page.markdown(parts), encoding="utf-8")
    (out / "index.html").write_text(page.html(parts), encoding="utf-8")
    print(f"wrote {len(wanted)} results to {out}; see {out / 'index.html'} or {out / 'README.md'}")


def _needed(wanted: Sequence[str]) -> list[Case]:
    """The cases that these results need."""
    cases = [case for name in wanted if name in FIGURES for case in FIGURES[name].cases]
    return cases + (claimed() if CLAIMS in wanted else [])


def _groups(out: Path, scans: Scans) -> list[tuple[str, list[str], Callable[[str], list[page.Block]]]]:
    def chapter(prefix: str) -> list[str]:
        return [number for number in FIGURES if number.startswith(prefix)]

    def table(name: str) -> list[page.Block]:
        return _table(name, out)

    def figure(name: str) -> list[page.Block]:
        picture, data = draw(FIGURES[name], scans, out)
        return [page.Image(picture.name, f"Figure {name}: {FIGURES[name].title}", data.name)]

    def checked(_: str) -> list[page.Block]:
        return _claims(scans, out)

    return [
        ("Tables A.1-A.4: reactions under given forces", list(TABLES), table),
        ("Chapter 5: one clamped whisker", chapter("5."), figure),
        ("Chapter 6: one and two whiskers on springs", chapter("6."), figure),
        ("Chapter 7: three whiskers", chapter("7."), figure),
        ("Claims", [CLAIMS], checked),
    ]


def _table(name: str, out: Path) -> list[page.Block]:
    table, cells = TABLES[name], rows(TABLES[name])
    title = f"Table {name}: {table.title}"
    write_rows(cells, out / f"table_{name}.csv")
    table_picture(title, cells, out / f"table_{name}.png")
    about = [page.Paragraph(_one_line(TABLES_ABOUT))] if name == next(iter(TABLES)) else []
    notes = [page.Paragraph(note) for note in table.notes]
    return [*about, page.Heading(3, title), page.Table(cells, (f"table_{name}.png", f"table_{name}.csv")), *notes]


def _claims(scans: Scans, out: Path) -> list[page.Block]:
    blocks = [block for number, claim in enumerate(all_claims(scans), 1) for block in claim.page(number)]
    title = page.Heading(1, "Claims of chapter 6, and the numbers")
    (out / "claims.md").write_text(page.markdown([title, page.Paragraph(_one_line(ABOUT)), *blocks]), encoding="utf-8")
    return blocks
