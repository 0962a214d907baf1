"""Argument checks before tracing, and what is known about traced arguments.

A wrong argument raises a ValueError that names it, states what is allowed and shows its value. The values of traced
arguments are unknown here: solvers check those and return a status.
"""

import inspect
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.errors import NonConcreteBooleanIndexError

RIGHT_ANGLE = math.pi / 2
ROUNDING = 1e-9  # relative error of the ends of a range that was computed in another unit or order


def is_traced(tree: Any) -> bool:
    """Whether any leaf of `tree` is a tracer, whose value is unknown."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def is_numeric(leaf: Any) -> bool:
    """Whether a leaf of a scene is data rather than a function or a name."""
    return isinstance(leaf, (int, float, np.ndarray, np.generic, jax.Array))


def is_staged(tree: Any) -> bool:
    """Whether any leaf is unknown until a caller's jit runs. Below vmap, jvp and grad alone, values are known."""
    return any(_is_staged(leaf) for leaf in jax.tree.leaves(tree))


def _is_staged(leaf: Any) -> bool:
    while isinstance(leaf, Tracer):
        leaf = _below(leaf)
        if leaf is None:
            return True
    return False


def _below(tracer: Any) -> Any:
    """What a tracer of vmap, jvp or grad stands for; None for others."""
    field = {"BatchTracer": "val", "JVPTracer": "primal", "LinearizeTracer": "primal"}.get(type(tracer).__name__)
    return field and getattr(tracer, field)


def lanes_of(leaves: Sequence[Any]) -> int:
    """Number of lanes of all vmaps around these values."""
    sizes: dict[int, int] = {}
    for leaf in leaves:
        while isinstance(leaf, Tracer) and not _is_staged(leaf):
            axis, below = getattr(leaf, "batch_dim", None), _below(leaf)
            if axis is not None:
                sizes[id(leaf._trace)] = np.shape(below)[axis]
            leaf = below
    return math.prod(sizes.values())


def all_finite(tree: Any) -> jax.Array:
    """Whether all numbers of a tree are finite, also while they are traced."""
    leaves = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(tree) if is_numeric(leaf)]
    return jnp.all(jnp.array(leaves, dtype=bool))


def as_float(leaf: Any) -> Any:
    """Convert a numeric leaf to a float64 array, which jit treats as data; return other leaves unchanged."""
    if isinstance(leaf, jax.Array):
        return jnp.asarray(leaf, dtype=float)
    return jax.device_put(np.asarray(leaf, dtype=float)) if is_numeric(leaf) else leaf


def fail(name: str, allowed: str, got: Any) -> NoReturn:
    """Raise a ValueError that names the argument, what it must be and what was passed."""
    raise ValueError(f"`{name}` must be {allowed}, got {got}.")


def instance(name: str, value: Any, kinds: type | tuple[type, ...], allowed: str, *, verb: str = "be") -> None:
    """Check that `value` is an instance of `kinds`; the error message describes these as `allowed`.

    The message about a scene, state or result in space where only those in the plane are allowed says so.
    """
    if isinstance(value, kinds):
        return
    in_space = getattr(value, "in_space", False)
    allowed += " in the plane, because scans in space are not supported here" * in_space
    got = f"a {type(value).__name__}" if in_space else repr(value)  # a result would print its events
    raise ValueError(f"`{name}` must {verb} {allowed}, got {got}.")


def unmasked(value: Any) -> Any:
    """The value with NaN where NumPy's mask says that a number is missing; others stay as they are."""
    masked = isinstance(value, np.ma.MaskedArray) and value.dtype.kind in "iufb"
    return np.ma.filled(value.astype(float), np.nan) if masked else value


def _numbers(value: Any) -> Any:
    """The value as an array of real numbers, or None if it is none; a traced value stays as it is."""
    try:
        array = value if isinstance(value, Tracer) else np.asarray(unmasked(value))
    except (TypeError, ValueError):
        return None
    return array if array.dtype.kind in "iuf" else None


def number(name: str, value: Any, *, positive: bool = False, non_negative: bool = False, finite: bool = True) -> None:
    """Check that `value` is a real number and, on request, positive, non-negative or finite.

    Only the shape and type of a traced value are checked.
    """
    words = {"positive": positive, "non-negative": non_negative, "finite": finite}
    allowed = " ".join(["a", *(word for word, wanted in words.items() if wanted), "number"])
    array = _numbers(value)
    if array is None or array.shape != ():
        fail(name, allowed, repr(value) if array is None else f"an array of shape {array.shape}")
    if isinstance(array, Tracer):
        return
    v = float(array)
    outside = (positive and not v > 0) or (non_negative and v < 0)
    if np.isnan(v) or (finite and np.isinf(v)) or outside:
        fail(name, allowed, v)


def pair(name: str, value: Any) -> None:
    """Check that `value` is a tuple of two finite numbers."""
    _tuple(name, value, 2, "a pair of numbers")


def triple(name: str, value: Any, *, positive: bool = False) -> None:
    """Check that `value` is a tuple of three finite numbers and, on request, that they are positive."""
    _tuple(name, value, 3, "a tuple of three numbers", positive=positive)


def as_array(value: Any) -> Any:
    """A column of a DataFrame or a DataArray as an array, without its mask; others stay as they are."""
    if isinstance(value, np.ma.MaskedArray) or (hasattr(value, "__array__") and not is_numeric(value)):
        return np.asarray(unmasked(value) if isinstance(value, np.ndarray) else value)
    return value


def as_tuple(value: Any) -> Any:
    """A list or a one-dimensional array of numbers as a tuple; others stay as they are."""
    if isinstance(value, list) or (isinstance(value, np.ndarray | jax.Array) and value.ndim == 1):
        return tuple(value.tolist() if isinstance(value, np.ndarray) else value)
    return value


