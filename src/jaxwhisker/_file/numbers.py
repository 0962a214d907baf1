"""The numbers of a scene in a file as parameters with names, for fits and sliders."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from jaxwhisker._file.kinds import Argument, Arguments, scene_arguments
from jaxwhisker._file.reading import KIND, Document
from jaxwhisker._file.toml import Place


class Number(NamedTuple):
    """A number in a file."""

    place: Place
    value: float
    listed: bool  # whether it is an element of an array of numbers


def numbers_of(document: Document) -> dict[str, Number]:
    """The numbers of a scene that may vary, by names.

    A name consists of the keys that lead to the number and of positions in arrays, from 1: `objects.2.radius`. Keys in
    front are left out as long as no other number has the same name, and so is the position of a single element.
    """
    found = list(_below(document.tables, (), scene_arguments()))
    longest = [_words(number.place, document.tables) for number in found]
    names = {}
    for number, words in zip(found, longest, strict=True):
        own = next(k for k in range(len(words) - 1, -1, -1) if _is_alone(words[k:], longest))
        names[".".join(words[own:])] = number
    return names


def chosen(name: str, numbers: Mapping[str, Number], document: Document) -> list[str]:
    """The names of the numbers that a name stands for: one number, or all with a key, also of several parts."""
    words = name.split(".")
    return [
        known
        for known, number in numbers.items()
        if name == known or _stands_for(words, _words(number.place, document.tables))
    ]


def with_values(document: Document, numbers: Mapping[str, Number], values: Mapping[str, Any]) -> Document:
    """The document with other values of some numbers, which may be traced."""
    tables = _copied(document.tables)
    for name, value in values.items():
        *above, own = numbers[name].place
        table = tables
        for key in above:
            table = table[key]
        table[own] = value
    return document.with_tables(tables)


def _below(table: Mapping[str, Any], place: Place, arguments: Arguments) -> Iterator[Number]:
    for key, value in table.items():
        if key in arguments:
            yield from _in_value(value, (*place, key), arguments[key], False)


def _in_value(value: Any, place: Place, argument: Argument, listed: bool) -> Iterator[Number]:
    if isinstance(value, Mapping):
        kind = argument.kinds[value[KIND].lower()] if KIND in value else argument.usual
        assert kind is not None  # the scene has been read
        yield from _below(value, place, kind.arguments)
    elif isinstance(value, list):
        for k, one in enumerate(value):
            yield from _in_value(one, (*place, k), argument, True)
    elif argument.is_number and isinstance(value, int | float) and not isinstance(value, bool):
        yield Number(place, float(value), listed)


def _words(place: Place, tables: Any) -> list[str]:
    """The words of a place: its keys, and positions from 1 in arrays of several elements."""
    words, here = [], tables
    for part in place:
        if isinstance(part, str):
            words.append(part)
        elif len(here) > 1:
            words.append(str(part + 1))
        here = here[part]
    return words


def _is_alone(words: list[str], others: list[list[str]]) -> bool:
    """Whether the words begin with a key, and are the last words of one of the others only."""
    return not words[0].isdecimal() and sum(other[-len(words) :] == words for other in others) == 1


def _stands_for(words: list[str], full: list[str]) -> bool:
    """Whether the words are the last ones, but for positions in an array behind them."""
    end = len(full)
    while end and full[end - 1].isdecimal() and full[:end][-len(words) :] != words:
        end -= 1
    return full[:end][-len(words) :] == words


def _copied(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _copied(one) for key, one in value.items()}
    return [_copied(one) for one in value] if isinstance(value, list) else value
