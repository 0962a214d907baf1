"""Compiled programs on disk: a bounded store of executables that later processes load instead of compiling.

An entry is valid for one version of this package, of jax and the libraries it compiles, and for one kind of processor.
Entries of other versions are never looked up, and disappear when the store is full. A damaged entry is ignored with a
warning and compiled again. Entries are written to a temporary file and renamed, so processes may share the store.

`JAXWHISKER_CACHE` chooses the folder; the value `off` keeps nothing. Like any cache of compiled code, the folder must
belong to the user: whoever can write to it can run code in the processes that read it.
"""

import dataclasses
import functools
import hashlib
import os
import pickle
import platform
import tempfile
import warnings
import zlib
from pathlib import Path
from typing import Any

import diffrax
import equinox
import jax
import jaxlib
import lineax
import numpy as np
import optimistix

LARGEST = 512 * 2**20  # bytes; when the store is larger, the entries that were not used for longest are deleted
MAGIC = b"jaxwhisker program 1\n"
DIGEST = hashlib.sha256().digest_size
SUFFIX = ".program"


def folder() -> Path | None:
    """Where programs are kept; None if they are not."""
    chosen = os.environ.get("JAXWHISKER_CACHE", "")
    if chosen.lower() in ("off", "0", "no", "false"):
        return None
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxwhisker"


@functools.cache
def _platform() -> str:
    """Everything that compiled code depends on but its source: versions, this package's code, and the processor."""
    sources = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        sources.update(path.read_bytes())
    versions = [module.__version__ for module in (jax, jaxlib, equinox, diffrax, optimistix, lineax)]
    device = jax.devices()[0]
    return repr([sources.hexdigest(), versions, platform.machine(), _processor(), device.platform, device.device_kind])


def _processor() -> str:
    """Model and instruction sets of this processor: code compiled for another one may not run here."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))}))


def key_of(text: str) -> str:
    """The name of the entry for a program with this description, on this machine with these versions."""
    names = "jax_enable_x64", "jax_debug_nans", "jax_default_matmul_precision"
    settings = os.environ.get("XLA_FLAGS", ""), [getattr(jax.config, name) for name in names]
    return hashlib.sha256(repr((text, _platform(), settings)).encode()).hexdigest()


def load(key: str) -> Any:
    """The contents of an entry, or None if there is none or it cannot be used."""
    where = folder()
    if where is None:
        return None
    path = where / (key + SUFFIX)
    try:
        data = path.read_bytes()
    except OSError:
        return None
    content = data[len(MAGIC) + DIGEST :]
    try:
        if not data.startswith(MAGIC) or hashlib.sha256(content).digest() != data[len(MAGIC) : len(MAGIC) + DIGEST]:
            raise ValueError("its checksum is wrong")
        if hasattr(os, "getuid") and path.stat().st_uid != os.getuid():
            raise ValueError("it belongs to another user")
        value = pickle.loads(zlib.decompress(content))
        os.utime(path)  # it was used just now
    except Exception as error:  # whatever is wrong, the program can still be compiled
        warnings.warn(f"A cached program is ignored and compiled again: {path} ({error}).", stacklevel=2)
        return None
    return value


def save(key: str, value: Any) -> None:
    """Keep the contents of an entry. A store that cannot be written to is left alone."""
    where = folder()
    if where is None:
        return
    content = zlib.compress(pickle.dumps(value), 1)
    try:
        where.mkdir(parents=True, exist_ok=True, mode=0o700)
        handle, temporary = tempfile.mkstemp(dir=where, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(MAGIC + hashlib.sha256(content).digest() + content)
            os.replace(temporary, where / (key + SUFFIX))
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
        _shrink(where)
    except OSError:
        return


def entries(where: Path) -> list[tuple[Path, os.stat_result]]:
    """Files of the store, with their properties; the least recently used one comes first."""
    found = []
    for path in [*where.glob("*" + SUFFIX), *where.glob("*.part")]:
        try:
            found.append((path, path.stat()))
        except OSError:  # another process has just deleted it
            continue
    return sorted(found, key=lambda entry: entry[1].st_mtime)


def _shrink(where: Path) -> None:
    found = entries(where)
    excess = sum(stat.st_size for _, stat in found) - LARGEST
    for path, stat in found:
        if excess <= 0:
            return
        path.unlink(missing_ok=True)
        excess -= stat.st_size


def clear() -> int:
    """Delete all entries; return their number."""
    where = folder()
    found = [] if where is None else entries(where)
    for path, _ in found:
        path.unlink(missing_ok=True)
    return len(found)


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
    if module.partition(".")[0] not in KNOWN or not name or "<" in name:
        raise _UnknownError
    return f"{module}.{name}"
