"""Which options a command line has, whatever their defaults."""

import argparse
from typing import Any


class Noted(argparse.Action):
    """Store a value, and note the option in `given`."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        setattr(namespace, self.dest, values)
        if option_string is not None:
            namespace.given = given(namespace) | {self.dest}


def note_options(command: argparse.ArgumentParser) -> None:
    """Note the options of a command that store a value."""
    command.register("action", None, Noted)


def given(args: argparse.Namespace) -> frozenset[str]:
    """Names of the values that were noted."""
    return getattr(args, "given", frozenset())
