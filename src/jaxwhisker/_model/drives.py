"""The drive in space: its position and orientation as functions of the control.

Frame: x along the scan, y up, z = x cross y. The drive's frame has the scene's axes while its rotation is the identity.
A whisker that stands upright on the drive has the directors d1 = x, d2 = -z and d3 = y, its tangent.
"""

import abc
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_field, as_text, name_of
from jaxwhisker._base.rotation import about, rotation_matrix
from jaxwhisker._base.types import Scalar, Triple
from jaxwhisker._model.motion import (
    AbstractBounded,
    AbstractDriveMotion,
    AbstractMotion,
    AbstractRotation,
    AbstractTranslation,
    AbstractUserDefined,
    Mount,
)

NOWHERE = (0.0, 0.0, 0.0)
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # columns d1, d2, d3 of an upright whisker
RETURNS = ("(x", "y", "z)", "(rotation_x", "rotation_y", "rotation_z)")  # two triples, as error messages print them


class Placement(NamedTuple):
    """A frame in space: its origin and, as columns, the directions of its axes, in the frame that contains it."""

    position: Float[Array, "3"]
    rotation: Float[Array, "3 3"]

    def containing(self, inner: "Placement") -> "Placement":
        """Where a frame is that has the placement `inner` in this one."""
        return Placement(self.position + self.rotation @ inner.position, self.rotation @ inner.rotation)


class SpaceMotion(AbstractDriveMotion):
    """A curve of placements of the drive in space; a scan follows it from one in which all whiskers are free."""

    @abc.abstractmethod
    def placement(self, control: Scalar) -> Placement:
        """The placement of the drive's frame in the scene at a control."""


class LinearDrive(SpaceMotion, AbstractTranslation):
    """Translation of the drive along a line; the control is the distance from `origin`, a length, and increases.

    Args:
        direction: (x, y, z) of a vector along which the drive moves, of any length but zero.
        origin: (x, y, z) of the drive at the control 0, lengths.

    Raises:
        ValueError: if an argument is not three finite numbers, or the direction is zero.

    Examples:
        >>> oblique = jw.LinearDrive(direction=(-3.0, 0.0, 4.0), origin=(0.0, 0.1, 0.0))
        >>> print(oblique.placement(0.5).position)
        [-0.3  0.1  0.4]
    """

    direction: Triple = eqx.field(converter=checks.as_tuple)
    origin: Triple = eqx.field(default=NOWHERE, converter=checks.as_tuple)

    def __check_init__(self):
        _check_direction("direction", self.direction)
        checks.triple("origin", self.origin)

    def placement(self, control):
        return Placement(_array(self.origin) + control * _unit(self.direction), jnp.eye(3))

    @property
    def onwards(self):
        return 1

    def valid(self):
        return checks.all_finite(self) & _has_length(self.direction)

    def __str__(self):
        origin = _text(self.origin)
        return f"translation along {_text(self.direction)}" + f" from {origin}" * (origin != _text(NOWHERE))


class RotaryDrive(SpaceMotion, AbstractRotation, AbstractBounded):
    """Rotation of the drive about an axis in space; the control is the angle, rad, right-handed about the axis.

    At the control 0, the drive's frame is that of the scene.

    Args:
        axis: (x, y, z) of a vector along the axis, of any length but zero.
        pivot: (x, y, z) of a point on the axis, lengths.
        start: a control at which all whiskers are free, rad. Default: a right angle before 0.
        stop: the last control of the default scan, rad. Default: a right angle after 0.

    Raises:
        ValueError: if `axis` or `pivot` is not three finite numbers, the axis is zero, or `start` and `stop`
            are not two different finite numbers.

    Examples:
        >>> nodding = jw.RotaryDrive(axis=(1.0, 0.0, 0.0), pivot=(0.0, -0.5, 0.0))
        >>> print(nodding.placement(0.1).position.round(4))
        [ 0.     -0.0025  0.0499]
    """

    axis: Triple = eqx.field(converter=checks.as_tuple)
    pivot: Triple = eqx.field(default=NOWHERE, converter=checks.as_tuple)
    start: Scalar = -np.pi / 2
    stop: Scalar = np.pi / 2
    direction: int = eqx.field(static=True, init=False)

    def __check_init__(self):
        _check_direction("axis", self.axis)
        checks.triple("pivot", self.pivot)

    def placement(self, control):
        return _about_pivot(self.pivot, rotation_matrix(control * _unit(self.axis)))

    def valid(self):
        return checks.all_finite(self) & _has_length(self.axis)

    def __str__(self):
        return f"rotation about {_text(self.axis)}"


