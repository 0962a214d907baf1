"""What the site does beyond its plugins: formulas as MathML, notebooks as pages, links to files beside docs/."""

import os
import re
from html import unescape
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
FUNCTION = re.compile(r"(<mi>(?:sin|cos|tan|max|min|det|ln)</mi>)(?=<m(?:i|n|row|sub|frac)>)")
SHORT = re.compile(r"<td>(?=[^<]{1,16}</td>)")
OUTSIDE = re.compile(r"\[([^\]]*)\]\(\.\./([\w./]+)\)")


def on_config(config):
    """The navigation's empty list of notebooks is filled."""
    section = next(entry for entry in config.nav if "Notebooks" in entry)
    section["Notebooks"] = [f"notebooks/{notebook.name}" for notebook in NOTEBOOKS]


def on_pre_build(**_):
    """Notebooks that are executed find what stands beside them."""
    os.chdir(ROOT / "notebooks")


def on_files(files, config):
    """Notebooks stand beside docs/, not in it."""
    for notebook in NOTEBOOKS:
        files.append(File(f"notebooks/{notebook.name}", str(ROOT), config.site_dir, config.use_directory_urls))
    return files


on_files.mkdocs_priority = 100  # before the plugin that makes pages of them


def on_page_markdown(markdown, page, **_):
    """Links to notebooks lead to their pages; to other files outside docs/ there are none on the site, only names."""

    def inside(match):
        name, file = match.groups()
        return f"[{name}]({file})" if file.startswith("notebooks/") else f"`{name.strip('`')}`"

    return OUTSIDE.sub(inside, markdown) if "/" not in page.file.src_uri else markdown


def on_page_content(html, **_):
    """Formulas become MathML, which browsers draw themselves; numbers in tables stay on one line."""
    return SHORT.sub('<td class="short">', FORMULA.sub(_mathml, html))


def _mathml(match):
    element, latex = match.groups()
    formula = convert(unescape(latex), display="block" if element == "div" else "inline")
    formula = FUNCTION.sub(r'\1<mspace width="0.17em"/>', formula)  # browsers leave no room after sin
    return f'<div class="formula">{formula}</div>' if element == "div" else formula
