"""Types that recur in signatures."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Array, Float, Int, Num

Scalar: TypeAlias = Float[Array, ""] | Int[Array, ""] | float | int | np.number  # one real number, perhaps traced
PerSpring: TypeAlias = Scalar | Sequence[Scalar] | Num[Array, " springs"] | Num[np.ndarray, " springs"]  # or one each
Control: TypeAlias = Num[Array, " steps"] | Num[np.ndarray, " steps"] | Sequence[Scalar]  # drive positions
