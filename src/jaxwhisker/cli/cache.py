"""The command `cache`: compiled programs on disk."""

import argparse
import os
from pathlib import Path

from jaxwhisker._base import store
from jaxwhisker.cli import options


def add_cache(commands) -> None:
    """Add the command `cache`."""
    command = options.add_command(commands, run_cache, "compiled programs on disk")
    command.add_argument("--clear", action="store_true", help="delete all programs")


def run_cache(args: argparse.Namespace) -> int:
    """Show the number, size and folder of compiled programs on disk, or delete them.

    Programs are compiled once for each kind of scene and kept for later processes.
    Programs that contain your own functions, such as Graph(function), are compiled
    in every process. When the cache is full, the programs that were unused for
    longest are deleted. You can clear it at any time.

    The environment variable JAXWHISKER_CACHE sets another folder. The value "off"
    turns the cache off.

    exit codes:
      0  done
      2  an option is wrong, or a program cannot be deleted
    """
    where = store.folder()
    if where is None:
        reason = "JAXWHISKER_CACHE is off" if os.environ.get("JAXWHISKER_CACHE") else "there is no home folder"
        print(f"The cache is off ({reason}): every process compiles its programs.")
        return options.OK
    if args.clear:
        size = _size(where)
        print(f"deleted {_programs(store.clear())}, {size}, from {where}")
        return options.OK
    count = sum(path.suffix == store.SUFFIX for path, _ in store.entries(where))
    print(f"{_programs(count)}, {_size(where)} of at most {_megabytes(store.LARGEST)}, in {where}")
    if reason := store.obstacle(where):
        print(f"The cache is not used: {reason}.")
    return options.OK


def _programs(count: int) -> str:
    return "1 program" if count == 1 else f"{count} programs"


def _size(where: Path) -> str:
    return _megabytes(sum(status.st_size for _, status in store.entries(where)))


def _megabytes(size: float) -> str:
    return f"{size / 2**20:.{0 if size % 2**20 == 0 else 1}f} MB"
