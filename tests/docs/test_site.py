"""The site: the reference describes every public name once, and all names and files that pages mention exist.

The Makefile has the targets that pages and the workflow of the hosted runners call.
"""

import importlib
import re
import tomllib
from collections import Counter
from pathlib import Path

import griffe
import pytest
import yaml

import jaxwhisker as jw
from jaxwhisker._scan.quantities import QUANTITIES

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
DESCRIBED = re.compile(r"^::: (\S+)$", re.MULTILINE)
MENTIONED = re.compile(r"\bjw((?:\.[A-Za-z]\w*)+)")
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
SHELL = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
CALLED = re.compile(r"^make ([a-z-]+)", re.MULTILINE)  # a line of a shell script
QUOTED = re.compile(r"`make ([a-z-]+)")
MAKEFILE = (ROOT / "Makefile").read_text("utf-8")
WORKFLOW = yaml.safe_load((ROOT / ".github" / "workflows" / "checks.yml").read_text("utf-8"))["jobs"]["checks"]


def name_of(page):
    return str(page.relative_to(ROOT))


def described():
    """Paths of the objects that the reference describes, with repetitions."""
    return [
        path
        for page in sorted((DOCS / "reference").glob("*.md"))
        for path in DESCRIBED.findall(page.read_text("utf-8"))
    ]


def test_every_public_name_is_described_once():
    counts = Counter(path.split(".")[-1] for path in described() if not path.startswith("jaxwhisker.plot."))
    assert counts == dict.fromkeys(jw.__all__, 1)


def test_the_reference_describes_the_objects_of_the_package():
    read = griffe.load("jaxwhisker", search_paths=[ROOT / "src"])
    for path in described():
        found = read[path.removeprefix("jaxwhisker.")]
        name = path.split(".")[-1]
        own = getattr(jw.plot if path.startswith("jaxwhisker.plot.") else jw, name)
        assert not found.is_module, path
        assert f"{own.__module__}.{own.__qualname__}" == found.canonical_path, path


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_names_on_pages_exist(page):
    for name in sorted(set(MENTIONED.findall(page.read_text("utf-8")))):
        # An attribute of an instance is not always one of its class.
        first, *further = name.removeprefix(".").split(".")
        found = getattr(jw, first)
        if further and (first == "plot" or first[0].isupper()):
            getattr(found, further[0])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_linked_files_exist(page):
    for link in LINK.findall(FENCED.sub("", page.read_text("utf-8"))):
        assert "://" in link or (page.parent / link).exists(), link


def test_the_navigation_has_every_page():
    class Loader(yaml.SafeLoader):
        """Accept the tags of mkdocs.yml that plain YAML does not have."""

    Loader.add_constructor("!ENV", lambda *_: None)
    settings = yaml.load((ROOT / "mkdocs.yml").read_text("utf-8"), Loader)

    def leaves(entry):
        if isinstance(entry, str):
            return [entry]
        return [leaf for part in (entry.values() if isinstance(entry, dict) else entry) for leaf in leaves(part)]

    assert sorted(leaves(settings["nav"])) == sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))


def test_the_reference_has_every_quantity(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs_hooks"))
    table = importlib.import_module("hooks").quantities()
    assert all(f"| `{name}` |" in table for name in QUANTITIES if not name.startswith(("before_", "after_")))
    assert "<!-- quantities -->" in (DOCS / "reference" / "scan.md").read_text("utf-8")


def test_the_table_of_quantities_has_every_field_of_a_result():
    fields = {
        name for name in jw.Result.__dataclass_fields__ if name not in ("deferred_events", "scene", "shaft_loads")
    }
    assert fields <= QUANTITIES.keys()


def targets():
    """Targets that `make help` lists."""
    return set(re.findall(r"^([a-z-]+):.*## ", MAKEFILE, re.MULTILINE))


def called_on(page):
    """Targets of the Makefile that a page names, in shell blocks and in prose."""
    text = page.read_text("utf-8")
    return {*CALLED.findall("".join(SHELL.findall(text))), *QUOTED.findall(text)}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_targets_on_pages_exist(page):
    assert called_on(page) <= targets()


def test_contributing_describes_the_checks():
    assert {"quick", "test", "lint", "types", "docs"} <= called_on(ROOT / "CONTRIBUTING.md")


def test_the_workflow_calls_the_checks_of_the_makefile():
    scripts = [step["run"] for step in WORKFLOW["steps"] if "run" in step]
    called = [CALLED.match(script) for script in scripts]
    assert all(called), "calls something else than make"
    assert {match[1] for match in called if match} == {"lint", "types", "docs", "test"} <= targets()


def test_the_workflow_has_the_python_versions_of_the_makefile():
    """The oldest one is that of pyproject.toml."""
    versions = WORKFLOW["strategy"]["matrix"]["python"]
    [candidates] = re.findall(r"^CANDIDATES := \$\(or \$\(PYTHON\),(.*)\)$", MAKEFILE, re.MULTILINE)
    assert sorted(versions) == sorted(re.findall(r"python(3\.\d+)", candidates))
    oldest = min(versions, key=lambda version: int(version.partition(".")[2]))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["requires-python"] == f">={oldest}"
