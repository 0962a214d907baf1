"""Compiled programs on disk: a bounded store of executables that later processes load instead of compiling.

The name of an entry has two parts. The key stands for what the program is traced from: a description of its function
and arguments, the sources that these depend on (sources.py), versions, and the kind of processor. A process that finds
an entry with its key loads it without tracing anything. The other part stands for the code that tracing leads to: after
a change of the sources that does not change the code, the program is traced again but not compiled.

Entries with other keys disappear when the store is full. A damaged entry is ignored with a warning and compiled again.
Entries are written to a temporary file and renamed, so processes may share the store.

`JAXWHISKER_CACHE` chooses the folder; the value `off` keeps nothing. An entry is code, and loading it runs it. A folder
or an entry that another user owns or can write to is therefore ignored with a warning.
"""

import dataclasses
import functools
import hashlib
import os
import pickle
import platform
import secrets
import stat
import sys
import tempfile
import threading
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import diffrax
import equinox
import jax
import jaxlib
import lineax
import numpy as np
import optimistix
from jax.experimental import serialize_executable
from jaxlib.utils import absl_set_min_log_level

from jaxwhisker._base import sources
from jaxwhisker._base.settings import device

LARGEST = 512 * 2**20  # bytes; when the store is larger, the entries that were not used for longest are deleted
MAGIC = b"jaxwhisker program 2\n"
DIGITS = 32  # of each part of a name
DIGEST = hashlib.sha256().digest_size
FATAL = 3  # the level of logs that XLA prints before it ends the process
SUFFIX = ".program"
UNFINISHED = SUFFIX + ".part"
# Settings of jax that change the program of a function.
SETTINGS = ("jax_enable_x64", "jax_numpy_dtype_promotion", "jax_default_matmul_precision", "jax_debug_nans")
# Number of lines in a report that XLA does not write: it changes nothing but the key in jax's own cache.
LINES = "xla_debug_buffer_assignment_show_max"


def folder() -> Path | None:
    """Where programs are kept; None if they are not."""
    chosen = os.environ.get("JAXWHISKER_CACHE", "")
    if chosen.lower() in ("off", "0", "no", "false"):
        return None
    try:
        if chosen:
            return Path(chosen).expanduser()
        shared = Path(os.environ.get("XDG_CACHE_HOME", ""))
        # Relative paths are to be ignored: https://specifications.freedesktop.org/basedir-spec
        return (shared if shared.is_absolute() else Path.home() / ".cache") / "jaxwhisker"
    except RuntimeError:  # the user has no home
        return None


def distrust(where: Path) -> str | None:
    """The reason not to use a folder that exists: others can put code into it."""
    try:
        return _others(where.stat())
    except OSError:
        return None


def obstacle(where: Path) -> str | None:
    """The reason why programs cannot be kept in a folder, which may not exist yet."""
    if reason := distrust(where):
        return reason
    existing = next(place for place in (where, *where.absolute().parents) if place.exists())
    if not existing.is_dir():
        return "it is a file" if existing == where else f"{existing} is a file"
    return None if os.access(existing, os.W_OK | os.X_OK) else f"{existing} cannot be written to"


@functools.cache
def _warn_once(where: Path, reason: str) -> None:
    text = f"Compiled programs are not kept in {where}: {reason}. Every process compiles them; JAXWHISKER_CACHE"
    warnings.warn(f"{text} sets another folder.", stacklevel=3)


def _others(status: os.stat_result) -> str | None:
    if hasattr(os, "getuid") and status.st_uid != os.getuid():
        return "it belongs to another user"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return "other users can write to it"
    return None


@functools.cache
def _platform(device: Any) -> str:
    """Everything that compiled code depends on but its source: versions and the processor."""
    versions = [module.__version__ for module in (np, jax, jaxlib, equinox, diffrax, optimistix, lineax)]
    compiler = device.platform, device.device_kind, device.client.platform_version, device.id
    return repr([platform.python_version(), versions, platform.machine(), _processor(), compiler])


