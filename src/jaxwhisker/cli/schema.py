"""The command `schema`: the JSON schema of files that describe scenes."""

import argparse
import json

from jaxwhisker.cli import options


def add_schema(commands) -> None:
    """Add the command `schema`."""
    options.add_command(commands, run_schema, "print the JSON schema of files that describe scenes")


def run_schema(args: argparse.Namespace) -> int:
    """Print the JSON schema of the TOML files that describe scenes.

    Editors that know TOML check files with it, and show the documentation of keys.

    exit code: 0

    example:
      jaxwhisker schema > scene.schema.json
    """
    from jaxwhisker._file.schema import schema

    del args
    print(json.dumps(schema(), indent=2))
    return options.OK
