"""What holds the shafts of moving whiskers: springs between the drive and a place of a whisker, and foundations.

A foundation is a row of springs at the Gauss points of its stretch, which act across the unloaded whisker.

The load of a spring in a time step is such that its work, on whisker and drive together, is the change of its energy:
the mean of the tension between its lengths at both ends of the step, along the difference quotient of the length by the
position of the spring's end.
"""

from collections import Counter
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.quadrature import gauss
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.legendre import Basis, sinc, weights_at
from jaxwhisker._equilibrium.attach import attached
from jaxwhisker._equilibrium.dimensionless import sections
from jaxwhisker._equilibrium.shaft_springs import (
    AXIAL,
    SHORTEST,
    Laws,
    ShaftSprings,
    Tissue,
    anchor_of,
    tension_of,
)
from jaxwhisker._model.scene import Scene, Sensor, units
from jaxwhisker._model.spring import POINTS, WEIGHTS

ROW = 8  # springs in the place of a foundation
MEAN = gauss(2)[0]  # Gauss points of the mean tension, exact up to the third power

PerPlace = Float[Array, "*whiskers places"]


class SprungShafts(NamedTuple):
    """Springs at places of one whisker; or of all whiskers, stacked."""

    springs: ShaftSprings  # fields (*whiskers, places)
    direction: Float[Array, "*whiskers places 3"]  # their length is the displacement along it; 0 if they are axial
    reach: Float[Array, "*whiskers places points"]  # integrals up to the place of what is known at the Gauss points
    bends: Float[Array, "*whiskers places n"]  # angle at the place per shape function
    rest: PerPlace  # angle of the unloaded whisker there to its base


class SpringPositions(NamedTuple):
    """The springs of one whisker at one time; or those of all whiskers, stacked."""

    at: Float[Array, "*whiskers places 3"]  # position of their ends, and angle of the whisker to the upright there
    apart: Float[Array, "*whiskers places 3"]  # that relative to their other ends, in the drive's frame
    length: PerPlace


class Pulls(NamedTuple):
    """What the springs of one whisker do in a step; or those of all whiskers, stacked."""

    first: SpringPositions
    last: SpringPositions
    elastic: PerPlace  # mean tension
    damped: PerPlace  # what damping adds to it
    load: Float[Array, "*whiskers places 3"]  # mean force along x and y and moment, on the whisker
    about_base: Float[Array, "*whiskers places 3"]  # the same, with moments about the base of forces on the follicle


def held_of(scene: Scene | Sensor, shapes: Basis) -> tuple[SprungShafts | None, Laws]:
    """Dimensionless springs on the shafts of all whiskers, None without any, and the laws of those not linear."""
    if not scene.support.on_shafts:
        return None, ()
    unit = units(scene)
    found = attached(scene.support, sections(scene.whiskers, unit.length, unit.moment * unit.length), unit)
    assert found is not None
    count = Counter(whisker for spring in scene.support.attached for whisker, _ in spring.ends)
    most = max(count.values(), default=0)
    order = found.ranks[:, :most]  # that of the support; fewer springs are followed by places without share
    springs = jax.tree.map(lambda leaf: jnp.take_along_axis(leaf, order, axis=1), found.held_by.springs)
    direction = jnp.eye(AXIAL + 1, 3)[springs.axis]
    if found.held_by.tissue is not None:
        row, across = jax.vmap(_row)(found.held_by.tissue)
        springs = jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=1), springs, row)
        direction = jnp.concatenate([direction, across], axis=1)
    each = []
    for k, whisker in enumerate(scene.whiskers):
        length = jnp.asarray(whisker.length, dtype=float)
        s = jnp.maximum(springs.at[k] * unit.length / length, 0.0)
        reach = jax.vmap(lambda s: weights_at(shapes, s)[1])(s)
        rest = length * reach @ jax.vmap(whisker.curvature_at)(length * shapes.points)
        each.append((reach, reach @ shapes.curvatures, rest))
    reach, bends, rest = (jnp.stack(parts) for parts in zip(*each, strict=True))
    return SprungShafts(springs, direction, reach, bends, rest), found.laws


def _row(tissue: Tissue) -> tuple[ShaftSprings, Float[Array, "places 3"]]:
    """Springs in the place of the foundation of one whisker, and their directions."""
    points, weights = gauss(ROW)
    stretch, zero = tissue.stop - tissue.start, jnp.zeros(ROW)
    s = tissue.start + stretch * points
    springs = ShaftSprings(
        at=s,
        anchor_x=tissue.x - s * tissue.sin,
        anchor_y=tissue.y + s * tissue.cos,
        anchor_angle=zero,
        stiffness=stretch * weights * tissue.stiffness,
        rest_length=zero + tissue.rest_length,
        axis=zero.astype(int),
        one_sided=zero,
        law=zero.astype(int),
        share=zero + 1.0,
    )
    return springs, jnp.stack([zero + tissue.cos, zero + tissue.sin, zero], axis=-1)


