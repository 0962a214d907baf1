"""A pipe around the whiskers: a hollow object."""

import jax.numpy as jnp

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text, text_unless
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, ContactPoint


class Pipe(AbstractProfile):
    """The inside of a circle around the whiskers, in scenes with several contacts of one whisker.

    Its parameter is minus the angle of the point about the centre (rad), from the x axis.

    Args:
        radius: a length; positive.
        position: x of the centre, a length.
        height: y of the centre, a length.

    Raises:
        ValueError: if a value is not a finite number, or `radius` is not positive.

    Examples:
        >>> scene = jw.Scene(jw.Whisker(), jw.Pipe(radius=0.65, height=0.4), contacts=2)
        >>> print(scene.profile)
        pipe r = 0.65, y = 0.4
    """

    radius: Scalar
    position: Scalar = 0.0
    height: Scalar = 0.0

    def __check_init__(self):
        for name in self.__dataclass_fields__:
            checks.number(name, getattr(self, name), positive=name == "radius")

    def point(self, parameter):
        cos, sin = jnp.cos(parameter), -jnp.sin(parameter)
        return ContactPoint(self.position + self.radius * cos, self.height + self.radius * sin, sin, -cos)

    def speed(self, parameter):
        return self.radius + 0.0 * parameter

    @property
    def is_concave(self):
        return True

    @property
    def closed(self):
        return True

    def span(self):
        return -jnp.pi, jnp.pi

    def lowest(self):
        return checks.RIGHT_ANGLE

    def vertex(self):
        return self.position, self.height - self.radius

    def first_touch(self, height, side):
        raise NotImplementedError("whiskers are inside a pipe from the start")

    def in_unit(self, length):
        return Pipe(self.radius / length, self.position / length, self.height / length)

    def _positive(self):
        return [self.radius]

    def __str__(self):
        place = text_unless(0.0, ", x = ", self.position) + text_unless(0.0, ", y = ", self.height)
        return f"pipe r = {as_text(self.radius)}{place}"
