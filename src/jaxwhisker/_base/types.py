"""Argument types that several signatures share."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np
from jaxtyping import Array, Float, Int, Num
from typing_extensions import TypeAliasType

# Types with a name: `help` shows the name instead of the whole union.
# One real number, possibly traced:
Scalar = TypeAliasType("Scalar", Float[Array, ""] | Int[Array, ""] | float | int | np.number)
Triple = TypeAliasType("Triple", tuple[Scalar, Scalar, Scalar])  # x, y and z of a point or vector in space
# What becomes a Triple:
Vector = TypeAliasType("Vector", Triple | list[Any] | Float[Array, "3"] | Float[np.ndarray, "3"])
# One value for all springs, or one value per spring:
PerSpring = TypeAliasType("PerSpring", Scalar | Sequence[Scalar] | Num[Array, " springs"] | Num[np.ndarray, " springs"])
Control = TypeAliasType("Control", Num[Array, " steps"] | Num[np.ndarray, " steps"] | Sequence[Scalar])  # positions


class NamedInt(IntEnum):
    """Integers with names, as which they are printed."""

    def __str__(self) -> str:
        return self.name

    def __format__(self, format_spec: str, /) -> str:
        return format(self.name, format_spec)  # IntEnum formats the number
