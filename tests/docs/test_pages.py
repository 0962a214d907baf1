"""The Python code of README, CONTRIBUTING and docs runs, and prints the output that the page shows below it.

The tables of these pages agree with the stored results.
"""

import re
import sys
from pathlib import Path
from unittest import SkipTest

import pytest
from matplotlib import pyplot
from sybil import Region, Sybil
from sybil.evaluators.skip import Skipper
from sybil.parsers.markdown import PythonCodeBlockParser

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "benchmarks"))

import report  # noqa: E402

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
BY_HAND = re.compile(r"^<!-- run by hand: (.+) -->\n(?=```python\n)", re.MULTILINE)
SKIPPED = Skipper("run by hand")
OUTPUT = re.compile(r"\n*```text\n(.*?)^```", re.MULTILINE | re.DOTALL)  # the output of the code block right above it
NUMBER = re.compile(r"[+-]?\d+\.\d*(?:e[+-]?\d+)?")


def by_hand(document):
    """Regions of comments `run by hand: reason`; the block right below such a comment is not run."""
    for match in BY_HAND.finditer(document.text):
        yield Region(match.start(), match.end(), ("next", repr(match[1])), SKIPPED)


CODE = Sybil(parsers=[PythonCodeBlockParser(), by_hand])


def name_of(page):
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", [page for page in PAGES if "```python" in page.read_text("utf-8")], ids=name_of)
def test_code_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = page.read_text("utf-8")
    for block in CODE.parse(page):
        try:
            block.evaluate()
        except SkipTest:
            continue
        printed = capsys.readouterr().out
        if shown := OUTPUT.match(text, block.region.end):
            assert NUMBER.sub("#", printed).split() == NUMBER.sub("#", shown[1]).split()
            for number, expected in zip(NUMBER.findall(printed), NUMBER.findall(shown[1]), strict=True):
                assert float(number) == pytest.approx(float(expected), rel=0, abs=last_digit(expected)), shown[1]
    pyplot.close("all")


def last_digit(number):
    """One unit of the last decimal, since processors round differently."""
    mantissa, _, exponent = number.partition("e")
    return 1.01 * 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def test_every_block_is_found():
    for page in PAGES:
        blocks = [block for block in CODE.parse(page) if block.region.evaluator is not SKIPPED]
        assert len(blocks) == len(re.findall(r"^```python", page.read_text("utf-8"), re.MULTILINE)), page


def test_every_block_run_by_hand_has_a_reason():
    for page in PAGES:
        comments = re.findall(r"^<!-- run by hand", page.read_text("utf-8"), re.MULTILINE)
        assert len(comments) == len(BY_HAND.findall(page.read_text("utf-8"))), page


@pytest.mark.parametrize("page", report.PAGES, ids=name_of)
def test_tables_agree_with_the_stored_results(page):
    text = page.read_text("utf-8")
    assert report.written(text) == text, "run `python benchmarks/report.py`"


def columns_of(line):
    return len(re.findall(r"(?<!\\)\|", line.strip())) - 1


def test_tables_of_the_page_on_prior_knowledge_fit_on_a_screen():
    lines = (ROOT / "docs" / "known.md").read_text("utf-8").splitlines()
    tables = [line for line in lines if line.startswith("|")]
    assert tables and max(map(columns_of, tables)) <= 6


def test_guides_have_no_tables_of_benchmarks():
    """The numbers of friction and motion are in the part of the site on numerics."""
    for name in ("dynamics", "friction", "when_statics_is_enough"):
        assert "<!-- table:" not in (ROOT / "docs" / f"{name}.md").read_text("utf-8"), name


def test_every_table_is_on_a_page():
    pages = "".join(page.read_text("utf-8") for page in report.PAGES)
    assert all(f"<!-- table: {name} -->" in pages for name in report.TABLES)