class WhiskDrive(SpaceMotion, AbstractRotation, AbstractBounded):
    """Whisking: protraction with an elevation and a roll that change with it.

    The control u, an angle in rad, changes the angle of protraction about z (towards -x for an upright whisker). The
    rotation of the drive is Rz(protraction + protraction_rate u) Rx(elevation + elevation_rate u) Ry(roll + roll_rate
    u): the roll turns an upright whisker about its root, the elevation tilts it towards +z, and the protraction turns
    it about z.

    Args:
        elevation: angle of elevation at u = 0, rad.
        roll: angle of roll at u = 0, rad.
        elevation_rate: change of the elevation per change of the control.
        roll_rate: the same for the roll.
        pivot: (x, y, z) of the point about which the drive turns, lengths. Default: the base of a whisker without
            mount.
        start: a control at which all whiskers are free, rad. Default: a right angle before 0.
        stop: the last control of the default scan, rad. Default: a right angle after 0.
        protraction: angle of protraction at u = 0, rad.
        protraction_rate: change of the protraction per change of the control: 1, or -1 for whiskers on the other side
            of a head.

    Raises:
        ValueError: if a value is not a finite number, `pivot` is not a tuple of three, or `start` and `stop` are equal.

    Examples:
        >>> row_c = jw.WhiskDrive(elevation_rate=0.30, roll_rate=0.22, start=-0.6, stop=0.9)
        >>> print(row_c.placement(0.0).rotation.diagonal())
        [1. 1. 1.]

    `Array.rat` has the rates of rats.
    """

    elevation: Scalar = 0.0
    roll: Scalar = 0.0
    elevation_rate: Scalar = 0.0
    roll_rate: Scalar = 0.0
    pivot: Triple = eqx.field(default=NOWHERE, converter=checks.as_tuple)
    start: Scalar = -np.pi / 2
    stop: Scalar = np.pi / 2
    protraction: Scalar = eqx.field(default=0.0, kw_only=True)
    protraction_rate: Scalar = eqx.field(default=1.0, kw_only=True)
    direction: int = eqx.field(static=True, init=False)

    def __check_init__(self):
        for name in ("elevation", "roll", "elevation_rate", "roll_rate", "protraction", "protraction_rate"):
            checks.number(name, getattr(self, name))
        checks.triple("pivot", self.pivot)

    def placement(self, control):
        elevation, roll = self.elevation + self.elevation_rate * control, self.roll + self.roll_rate * control
        protraction = self.protraction + self.protraction_rate * control
        return _about_pivot(self.pivot, _angles(protraction, elevation, roll))

    def __str__(self):
        return "whisking"


class PoseDrive(SpaceMotion, AbstractUserDefined):
    """User-defined motion of the drive in space.

    Args:
        function: maps the control to the position (x, y, z) of the drive's frame, lengths, and its rotation vector: the
            direction of the axis times the angle, rad, right-handed. Both are tuples of three numbers or arrays of
            shape (3,). JAX must be able to trace it. The parameters of an `equinox.Module` are differentiable; a plain
            function is constant.
        start: a control at which all whiskers are free.
        stop: the last control of the default scan.

    Raises:
        ValueError: if JAX cannot trace `function` or it does not return two triples, or `start` and `stop` are not two
            different finite numbers.

    Examples:
        >>> rolling = jw.PoseDrive(lambda u: ((1.2 - u, 0.0, 0.0), (0.0, 0.3 * u, 0.0)), start=0.0, stop=2.4)
        >>> print(f"x = {rolling.placement(1.0).position[0]:.1f}")
        x = 0.2
    """

    function: Callable[[Any], Any] = eqx.field(converter=lambda value: _placement_function(value))
    start: Scalar
    stop: Scalar
    direction: int = eqx.field(static=True, init=False)

    def placement(self, control):
        position, turn = self.function(control)
        return Placement(_array(position), rotation_matrix(_array(turn)))


def placement_of(motion: SpaceMotion | AbstractMotion, control: Scalar) -> Placement:
    """The placement in space of the drive at a control, also for a motion in the plane, which turns about z."""
    if isinstance(motion, SpaceMotion):
        return motion.placement(control)
    x, y, angle = motion.pose(control)
    return Placement(_array((x, y, 0.0)), about(2, angle))


def mount_in_space(mount: Mount) -> Placement:
    """The placement, in the drive's frame, of the directors of a whisker's root while its base is on its mount.

    The origin is (x, y, z) of the mount, and the rotation is Rz(angle) Rx(elevation) R Rot3(roll), with the directors R
    of an upright whisker and Rot3 about the third one, the tangent.
    """
    z, elevation, roll = (0.0 if value is None else value for value in (mount.z, mount.elevation, mount.roll))
    return Placement(_array((mount.x, mount.y, z)), _angles(mount.angle, elevation, roll) @ jnp.asarray(UPRIGHT))


def _placement_function(value: Any) -> Any:
    """Check a function that returns a position and a rotation vector, and convert it to a field."""

    def flat(control):
        result = value(control)
        try:
            position, turn = map(tuple, result)
        except (TypeError, ValueError):
            return result
        return [*position, *turn] if len(position) == len(turn) == 3 else result

    if callable(value):
        functools.update_wrapper(flat, value, updated=())
        flat.__name__ = name_of(value)
    checks.function("function", flat if callable(value) else value, RETURNS)
    return as_field(value)


def _angles(protraction: Scalar, elevation: Scalar, roll: Scalar) -> Float[Array, "3 3"]:
    return about(2, protraction) @ about(0, elevation) @ about(1, roll)


def _about_pivot(pivot: Triple, rotation: Float[Array, "3 3"]) -> Placement:
    """The placement after a rotation about a point that the rotation leaves where it is."""
    point = _array(pivot)
    return Placement(point - rotation @ point, rotation)


def _check_direction(name: str, value: Any) -> None:
    checks.triple(name, value)
    if not checks.is_traced(value) and not any(map(float, value)):
        checks.fail(name, "a vector that is not zero", repr(value))


def _has_length(direction: Triple) -> Bool[Array, ""]:
    return jnp.any(_array(direction) != 0)


def _unit(direction: Triple) -> Float[Array, "3"]:
    vector = _array(direction)
    return vector / jnp.sqrt(jnp.sum(vector**2))


def _array(triple: Any) -> Float[Array, "3"]:
    return jnp.stack([jnp.asarray(part, dtype=float) for part in triple])


def _text(triple: Triple) -> str:
    return f"({', '.join(map(as_text, triple))})"
