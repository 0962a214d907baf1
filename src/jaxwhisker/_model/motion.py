"""The motion of the drive as a function of the control, and the mounts of the whiskers on the drive.

The abstract classes describe the control of a motion, in the plane or in space. The motions below them are those of the
plane; `drives.py` has those in space.
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_field, as_text, name_of
from jaxwhisker._base.types import Scalar

IN_SPACE = ("z", "elevation", "roll")  # of a mount


class Pose(NamedTuple):
    """Pose of a frame in the scene: its origin, and its angle to the upright (rad, positive counter-clockwise)."""

    x: Scalar
    y: Scalar
    angle: Scalar


class AbstractDriveMotion(eqx.Module):
    """A curve of frames of the drive; a scan follows it from one in which all whiskers are free."""

    control_kind = "number"  # what the control is: a "length", an "angle" or a "number"

    @property
    @abc.abstractmethod
    def ends(self) -> tuple[Scalar, Scalar] | None:
        """First control, at which all whiskers are free, and last control of a scan; None if both are far away."""

    @property
    @abc.abstractmethod
    def onwards(self) -> int:
        """+1 if the control increases during a scan, else -1."""

    @abc.abstractmethod
    def unit(self, length: Scalar) -> Scalar:
        """Unit of control of the dimensionless problem: `length`, 1 rad, or the range of a user-defined motion."""

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domain that the constructor checks; by default, all finite numbers."""
        return checks.all_finite(self)


class AbstractTranslation(AbstractDriveMotion):
    """A motion whose control is a length, from far away to far away."""

    control_kind = "length"

    @property
    def ends(self):
        return None

    def unit(self, length):
        return length


class AbstractRotation(AbstractDriveMotion):
    """A motion whose control is an angle, rad."""

    control_kind = "angle"

    def unit(self, length):
        del length
        return 1.0


# Subclasses of the following classes declare the fields, because the order of fields is that of the arguments.


class AbstractDirected(AbstractDriveMotion):
    """A motion with a static `direction`: +1 if the control increases during a scan, else -1."""

    def __check_init__(self: Any):
        if isinstance(self.direction, bool) or self.direction not in (-1, 1):
            checks.fail("direction", "-1 or 1", repr(self.direction))

    @property
    def onwards(self: Any):
        return self.direction


class AbstractBounded(AbstractDirected):
    """A motion from the control `start` to the control `stop`, of which the direction follows."""

    def __post_init__(self: Any):
        checks.number("start", self.start)
        checks.number("stop", self.stop)
        self.start, self.stop = float(self.start), float(self.stop)
        if self.start == self.stop:
            checks.fail("stop", "different from `start`", f"{self.stop} for both")
        self.direction = 1 if self.stop > self.start else -1

    @property
    def ends(self: Any):
        return self.start, self.stop


class AbstractUserDefined(AbstractBounded):
    """A bounded motion whose frames are those of a `function` of the control."""

    def unit(self: Any, length):
        del length
        return jnp.abs(self.stop - self.start)

    def valid(self: Any):
        return jnp.isfinite(self.start) & jnp.isfinite(self.stop)

    def __str__(self: Any):
        return f"motion {name_of(self.function)}(u)"


class AbstractMotion(AbstractDriveMotion):
    """A curve of poses of the drive in the plane; a scan follows it from a pose in which all whiskers are free."""

    @abc.abstractmethod
    def pose(self, control: Scalar) -> Pose:
        """The pose of the drive's frame at a control."""

    def undirected(self) -> "AbstractMotion":
        """The same poses, without a static direction where that is possible."""
        return self


class Translation(AbstractMotion, AbstractTranslation, AbstractDirected):
    """Translation of the drive along x; the control is its position, a length.

    Args:
        direction: -1 for a scan towards -x, from the right of the object; +1 for a scan from the left.

    Raises:
        ValueError: if `direction` is neither -1 nor 1.

    Examples:
        >>> print(jw.Scene(jw.Whisker(), jw.Parabola(0.2), motion=jw.Translation(direction=1)))
        clamped: 1 whisker, parabola q = 0.2, translation towards +x
    """

    direction: int = eqx.field(static=True, default=-1)

    def pose(self, control):
        control = jnp.asarray(control, dtype=float)
        return Pose(control, jnp.zeros_like(control), jnp.zeros_like(control))

    def undirected(self):
        return Translation()

    def __str__(self):
        return "translation" if self.direction < 0 else "translation towards +x"


class Rotation(AbstractMotion, AbstractRotation, AbstractDirected):
    """Rotation of the drive about a pivot; the control is its angle to the upright, rad, positive counter-clockwise.

    A scan runs from a right angle on one side to a right angle on the other.

    Args:
        pivot: (x, y) of the pivot, lengths.
        radius: distance from the pivot to the drive along the y axis of the drive's frame, a length. With a pivot far
            below the drive, the motion becomes a translation.
        direction: +1 turns counter-clockwise, from the right of the object to the left; -1 clockwise.

    Raises:
        ValueError: if a value is not a finite number, or `direction` is neither -1 nor 1.

    Examples:
        >>> pose = jw.Rotation(pivot=(0.0, -0.5), radius=0.5).pose(0.1)
        >>> print(f"x = {pose.x:.4f}, y = {pose.y:.4f}")
        x = -0.0499, y = -0.0025
    """

    pivot: tuple[Scalar, Scalar] = (0.0, 0.0)
    radius: Scalar = 0.0
    direction: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        checks.pair("pivot", self.pivot)
        checks.number("radius", self.radius)

    def pose(self, control):
        x, y = self.pivot
        return Pose(x - self.radius * jnp.sin(control), y + self.radius * jnp.cos(control), control)

    @property
    def ends(self):
        return -self.direction * np.pi / 2, self.direction * np.pi / 2

    def undirected(self):
        return Rotation(self.pivot, self.radius)

    def __str__(self):
        return "rotation" if self.direction > 0 else "clockwise rotation"


