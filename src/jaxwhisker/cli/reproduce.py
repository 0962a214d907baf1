"""The command `reproduce`: the results of the thesis."""

import argparse
from pathlib import Path

from jaxwhisker.cli import options


def add_reproduce(commands) -> None:
    """Add the command `reproduce`."""
    command = options.add_command(commands, run_reproduce, "tables, figures and claims of the thesis")
    text = "folder for the results (default: %(default)s)"
    command.add_argument("--out", type=Path, default=Path("out"), metavar="DIR", help=text)
    text = "only these figures, tables or the claims, e.g. 6.2,A.1,claims (default: everything)"
    command.add_argument("--only", metavar="NAME[,NAME...]", help=text)


def run_reproduce(args: argparse.Namespace) -> int:
    """Compute and draw the results of the thesis: tables A.1 to A.4, figures 5.10 to
    5.16, 6.1 to 6.24 and 7.4, each as PNG with its data as CSV, and the claims with
    numbers (claims.md). One page shows all of them (index.html, README.md).
    """
    from jaxwhisker.thesis.reproduce import parse_names, reproduce

    with options.usage_errors():
        names = None if args.only is None else parse_names(args.only)
        args.out.mkdir(parents=True, exist_ok=True)
        options.check_writable(args.out, folder=True)
        reproduce(args.out, names)
    return options.OK
