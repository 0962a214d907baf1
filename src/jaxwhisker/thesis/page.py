"""A page as a list of blocks, written as Markdown and as HTML."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch
from html import escape


@dataclass(frozen=True)
class Heading:
    """A heading; level 1 is the page's title."""

    level: int
    text: str


@dataclass(frozen=True)
class Paragraph:
    """Plain text; `strong` stands before it."""

    text: str
    strong: str = ""


@dataclass(frozen=True)
class Table:
    """Header and rows of words, and files that hold the same."""

    rows: Sequence[Sequence[str]]
    files: tuple[str, ...] = ()


@dataclass(frozen=True)
class Image:
    """A picture, what it shows, and the file with its data."""

    file: str
    caption: str
    data: str


Block = Heading | Paragraph | Table | Image


def markdown(blocks: Sequence[Block]) -> str:
    """The page as Markdown."""
    return "\n\n".join(_markdown(block) for block in blocks) + "\n"


def html(blocks: Sequence[Block]) -> str:
    """The page as HTML that needs nothing else."""
    title = next((b.text for b in blocks if isinstance(b, Heading)), "")
    body = "\n".join(_html(block) for block in blocks)
    return _PAGE.format(title=escape(title), body=body)


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }}
img {{ max-width: 100%; }}
.wide {{ overflow-x: auto; }}
table {{ border-collapse: collapse; font-size: 0.85rem; }}
th, td {{ border: 1px solid #ccc; padding: 0.15rem 0.5rem; text-align: right; }}
th {{ background: #eee; }}
figure {{ margin: 1.5rem 0; }}
</style>
</head>
<body>
{body}
</body>
</html>
"""


@singledispatch
def _markdown(block) -> str:
    raise TypeError(f"no block of a page: {block!r}")


@_markdown.register
def _(block: Heading) -> str:
    return f"{'#' * block.level} {block.text}"


@_markdown.register
def _(block: Paragraph) -> str:
    return f"**{block.strong}** {block.text}" if block.strong else block.text


@_markdown.register
def _(block: Table) -> str:
    def line(cells):
        return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"

    lines = [line(block.rows[0]), line(["---:"] * len(block.rows[0])), *map(line, block.rows[1:])]
    links = [", ".join(f"[{file}]({file})" for file in block.files)] if block.files else []
    return "\n\n".join(["\n".join(lines), *links])


@_markdown.register
def _(block: Image) -> str:
    return f"![{block.caption}]({block.file})\n\n{block.caption} ([data]({block.data}))"


@singledispatch
def _html(block) -> str:
    raise TypeError(f"no block of a page: {block!r}")


@_html.register
def _(block: Heading) -> str:
    return f"<h{block.level}>{escape(block.text)}</h{block.level}>"


@_html.register
def _(block: Paragraph) -> str:
    strong = f"<strong>{escape(block.strong)}</strong> " if block.strong else ""
    return f"<p>{strong}{escape(block.text)}</p>"


@_html.register
def _(block: Table) -> str:
    def line(cells, tag):
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    rows = [line(block.rows[0], "th"), *(line(row, "td") for row in block.rows[1:])]
    links = ", ".join(f'<a href="{escape(file)}">{escape(file)}</a>' for file in block.files)
    return '<div class="wide"><table>\n' + "\n".join(rows) + f"\n</table></div>\n<p>{links}</p>"


@_html.register
def _(block: Image) -> str:
    caption = f'{escape(block.caption)} (<a href="{escape(block.data)}">data</a>)'
    image = f'<img src="{escape(block.file)}" alt="{escape(block.caption)}" loading="lazy">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
