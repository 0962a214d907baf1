"""Processor time of the tests with empty caches: which tests take longest, and what each package takes.

python benchmarks/time_of_tests.py

The caches of the tests are deleted first. Times include compiler threads and child processes. A test that shares
programs with others pays for those that it needs first.
"""

import json
import shutil
import subprocess
import tempfile
import time
from collections import defaultdict
from pathlib import Path

from common import write

ROOT = Path(__file__).parents[1]
CACHES = (ROOT / ".cache", ROOT / ".pytest_cache")  # also of which tests have passed
LONG = 20.0  # seconds of processor time beyond which a test is listed
MINUTE = 60.0


def measured() -> tuple[dict[str, float], float]:
    """Processor time of each test of `make test`, and the wall time of all."""
    for cache in CACHES:
        shutil.rmtree(cache, ignore_errors=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "times"
        start = time.monotonic()
        command = ["make", "--no-print-directory", "test", f"PYTEST_OPTIONS=--times={path}"]
        subprocess.run(command, cwd=ROOT, check=True)
        wall = time.monotonic() - start
        return dict(map(json.loads, path.read_text("utf-8").splitlines())), wall


def tables(times: dict[str, float], wall: float) -> None:
    """Write one table of tests and one of packages."""
    ordered = sorted(times.items(), key=lambda entry: -entry[1])
    write("test_times", [{"test": name, "CPU, s": seconds} for name, seconds in ordered if seconds > LONG])
    packages: dict[str, list[float]] = defaultdict(list)
    for name, seconds in ordered:
        packages["/".join(name.split("/")[:2])].append(seconds)
    rows = [{"tests of": name, "number": len(own), "CPU, min": sum(own) / MINUTE} for name, own in packages.items()]
    rows.sort(key=lambda row: -row["CPU, min"])
    total = {"tests of": "all", "number": len(times), "CPU, min": sum(times.values()) / MINUTE}
    write("test_packages", [*rows, total | {"wall, min": wall / MINUTE}])


if __name__ == "__main__":
    tables(*measured())
