"""The sensor: what is known of an instrument when the object is not."""

import equinox as eqx

from jaxwhisker._model.motion import AbstractMotion, Translation
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, check_sensor, each_whisker
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker


class Sensor(eqx.Module):
    """Whiskers on a support: a Scene without its object.

    Args:
        whisker: one Whisker for all bases, or a tuple with one per base.
        support: the springs between drive and bases; clamped by default.
        motion: of the drive: Translation(), Rotation(), or a Motion of one's own.

    Raises:
        ValueError: if an argument is not of that kind, or their numbers of whiskers differ.
    """

    whisker: Whisker | tuple[Whisker, ...]
    support: Support = Support()
    motion: AbstractMotion = Translation()

    def __check_init__(self):
        check_sensor(self.whisker, self.support, self.motion)

    @classmethod
    def of(cls, scene: Scene) -> "Sensor":
        """The sensor of a scene."""
        return cls(scene.whisker, scene.support, scene.motion)

    def before(self, profile: AbstractProfile) -> Scene:
        """The scene with that object."""
        return Scene(self.whisker, profile, self.support, motion=self.motion)

    @property
    def whiskers(self) -> tuple[Whisker, ...]:
        """One Whisker per base."""
        return each_whisker(self.whisker, self.support)
