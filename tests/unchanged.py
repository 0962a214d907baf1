"""`pytest --unchanged`, as `make test` does: leave out tests that have passed with the same sources.

What a test depends on is found for its whole file: the file, the helpers that it imports, and what they use of the
package, with everything that this imports (`jaxwhisker/_base/sources.py` follows imports, for stored programs as well).
Files that look at sources or start processes depend on every file of the repository. All tests depend on versions,
flags, the processor, and files that are not Python.

`make clean` forgets which tests have passed. Tests that fail, skip or are not asked for keep no record.
"""

import functools
import hashlib
import json
import os
import platform
import re
from importlib.metadata import distributions
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

TESTS = Path(__file__).parent
ROOT = TESTS.parent
HELPERS = (TESTS, TESTS / "oracles")
RECORDS = ROOT / ".cache" / "passed.json"  # unless the option names another file
FOLDERS = ("src", "tests", "docs", "docs_hooks", "examples", "notebooks", "benchmarks", "figures")  # of the repository
COMMON = (TESTS / "conftest.py", Path(__file__), ROOT / "pyproject.toml", TESTS / "long.txt")

IMPORTED = re.compile(r"^[ \t]*(?:from|import) (\w+)", re.MULTILINE)
ALIAS = re.compile(r"^[ \t]*import jaxwhisker as jw$", re.MULTILINE)
USED = re.compile(r"\bjw\.(\w+)")
# A file may look at any other file, or use names of the package that its text does not show. Data are common to all.
BARE = re.compile(r"\bjw\b(?!\.)|\bimport jaxwhisker\b")
AT_LARGE = re.compile(
    r"\b(?:subprocess|importlib|inspect|runpy|sys\.modules|exec|os\.system)\b|\b__file__(?!.*\bdata\b)"
)


def _loaded(path: Path, name: str) -> ModuleType:
    """One module of the package alone: the package itself is imported after the import hook."""
    spec = spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


sources: Any = _loaded(ROOT / "src" / "jaxwhisker" / "_base" / "sources.py", "jaxwhisker._base.sources")


def _checksum(parts: Any) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]


@functools.cache
def _text(path: Path) -> str:
    return path.read_text("utf-8")


@functools.cache
def _files(python: bool) -> tuple[tuple[str, str], ...]:
    """Names and checksums of files of the repository: those in Python, or the others that tests and package read."""
    found = []
    for folder in FOLDERS if python else ("src", "tests"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts and (python or path.suffix != ".py"):
                found.append((str(path.relative_to(ROOT)), hashlib.sha256(path.read_bytes()).hexdigest()))
    return tuple(found)


@functools.cache
def _surroundings() -> str:
    """Everything but the sources: versions, flags, the processor, files that are not Python."""
    versions = sorted(f"{one.name} {one.version}" for one in distributions() if one.name != "jaxwhisker")
    flags = [os.environ.get(name, "") for name in ("XLA_FLAGS", "JAXWHISKER_CACHE")]
    return _checksum([versions, flags, platform.python_version(), platform.processor(), _files(python=False)])


@functools.cache
def _origin() -> dict[str, str]:
    """Where each public name is defined."""
    names = {"plot": "jaxwhisker.plot", "film": "jaxwhisker.film"}
    for start, some in sources.IMPORT.findall(_text(ROOT / "src" / "jaxwhisker" / "__init__.py")):
        names |= {name: f"{start}.{name}" for name in re.findall(r"\w+", some)}
    return names


def _helper(name: str) -> Path | None:
    return next((path for folder in HELPERS if (path := folder / f"{name}.py").is_file()), None)


@functools.cache
def _with_helpers(path: Path) -> frozenset[Path]:
    """A file of the tests, and all helpers that it imports."""
    found, rest = set(), {path}
    while rest:
        found |= rest
        names = {name for some in rest for name in IMPORTED.findall(_text(some))}
        rest = {own for name in names if (own := _helper(name))} - found
    return frozenset(found)


@functools.cache
def names_used(path: Path) -> frozenset[str] | None:
    """Names of the package that a test file and its helpers use; None if they may use anything."""
    names = set()
    for text in map(_text, _with_helpers(path)):
        rest = ALIAS.sub("", text)
        used = set(USED.findall(rest))
        if AT_LARGE.search(rest) or BARE.search(rest) or not used <= _origin().keys():
            return None
        names |= {_origin()[name] for name in used} | set(sources.NAME.findall(rest))
        for start, some in sources.IMPORT.findall(rest):
            names |= {f"{start}.{name}" for name in re.findall(r"\w+", some)}
    return frozenset(names)


@functools.cache
def digest(path: Path, typed: bool) -> str:
    """A checksum of everything that the tests of a file depend on."""
    names = names_used(path)
    if names is None:
        return _checksum([typed, _surroundings(), _files(python=True), _text(ROOT / "pyproject.toml")])
    texts = [_text(one) for one in sorted(_with_helpers(path) | {*COMMON})]
    return _checksum([typed, _surroundings(), texts, sources.digest(" ".join(sorted(names)))])


class Unchanged:
    """The plugin. Workers of xdist leave out tests, too; the process that started them keeps the records."""

    def __init__(self, records: Path, typed: bool, worker: bool):
        self.records, self.typed = records, typed
        self.passed: dict[str, bool] = {}
        self.left_out = 0
        if not worker:  # before anyone edits a file while tests run
            for path in TESTS.rglob("test_*.py"):
                digest(path, typed)

    def _digest(self, nodeid: str) -> str:
        return digest(ROOT / nodeid.partition("::")[0], self.typed)

    def _key(self, nodeid: str) -> str:
        return f"{'typed ' if self.typed else ''}{nodeid}"

    def _read(self) -> dict[str, str]:
        """The digest with which each test has passed."""
        try:
            return json.loads(self.records.read_text("utf-8"))
        except (OSError, ValueError):
            return {}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: Any, items: list[Any]) -> None:
        """Leave out tests whose record has the digest of now."""
        records = self._read()
        kept, left_out = [], []
        for item in items:
            known = records.get(self._key(item.nodeid))
            (left_out if known and known == self._digest(item.nodeid) else kept).append(item)
        items[:], self.left_out = kept, len(left_out)
        config.hook.pytest_deselected(items=left_out)

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Note the outcome of a part of a test."""
        self.passed[report.nodeid] = self.passed.get(report.nodeid, True) and report.passed

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take over what a worker has left out; all of them collect the same tests."""
        self.left_out = getattr(node, "workeroutput", {}).get("left out", self.left_out)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: Any) -> None:
        """Write the records; a run in which nothing is left to do is a success."""
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput["left out"] = self.left_out
            return
        records = self._read()
        for nodeid, good in self.passed.items():
            records.pop(self._key(nodeid), None)
            if good:
                records[self._key(nodeid)] = self._digest(nodeid)
        self.records.parent.mkdir(exist_ok=True)
        partly = self.records.with_suffix(f".{os.getpid()}")
        partly.write_text(json.dumps(records), "utf-8")
        partly.replace(self.records)
        if session.exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED and self.left_out:
            session.exitstatus = pytest.ExitCode.OK

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Say how many tests were left out."""
        if self.left_out:
            text = "have passed with the same sources and were left out; `make clean` makes all of them run again"
            terminalreporter.write_line(f"{self.left_out} tests {text}")
