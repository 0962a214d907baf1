"""Types of arguments that several signatures share."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Array, Float, Int, Num

Scalar: TypeAlias = Float[Array, ""] | Int[Array, ""] | float | int | np.number  # one real number, possibly traced
PerSpring: TypeAlias = Scalar | Sequence[Scalar] | Num[Array, " springs"] | Num[np.ndarray, " springs"]  # one or each
Control: TypeAlias = Num[Array, " steps"] | Num[np.ndarray, " steps"] | Sequence[Scalar]  # drive positions
