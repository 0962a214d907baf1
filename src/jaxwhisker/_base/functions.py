"""Functions as fields of a scene: of the arc length along a whisker, of the abscissa of a profile."""

from collections.abc import Callable
from typing import Any

import equinox as eqx


class _Plain(eqx.Module):
    # A plain function is structure, not data: hidden from jax, which could neither batch nor differentiate it.
    function: Callable = eqx.field(static=True)

    def __call__(self, x):
        return self.function(x)


def as_field(value: Any) -> Any:
    """A value as a field of a scene; a function with parameters to differentiate by has to be an equinox.Module."""
    return _Plain(value) if callable(value) and not isinstance(value, eqx.Module) else value


def name_of(function: Callable) -> str:
    """What a person calls the function."""
    return getattr(getattr(function, "function", function), "__name__", type(function).__name__)
