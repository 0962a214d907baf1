"""Loads on a whisker: forces and moments at points along it, and forces distributed along it.

A direction in the plane is an angle (PointForce). In space, forces and moments have components (SpaceForce,
SpaceMoment). A LineLoad has components in the plane already, and takes one more in space.
"""

import math

import equinox as eqx

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import number_or_function
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.rod import AlongRod


class PointForce(eqx.Module):
    """A force in the plane at one point of the whisker.

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
    """A moment about z at one point of the whisker.

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


class SpaceForce(eqx.Module):
    """A force in space at one point of the whisker.

    Args:
        fx: force along x (in EI/L^2 with the default whisker). That of a follower is the component along x before the
            whisker bends, along d1 of the cross-section.
        fy: force along y, likewise; along the tangent.
        fz: force along z, out of the plane, likewise; against d2.
        position: arc length from the base to the point, a length; positive. Default: the tip.
        follower: whether the force turns with the cross-section; otherwise it keeps its direction (a dead load).

    Raises:
        ValueError: if a value is not a finite number, or the position is not positive.

    Examples:
        >>> bent = jw.deflect(jw.Whisker(), jw.SpaceForce(-1.0, 0.0, 0.5))
        >>> print(f"x = {bent.x[-1]:.3f}, z = {bent.z[-1]:.3f}")
        x = -0.295, z = 0.148
    """

    fx: Scalar
    fy: Scalar
    fz: Scalar
    position: Scalar | None = None
    follower: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        for name in ("fx", "fy", "fz"):
            checks.number(name, getattr(self, name))
        checks.instance("follower", self.follower, bool, "True or False")
        if self.position is not None:
            checks.number("position", self.position, positive=True)


class SpaceMoment(eqx.Module):
    """A moment in space at one point of the whisker.

    A moment that keeps its direction has no potential, and neither has one that turns with the whisker: their work
    depends on the order of rotations.

    Args:
        mx: moment about x, force times length (in EI/L with the default whisker), right-handed. That of a follower is
            the component about x before the whisker bends, about d1 of the cross-section.
        my: moment about y, likewise; about the tangent: it twists the whisker.
        mz: moment about z, likewise, as that of a PointMoment; against d2.
        position: arc length from the base to the point, a length; positive. Default: the tip.
        follower: whether the moment turns with the cross-section; otherwise it keeps its direction (a dead load).

    Raises:
        ValueError: if a value is not a finite number, or the position is not positive.

    Examples:
        >>> twisted = jw.deflect(jw.Whisker(torsion_ratio=0.8), jw.SpaceMoment(0.0, 0.4, 0.0))
        >>> print(f"{twisted.curvature[0, 2]:.3f}")  # twist M / C, with C = 0.8 EI
        0.500
    """

    mx: Scalar
    my: Scalar
    mz: Scalar
    position: Scalar | None = None
    follower: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        for name in ("mx", "my", "mz"):
            checks.number(name, getattr(self, name))
        checks.instance("follower", self.follower, bool, "True or False")
        if self.position is not None:
            checks.number("position", self.position, positive=True)


class LineLoad(eqx.Module):
    """A force per length that keeps its direction, along the whisker or a part of it.

    Args:
        x: force per length along x (in EI/L^3 with the default whisker): a number, or a function of the arc length from
            the base, which is smooth between `start` and `stop`.
        y: force per length along y, likewise.
        start: arc length from the base to the beginning of the loaded part, a length; not negative.
        stop: arc length from the base to its end, a length; greater than `start`. Default: the tip.
        z: force per length along z, likewise; with it, the whisker bends in space. Default: none, in the plane.

    Raises:
        ValueError: if a number is not finite, JAX cannot trace a function with one number as its argument, or `start`
            and `stop` are not as above.

    Examples:
        >>> sagging = jw.deflect(jw.Whisker(), jw.LineLoad(x=-0.6))
        >>> print(f"{sagging.fx:.3f}, {sagging.mz:.3f}")  # about w L and -w L^2 / 2
        0.600, -0.299
    """

    x: AlongRod = eqx.field(default=0.0, converter=number_or_function("x"))
    y: AlongRod = eqx.field(default=0.0, converter=number_or_function("y"))
    start: Scalar = 0.0
    stop: Scalar | None = None
    z: AlongRod | None = eqx.field(default=None, converter=number_or_function("z"))

    def __check_init__(self):
        for name in ("x", "y", "z"):
            if getattr(self, name) is not None and not callable(getattr(self, name)):
                checks.number(name, getattr(self, name))
        checks.number("start", self.start, non_negative=True)
        if self.stop is not None:
            checks.number("stop", self.stop, positive=True)
            if not checks.is_traced((self.start, self.stop)) and float(self.stop) <= float(self.start):
                checks.fail("stop", f"greater than `start`, {self.start}", self.stop)
