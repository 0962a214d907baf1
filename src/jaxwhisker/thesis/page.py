"""Results as Markdown: paragraphs, tables, figures and claims, for the folder of results and for the documentation.

Python-Markdown, which renders the documentation, also renders the page in the folder of results.
"""

import re
import textwrap
from collections.abc import Sequence

from jaxwhisker.thesis.claims import Claim

LINE = 120  # characters
HTML = """\
<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }}
img {{ max-width: 100%; }}
table {{ border-collapse: collapse; font-size: 0.85rem; display: block; overflow-x: auto; }}
th, td {{ border: 1px solid #ccc; padding: 0.15rem 0.5rem; }}
th {{ background: #eee; }}
</style>
{body}
</html>
"""


def html_page(text: str) -> str:
    """Render a page of Markdown, whose first line is its title.

    Raises:
        ImportError: if Python-Markdown is missing.
    """
    try:
        from markdown import markdown
    except ImportError as error:
        raise ImportError("`reproduce` needs markdown: pip install jaxwhisker[study]") from error
    return HTML.format(title=text.splitlines()[0].lstrip("# "), body=markdown(text, extensions=["tables", "toc"]))


def paragraph(text: str) -> str:
    """Wrap a text to lines of at most 120 characters."""
    return textwrap.fill(" ".join(text.split()), LINE, break_on_hyphens=False)


def markdown_table(rows: Sequence[Sequence[str]], align: str = "---:") -> str:
    """A Markdown table of a header and rows of words; columns are aligned to the right by default."""
    cells = [[cell.replace("|", r"\|") for cell in row] for row in [rows[0], [align] * len(rows[0]), *rows[1:]]]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)


def folded(title: str, text: str) -> str:
    """A text that is hidden until the reader unfolds it."""
    return f"<details markdown><summary>{title}</summary>\n\n{text}\n\n</details>"


def figure(file: str, caption: str, data: str = "") -> str:
    """A picture with its caption and a link to its data."""
    return f"![{caption}]({file})\n\n{caption}" + f" ([data]({data}))" * bool(data)


def claims_table(claims: Sequence[Claim]) -> str:
    """A table of all claims, with links to their sections."""
    rows = [["", "claim", "figures", "holds", "result"]]
    for number, claim in enumerate(claims, 1):
        words = re.sub(r"[^\w\s-]", "", f"{number}. {claim.statement}").strip().lower()
        anchor = re.sub(r"[-\s]+", "-", words)
        figures = claim.figures or "not in the thesis"
        rows.append([f"[{number}](#{anchor})", claim.statement, figures, claim.holds, claim.in_short()])
    return markdown_table(rows, align="---")


def claim_sections(claims: Sequence[Claim], fold: bool = False) -> str:
    """All claims in full: statement, result, explanation and numbers."""
    parts = []
    for count, claim in enumerate(claims, 1):
        numbers = markdown_table(claim.rows)
        parts += [f"### {count}. {claim.statement}", paragraph(f"**Result:** {claim.result}")]
        parts += [paragraph(claim.explanation), folded("Numbers", numbers) if fold else numbers]
    return "\n\n".join(parts)