def _tuple(name: str, value: Any, size: int, allowed: str, *, positive: bool = False) -> None:
    if not (isinstance(value, tuple) and len(value) == size):
        fail(name, allowed, repr(value))
    for k, part in enumerate(value):
        number(f"{name}[{k}]", part, positive=positive)


def acute_angle(name: str, value: Any) -> None:
    """Check that `value`, in rad, lies strictly between minus and plus a right angle."""
    number(name, value)
    if not is_traced(value) and not abs(float(value)) < RIGHT_ANGLE:
        fail(name, "less than a right angle", f"{float(value):g} rad")


def vector(name: str, value: Any, *, finite: bool = True) -> None:
    """Check that `value` is a non-empty, one-dimensional array of real numbers, finite unless that is not required.

    Only the shape and type of a traced value are checked.
    """
    allowed = f"a non-empty one-dimensional array of {'finite ' * finite}numbers"
    array = _numbers(value)
    if array is None or array.ndim != 1 or array.size == 0:
        fail(name, allowed, repr(value) if array is None else f"an array of shape {array.shape}")
    if finite and not isinstance(array, Tracer) and not np.isfinite(array).all():
        k = int(np.argmin(np.isfinite(array)))
        fail(name, allowed, f"{array[k]} at index {k}")


def within(name: str, values: Any, places: Any, what: str) -> None:
    """Check that numbers lie within the range of the known places of a run, such as its drive positions.

    Traced values, of which only the shape is known, pass.
    """
    if is_traced((values, places)):
        return
    known = np.asarray(places)[np.isfinite(places)]
    if known.size == 0:
        return
    low, high = known.min(), known.max()
    room = ROUNDING * max(abs(low), abs(high))
    for value in np.atleast_1d(values):
        if not low - room <= value <= high + room:
            fail(name, f"within the {what}, from {low:g} to {high:g}", f"{value:g}")


def rows(name: str, value: Any, *, columns: int, least: int = 1) -> None:
    """Check that `value` is a two-dimensional array of finite real numbers with so many columns, and enough rows.

    Only the shape and type of a traced value are checked.
    """
    allowed = f"an array of finite numbers of shape (n, {columns}), n at least {least}"
    array = _numbers(value)
    if array is None or array.ndim != 2 or array.shape[1] != columns or array.shape[0] < least:
        fail(name, allowed, repr(value) if array is None else f"an array of shape {array.shape}")
    if not isinstance(array, Tracer) and not np.isfinite(array).all():
        fail(name, allowed, np.asarray(array).tolist())


def count(name: str, value: Any, least: int = 1) -> None:
    """Check that `value` is an int, not a bool, and at least `least`."""
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        fail(name, "a positive int" if least == 1 else f"an int of at least {least}", repr(value))


def function(
    name: str, value: Any, returns: tuple[str, ...] = (), *, given: int = 1, shape: tuple[int, ...] = ()
) -> None:
    """Check that `value` is a function of numbers or arrays that JAX can trace and that returns the right numbers.

    Args:
        name: name of the argument.
        value: the function; it is traced with floats and not evaluated.
        returns: names of the numbers that it must return as a sequence; empty for a single number.
        given: how many arguments it is called with: one or two.
        shape: shape of each of them; empty for numbers.

    Raises:
        ValueError: if `value` is not such a function.
    """
    result = f"({', '.join(returns)})" if returns else "one number"
    what = f"array{'s' * (given - 1)} of shape {shape}" if shape else f"number{'s' * (given - 1)}"
    allowed = f"a function that is called with {('one', 'two')[given - 1]} {what} and returns {result}"
    if not callable(value):
        fail(name, allowed, repr(value))
    called = getattr(value, "__name__", type(value).__name__)
    if _mismatch(value, *[0.0] * given):
        fail(name, allowed, f"{called}{inspect.signature(value)}")
    wrong = []  # filled during tracing, because results other than arrays cannot leave the trace
    try:
        numbers = [jax.ShapeDtypeStruct(shape, float)] * given
        jax.eval_shape(lambda *x: wrong.append(_wrong_result(value(*x), returns)), *numbers)
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
    sequence = isinstance(result, tuple | list) or getattr(result, "ndim", 0) == 1
    if not (names and sequence):
        return _not_a_number(result) or ("an array of shape ()" if names else None)
    if len(result) != len(names):
        return f"{len(result)} values"
    return next(filter(None, map(_not_a_number, result)), None)


def _not_a_number(value: Any) -> str | None:
    """Description of a value that is not one real number."""
    if not is_numeric(value):
        return f"a value of type {type(value).__name__}"
    shape, kind = np.shape(value), jnp.result_type(value)
    return None if shape == () and kind.kind in "iuf" else f"an array of shape {shape} and type {kind}"


@contextmanager
def traceable(argument: str, name: str) -> Iterator[None]:
    """Check that JAX can trace a user's function, as every compiled program must, while it is traced.

    Raises:
        ValueError: if not; the message names the argument, the function and the remedy.
    """
    try:
        yield
    except (jax.errors.JAXTypeError, jax.errors.JAXIndexError) as error:
        raise ValueError(
            f"`{argument}` must be a function that JAX can trace, got {name}, which raised {type(error).__name__}. Use "
            "jnp.where instead of `if`, jnp.interp instead of np.interp, and jax.numpy instead of math and numpy."
        ) from error


def float64_mode() -> None:
    """Check that JAX computes in double precision, which importing the library does not enable."""
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise ValueError(
            "`jax_enable_x64` must be True, got False: in float32, folds and snaps cannot be distinguished from "
            'rounding errors. Call `jax.config.update("jax_enable_x64", True)` before the first computation, or set '
            "the environment variable JAX_ENABLE_X64=1."
        )
