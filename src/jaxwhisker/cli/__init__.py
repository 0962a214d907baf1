"""The command `jaxwhisker`: scan, film or explore one scene, study many scenes, or identify a scene from signals."""

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import version

import jax

from jaxwhisker.cli.cache import add_cache
from jaxwhisker.cli.explore import add_explore
from jaxwhisker.cli.film import add_film
from jaxwhisker.cli.inverse import add_identify, add_reconstruct
from jaxwhisker.cli.options import INTERRUPTED, NO_CONTACT, NOT_ALL_OK, OK, USAGE, UsageError, short_warnings
from jaxwhisker.cli.reproduce import add_reproduce
from jaxwhisker.cli.scan import add_scan
from jaxwhisker.cli.schema import add_schema
from jaxwhisker.cli.study import add_study

__all__ = ["INTERRUPTED", "NOT_ALL_OK", "NO_CONTACT", "OK", "USAGE", "main"]


class _Parser(argparse.ArgumentParser):
    def error(self, message: str):
        # argparse would print the usage as well, which hides this line.
        self.exit(USAGE, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="jaxwhisker", description="Quasi-static scans with elastically coupled tactile whiskers.")
    parser.add_argument("--version", action="version", version=f"jaxwhisker {version('jaxwhisker')}")
    commands = parser.add_subparsers(dest="command", metavar="command", required=True)
    for add in (add_scan, add_film, add_explore, add_study, add_identify, add_reconstruct, add_reproduce, add_cache):
        add(commands)
    add_schema(commands)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    Wrong options and parameters, and files that cannot be written, end with one line on stderr and exit code 2.
    """
    parser = _parser()
    try:
        args = parser.parse_args(argv)
    except SystemExit as stop:  # argparse has printed the reason
        return stop.code if isinstance(stop.code, int) else USAGE
    jax.config.update("jax_enable_x64", True)
    try:
        with short_warnings():
            return args.run(args)
    except (UsageError, OSError, MemoryError) as error:
        message = " ".join(str(error).split()) or "not enough memory"
        print(f"{parser.prog} {args.command}: error: {message}", file=sys.stderr)
        return USAGE
    except KeyboardInterrupt:
        return INTERRUPTED
