"""Settings of JAX under which this package computes, whatever its caller has chosen.

The package promotes types and ranks, moves numbers to the device, and uses NaN for what failed. Settings that forbid
this, or compilation, stay in force for the caller's own code. (As plain Python, `deflect` takes nine minutes.)
"""

import functools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from operator import attrgetter
from typing import Any, TypeVar

import jax
from jax.core import Tracer

Function = TypeVar("Function", bound=Callable)

# Name of each setting with the value that the package needs.
NEEDED: dict[str, Any] = {
    "numpy_dtype_promotion": "standard",
    "numpy_rank_promotion": "allow",
    "debug_nans": False,
    "debug_infs": False,
    "disable_jit": False,
}
GUARDS = tuple(f"jax_transfer_guard_{way}" for way in ("host_to_device", "device_to_device", "device_to_host"))
OPEN = {None, "allow"}  # values of guards
# Every call of the package looks at these settings: all at once takes half the time.
_CHOSEN, _CHOSEN_GUARDS = attrgetter(*(f"jax_{name}" for name in NEEDED)), attrgetter(*GUARDS)


def _chosen(name: str) -> Any:
    return getattr(jax.config, name)


@contextmanager
def own_settings(arguments: Any = None) -> Iterator[None]:
    """Compute with the settings that the package needs, on the device on which the arguments are."""
    with ExitStack() as stack:
        for context in _changes(arguments):
            stack.enter_context(context)
        yield


def _changes(arguments: Any) -> list[AbstractContextManager]:
    """What changes the caller's settings to those that the package needs; mostly nothing."""
    there = _other_device(arguments)
    changes: list[Any] = [] if there is None else [jax.default_device(there)]
    for (name, value), chosen in zip(NEEDED.items(), _CHOSEN(jax.config), strict=True):
        if chosen != value:
            changes.append(getattr(jax, name)(value))
    if not OPEN.issuperset(_CHOSEN_GUARDS(jax.config)):
        changes.append(jax.transfer_guard("allow"))
    return changes


def device() -> Any:
    """The device on which programs run, for which they are compiled."""
    chosen = _chosen("jax_default_device")
    return chosen if isinstance(chosen, jax.Device) else jax.devices(chosen)[0]


def _other_device(arguments: Any) -> Any:
    """The device of the first array that is not on the default device; None if there is no such array."""
    if jax.local_device_count() == 1:
        return None
    here = device()
    for leaf in jax.tree.leaves(arguments):
        if isinstance(leaf, jax.Array) and not isinstance(leaf, Tracer) and leaf.devices() != {here}:
            there, *others = leaf.devices()
            return None if others else there
    return None


def with_own_settings(function: Function) -> Function:
    """Decorator: the function computes with the package's settings, on the device of its arguments."""

    @functools.wraps(function)
    def run(*args, **kwargs):
        if not _changes((args, kwargs)):  # entering nothing takes microseconds
            return function(*args, **kwargs)
        with own_settings((args, kwargs)):
            return function(*args, **kwargs)

    return run  # pyright: ignore[reportReturnType]


def in_double(function: Function) -> Function:
    """Decorator: the function computes in float64, as its argument did, also after a block `jax.enable_x64(True)`."""

    @functools.wraps(function)
    def run(*args, **kwargs):
        with jax.enable_x64(True), own_settings((args, kwargs)):
            return function(*args, **kwargs)

    return run  # pyright: ignore[reportReturnType]


def as_here(function: Callable) -> Callable:
    """The function with this thread's precision and device and the package's settings, for other threads or for later.

    Other threads do not see that `jax.enable_x64` or `jax.default_device` surround this one.
    """
    precise, device = _chosen("jax_enable_x64"), _chosen("jax_default_device")

    def run(*args):
        with jax.enable_x64(precise), jax.default_device(device), own_settings():
            return function(*args)

    return run