def _processor() -> str:
    """Model and instruction sets of this processor: code compiled for another one may not run here."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))}))


def key_of(description: str) -> str:
    """The key of a program with this description, with the sources, versions and settings here."""
    return _checksum(description, sources.digest(description))


def name_of(key: str, lowered: jax.stages.Lowered, options: dict[str, Any]) -> str:
    """The name of the entry of a program that was traced."""
    return f"{key}-{_checksum(lowered.as_text(), repr(options))}"


def _checksum(*parts: str) -> str:
    settings = [os.environ.get("XLA_FLAGS", ""), *(getattr(jax.config, name) for name in SETTINGS)]
    return hashlib.sha256(repr((parts, _platform(device()), settings)).encode()).hexdigest()[:DIGITS]


def with_key(key: str) -> Any:
    """The contents of the entry with this key, or None if there is none or it cannot be used."""
    if (where := folder()) and (reason := distrust(where)):
        warnings.warn(f"Compiled programs are not kept in {where}: {reason}.", stacklevel=2)
        return None
    return _first(f"{key}-*")


def with_same_code(name: str) -> Any:
    """The contents of an entry with the same code as that of this name, whatever it was traced from."""
    return _first(f"*-{name.partition('-')[2]}")


def _first(pattern: str) -> Any:
    where = folder()
    found = [] if where is None else sorted(path.stem for path in where.glob(pattern + SUFFIX))
    return next((value for name in found if (value := load(name)) is not None), None)


def load(name: str) -> Any:
    """The contents of an entry, or None if there is none or it cannot be used."""
    where = folder()
    if where is None or distrust(where):
        return None
    path = where / (name + SUFFIX)
    try:
        with path.open("rb") as file:
            status, data = os.fstat(file.fileno()), file.read()
    except OSError:
        return None
    content = data[len(MAGIC) + DIGEST :]
    try:
        if reason := _others(status):
            raise ValueError(reason)
        if data[: len(MAGIC) + DIGEST] != _head(name, content):
            raise ValueError("its checksum is wrong")
        value = pickle.loads(zlib.decompress(content))
    except (AttributeError, ImportError):  # a class that an earlier version had under this name
        return None
    except Exception as error:  # whatever is wrong, the program can still be compiled
        _ignored(name, error)
        return None
    with suppress(OSError):  # of a file system that is read only
        os.utime(path)  # it was used just now
    return value


def _head(name: str, content: bytes) -> bytes:
    """The first bytes of an entry: its format, and a checksum of its name and content."""
    return MAGIC + hashlib.sha256(name.encode() + content).digest()


def _ignored(name: str, error: Exception) -> None:
    text = f"A cached program is ignored and compiled again: {name}{SUFFIX} in {folder()} ({error})."
    warnings.warn(text, stacklevel=3)


def save(name: str, value: Any) -> None:
    """Keep the contents of an entry. A store that cannot be written to is left alone, with one warning."""
    where = folder()
    if where is None or distrust(where):
        return
    if reason := obstacle(where):
        return _warn_once(where, reason)
    content = zlib.compress(pickle.dumps(value), 1)
    try:
        where.mkdir(parents=True, exist_ok=True, mode=0o700)
        if distrust(where):
            return
        handle, temporary = tempfile.mkstemp(dir=where, suffix=UNFINISHED)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_head(name, content) + content)
            os.replace(temporary, where / (name + SUFFIX))
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
        _shrink(where)
    except OSError as error:
        _warn_once(where, error.strerror or str(error))


def code(program: jax.stages.Compiled) -> Any:
    """What `executable` needs to load this program in another process; None if it has to be compiled there."""
    try:
        return serialize_executable.serialize(program)
    except Exception:  # such as a program that calls Python
        return None


def executable(code: Any) -> jax.stages.Compiled | None:
    """The program with this code, or None if it cannot be loaded."""
    chosen, (serialized, arguments, results) = device(), code
    try:
        if b"lapack" in serialized:
            # jax initialises LAPACK when it lowers a function that needs it. Without it the process would crash.
            jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), np.dtype(np.float32)))
        with silent():
            return serialize_executable.deserialize_and_load(serialized, arguments, results, chosen.client, [chosen])
    except Exception as error:  # whatever is wrong, the program can still be compiled
        text = f"A cached program in {folder()} is ignored and compiled again ({error})."
        warnings.warn(text, stacklevel=2)
        return None


_QUIET: list[None] = []  # one entry per thread that loads or compiles a program


@contextmanager
def silent() -> Iterator[None]:
    """Keep XLA from logging errors.

    On some processors it logs that a program may crash whenever it loads one, even one that the same processor compiled
    (openxla/xla#44565). After two minutes of compilation, it asks for a bug report.
    """
    _QUIET.append(None)
    absl_set_min_log_level(FATAL)
    try:
        yield
    finally:
        _QUIET.pop()
        if not _QUIET:
            absl_set_min_log_level(int(os.environ.get("TF_CPP_MIN_LOG_LEVEL", "1")))  # the default of jax


def compiled(lowered: jax.stages.Lowered, options: dict[str, Any]) -> tuple[jax.stages.Compiled, Any]:
    """Compile a program; return it with its code, or None for what has to be compiled in every process."""
    with _complete() as is_complete:
        program = lowered.compile(options)
    if not is_complete():
        with _complete() as is_complete:  # under a key that no process has used before
            again: dict[str, Any] = options | {LINES: 1 + secrets.randbelow(2**62)}
            program = lowered.compile(again)
    return program, code(program) if is_complete() else None


@contextmanager
def _complete() -> Iterator[Callable[[], bool]]:
    """Find out whether this thread really compiles a program, or gets it from jax's own cache.

    The code of a program from that cache lacks its kernels when it is stored once more.
    """
    thread, found = threading.get_ident(), []

    def listen(event: str, **_) -> None:
        if event == "/jax/compilation_cache/cache_hits" and threading.get_ident() == thread:
            found.append(event)

    jax.monitoring.register_event_listener(listen)
    try:
        yield lambda: not found
    finally:
        with suppress(Exception):  # someone else has removed all listeners
            jax.monitoring.unregister_event_listener(listen)


def entries(where: Path) -> list[tuple[Path, os.stat_result]]:
    """Files of the store, with their properties; the least recently used one comes first."""
    found = []
    for path in [*where.glob("*" + SUFFIX), *where.glob("*" + UNFINISHED)]:
        try:
            found.append((path, path.stat()))
        except OSError:  # another process has just deleted it
            continue
    return sorted(found, key=lambda entry: entry[1].st_mtime)


def _shrink(where: Path) -> None:
    found = entries(where)
    excess = sum(status.st_size for _, status in found) - LARGEST
    for path, status in found:
        if excess <= 0:
            return
        path.unlink(missing_ok=True)
        excess -= status.st_size


def clear() -> int:
    """Delete all entries; return their number."""
    where = folder()
    found = [] if where is None else entries(where)
    for path, _ in found:
        path.unlink(missing_ok=True)
    return sum(path.suffix == SUFFIX for path, _ in found)


KNOWN = {"builtins", "diffrax", "equinox", "functools", "jax", "jaxlib", "jaxwhisker", "lineax", "numpy", "optimistix"}


def describe(value: Any) -> str | None:
    """A description of a program's arguments, in which `...` stands for arrays; None if other code is part of them.

    Two values with the same description lead to the same program. Functions and classes of users have none: their code
    may change between two processes.
    """
    try:
        return _described(value)
    except _UnknownError:
        return None


class _UnknownError(Exception):
    """A value whose code belongs neither to this package nor to the libraries whose versions are known."""


def _described(value: Any) -> str:
    if value is None or value is ... or isinstance(value, (bool, int, float, complex, str, bytes)):
        return repr(value)
    if isinstance(value, np.dtype):
        return repr(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key!r}: {_described(value[key])}" for key in value) + "}"
    if isinstance(value, functools.partial):
        return f"partial({_described([value.func, value.args, value.keywords])})"
    if isinstance(value, type) or not (isinstance(value, (list, tuple)) or dataclasses.is_dataclass(value)):
        return _named(value)
    if dataclasses.is_dataclass(value):
        parts = [_described(getattr(value, field.name, None)) for field in dataclasses.fields(value)]
    else:
        parts = [_described(part) for part in value]
    return f"{_named(type(value))}({', '.join(parts)})"


def _named(value: Any) -> str:
    """Module and name of a function or class that is known by these."""
    module, name = getattr(value, "__module__", None) or "", getattr(value, "__qualname__", "")
    found: Any = sys.modules.get(module) if module.partition(".")[0] in KNOWN and name else None
    for part in name.split("."):
        found = getattr(found, part, None)
    # The name of a function may be that of another one, which wraps it; a program that decorates it is as good.
    if found is not value and getattr(found, "function", None) is not value:
        raise _UnknownError
    return f"{module}.{name}"
