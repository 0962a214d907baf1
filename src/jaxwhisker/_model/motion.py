"""The motion: how the drive, to which the bases are tied, moves with the control."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.functions import as_field, name_of
from jaxwhisker._base.types import Scalar


class Pose(NamedTuple):
    """Where a frame stands in the scene: its origin, and its angle to the upright, counter-clockwise."""

    x: Scalar
    y: Scalar
    angle: Scalar


class AbstractMotion(eqx.Module):
    """A motion takes the drive along a curve of poses; a scan runs through it from where all whiskers are free."""

    @abc.abstractmethod
    def pose(self, control: Scalar) -> Pose:
        """The pose of the drive's frame."""

    @property
    @abc.abstractmethod
    def ends(self) -> tuple[Scalar, Scalar] | None:
        """Controls between which a scan lies, the first one with all whiskers free; None if far away on both sides."""

    @property
    @abc.abstractmethod
    def onwards(self) -> int:
        """+1 if the control grows on the way, else -1."""

    @abc.abstractmethod
    def unit(self, length: Scalar) -> Scalar:
        """The size of a step of the control that goes with that length."""

    @abc.abstractmethod
    def valid(self) -> Any:
        """Whether traced parameters lie where the constructor would have let them."""


class Translation(AbstractMotion):
    """The drive moves along x; the control is its position, a length.

    Args:
        direction: -1 for a scan towards -x, from the right of the object; +1 from the left.

    Raises:
        ValueError: if it is neither.
    """

    direction: int = eqx.field(static=True, default=-1)

    def __check_init__(self):
        _direction(self.direction)

    def pose(self, control):
        control = jnp.asarray(control, dtype=float)
        return Pose(control, jnp.zeros_like(control), jnp.zeros_like(control))

    @property
    def ends(self):
        return None

    @property
    def onwards(self):
        return self.direction

    def unit(self, length):
        return length

    def valid(self):
        return jnp.asarray(True)

    def __str__(self):
        return "translation" if self.direction < 0 else "translation towards +x"


class Rotation(AbstractMotion):
    """The drive turns about a pivot; the control is its angle to the upright, rad, counter-clockwise positive.

    A scan runs from a right angle on one side to a right angle on the other.

    Args:
        pivot: (x, y) of the pivot, lengths.
        radius: how far in front of it the bases lie; of a pivot far below them the motion is a translation.
        direction: +1 turns counter-clockwise, from the right of the object to the left; -1 clockwise.

    Raises:
        ValueError: if a value is not a finite number, or the direction neither of the two.
    """

    pivot: tuple[Scalar, Scalar] = (0.0, 0.0)
    radius: Scalar = 0.0
    direction: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        if not (isinstance(self.pivot, tuple) and len(self.pivot) == 2):
            raise ValueError(f"`pivot` must be a pair of numbers, but is {self.pivot!r}.")
        for value in self.pivot:
            checks.number("pivot", value)
        checks.number("radius", self.radius)
        _direction(self.direction)

    def pose(self, control):
        x, y = self.pivot
        return Pose(x - self.radius * jnp.sin(control), y + self.radius * jnp.cos(control), control)

    @property
    def ends(self):
        return -self.direction * np.pi / 2, self.direction * np.pi / 2

    @property
    def onwards(self):
        return self.direction

    def unit(self, length):
        del length
        return 1.0

    def valid(self):
        return jnp.all(jnp.isfinite(jnp.stack([jnp.asarray(v, dtype=float) for v in (*self.pivot, self.radius)])))

    def __str__(self):
        return "rotation" if self.direction > 0 else "clockwise rotation"


class Motion(AbstractMotion):
    """A motion of one's own.

    Args:
        function: takes the control to (x, y, angle) of the drive's frame: two lengths, and the angle to the upright,
            rad, counter-clockwise. It is traced; an `equinox.Module` keeps its parameters differentiable.
        start: a control at which all whiskers are free.
        stop: where the default control of a scan ends.

    Raises:
        ValueError: if start and stop are not two different finite numbers.
    """

    function: Callable[[Any], Any] = eqx.field(converter=as_field)
    start: Scalar
    stop: Scalar
    direction: int = eqx.field(static=True)

    def __init__(self, function: Callable, start: float, stop: float):
        if not callable(function):
            raise ValueError(f"`function` must take the control to (x, y, angle), but is {function!r}.")
        checks.number("start", start)
        checks.number("stop", stop)
        if float(start) == float(stop):
            raise ValueError(f"`stop` must differ from `start`, but both are {float(start)}.")
        self.function, self.start, self.stop = as_field(function), float(start), float(stop)
        self.direction = 1 if float(stop) > float(start) else -1

    def pose(self, control):
        pose = tuple(self.function(control))
        if len(pose) != len(Pose._fields):
            raise ValueError(f"`function` must return x, y and angle, but returned {len(pose)} values.")
        return Pose(*(jnp.asarray(value, dtype=float) for value in pose))

    @property
    def ends(self):
        return self.start, self.stop

    @property
    def onwards(self):
        return self.direction

    def unit(self, length):
        del length
        return jnp.abs(self.stop - self.start)

    def valid(self):
        return jnp.isfinite(self.start) & jnp.isfinite(self.stop)

    def __str__(self):
        return f"motion {name_of(self.function)}(u)"


def _direction(value: Any) -> None:
    if isinstance(value, bool) or value not in (-1, 1):
        raise ValueError(f"`direction` must be -1 or 1, but is {value!r}.")


class Frame(NamedTuple):
    """Where a base would be without load on any: origin, and the direction of its x axis."""

    x: Float[Array, "*batch"]
    y: Float[Array, "*batch"]
    cos: Float[Array, "*batch"]
    sin: Float[Array, "*batch"]


def mounted(pose: Pose, mount: Pose) -> Frame:
    """The frame of a mount on a drive."""
    cos, sin = jnp.cos(pose.angle), jnp.sin(pose.angle)
    angle = pose.angle + mount.angle
    return Frame(
        pose.x + cos * mount.x - sin * mount.y,
        pose.y + sin * mount.x + cos * mount.y,
        jnp.cos(angle),
        jnp.sin(angle),
    )


def frame_and_rate(drive: Callable[[Scalar], Pose], mounts: Pose, control: Scalar) -> tuple[Frame, Frame]:
    """Frames of all mounts at a control, and their derivative by it."""

    def at(control):
        return jax.vmap(lambda mount: mounted(drive(control), mount))(mounts)

    return jax.jvp(at, (control,), (jnp.ones_like(control),))
