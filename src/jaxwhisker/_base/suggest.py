"""Errors about unknown names that suggest a similar one, in notebooks as well."""

import dataclasses
import difflib
from collections.abc import Iterable
from typing import dataclass_transform

import equinox as eqx


def no_attribute(owner: str, name: str, known: Iterable[str]) -> AttributeError:
    """The error for an unknown attribute of an owner with these known ones."""
    public = {each.lower(): each for each in known if not each.startswith("_")}
    close = [] if name.startswith("_") else difflib.get_close_matches(name.lower(), public, n=1)
    hint = f". Did you mean {public[close[0]]!r}?" if close else ""
    # Without the object: Python would append its own suggestion on terminals.
    return AttributeError(f"{owner} has no attribute {name!r}{hint}", name=name, obj=None)


@dataclass_transform(field_specifiers=(dataclasses.field, eqx.field))  # as that of equinox, for type checkers
class Suggesting(type(eqx.Module)):
    """The type of classes whose constructors have names, such as `Support.fb`."""

    def __getattr__(cls, name: str):
        raise no_attribute(f"type object {cls.__name__!r}", name, dir(cls))
