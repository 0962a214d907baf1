"""Notebooks: two run here, `make notebooks` runs all. The names that they use exist."""

import ast
import inspect
import re
from pathlib import Path
from typing import Any

import pytest
from matplotlib import pyplot

import jaxwhisker as jw

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))
RUN_HERE = ("01_first_scan", "05_stiffness")  # all others compile for at least a minute
HEADER = "# ---\n# jupyter:\n#   jupytext:\n#     formats: py:percent\n# ---\n\n# %% [markdown]\n# # "
CELL = re.compile(r"^# %%(.*)\n", re.MULTILINE)


def name_of(notebook):
    return notebook.stem


def tree(notebook):
    return ast.parse(notebook.read_text("utf-8"), str(notebook))


def calls(notebook):
    """Functions of `jw` that a notebook calls, with the names of their keyword arguments."""
    for node in ast.walk(tree(notebook)):
        if isinstance(node, ast.Call) and (path := ast.unparse(node.func)).startswith("jw."):
            yield path, [keyword.arg for keyword in node.keywords if keyword.arg]


@pytest.mark.parametrize("name", RUN_HERE)
def test_a_notebook_runs(name, tmp_path, monkeypatch):
    # In a temporary folder with links to the files that it reads.
    for folder in ("examples", "benchmarks"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    (tmp_path / "notebooks").mkdir()
    monkeypatch.chdir(tmp_path / "notebooks")
    notebook = ROOT / "notebooks" / f"{name}.py"
    exec(compile(notebook.read_text("utf-8"), notebook, "exec"), {"__name__": "__main__"})
    assert pyplot.get_fignums()
    pyplot.close("all")


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=name_of)
def test_functions_that_a_notebook_calls_exist(notebook):
    for path, arguments in calls(notebook):
        called: Any = jw
        for part in path.split(".")[1:]:
            called = getattr(called, part)
        known = inspect.signature(called).parameters
        free = any(parameter.kind is parameter.VAR_KEYWORD for parameter in known.values())
        assert free or set(arguments) <= set(known), f"{path} has no {set(arguments) - set(known)}"


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=name_of)
def test_names_that_a_notebook_imports_exist(notebook):
    for node in ast.walk(tree(notebook)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jaxwhisker"):
            names: dict[str, Any] = {}
            exec(
                compile(ast.Module([node], []), "a notebook", "exec"), names
            )  # finds modules as well as their contents
            assert len(names) > len(node.names)  # and __builtins__


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=name_of)
def test_a_notebook_has_a_title_a_check_and_something_to_try(notebook):
    text = notebook.read_text("utf-8")
    assert text.startswith(HEADER)
    *_, (kind, last) = zip(CELL.findall(text), CELL.split(text)[2::2], strict=True)
    assert kind == " [markdown]" and "omething to try" in last
    assert any(isinstance(node, ast.Assert) for node in ast.walk(tree(notebook)))
