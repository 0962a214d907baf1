"""Argument types that several signatures share."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Array, Float, Int, Num

Scalar: TypeAlias = Float[Array, ""] | Int[Array, ""] | float | int | np.number  # one real number, possibly traced
Triple: TypeAlias = tuple[Scalar, Scalar, Scalar]  # x, y and z of a point or vector in space
Vector: TypeAlias = Triple | list[Any] | Float[Array, "3"] | Float[np.ndarray, "3"]  # what becomes a Triple
# One value for all springs, or one value per spring.
PerSpring: TypeAlias = Scalar | Sequence[Scalar] | Num[Array, " springs"] | Num[np.ndarray, " springs"]
Control: TypeAlias = Num[Array, " steps"] | Num[np.ndarray, " steps"] | Sequence[Scalar]  # drive positions


class NamedInt(IntEnum):
    """Integers with names, as which they are printed."""

    def __str__(self) -> str:
        return self.name

    def __format__(self, format_spec: str, /) -> str:
        return format(self.name, format_spec)  # IntEnum formats the number
