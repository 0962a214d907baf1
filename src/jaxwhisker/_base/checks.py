"""Argument checks before tracing.

A wrong argument raises a ValueError that names it, states what is allowed and shows its value. The values of traced
arguments are unknown here: solvers check those and return a status.
"""

import inspect
import math
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.errors import NonConcreteBooleanIndexError

RIGHT_ANGLE = math.pi / 2


def is_traced(tree: Any) -> bool:
    """Whether any leaf of `tree` is a tracer, whose value is unknown."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def is_numeric(leaf: Any) -> bool:
    """Whether a leaf of a scene is data rather than a function or a name."""
    return isinstance(leaf, (int, float, np.ndarray, np.generic, jax.Array))


def as_float(leaf: Any) -> Any:
    """Convert a numeric leaf to a float64 array, which jit treats as data; return other leaves unchanged."""
    return jnp.asarray(leaf, dtype=float) if is_numeric(leaf) else leaf


def fail(name: str, allowed: str, got: Any) -> NoReturn:
    """Raise a ValueError that names the argument, what it must be and what was passed."""
    raise ValueError(f"`{name}` must be {allowed}, got {got}.")


def instance(name: str, value: Any, kinds: type | tuple[type, ...], allowed: str) -> None:
    """Check that `value` is an instance of `kinds`; the error message describes these as `allowed`."""
    if not isinstance(value, kinds):
        fail(name, allowed, repr(value))


def number(name: str, value: Any, *, positive: bool = False, non_negative: bool = False, finite: bool = True) -> None:
    """Check that `value` is a real number and, on request, positive, non-negative or finite.

    Only the shape and type of a traced value are checked.
    """
    allowed = " ".join(
        ["a", *["positive"] * positive, *["non-negative"] * non_negative, *["finite"] * finite, "number"]
    )
    if isinstance(value, Tracer):
        shape, kind = value.shape, value.dtype.kind
    else:
        try:
            array = np.asarray(value)
        except (TypeError, ValueError):
            array = np.asarray(None)
        shape, kind = array.shape, array.dtype.kind
    if shape != () or kind not in "iuf":
        fail(name, allowed, repr(value) if shape == () else f"an array of shape {shape}")
    if isinstance(value, Tracer):
        return
    v = float(array)
    outside = (positive and not v > 0) or (non_negative and v < 0)
    if np.isnan(v) or (finite and np.isinf(v)) or outside:
        fail(name, allowed, v)


def pair(name: str, value: Any) -> None:
    """Check that `value` is a tuple of two finite numbers."""
    if not (isinstance(value, tuple) and len(value) == 2):
        fail(name, "a pair of numbers", repr(value))
    for part in value:
        number(name, part)


def acute_angle(name: str, value: Any) -> None:
    """Check that `value`, in rad, lies strictly between minus and plus a right angle."""
    number(name, value)
    if not is_traced(value) and not abs(float(value)) < RIGHT_ANGLE:
        fail(name, "less than a right angle", f"{float(value):g} rad")


def vector(name: str, value: Any) -> None:
    """Check that `value` is a non-empty, one-dimensional array of finite real numbers.

    Only the shape and type of a traced value are checked.
    """
    allowed = "a non-empty one-dimensional array of finite numbers"
    if not isinstance(value, Tracer):
        try:
            value = np.asarray(value)
        except (TypeError, ValueError):
            fail(name, allowed, repr(value))
    if value.ndim != 1 or value.size == 0:
        fail(name, allowed, f"an array of shape {value.shape}")
    if value.dtype.kind not in "iuf":
        fail(name, allowed, f"an array of type {value.dtype}")
    if not isinstance(value, Tracer):
        bad = ~np.isfinite(value)
        if bad.any():
            fail(name, allowed, f"{value[bad][0]} at index {int(np.argmax(bad))}")


def count(name: str, value: Any, least: int = 1) -> None:
    """Check that `value` is an int, not a bool, and at least `least`."""
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        fail(name, "a positive int" if least == 1 else f"an int of at least {least}", repr(value))


def function(name: str, value: Any, returns: tuple[str, ...] = ()) -> None:
    """Check that `value` is a function of one number that JAX can trace and that returns the right numbers.

    Args:
        name: name of the argument.
        value: the function; it is traced with one float and not evaluated.
        returns: names of the numbers that it must return as a sequence; empty for a single number.

    Raises:
        ValueError: if `value` is not such a function.
    """
    result = f"({', '.join(returns)})" if returns else "one number"
    allowed = f"a function that is called with one number and returns {result}"
    if not callable(value):
        fail(name, allowed, repr(value))
    called = getattr(value, "__name__", type(value).__name__)
    if _mismatch(value, 0.0):
        fail(name, allowed, f"{called}{inspect.signature(value)}")
    wrong = []  # filled during tracing, because results other than arrays cannot leave the trace
    try:
        jax.eval_shape(lambda x: wrong.append(_wrong_result(value(x), returns)), jax.ShapeDtypeStruct((), float))
    except (TypeError, NonConcreteBooleanIndexError) as error:
        raise ValueError(
            f"`{name}` must be a function that JAX can trace, got {called}, which raised {type(error).__name__}. Use "
            "jnp.where instead of `if`, jnp.interp instead of np.interp, and jax.numpy instead of math and numpy."
        ) from error
    if wrong[0]:
        fail(name, allowed, f"{called}, which returns {wrong[0]}")


def arguments(name: str, value: Any, given: Sequence[str], called: str = "build") -> None:
    """Check that a user's function takes arguments of these names.

    Args:
        name: name of the argument from which the names come.
        value: the function.
        given: the names.
        called: name of the argument that is the function.

    Raises:
        ValueError: if `value` is not such a function.
    """
    if not callable(value):
        fail(called, "a function that returns a Scene", repr(value))
    mismatch = _mismatch(value, **dict.fromkeys(given))
    if mismatch:
        raise ValueError(
            f"`{name}` must name the parameters of `{called}`, which takes {inspect.signature(value)}, got "
            f"{', '.join(map(repr, given))}: {mismatch}."
        )


def _mismatch(value: Callable, *args: Any, **kwargs: Any) -> str:
    """Why a function does not take these arguments; empty if it does."""
    try:
        inspect.signature(value).bind(*args, **kwargs)
    except TypeError as error:
        return str(error)
    except ValueError:  # functions written in C may have no signature
        pass
    return ""


def _wrong_result(result: Any, names: tuple[str, ...]) -> str | None:
    """Description of a wrong result; None if it is one number or, where names are given, one number per name."""
    if not names:
        results = (result,)
    elif isinstance(result, (tuple, list)) or getattr(result, "ndim", 0) == 1:
        results = tuple(result)
        if len(results) != len(names):
            return f"{len(results)} values"
    else:
        return _described(result)
    return next((_described(part) for part in results if not _is_number(part)), None)


def _is_number(value: Any) -> bool:
    return is_numeric(value) and np.shape(value) == () and jnp.result_type(value).kind in "iuf"


def _described(value: Any) -> str:
    if not is_numeric(value):
        return f"a value of type {type(value).__name__}"
    return f"an array of shape {np.shape(value)} and type {jnp.result_type(value)}"


def float64_mode() -> None:
    """Check that JAX computes in double precision, which importing the library does not enable."""
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise ValueError(
            "`jax_enable_x64` must be True, got False: in float32, folds and snaps cannot be distinguished from "
            'rounding errors. Call `jax.config.update("jax_enable_x64", True)` before the first computation, or set '
            "the environment variable JAX_ENABLE_X64=1."
        )
