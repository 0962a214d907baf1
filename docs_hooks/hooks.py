"""Hooks of the documentation site: formulas as MathML, notebooks as pages, links to files outside docs/."""

import os
import re
from html import unescape
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.structure.files import File

from jaxwhisker._scan.quantities import CONTROL, QUANTITIES, unit_in_words

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
FUNCTION = re.compile(r"(<mi>(?:sin|cos|tan|max|min|det|ln)</mi>)(?=<m(?:i|n|row|sub|frac)>)")
SHORT = re.compile(r"<td>(?=[^<]{1,16}</td>)")
OUTSIDE = re.compile(r"\[([^\]]*)\]\(\.\./([\w./]+)\)")


def on_config(config):
    """Fill the empty list of notebooks in the navigation."""
    section = next(entry for entry in config.nav if "Notebooks" in entry)
    section["Notebooks"] = [f"notebooks/{notebook.name}" for notebook in NOTEBOOKS]


def on_pre_build(**_):
    """Change to the folder of the notebooks, because they read files by relative path when they are executed."""
    os.chdir(ROOT / "notebooks")


def on_files(files, config):
    """Add the notebooks, which are outside docs/."""
    for notebook in NOTEBOOKS:
        files.append(File(f"notebooks/{notebook.name}", str(ROOT), config.site_dir, config.use_directory_urls))
    return files


on_files.mkdocs_priority = 100  # before the plugin that turns them into pages


def quantities():
    """The table of quantities, in Markdown."""
    rows = ["| name | description | symbol | axes | unit | positive means |", "| --- | --- | --- | --- | --- | --- |"]
    for name, quantity in QUANTITIES.items():
        if name.startswith(("before_", "after_")):
            continue  # the same as the state's, at an event
        unit = "as the control" if quantity.kind == CONTROL else unit_in_words(quantity.kind, dimensionless=True)
        symbol = rf"\({quantity.symbol}\)" if quantity.symbol else ""
        axes = ", ".join(quantity.axes)
        rows.append(f"| `{name}` | {quantity.description} | {symbol} | {axes} | {unit} | {quantity.sign} |")
    return "\n".join(rows)


def on_page_markdown(markdown, page, **_):
    """Insert the table of quantities, and adapt links to files outside docs/.

    Links to notebooks point at their pages; the site has no other files, so that only their names remain.
    """

    markdown = markdown.replace("<!-- quantities -->", quantities())

    def inside(match):
        name, file = match.groups()
        return f"[{name}]({file})" if file.startswith("notebooks/") else f"`{name.strip('`')}`"

    return OUTSIDE.sub(inside, markdown) if "/" not in page.file.src_uri else markdown


def on_page_content(html, **_):
    """Turn formulas into MathML, which needs no script, and keep numbers in tables on one line."""
    return SHORT.sub('<td class="short">', FORMULA.sub(_mathml, html))


def _mathml(match):
    element, latex = match.groups()
    formula = convert(unescape(latex), display="block" if element == "div" else "inline")
    formula = FUNCTION.sub(r'\1<mspace width="0.17em"/>', formula)  # browsers leave no space after sin
    return f'<div class="formula">{formula}</div>' if element == "div" else formula
