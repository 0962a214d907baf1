"""The Python code of README and docs runs, each page from top to bottom."""

import re
import sys
from pathlib import Path

import pytest
from matplotlib import pyplot

ROOT = Path(__file__).parent.parent
sys.path.append(str(ROOT / "benchmarks"))

import report  # noqa: E402

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"(<!-- run by hand[^\n]*-->\n)?```python\n(.*?)```", re.DOTALL)


def blocks(page):
    """The blocks of a page at the lines where they stand, but for those that are run by hand."""
    text = page.read_text(encoding="utf-8")
    found = [match for match in BLOCK.finditer(text) if not match[1]]
    return [compile("\n" * text.count("\n", 0, match.start(2)) + match[2], str(page), "exec") for match in found]


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page)], ids=lambda page: page.name)
def test_code_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": page.stem}
    for block in blocks(page):
        exec(block, names)
    pyplot.close("all")


def test_pages_with_code_are_found():
    assert {"README.md", "studies.md"} <= {page.name for page in PAGES if blocks(page)}


@pytest.mark.parametrize("page", report.PAGES, ids=lambda page: page.name)
def test_tables_are_those_of_the_stored_results(page):
    text = page.read_text(encoding="utf-8")
    assert report.written(text) == text, "run `python benchmarks/report.py`"


def test_every_table_stands_on_a_page():
    pages = "".join(page.read_text(encoding="utf-8") for page in report.PAGES)
    assert all(f"<!-- table: {name} -->" in pages for name in report.TABLES)
