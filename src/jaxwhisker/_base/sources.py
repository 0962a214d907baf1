"""The sources that a program depends on. Its entry on disk stays valid when other sources change.

They are the modules of the functions and classes that describe the program, and all modules that these import. A module
of scans may also import what the compiled function does not use, such as figures. Of the modules that a description
names, only the imports that the named definitions use are therefore followed.
"""

import ast
import functools
import hashlib
import re
import threading
from collections.abc import Iterable
from pathlib import Path

PACKAGE = __name__.partition(".")[0]
ROOT = Path(__file__).parents[2]  # the folder that holds the package
NAME = re.compile(rf"\b{PACKAGE}(?:\.\w+)+")
ONLY_FOR_TYPES = re.compile(r"^if TYPE_CHECKING:\n(?:[ \t]+.*\n|\n)+", re.MULTILINE)
# Functions import modules, too, and names in parentheses may stand on several lines.
IMPORT = re.compile(rf"^[ \t]*from ({PACKAGE}[\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)

# In Python 3.11, ast.parse fails in two threads at once if one gives way to the other, which collecting garbage may
# cause (python/cpython#106905).
_PARSING = threading.Lock()


@functools.lru_cache(maxsize=1024)
def digest(description: str) -> str:
    """A checksum of all sources that the functions and classes named in a description depend on."""
    return _digest(modules(description))


@functools.lru_cache(maxsize=1024)
def modules(description: str) -> frozenset[str]:
    """Names of the modules that the functions and classes named in a description depend on."""
    return _closure(frozenset(NAME.findall(description)))


@functools.cache
def _closure(names: frozenset[str]) -> frozenset[str]:
    found, rest = set(), set()
    for name in names:
        module, definition = _located(name)
        found.add(module)
        rest |= _used_by(module, definition) if definition else _imports(module)
    while rest:
        found |= rest
        rest = frozenset().union(*map(_imports, rest)) - found
    return frozenset(found)


def _located(name: str) -> tuple[str, str]:
    """The module of a function or class, and the name of the definition at its top level."""
    parts = name.split(".")
    size = max(k for k in range(1, len(parts) + 1) if _path(".".join(parts[:k])))
    return ".".join(parts[:size]), "".join(parts[size : size + 1])


@functools.cache
def _path(module: str) -> Path | None:
    """The file of a module of this package; None if there is no such module."""
    place = ROOT.joinpath(*module.split("."))
    return next((path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()), None)


@functools.cache
def _source(module: str) -> str:
    path = _path(module)
    return "" if path is None else path.read_text("utf-8")


@functools.cache
def _digest(modules: frozenset[str]) -> str:
    sources = hashlib.sha256()
    for module in sorted(modules):
        sources.update(f"{module}\n{_source(module)}\n".encode())
    return sources.hexdigest()


@functools.cache
def _imports(module: str) -> frozenset[str]:
    """Modules that a module imports at run time."""
    found = IMPORT.findall(ONLY_FOR_TYPES.sub("", _source(module)))
    return frozenset().union(*(_imported(start, re.findall(r"\w+", names)) for start, names in found))


def _imported(start: str, names: Iterable[str]) -> set[str]:
    """Modules that an import of names from a package or a module needs."""
    return {start} | {f"{start}.{name}" for name in names if _path(f"{start}.{name}")}


@functools.cache
def _used_by(module: str, definition: str) -> frozenset[str]:
    """Modules that a definition uses, also through other definitions of its module."""
    definitions, origin = _definitions(module)
    used, seen, rest = set(), set(), {definition}
    while rest:
        seen |= rest
        nodes = [node for name in rest & definitions.keys() for node in ast.walk(definitions[name])]
        for name in rest:
            used |= origin.get(name, set())
        for node in nodes:
            if isinstance(node, ast.ImportFrom):
                used.update(*_origin_of(node).values())
        rest = {node.id for node in nodes if isinstance(node, ast.Name)} - seen
    return frozenset(used)


@functools.cache
def _definitions(module: str) -> tuple[dict[str, ast.stmt], dict[str, set[str]]]:
    """The definitions at the top level of a module, and the modules that its imports come from, both by name."""
    definitions: dict[str, ast.stmt] = {}
    origin: dict[str, set[str]] = {}
    for statement in _tree(module).body:
        if isinstance(statement, ast.ImportFrom):
            origin |= _origin_of(statement)
        elif isinstance(statement, (ast.FunctionDef, ast.ClassDef)):
            definitions[statement.name] = statement
        else:
            stored = (node for node in ast.walk(statement) if isinstance(node, ast.Name))
            definitions |= {node.id: statement for node in stored if isinstance(node.ctx, ast.Store)}
    return definitions, origin


@functools.cache
def _tree(module: str) -> ast.Module:
    with _PARSING:
        return ast.parse(_source(module))


def _origin_of(statement: ast.ImportFrom) -> dict[str, set[str]]:
    """The modules that the names of an import come from, by name."""
    start = statement.module or ""
    if start.partition(".")[0] != PACKAGE:
        return {}
    return {alias.asname or alias.name: _imported(start, [alias.name]) for alias in statement.names}