def ends_of(held: SprungShafts, length: Scalar, q: Array, base: Array, angle: Array, drive: Array) -> SpringPositions:
    """The springs of one whisker with these coordinates, base and angles at its Gauss points."""
    below, (x, y, turn) = jnp.minimum(held.springs.at, 0.0), base
    at = jnp.stack(
        [
            x + length * held.reach @ jnp.cos(angle) - below * jnp.sin(turn),
            y + length * held.reach @ jnp.sin(angle) + below * jnp.cos(turn),
            turn + held.rest + held.bends @ q,
        ],
        axis=-1,
    )
    cos, sin, (right, up, turned) = jnp.cos(drive[2]), jnp.sin(drive[2]), (at - drive).T
    here = jnp.stack([right * cos + up * sin, up * cos - right * sin, turned], axis=-1)
    apart = here - jax.vmap(anchor_of)(held.springs)
    distance = jnp.sqrt(apart[:, 0] ** 2 + apart[:, 1] ** 2 + SHORTEST**2)
    along = jnp.sum(held.direction * apart, axis=-1)
    return SpringPositions(jnp.asarray(at), apart, jnp.where(held.springs.axis == AXIAL, distance, along))


def tensions(held: SprungShafts, laws: Laws, length: Float[Array, " places"]) -> Float[Array, " places"]:
    """Tensions of springs of these lengths."""
    return jax.vmap(lambda spring, length: jnp.asarray(tension_of(spring, laws, length)))(held.springs, length)


def energies(held: SprungShafts, laws: Laws, length: Float[Array, " places"]) -> Float[Array, " places"]:
    """Energies of springs of these lengths."""
    rest, extension = held.springs.rest_length, length - held.springs.rest_length
    each = jax.vmap(lambda share: tensions(held, laws, rest + share * extension))(jnp.asarray(POINTS))
    return extension * (WEIGHTS @ each)


def mean_tensions(held: SprungShafts, laws: Laws, first: Array, last: Array, ahead: Scalar) -> Float[Array, " places"]:
    """Tensions in a step between these lengths: the mean, or those at the end if the step is implicit (ahead = 1).

    Springs that only pull or push begin to do so where they are unstrained, which divides the step.
    """
    change = last - first
    at_rest = (held.springs.rest_length - first) / jnp.where(change == 0, 1.0, change)
    split = jnp.where(change == 0, 0.0, jnp.clip(at_rest, 0.0, 1.0))

    def mean(start, share):
        at = start + share * MEAN[:, None]
        at += (2 * ahead - 1) * (1 - at)
        return share * jnp.mean(jax.vmap(lambda at: tensions(held, laws, first + at * change))(at), axis=0)

    return mean(0.0, split) + mean(split, 1 - split)


def pulls_of(
    held: SprungShafts,
    laws: Laws,
    first: SpringPositions,
    last: SpringPositions,
    turns: tuple[Float[Array, "2"], Float[Array, "2"]],
    ahead: Scalar,
    lag: Scalar,
) -> Pulls:
    """What springs do in a step.

    Args:
        held: the springs of one whisker.
        laws: of all springs that are not linear.
        first: the springs at the start of the step.
        last: the springs at its end.
        turns: angles of the drive and of the base at both times.
        ahead: see `Moving.ahead`.
        lag: time constant of the damping, in steps.
    """
    elastic = mean_tensions(held, laws, first.length, last.length, ahead)
    damped = lag * (tensions(held, laws, last.length) - tensions(held, laws, first.length))
    axial = (held.springs.axis == AXIAL)[:, None]
    total = jnp.where(held.springs.axis == AXIAL, first.length + last.length, 1.0)
    direction = (first.apart + last.apart)[:, :2] / total[:, None]
    direction = jnp.where(axial, jnp.pad(direction, ((0, 0), (0, 1))), held.direction)
    right, up, turn = -(elastic + damped) * direction.T
    drive, base = turns
    cos, sin = jnp.mean(jnp.cos(drive)), jnp.mean(jnp.sin(drive))
    load = jnp.stack([right * cos - up * sin, right * sin + up * cos, turn], axis=-1)
    # The follicle below the base turns with it.
    middle, half = jnp.mean(base), (base[1] - base[0]) / 2
    below = jnp.minimum(held.springs.at, 0.0) * sinc(half)
    lever = below * (load[:, 0] * jnp.cos(middle) + load[:, 1] * jnp.sin(middle))
    return Pulls(first, last, elastic, damped, load, load.at[:, 2].add(-lever))
