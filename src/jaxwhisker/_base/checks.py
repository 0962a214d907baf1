"""What can be known before tracing: a bad argument is a ValueError that names it, its value and what is allowed."""

from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer


def is_traced(tree: Any) -> bool:
    """Whether any leaf of `tree` is an abstract value, about which nothing can be said yet."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def is_numeric(leaf: Any) -> bool:
    """Whether a leaf of a scene is data, and not a function or a name."""
    return isinstance(leaf, (int, float, np.ndarray, np.generic, jax.Array))


def as_float(leaf: Any) -> Any:
    """A leaf of a scene as a float64 array, so that jit treats it as data; functions and names stay."""
    return jnp.asarray(leaf, dtype=float) if is_numeric(leaf) else leaf


def _fail(name: str, value: Any, allowed: str) -> NoReturn:
    raise ValueError(f"`{name}` must be {allowed}, but is {value}.")


def number(name: str, value: Any, *, positive: bool = False, finite: bool = True) -> None:
    """Check that `value` is a real number; positive, finite if asked. Traced values pass: they get a status later."""
    allowed = " ".join(["a", *["positive"] * positive, *["finite"] * finite, "number"])
    if isinstance(value, Tracer):
        shape, kind = value.shape, value.dtype.kind
    else:
        try:
            array = np.asarray(value)
        except (TypeError, ValueError):
            array = np.asarray(None)
        shape, kind = array.shape, array.dtype.kind
    if shape != () or kind not in "iuf":
        _fail(name, repr(value) if shape == () else f"an array of shape {shape}", allowed)
    if isinstance(value, Tracer):
        return
    v = float(array)
    if np.isnan(v) or (finite and np.isinf(v)) or (positive and not v > 0):
        _fail(name, v, allowed)


def vector(name: str, value: Any) -> None:
    """Check that `value` is a finite, non-empty, one-dimensional array of real numbers."""
    allowed = "a non-empty one-dimensional array of finite numbers"
    if not isinstance(value, Tracer):
        try:
            value = np.asarray(value)
        except (TypeError, ValueError):
            _fail(name, repr(value), allowed)
    if value.ndim != 1 or value.size == 0:
        _fail(name, f"of shape {value.shape}", allowed)
    if value.dtype.kind not in "iuf":
        _fail(name, f"of type {value.dtype}", allowed)
    if not isinstance(value, Tracer):
        bad = value[~np.isfinite(value)]
        if bad.size:
            _fail(name, f"not: it holds {bad[0]} at index {int(np.argmax(~np.isfinite(value)))}", allowed)


def count(name: str, value: Any) -> None:
    """Check that `value` is a positive int, which True is not."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        _fail(name, repr(value), "a positive int")


def float64_mode() -> None:
    """Check that JAX computes in double precision; the library never switches it on by itself."""
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise ValueError(
            "jaxwhisker needs `jax_enable_x64` to be True, but it is False (JAX is in float32 mode, in which folds and "
            'snaps cannot be told from rounding). Call `jax.config.update("jax_enable_x64", True)` before the first '
            "computation, or set the environment variable JAX_ENABLE_X64=1."
        )
