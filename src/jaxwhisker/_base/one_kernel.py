"""Small programs as one kernel of the CPU.

XLA starts every loop and every fused operation as a kernel of its own, which takes longer than a few scalars need. What
it marks as a small call, it compiles to one function instead, with all loops inside.
"""

from collections.abc import Callable
from typing import Any

import jax
from jax.experimental.xla_metadata import set_xla_metadata

from jaxwhisker._base.settings import device

# A call that is inlined early is no call any more. XLA ignores what it does not know.
SMALL_CALL = {"xla_cpu_small_call": "true", "inlineable": "false"}


def in_one_kernel(function: Callable) -> Callable:
    """The function, as one kernel if it is compiled for the CPU."""

    def run(*args: Any) -> Any:
        if device().platform != "cpu":
            return function(*args)
        return set_xla_metadata(jax.jit(function)(*args), **SMALL_CALL)

    return run
