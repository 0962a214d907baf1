"""Options that a command line has are noted, even with their defaults."""

import argparse

from jaxwhisker.cli.given import given, note_options


def test_options_are_noted():
    parser = argparse.ArgumentParser()
    note_options(parser)
    group = parser.add_argument_group("numbers")
    group.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--name", choices=("a", "b"))
    parser.add_argument("--flag", action="store_true")
    parser.add_argument("file", nargs="?")
    args = parser.parse_args(["--size", "1", "x.csv", "--flag"])
    assert (args.size, args.name, args.flag, args.file) == (1.0, None, True, "x.csv")
    assert given(args) == {"size"}
    assert given(parser.parse_args([])) == frozenset()
