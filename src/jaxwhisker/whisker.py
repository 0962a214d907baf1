"""The whisker: a slender, inextensible, shearless elastic rod."""

import equinox as eqx

from jaxwhisker import _checks
from jaxwhisker._types import Scalar


class Whisker(eqx.Module):
    """A straight uniform whisker.

    Args:
        length: L, the arc length from base to tip, in your unit of length; positive.
        bending_stiffness: EI, force times length squared; positive.

    Raises:
        ValueError: if either is not a positive finite number.

    With the defaults everything is dimensionless: lengths in L, forces in EI/L^2, moments in EI/L.
    """

    length: Scalar = 1.0
    bending_stiffness: Scalar = 1.0

    def __check_init__(self):
        _checks.number("length", self.length, positive=True)
        _checks.number("bending_stiffness", self.bending_stiffness, positive=True)
