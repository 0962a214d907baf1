"""The JSON schema of files that describe scenes, for editors; it follows from the classes that make scenes."""

import inspect
import re
from types import NoneType
from typing import Any

import equinox as eqx

from jaxwhisker._file.kinds import NONE, RENAMED, Argument, Arguments, Kind, file_arguments, kind_name
from jaxwhisker._file.reading import KIND
from jaxwhisker._model.scene import Scene

_DEFINITIONS = "definitions"
_WORDS = {str: "string", bool: "boolean", int: "integer"}
_REFERS = re.compile(r"Arguments and errors are those of `(\w+)`")
_ARGUMENT = re.compile(r"^    (\w+): (.*(?:\n {8,}.*)*)", re.MULTILINE)


def schema() -> dict[str, Any]:
    """The schema, of draft 7, which editors know."""
    made = _Schema()
    root = made.table(file_arguments(), Scene)
    return (
        {"$schema": "http://json-schema.org/draft-07/schema#", "title": "jaxwhisker scene"}
        | root
        | {_DEFINITIONS: made.definitions}
    )


class _Schema:
    """Schemas of tables and values, and the definitions that they refer to."""

    def __init__(self):
        self.definitions: dict[str, Any] = {}

    def table(self, arguments: Arguments, make: Any) -> dict[str, Any]:
        """The schema of a table whose keys are the arguments of a function."""
        described = _described(make)
        return {
            "type": "object",
            "description": (inspect.getdoc(make) or "").partition("\n\n")[0].replace("\n", " "),
            "properties": {name: self._value(argument, described.get(name)) for name, argument in arguments.items()},
            "required": [name for name, argument in arguments.items() if argument.required],
            "additionalProperties": False,
        }

    def _value(self, argument: Argument, description: str | None) -> dict[str, Any]:
        """The schema of the value of a key."""
        words = {word for made, word in _WORDS.items() if made in argument.types}
        if argument.is_number:
            words = (words - {"integer"}) | {"number"}
        allowed: list[dict[str, Any]] = [{"type": word} for word in sorted(words)]
        if argument.families:
            allowed.append(self._tables(argument))
        if NoneType in argument.types:
            allowed.append({"const": NONE})
        if argument.dimensions > 0:
            items = _any_of(allowed)
            for _ in range(argument.dimensions - 1):
                items = _any_of([*allowed, {"type": "array", "items": items}])
            allowed.append({"type": "array", "items": items})
        found, default = _any_of(allowed), argument.default
        if description:
            found = {"description": description} | found
        if not argument.required and default is not None and not isinstance(default, eqx.Module):
            found = found | {"default": list(default) if isinstance(default, tuple) else default}
        return found

    def _tables(self, argument: Argument) -> dict[str, Any]:
        """The schema of the tables of all kinds of an argument."""
        usual = argument.usual
        name = "any_" + "_or_".join(map(kind_name, argument.families)) + (f"_by_default_{usual.name}" if usual else "")
        if name not in self.definitions:
            self.definitions[name] = {}  # tables of this kind may hold others of the same kind
            each = [self._of_kind(kind, usual=kind is usual) for kind in argument.kinds.values()]
            self.definitions[name] = _any_of(each)
        return {"$ref": f"#/{_DEFINITIONS}/{name}"}

    def _of_kind(self, kind: Kind, *, usual: bool) -> dict[str, Any]:
        """A table of a kind, whose name is required unless it is the usual one."""
        name = kind.name if kind.is_class else f"{kind.makes.__name__}.{kind.name}"
        if name not in self.definitions:
            self.definitions[name] = {}
            found = self.table(kind.arguments, kind.make)
            # Reading accepts upper case, as models such as FBFBR are written.
            names = list(dict.fromkeys((kind.name, kind.name.upper())))
            self.definitions[name] = found | {"properties": {KIND: {"enum": names}} | found["properties"]}
        reference = {"$ref": f"#/{_DEFINITIONS}/{name}"}
        return reference if usual else {"allOf": [reference, {"required": [KIND]}]}


def _any_of(allowed: list[dict[str, Any]]) -> dict[str, Any]:
    return allowed[0] if len(allowed) == 1 else {"anyOf": list(allowed)}


def _described(make: Any) -> dict[str, str]:
    """The descriptions of arguments in the docstring of a class or function, or in that to which it refers."""
    text = inspect.getdoc(make) or ""
    if other := _REFERS.search(text):
        return _described(getattr(make.__self__, other[1]))
    block = text.partition("Args:\n")[2].partition("\n\nRaises:")[0]
    found = {name: " ".join(words.split()) for name, words in _ARGUMENT.findall(block)}
    renamed = RENAMED if make is Scene else {}
    return {renamed.get(str(name), str(name)): words for name, words in found.items()}
