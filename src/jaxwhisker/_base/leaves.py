"""Leaves of a scene: user-defined functions as fields, text for values, placeholders for invalid values."""

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Bool

from jaxwhisker._base import checks
from jaxwhisker._base.settings import as_here

Tree = TypeVar("Tree")


class PlainFunction(eqx.Module):
    # Static, because JAX can neither batch nor differentiate a plain function.
    function: Callable = eqx.field(static=True)

    def __call__(self, *numbers):
        return self.function(*numbers)


def as_field(value: Any) -> Any:
    """Wrap a plain function as static structure; an `equinox.Module` stays as it is, with differentiable parameters."""
    return PlainFunction(value) if callable(value) and not isinstance(value, eqx.Module) else value


def number_or_function(name: str) -> Callable[[Any], Any]:
    """Converter for a field that holds a number or a function of one number; a function is checked."""

    def convert(value):
        if callable(value):
            checks.function(name, value)
        return as_field(value)

    return convert


def name_of(function: Callable) -> str:
    """Name of a user-defined function, or of its class."""
    function = function.function if isinstance(function, PlainFunction) else function
    return getattr(function, "__name__", type(function).__name__)


def as_text(value: Any) -> str:
    """Format a number with six significant digits; `?` stands for a traced number, `...` for an array."""
    return "?" if isinstance(value, Tracer) else f"{float(value):.6g}" if jnp.ndim(value) == 0 else "..."


def text_unless(default: float, prefix: str, value: Any) -> str:
    """The prefix followed by the value, or an empty text if the value is the default."""
    text = as_text(value)
    return "" if text == as_text(default) else prefix + text


def safe_placeholder(tree: Tree, valid: Bool[Array, ""]) -> Tree:
    """The tree if it is valid; otherwise the tree with safe placeholder values in (0, 1].

    Invalid batch elements are computed like all others, and their results are discarded. Their derivatives must still
    be finite: zero weight times NaN would be NaN for every parameter that the batch shares.
    """

    def placeholder(leaf):
        if not (checks.is_numeric(leaf) and jnp.issubdtype(jnp.result_type(leaf), jnp.floating)):
            return leaf
        safe = jnp.where(jnp.isfinite(leaf) & (leaf > 0), jnp.minimum(leaf, 1.0), 1.0)
        return jnp.where(valid, leaf, jax.lax.stop_gradient(safe))

    return jax.tree.map(placeholder, tree)


@jax.tree_util.register_pytree_node_class
class Deferred:
    """A tree that is computed when it is first asked for, or when it becomes part of the result of a transformation.

    It is computed with the precision that was chosen when it was made.
    """

    def __init__(self, compute: Callable[[], Any]):
        self._compute = as_here(compute)

    @cached_property
    def value(self) -> Any:
        """The tree."""
        return self._compute()

    def tree_flatten(self):
        """Compute the tree."""
        return (self.value,), None

    @classmethod
    def tree_unflatten(cls, _, children):
        """A tree that is known."""
        return cls(lambda: children[0])

    def __reduce__(self):
        return deferred, (self.value,)


def deferred(tree: Any) -> Deferred:
    """Converter for a field that holds a tree, or a function of no arguments that computes it."""
    return tree if isinstance(tree, Deferred) else Deferred(tree if callable(tree) else lambda: tree)
