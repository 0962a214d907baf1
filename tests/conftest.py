"""Float64, caches of compiled code shared by workers and runs, reproducible random scenes, limited compiled code.

`--check-types` enforces types and shapes of all arguments and results. The package then takes five times as long to
import and ten percent longer to trace, so `make test` does this for the tests of the lowest packages only.
"""

import contextlib
import ctypes
import gc
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

# Before jax starts: on some processors it logs an error for every cached executable, even its own.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import jax
import jaxtyping
import pytest
from hypothesis import HealthCheck, settings

import unchanged

# Compilation takes most of the tests' time. With these options it takes half as long, and the code runs slower. Both
# cores are busy anyway: splitting a program among threads only adds cost. To test with the default options, run
# XLA_FLAGS= make test
PLAIN = "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"
if version("jaxlib").startswith("0.10."):
    PLAIN += " --xla_cpu_use_fusion_emitters=false"
if "XLA_FLAGS" not in os.environ:
    # XLA aborts a process with an unknown flag, and therefore another process tries them; workers inherit the result.
    command = [sys.executable, "-c", "import jax; jax.devices()"]
    tried = subprocess.run(command, env=os.environ | {"XLA_FLAGS": PLAIN}, capture_output=True, check=False)
    os.environ["XLA_FLAGS"] = "" if tried.returncode else PLAIN

# Not through JAX_ENABLE_X64: tests of the command line start processes that must enable float64 themselves.
jax.config.update("jax_enable_x64", True)

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("MALLOC_ARENA_MAX", "2")  # of workers, so that memory that one thread freed serves the others

# Not in the user's home. JAXWHISKER_CACHE=off runs the tests without stored programs.
os.environ.setdefault("JAXWHISKER_CACHE", str(Path(__file__).parents[1] / ".cache" / "programs"))


BEARTYPE = "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"  # an int is accepted as a float


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--check-types", action="store_true", help="enforce types and shapes of all arguments")
    parser.addoption(
        "--unchanged",
        nargs="?",
        const=str(unchanged.RECORDS),
        metavar="FILE",
        help="leave out tests that have passed with the same sources, which this file records",
    )
    parser.addoption("--times", metavar="FILE", help="append the processor time of every test to this file")


# Tests that compile for the longest time for features that other tests cover as well; `make test` leaves them out.
LONG = Path(__file__).with_name("long.txt")
LAST_START = float(os.environ.get("JAXWHISKER_LONG_UNTIL", "inf"))  # seconds since 1970
HOUR = 3600  # seconds
STRIDE = 37  # long tests, of about 800


class _Missing(pytest.Item):
    """Fails, because `long.txt` names a test that does not exist. Of an error in a hook, xdist shows no message."""

    def runtest(self) -> None:
        raise AssertionError(f"{LONG} names a test that does not exist: {self.name}")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(session: pytest.Session, config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark long tests."""
    names = set(LONG.read_text("utf-8").splitlines())
    long = [item for item in items if item.nodeid in names]
    for item in long:
        item.add_marker(pytest.mark.long)
    if config.getoption("markexpr") != "long":
        return
    for name in sorted(names - {item.nodeid for item in long}):
        items.append(_Missing.from_parent(session, name=name))
        items[-1].add_marker(pytest.mark.long)
    if float("inf") > LAST_START:  # begin with others every hour, so that those left out are not always the same
        first = items.index(long[int(LAST_START / HOUR) * STRIDE % len(long)])
        items[:] = items[first:] + items[:first]


WORKER = 3e9  # bytes that a worker may need


def _memory() -> float:
    """Bytes of this machine."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # on other systems
        return 16e9


def pytest_xdist_auto_num_workers() -> int:
    """One worker per core, as far as the memory allows."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, int(_memory() / WORKER)))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let intentionally wrong input reach the library's own checks, and start no long test too late."""
    if item.get_closest_marker("long") and time.time() > LAST_START:
        pytest.skip("no time is left for long tests (JAXWHISKER_LONG_UNTIL)")
    jaxtyping.config.update("jaxtyping_disable", item.get_closest_marker("unchecked") is not None)


settings.register_profile(
    "ci",
    deadline=None,  # the first example compiles
    derandomize=True,
    max_examples=25,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("ci")


def _machine() -> str:
    """Name of this processor: code compiled for another one may not run here."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    features = sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))})
    return hashlib.sha256("\n".join([platform.machine(), *features]).encode()).hexdigest()[:12]


def pytest_collection_finish() -> None:
    """Collect garbage less often: tracing creates millions of objects, which every collection visits."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)


def pytest_configure(config: pytest.Config) -> None:
    if records := config.getoption("unchanged"):
        typed, worker = bool(config.getoption("check_types")), hasattr(config, "workerinput")
        config.pluginmanager.register(unchanged.Unchanged(Path(records), typed, worker))
    if config.getoption("check_types"):
        jaxtyping.install_import_hook("jaxwhisker", BEARTYPE)
    cache = getattr(config, "cache", None)
    shared = cache.mkdir("jax") if cache else Path(tempfile.gettempdir()) / "jaxwhisker-tests"
    directory = shared / _machine()
    # Also in the environment, for processes that tests start.
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(directory)
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"  # even a tiny program takes 10 ms to compile
    jax.config.update("jax_compilation_cache_dir", str(directory))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _processor_time() -> float:
    """Seconds of this process, with its compiler threads, and of the processes that it has started."""
    return sum(os.times()[:4])


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> None:
    """Attach the processor time since the last test to the last report of this one."""
    if call.when == "teardown":
        now = _processor_time()
        item.user_properties.append(("processor time", now - _LAST.get(0, 0.0)))
        _LAST[0] = now


_LAST: dict[int, float] = {}


def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    """Write processor times, of all workers, to the file of `--times`."""
    path = config.getoption("times")
    if path is None:
        return
    reports = [one for every in terminalreporter.stats.values() for one in every if hasattr(one, "when")]
    times = {one.nodeid: dict(one.user_properties)["processor time"] for one in reports if one.when == "teardown"}
    with Path(path).open("a", encoding="utf-8") as file:
        file.writelines(json.dumps([name, seconds]) + "\n" for name, seconds in times.items())


MAPPINGS = 40_000  # of memory; Linux allows 65,530 per process, beyond which the compiler crashes
SHARE = 0.2  # of the machine's memory that a worker may use when the next module begins


@pytest.fixture(autouse=True, scope="module")
def _release_compiled_code():
    """Release what a test module has compiled if it is much; most of it stays in the caches on disk."""
    yield
    try:
        mappings = len(Path("/proc/self/maps").read_text().splitlines())
        memory = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return
    if mappings > MAPPINGS or memory > max(WORKER / 2, SHARE * _memory()):
        from jaxwhisker._base import program  # after the import hook

        jax.clear_caches()
        program.clear()
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):  # of other C libraries
            ctypes.CDLL(None).malloc_trim(0)
