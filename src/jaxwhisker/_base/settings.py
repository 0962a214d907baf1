"""Settings of JAX under which this package computes, whatever its caller has chosen.

The package promotes types and ranks, moves numbers to the device, and uses NaN for what failed. Settings that forbid
this, or compilation, stay in force for the caller's own code. (As plain Python, `deflect` takes nine minutes.)
"""

import functools
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

import jax

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


def _chosen(name: str) -> Any:
    return getattr(jax.config, name)


@contextmanager
def own_settings() -> Iterator[None]:
    """Compute with the settings that the package needs."""
    with ExitStack() as stack:
        for name, value in NEEDED.items():
            if _chosen(f"jax_{name}") != value:
                stack.enter_context(getattr(jax, name)(value))
        if any(_chosen(name) not in (None, "allow") for name in GUARDS):
            stack.enter_context(jax.transfer_guard("allow"))
        yield


def with_own_settings(function: Function) -> Function:
    """Decorator: the function computes with the settings that the package needs."""

    @functools.wraps(function)
    def run(*args, **kwargs):
        with own_settings():
            return function(*args, **kwargs)

    return run  # pyright: ignore[reportReturnType]


def in_double(function: Function) -> Function:
    """Decorator: the function computes in float64, as its argument did, also after a block `jax.enable_x64(True)`."""

    @functools.wraps(function)
    def run(*args, **kwargs):
        with jax.enable_x64(True), own_settings():
            return function(*args, **kwargs)

    return run  # pyright: ignore[reportReturnType]


def as_here(function: Callable) -> Callable:
    """The function with this thread's precision and the package's settings, for other threads or for later.

    Other threads do not see that `jax.enable_x64` surrounds this one.
    """
    precise = _chosen("jax_enable_x64")

    def run(*args):
        with jax.enable_x64(precise), own_settings():
            return function(*args)

    return run
