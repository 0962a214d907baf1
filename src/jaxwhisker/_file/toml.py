"""TOML beyond `tomllib`: the line of every value of a document, and the text of a document."""

import bisect
import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any, TypeAlias

Place: TypeAlias = tuple[str | int, ...]  # keys of tables and indices of arrays that lead to a value

_BLANK = re.compile(r"(?:\s|#[^\n]*)*")
_SPACE = re.compile(r"[ \t]*")
_KEY = re.compile(r"\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'|[\w-]+")
_PLAIN = re.compile(
    r'"""(?:[^\\]|\\.)*?"""(?:"{0,2})|' + r"'''.*?'''(?:'{0,2})|"  # strings of several lines
    r"\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'|"
    r"[^\s,\]}#]+(?: \d\d:[^\s,\]}#]+)?",  # numbers, words and times
    re.DOTALL,
)
WIDTH = 100  # characters of a line; longer arrays have a line for each element


def lines_of(text: str) -> dict[Place, int]:
    """The line of every key, table and element of a document that `tomllib` accepts, counted from 1."""
    return _Lines(text.replace("\r\n", "\n")).found


class _Lines:
    """Walks through a document that is known to be valid."""

    def __init__(self, text: str):
        self.found: dict[Place, int] = {}
        self._text, self._at = text, 0
        self._starts = [0, *(match.end() for match in re.finditer("\n", text))]
        self._last: dict[Place, int] = {}  # the index of the last table of each array of tables
        base: Place = ()
        while self._after_blanks() < len(text):
            if text[self._at] == "[":
                base = self._header()
            else:
                self._pair(base)

    def _skip(self, pattern: re.Pattern) -> str:
        match = pattern.match(self._text, self._at)
        assert match is not None
        self._at = match.end()
        return match[0]

    def _after_blanks(self) -> int:
        self._skip(_BLANK)
        return self._at

    def _note(self, place: Place) -> None:
        line = bisect.bisect_right(self._starts, self._at)
        for size in range(1, len(place) + 1):
            self.found.setdefault(place[:size], line)

    def _keys(self) -> list[str]:
        keys = []
        while True:
            self._skip(_SPACE)
            key = self._skip(_KEY)
            keys.append(tomllib.loads(f"key = {key}")["key"] if key[0] in "\"'" else key)
            self._skip(_SPACE)
            if self._text[self._at] != ".":
                return keys
            self._at += 1

    def _header(self) -> Place:
        several = self._text.startswith("[[", self._at)
        start = self._at
        self._at += 1 + several
        *above, own = self._keys()
        end = self._at + 1 + several
        place: Place = ()
        for key in above:
            place = (*place, key)
            place += (self._last[place],) if place in self._last else ()
        place = (*place, own)
        if several:
            self._last[place] = self._last.get(place, -1) + 1
            place = (*place, self._last[place])
        self._at = start
        self._note(place)
        self._at = end
        return place

    def _pair(self, base: Place) -> None:
        start = self._at
        place = (*base, *self._keys())
        end, self._at = self._at + 1, start
        self._note(place)
        self._at = end
        self._skip(_SPACE)
        self._value(place)

    def _value(self, place: Place) -> None:
        self._note(place)
        opening = self._text[self._at]
        if opening not in "[{":
            self._skip(_PLAIN)
            return
        self._at, index = self._at + 1, 0
        while self._text[self._after_blanks()] not in "]}":
            if self._text[self._at] == ",":
                self._at += 1
            elif opening == "{":
                self._pair(place)
            else:
                self._value((*place, index))
                index += 1
        self._at += 1


def text_of(document: Mapping[str, Any]) -> str:
    """The text of a document of tables, arrays, numbers, texts and truth values.

    Tables and arrays of tables have headers, unless an array holds something else as well.
    """
    return "\n\n".join(_blocks(document, ())) + "\n"


def _blocks(table: Mapping[str, Any], keys: tuple[str, ...], header: str = "") -> list[str]:
    lines, further = [header] * bool(header), []
    for key, value in table.items():
        below = (*keys, key)
        if isinstance(value, Mapping):
            further += _blocks(value, below, f"[{'.'.join(below)}]")
        elif isinstance(value, list) and value and all(isinstance(one, Mapping) for one in value):
            for one in value:
                further += _blocks(one, below, f"[[{'.'.join(below)}]]")
        else:
            lines.append(f"{key} = {_literal(value)}")
    # A table that only holds tables needs no header, but an element of an array does.
    return further if further and lines in ([], [f"[{'.'.join(keys)}]"]) else ["\n".join(lines), *further]


def _literal(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_literal(one)}" for key, one in value.items()) + " }"
    parts = [_literal(one) for one in value]
    flat = f"[{', '.join(parts)}]"
    return flat if len(flat) <= WIDTH else "[\n" + "".join(f"    {part},\n" for part in parts) + "]"
