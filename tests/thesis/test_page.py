"""Markdown of results: paragraphs, tables, figures, claims with links to their sections."""

from jaxwhisker.thesis.claims import Claim
from jaxwhisker.thesis.page import (
    claim_sections,
    claims_table,
    figure,
    folded,
    html_page,
    markdown_table,
    paragraph,
)

CLAIM = Claim("It holds at u = -0.534, always", "6.1", "yes", "The claim holds: a | b.", "Because.", [["x"], ["1"]])


def test_paragraphs_are_wrapped():
    lines = paragraph("word\n   " * 60).splitlines()
    assert max(map(len, lines)) <= 120 and " ".join(lines) == " ".join(["word"] * 60)


def test_tables_escape_bars():
    assert markdown_table([["x", "y"], ["1", "a|b"]]) == "| x | y |\n| ---: | ---: |\n| 1 | a\\|b |"
    assert "| --- |" in markdown_table([["x"], ["1"]], align="---")


def test_figures_link_to_their_data():
    assert figure("f.png", "Caption", "f.csv") == "![Caption](f.png)\n\nCaption ([data](f.csv))"
    assert figure("f.png", "Caption") == "![Caption](f.png)\n\nCaption"


def test_claims_link_to_their_sections():
    overview, sections = claims_table([CLAIM]), claim_sections([CLAIM])
    row = "| [1](#1-it-holds-at-u-0534-always) | It holds at u = -0.534, always | 6.1 | yes | a \\| b |"
    assert overview.splitlines()[2] == row
    assert sections.startswith(
        "### 1. It holds at u = -0.534, always\n\n**Result:** The claim holds: a | b.\n\nBecause."
    )
    html = html_page(f"# Title\n\n{overview}\n\n{sections}")
    assert "<title>Title</title>" in html and '<td><a href="#1-it-holds-at-u-0534-always">1</a></td>' in html
    assert '<h3 id="1-it-holds-at-u-0534-always">' in html and "<strong>Result:</strong>" in html
    assert folded("Numbers", markdown_table(CLAIM.rows)) in claim_sections([CLAIM], fold=True)
