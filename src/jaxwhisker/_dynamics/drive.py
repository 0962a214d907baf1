"""The control of a moving drive as a function of time."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.leaves import as_field
from jaxwhisker._base.types import Scalar


class Whisking(eqx.Module):
    """Sinusoidal drive: control(t) = offset + amplitude * sin(2 pi frequency t + phase).

    Args:
        amplitude: in the unit of the control: a length, or an angle in rad for a Rotation.
        frequency: 1/time; positive.
        offset: in the unit of the control.
        phase: rad.

    Raises:
        ValueError: if a value is not a finite number, or the frequency is not positive.

    Examples:
        >>> print(f"{jw.Whisking(amplitude=0.3, frequency=8.0)(1 / 32):.3f}")
        0.300
    """

    amplitude: Scalar
    frequency: Scalar
    offset: Scalar = 0.0
    phase: Scalar = 0.0

    def __check_init__(self):
        for name in ("amplitude", "offset", "phase"):
            checks.number(name, getattr(self, name))
        checks.number("frequency", self.frequency, positive=True)

    def __call__(self, t: Scalar) -> Scalar:
        """The control at a time."""
        return self.offset + self.amplitude * jnp.sin(2 * jnp.pi * self.frequency * t + self.phase)


class Sweep(eqx.Module):
    """Drive that moves at a constant speed and then holds its position.

    control(t) = start + speed t towards stop, and stop from the time |stop - start| / speed on. It stops at once: the
    whiskers vibrate until their damping brings them to rest.

    Args:
        start: in the unit of the control: a length, or an angle in rad for a Rotation.
        stop: in the unit of the control.
        speed: in the unit of the control per time; positive.

    Raises:
        ValueError: if a value is not a finite number, or the speed is not positive.

    Examples:
        >>> sweep = jw.Sweep(start=0.8, stop=-0.2, speed=0.5)
        >>> print(f"{sweep(1.0):.2f} {sweep(2.0):.2f} {sweep(5.0):.2f}")
        0.30 -0.20 -0.20
    """

    start: Scalar
    stop: Scalar
    speed: Scalar

    def __check_init__(self):
        for name in ("start", "stop"):
            checks.number(name, getattr(self, name))
        checks.number("speed", self.speed, positive=True)

    def __call__(self, t: Scalar) -> Scalar:
        """The control at a time."""
        way, travelled = self.stop - self.start, self.speed * t
        return jnp.where(travelled < jnp.abs(way), self.start + jnp.sign(way) * travelled, self.stop)


class SampledControl(eqx.Module):
    """Control through equidistant samples, the first at time 0 and the last at the end: smooth cubics."""

    values: Float[Array, " samples"]
    duration: Scalar

    def __call__(self, t: Scalar) -> Scalar:
        """The control at a time (Catmull-Rom)."""
        count = self.values.shape[0]
        at = t / self.duration * (count - 1)
        k = jnp.clip(jnp.floor(at).astype(int), 0, count - 2)
        # Beyond both ends the samples go on linearly.
        first, last = 2 * self.values[0] - self.values[1], 2 * self.values[-1] - self.values[-2]
        values = jnp.concatenate([first[None], self.values, last[None]])
        before, start, stop, after = (values[k + j] for j in range(4))
        return Cubic(start, stop, (stop - before) / 2, (after - start) / 2).value(at - k)


def drive_of(drive: Any, duration: Scalar) -> Callable[[Scalar], Scalar]:
    """A function of time from a user's drive: a function, samples, or a number if the drive rests.

    Raises:
        ValueError: if `drive` is not one of these, or a sample is not finite.
    """
    if callable(drive):
        checks.function("drive", drive)
        return as_field(drive)
    if jnp.ndim(drive) == 0:
        checks.number("drive", drive)
        drive = jnp.full(2, drive, dtype=float)
    checks.vector("drive", drive)
    if jnp.shape(drive)[0] < 2:
        checks.fail("drive", "a function of time, a number, or at least two samples", repr(drive))
    return SampledControl(jnp.asarray(drive, dtype=float), duration)
