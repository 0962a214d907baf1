"""Loads on a whisker: forces and moments at points along it."""

import math

import equinox as eqx

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar


class PointForce(eqx.Module):
    """A force at one point of the whisker.

    Args:
        force: magnitude, a force (in EI/L^2 with the default whisker).
        position: arc length from the base to the point, a length; positive. Default: the tip.
        follower: whether the force turns with the whisker; otherwise it keeps its direction (a dead load).
        direction: angle between the force and +x before the whisker bends, rad, positive counter-clockwise. Default:
            pi, towards -x, across the upright whisker.

    Raises:
        ValueError: if a value is not a finite number, or the position is not positive.

    Examples:
        >>> jw.PointForce(5.0, position=0.6, follower=True).follower
        True
    """

    force: Scalar
    position: Scalar | None = None
    follower: bool = eqx.field(static=True, default=False)
    direction: Scalar = math.pi

    def __check_init__(self):
        checks.number("force", self.force)
        checks.instance("follower", self.follower, bool, "True or False")
        checks.number("direction", self.direction)
        if self.position is not None:
            checks.number("position", self.position, positive=True)


class PointMoment(eqx.Module):
    """A moment at one point of the whisker.

    Args:
        moment: magnitude, force times length (in EI/L with the default whisker), positive counter-clockwise.
        position: arc length from the base to the point, a length; positive. Default: the tip.

    Raises:
        ValueError: if a value is not a finite number, or the position is not positive.

    Examples:
        >>> bent = jw.deflect(jw.Whisker(), jw.PointMoment(0.8))
        >>> print(f"{bent.curvature[0]:.3f}")  # a circular arc
        0.800
    """

    moment: Scalar
    position: Scalar | None = None

    def __check_init__(self):
        checks.number("moment", self.moment)
        if self.position is not None:
            checks.number("position", self.position, positive=True)
