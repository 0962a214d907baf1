"""The scene in space: whiskers, a surface, springs and a drive.

Frame: x along the scan, y up, z = x cross y; the object is above. A whisker on the default mount stands at the origin of
the drive's frame and points along +y; the axes of its body are d1 = x, d2 = -z and d3 = y, its tangent. Springs act along
the axes of the drive's frame.

The contact force is f n, with f >= 0 and the outward normal n of the object. The support exerts the reaction (fx, fy, fz)
on the whisker, and the moment (mx, my, mz) about its displaced base; all in the frame of the scene.
"""

from typing import Any

import equinox as eqx
from jaxtyping import Array, Bool

from jaxwhisker._base import checks
from jaxwhisker._model.drives import SpaceMotion
from jaxwhisker._model.motion import AbstractMotion, Translation
from jaxwhisker._model.support import Support
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import AbstractRod, Shooting


class SpaceScene(eqx.Module):
    """Whiskers on a support, scanned past a surface in space.

    `jw.Scene` with a surface in place of a profile makes one.

    Args:
        whisker: one Whisker for all bases, or a tuple with one per base.
        surface: the object: a Sphere, Ellipsoid, Cylinder, Paraboloid, Extruded, Revolved or Surface.
        support: springs between the drive and the bases. Default: clamped.
        rod: how rods are computed.
        motion: motion of the drive: a LinearDrive, RotaryDrive, WhiskDrive or PoseDrive, or one in the plane.

    Raises:
        ValueError: if an argument has the wrong type or value.
    """

    whisker: Whisker | tuple[Whisker, ...]
    surface: AbstractSurface
    support: Support = Support()
    rod: AbstractRod = Shooting()
    motion: SpaceMotion | AbstractMotion = Translation()

    def __check_init__(self):
        checks.instance("surface", self.surface, AbstractSurface, "a surface")

    @property
    def whiskers(self) -> tuple[Whisker, ...]:
        """One Whisker per base."""
        return self.whisker if isinstance(self.whisker, tuple) else (self.whisker,) * self.support.whiskers

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domains that the constructors check."""
        valid: Any = self.surface.valid() & self.support.valid() & self.motion.valid()
        for whisker in self.whiskers:
            valid &= whisker.valid()
        return valid