class Motion(AbstractMotion, AbstractUserDefined):
    """User-defined motion of the drive.

    Args:
        function: maps the control to (x, y, angle) of the drive's frame: two lengths, and the angle to the upright,
            rad, positive counter-clockwise. JAX must be able to trace it. The parameters of an `equinox.Module` are
            differentiable; a plain function is constant.
        start: a control at which all whiskers are free.
        stop: the last control of the default scan.

    Raises:
        ValueError: if JAX cannot trace `function` or it does not return three numbers, or `start` and `stop` are not
            two different finite numbers.

    Examples:
        >>> bob = jw.Motion(lambda u: (1.2 - u, 0.03 * jnp.sin(2 * u), 0.0), start=0.0, stop=2.6)
        >>> print(f"x = {bob.pose(1.0).x:.3f}, y = {bob.pose(1.0).y:.3f}")
        x = 0.200, y = 0.027
    """

    function: Callable[[Any], Any] = eqx.field(converter=lambda value: _pose_function(value))
    start: Scalar
    stop: Scalar
    direction: int = eqx.field(static=True, init=False)

    def pose(self, control):
        return Pose(*(jnp.asarray(value, dtype=float) for value in self.function(control)))


def _pose_function(value: Any) -> Any:
    """Check a function that returns a pose, and convert it to a field."""
    checks.function("function", value, Pose._fields)
    return as_field(value)


def pose_of(motion: AbstractMotion, control: Scalar) -> Pose:
    """The pose of the drive at a control, as arrays of floats."""
    return Pose(*(jnp.asarray(part, dtype=float) for part in motion.pose(control)))


class Mount(eqx.Module):
    """Mount of a whisker: where its base is in the drive's frame when all rest lengths are 0, and at which angle.

    The angle turns the whisker about its root.

    Args:
        x: offset along x, a length.
        y: height of the base, a length.
        angle: angle between the root of the unloaded whisker and the upright, rad, positive counter-clockwise (towards
            -x); less than a right angle.
        z: offset along z, a length. Only for objects in space. Default: none.
        elevation: angle, rad, by which the whisker is tilted towards +z before `angle` turns it about z. Only for
            objects in space. Default: none.
        roll: angle, rad, right-handed, by which the whisker is turned about its root before that, which matters only
            for curved whiskers. Only for objects in space. Default: none.

    Raises:
        ValueError: if a value is not a finite number, or the angle is not less than a right angle.

    Examples:
        >>> leaning = jw.Mount(y=0.05, angle=-0.2)
        >>> jw.Support.follicle(phi=3.0, mount=leaning).mounts[0].angle
        -0.2
    """

    x: Scalar = 0.0
    y: Scalar = 0.0
    angle: Scalar = 0.0
    z: Scalar | None = eqx.field(default=None, kw_only=True)
    elevation: Scalar | None = eqx.field(default=None, kw_only=True)
    roll: Scalar | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        checks.number("x", self.x)
        checks.number("y", self.y)
        checks.acute_angle("angle", self.angle)
        for name in IN_SPACE:
            if getattr(self, name) is not None:
                checks.number(name, getattr(self, name))

    def __str__(self) -> str:
        place = [self.x, self.y, *[self.z] * (self.z is not None)]
        angles = {name: getattr(self, name) for name in ("angle", "elevation", "roll")}
        turned = [f"{name} {as_text(value)}" for name, value in angles.items() if value is not None]
        return ", ".join([f"({', '.join(map(as_text, place))})", *turned])

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domain that the constructor checks."""
        return checks.all_finite(self) & (jnp.abs(jnp.asarray(self.angle)) < checks.RIGHT_ANGLE)

    def check_in_plane(self) -> None:
        """Raise a ValueError if it leaves the plane."""
        for name in IN_SPACE:
            if getattr(self, name) is not None:
                checks.fail(name, "None in the plane: others need an object in space", as_text(getattr(self, name)))


class Frame(NamedTuple):
    """Frame of a mount: its origin, and the direction of its x axis."""

    x: Float[Array, "*batch"]
    y: Float[Array, "*batch"]
    cos: Float[Array, "*batch"]
    sin: Float[Array, "*batch"]


def mounted(pose: Pose, mount: Pose) -> Frame:
    """The frame of a mount on the drive."""
    cos, sin = jnp.cos(pose.angle), jnp.sin(pose.angle)
    angle = pose.angle + mount.angle
    x, y = pose.x + cos * mount.x - sin * mount.y, pose.y + sin * mount.x + cos * mount.y
    return Frame(x, y, jnp.cos(angle), jnp.sin(angle))


def frame_and_rate(drive: Callable[[Scalar], Pose], mounts: Pose, control: Scalar) -> tuple[Frame, Frame]:
    """Frames of all mounts at a control, and their derivatives with respect to the control."""

    def at(control):
        return jax.vmap(lambda mount: mounted(drive(control), mount))(mounts)

    return jax.jvp(at, (control,), (jnp.ones_like(control),))
