"""The command `reproduce`: the thesis's results."""

import argparse
from pathlib import Path

from jaxwhisker.cli.options import OK, UsageError

HELP = """\
Compute and draw the results of the thesis: tables A.1-A.4, figures 5.10-5.16,
6.1-6.24 and 7.4, each as PNG with the data behind it as CSV, its claims with
numbers (claims.md), and all of it on one page (README.md, index.html).
"""


def add(commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "reproduce",
        help="the thesis's tables, figures and claims",
        description=HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument(
        "--out", type=Path, default=Path("out"), metavar="DIR", help="folder for the results (default: %(default)s)"
    )
    command.add_argument(
        "--only",
        metavar="NAME[,NAME...]",
        help="only these figures, tables or the claims, e.g. 6.2,A.1,claims (default: everything)",
    )
    command.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from jaxwhisker.thesis import names, reproduce

    try:
        wanted = None if args.only is None else names(args.only)
    except ValueError as error:
        raise UsageError(str(error)) from None
    if args.out.exists() and not args.out.is_dir():
        raise UsageError(f"cannot write to {args.out}: it is a file")
    try:
        reproduce(args.out, wanted)
    except ImportError as error:
        raise UsageError(str(error)) from None
    return OK
