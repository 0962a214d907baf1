"""Given loads that are distributed along a whisker, dimensionless, and its weight."""

from functools import reduce
from typing import Any, TypeAlias, overload

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.loads import LineLoad, PointForce, SpaceForce
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.foundation import DeadDensity
from jaxwhisker._rod.rod import Along, at_arc

Gravity: TypeAlias = tuple[Scalar, Scalar] | tuple[Scalar, Scalar, Scalar]  # in space with three components

SAMPLES = 5  # arc lengths at which the size of a load is measured


class ScaledLineLoad(eqx.Module):
    """A distributed load, with its ends in lengths of the whisker."""

    load: LineLoad
    start: Scalar
    stop: Scalar
    length: Scalar  # unit of length
    force: Scalar  # unit of force per length

    def between(self, s: Scalar, stop: Scalar) -> Scalar:
        """1 if a stretch of the whisker lies on the loaded part, else 0; no end of this part is inside the stretch."""
        middle = (s + stop) / 2
        return jnp.where((middle > self.start) & (middle < self.stop), 1.0, 0.0)

    def density(self, s: Scalar) -> Float[Array, "3"]:
        """Dimensionless force per length along x, y and z, at an arc length on the loaded part."""
        parts = (0.0 if part is None else part for part in (self.load.x, self.load.y, self.load.z))
        return jnp.stack([at_arc(part, s * self.length) for part in parts]) / self.force

    @property
    def size(self) -> Float[Array, ""]:
        """Size of the whole load, about the sum of its forces along the axes."""
        along = self.start + (self.stop - self.start) * jnp.linspace(0.0, 1.0, SAMPLES)
        return (self.stop - self.start) * jnp.sum(jnp.abs(jax.vmap(self.density)(along))) / SAMPLES

    @property
    def inside(self) -> Bool[Array, ""]:
        """Whether the loaded part has a length and lies on the whisker."""
        start, stop = jnp.asarray(self.start), jnp.asarray(self.stop)
        return (start >= 0) & (stop > start) & (stop <= 1)


class _WeightAlong(eqx.Module):
    """Weight per length along one axis."""

    mass_per_length: Any
    gravity: Scalar

    def __call__(self, s: Scalar) -> Scalar:
        return self.gravity * at_arc(self.mass_per_length, s)


@overload
def weight_of(whisker: Whisker, gravity: tuple[Scalar, Scalar]) -> tuple[PointForce | LineLoad, ...]: ...
@overload
def weight_of(whisker: Whisker, gravity: Gravity) -> tuple[PointForce | LineLoad | SpaceForce, ...]: ...
def weight_of(whisker: Whisker, gravity: Gravity) -> tuple[PointForce | LineLoad | SpaceForce, ...]:
    """Weight of the whisker and of the mass at its tip; the base's mass does not load the whisker.

    With two components of `gravity` these are loads in the plane.
    """
    x, y, *z = (_WeightAlong(whisker.mass_per_length, along) for along in gravity)
    weight = LineLoad(x, y, z=z[0] if z else None)
    if whisker.tip_mass is None:
        return (weight,)
    at_tip = [whisker.tip_mass * along for along in gravity]
    if z:
        fx, fy, fz = at_tip
        return weight, SpaceForce(fx, fy, fz)
    ways = 0.0, jnp.pi / 2
    return weight, *(PointForce(force, direction=way) for force, way in zip(at_tip, ways, strict=True))


def lines_of(whisker: Whisker, loads: tuple[Any, ...]) -> tuple[ScaledLineLoad, ...]:
    """Dimensionless distributed loads among all loads, in the units of the whisker."""
    length, stiffness = whisker.length, whisker.base_stiffness
    lines = []
    for load in loads:
        if isinstance(load, LineLoad):
            stop = jnp.ones(()) if load.stop is None else jnp.asarray(load.stop / length, dtype=float)
            start = jnp.asarray(load.start / length, dtype=float)
            lines.append(ScaledLineLoad(load, start, stop, length, stiffness / length**3))
    return tuple(lines)


def ends_of_lines(lines: tuple[ScaledLineLoad, ...]) -> Along:
    """Arc lengths at which distributed loads begin and end."""
    ends = [end for line in lines for end in (line.start, line.stop)]
    return jnp.stack(ends) if ends else jnp.zeros(0)


def density_of(
    lines: tuple[ScaledLineLoad, ...], start: Scalar, stop: Scalar, factor: Scalar = 1.0
) -> DeadDensity | None:
    """Force per length of `factor` times all line loads between two arc lengths; None without any."""

    def density(s: Scalar) -> Float[Array, "3"]:
        return reduce(jnp.add, (factor * line.between(start, stop) * line.density(s) for line in lines))

    return density if lines else None
