"""Compilation: a decorator that compiles functions with the library's compiler options."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

import equinox as eqx
from jaxlib.version import __version_info__ as version

from jaxwhisker._base.checks import is_traced

# Up to version 0.10, jaxlib has two emitters of CPU kernels. The one that is not the default compiles in half the
# time, and its kernels run equally fast.
COMPILER_OPTIONS: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False} if version < (0, 11) else {}


class jit:  # noqa: N801, a decorator
    """Compile a function with the library's compiler options. Inside a caller's jit, the caller's options apply.

    Arguments that are not arrays (functions, names, integers) are static, as in `equinox.filter_jit`.
    """

    def __init__(self, function: Callable):
        self._inside = eqx.filter_jit(function)
        # XLA accepts compiler options for whole programs only.
        options: Any = {"compiler_options": COMPILER_OPTIONS}
        self._outermost = eqx.filter_jit(function, **options)
        self.__doc__, self.__wrapped__ = function.__doc__, function

    def __call__(self, *args, **kwargs):
        return (self._inside if is_traced((args, kwargs)) else self._outermost)(*args, **kwargs)

    def compile(self, *args) -> None:
        """Compile for arguments of these shapes without running the function."""
        self._outermost.lower(*args).compile()

    def compile_aside(self, pool: Executor, *args) -> Future:
        """Trace for arguments of these shapes, and compile in a thread of the pool."""
        return pool.submit(self._outermost.lower(*args).compile)
