"""Given loads on a whisker, in the form in which `deflect` walks past them."""

from functools import reduce
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.loads import LineLoad, PointForce, PointMoment
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._rod.foundation import Density
from jaxwhisker._rod.rod import Along, at_arc
from jaxwhisker._rod.walk import pressed

Given: TypeAlias = tuple[PointForce | PointMoment | LineLoad, ...]


class Loads(eqx.Module):
    """Forces and moments in one form, sorted from the tip to the base; dimensionless."""

    force: Float[Array, "*loads"]
    direction: Float[Array, "*loads"]
    follower: Float[Array, "*loads"]
    moment: Float[Array, "*loads"]
    position: Float[Array, "*loads"]


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

    def density(self, s: Scalar) -> Float[Array, "2"]:
        """Dimensionless force per length along x and y, at an arc length on the loaded part."""
        each = [at_arc(part, s * self.length) for part in (self.load.x, self.load.y)]
        return jnp.stack(each) / self.force


class _Weight(eqx.Module):
    """Weight per length along one axis."""

    mass_per_length: Any
    gravity: Scalar

    def __call__(self, s: Scalar) -> Scalar:
        return self.gravity * at_arc(self.mass_per_length, s)


def weight_of(whisker: Whisker, gravity: tuple[Scalar, Scalar]) -> Given:
    """Weight of the whisker and of the mass at its tip; the base's mass does not load the whisker."""
    x, y = (_Weight(whisker.mass_per_length, along) for along in gravity)
    weight: Given = (LineLoad(x, y),)
    if whisker.tip_mass is None:
        return weight
    each = [
        PointForce(whisker.tip_mass * along, direction=way)
        for along, way in zip(gravity, (0.0, jnp.pi / 2), strict=True)
    ]
    return (*weight, *each)


def sorted_loads(whisker: Whisker, loads: Given) -> Loads:
    """Dimensionless loads at points, in the units of the whisker; one of zero at the tip if there are no others."""
    length, stiffness = whisker.length, whisker.base_stiffness
    rows = []
    for load in loads:
        if isinstance(load, LineLoad):
            continue
        position = 1.0 if load.position is None else load.position / length
        if isinstance(load, PointForce):
            size = load.force * length**2 / stiffness
            rows.append((size, load.direction, float(load.follower), 0.0, position))
        else:
            rows.append((0.0, 0.0, 0.0, load.moment * length / stiffness, position))
    columns = jnp.array(rows or [(0.0, 0.0, 0.0, 0.0, 1.0)], dtype=float).T
    return Loads(*columns[:, jnp.argsort(-columns[-1])])


def lines_of(whisker: Whisker, loads: Given) -> tuple[ScaledLineLoad, ...]:
    """Dimensionless distributed loads, in the units of the whisker."""
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


def density_of(lines: tuple[ScaledLineLoad, ...], start: Scalar, stop: Scalar, factor: Scalar = 1.0) -> Density | None:
    """Force per length of `factor` times all line loads between two arc lengths; None without any."""

    def density(x: Scalar, y: Scalar, s: Scalar) -> tuple[Scalar, Scalar]:
        total = reduce(jnp.add, (factor * line.between(start, stop) * line.density(s) for line in lines))
        return total[0], total[1]

    return density if lines else None


def with_load(total: rod.Load, load: Loads, state: rod.RodState, factor: Scalar) -> rod.Load:
    """The load on the rod between `factor` times this load, which acts at this state, and the next one."""
    x, y, cos, sin = state
    dead_x, dead_y = jnp.cos(load.direction), jnp.sin(load.direction)
    follower = load.follower > 0
    force = factor * load.force
    # A follower is turned by phi - pi/2, like the whisker.
    fx = force * jnp.where(follower, dead_y * cos + dead_x * sin, dead_x)
    fy = force * jnp.where(follower, dead_y * sin - dead_x * cos, dead_y)
    return jax.tree.map(jnp.add, total, pressed((x, y), fx, fy, factor * load.moment))
