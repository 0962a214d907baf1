"""From the tables of a file to the parts of a scene, with errors that name the file and the line."""

import difflib
import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jax.errors import JAXTypeError

from jaxwhisker._file.kinds import NONE, Argument, Arguments
from jaxwhisker._file.toml import Place, lines_of

KIND = "kind"


class SceneFileError(ValueError):
    """An error in a file that describes a scene."""


class Document:
    """A file: its tables, the lines of its values, and the objects that its tables describe.

    Args:
        path: of the file, which error messages name.
        tables: of the file; numbers may be traced.
        lines: of keys, tables and elements.
    """

    def __init__(self, path: str | Path, tables: Mapping[str, Any], lines: Mapping[Place, int]):
        self.path, self.tables, self._lines = path, tables, lines

    @classmethod
    def read(cls, path: str | Path) -> "Document":
        """The document in a file.

        Raises:
            SceneFileError: if there is no such file, or it is not TOML.
        """
        try:
            text = Path(path).read_text("utf-8-sig")
        except (OSError, TypeError, UnicodeDecodeError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise SceneFileError(f"`path` must be the path of a TOML file, got {path}: {why}.") from None
        try:
            tables = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            what, _, where = str(error).rpartition(" (at ")
            line = re.match(r"line \d+", where)
            last = f"line {len(text.splitlines())}"
            raise SceneFileError(f"{path}, {line[0] if line else last}: not TOML: {what or error}.") from None
        return cls(path, tables, lines_of(text))

    def with_tables(self, tables: Mapping[str, Any]) -> "Document":
        """The document with other values at the same places."""
        return Document(self.path, tables, self._lines)

    def error(self, place: Place, message: str, what: str = "") -> SceneFileError:
        """The error about the value at a place, in a table of this kind."""
        while place and place not in self._lines:
            place = place[:-1]
        line = f", line {self._lines[place]}" if place else ""
        return SceneFileError(f"{self.path}{line}{f' ({what})' * bool(what)}: {message}")

    def call(
        self,
        make: Callable[..., Any],
        arguments: Arguments,
        table: Mapping[str, Any],
        place: Place,
        what: str,
        renamed: Mapping[str, str] | None = None,
    ) -> Any:
        """What a function makes of the keys of a table.

        Args:
            make: the function.
            arguments: its arguments.
            table: the keys with their values.
            place: of the table.
            what: its name in messages.
            renamed: names of keys, where they differ from those that errors of the function name.

        Raises:
            SceneFileError: if a key is unknown or missing, or the function rejects a value.
        """
        for key in table:
            if key not in arguments:
                close = difflib.get_close_matches(key, arguments, n=1)
                hint = f" Did you mean `{close[0]}`?" if close else ""
                known = ", ".join(arguments) or "no keys"
                raise self.error((*place, key), f"`{key}` is not a key of {what}, which has {known}.{hint}")
        missing = [key for key, argument in arguments.items() if argument.required and key not in table]
        if missing:
            raise self.error(place, f"`{missing[0]}` is missing in {what}.")
        given = {key: self._value(value, (*place, key), arguments[key]) for key, value in table.items()}
        try:
            return make(**given)
        except (ValueError, TypeError) as error:
            if isinstance(error, SceneFileError | JAXTypeError):
                raise
            message = str(error)
            for name, key in (renamed or {}).items():
                message = message.replace(f"`{name}`", f"`{key}`")
            named = next((key for key in re.findall(r"`(\w+)", message) if key in table), None)
            raise self.error(place if named is None else (*place, named), message, what) from error

    def _value(self, given: Any, place: Place, argument: Argument) -> Any:
        if given == NONE:
            return None
        if isinstance(given, Mapping):
            return self._object(given, place, argument)
        if isinstance(given, list):
            return tuple(self._value(one, (*place, k), argument) for k, one in enumerate(given))
        return given

    def _object(self, table: Mapping[str, Any], place: Place, argument: Argument) -> Any:
        own, kinds, usual = table.get(KIND), argument.kinds, argument.usual
        key = next(part for part in reversed(place) if isinstance(part, str))
        if not kinds:
            raise self.error(place, f"`{key}` must not be a table, got one with {', '.join(table) or 'no keys'}.")
        allowed = ", ".join(kinds)
        if own is None and usual is None:
            raise self.error(place, f"`{KIND}` is missing in `{key}`; it must be one of {allowed}.")
        found = usual if own is None else kinds.get(own.lower()) if isinstance(own, str) else None
        if found is None:
            close = difflib.get_close_matches(str(own).lower(), kinds, n=1)
            hint = f" Did you mean {close[0]}?" if close else ""
            raise self.error((*place, KIND), f"`{KIND}` of `{key}` must be one of {allowed}, got {own!r}.{hint}")
        without = {name: value for name, value in table.items() if name != KIND}
        return self.call(found.make, found.arguments, without, place, key if own is None else found.name)
