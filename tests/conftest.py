"""Float64, a compilation cache that workers and runs share, reproducible random scenes, not too much compiled code."""

import gc
import hashlib
import os
import platform
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

# Before jax starts: on some processors it logs an error for every cached executable, though this very one wrote it.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import jax
import jaxtyping
import pytest
from hypothesis import HealthCheck, settings

# Compiling takes most of the tests' time. XLA's older, plainer code takes half of that, and runs slower; both cores are
# busy anyway, so that splitting a program among threads only costs. Tests of what everybody else gets:
# XLA_FLAGS= make test
PLAIN = "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"
if version("jaxlib").startswith("0.10."):
    PLAIN += " --xla_cpu_use_fusion_emitters=false"
if "XLA_FLAGS" not in os.environ:
    # A process that is given a flag which its XLA does not know is aborted, so another one tries; workers inherit.
    command = [sys.executable, "-c", "import jax; jax.devices()"]
    tried = subprocess.run(command, env=os.environ | {"XLA_FLAGS": PLAIN}, capture_output=True, check=False)
    os.environ["XLA_FLAGS"] = "" if tried.returncode else PLAIN

# By configuration, not JAX_ENABLE_X64: the command line is tested in processes that must switch it on themselves.
jax.config.update("jax_enable_x64", True)

os.environ.setdefault("MPLBACKEND", "Agg")

# Types and shapes of all functions hold while tests run; an int may stand for a float.
jaxtyping.install_import_hook("jaxwhisker", "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Wrong input on purpose has to meet the library's own checks."""
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
    """A name for this processor: code compiled for another one may not run here."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    features = sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))})
    return hashlib.sha256("\n".join([platform.machine(), *features]).encode()).hexdigest()[:12]


def pytest_collection_finish() -> None:
    """Tracing makes millions of objects, and Python looks through all of them for rings, again and again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)


def pytest_configure(config: pytest.Config) -> None:
    cache = getattr(config, "cache", None)
    shared = cache.mkdir("jax") if cache else Path(tempfile.gettempdir()) / "jaxwhisker-tests"
    directory = shared / _machine()
    # Through the environment, too: for the processes that tests start.
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(directory)
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.5"
    jax.config.update("jax_compilation_cache_dir", str(directory))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


MAPPINGS = 20_000  # of memory; where Linux allows a process 65,530, the compiler crashes beyond


@pytest.fixture(autouse=True, scope="module")
def _compiled_code_is_let_go():
    """What a module compiled is in the cache on disk; in memory every one of its thousands of kernels is a mapping."""
    yield
    try:
        mappings = len(Path("/proc/self/maps").read_text().splitlines())
    except OSError:
        return
    if mappings > MAPPINGS:
        jax.clear_caches()
