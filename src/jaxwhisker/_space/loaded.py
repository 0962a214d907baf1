"""The equilibrium of one clamped whisker under dead forces in space.

The rod is integrated from its tip past all forces to the base. Only differences of positions enter the moments. The
rotation at the tip is therefore the only unknown, and the rotation of the base the only equation.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import positive_definite
from jaxwhisker._base.quadrature import gauss, legendre, legendre_integrals
from jaxwhisker._base.quaternions import (
    Quaternion,
    Vector,
    cross,
    inverse_rotation,
    plus,
    product,
    small_rotation,
    third_axis,
)
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.loads import PointForce, SpaceForce
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.deflection import LEAST_LOAD, ROD_STEPS, AbstractLoadedRod, AtBase, Shares
from jaxwhisker._rod.second_variation import BentRod, second_variation
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, SpaceState, integrate
from jaxwhisker._rod.walk import NO_POINTS, stretches, walk
from jaxwhisker._space.section import space_section

NODES, MODES = 12, 8  # quadrature points on a stretch and polynomials for each axis, with which stability is checked
HALF = float(np.sqrt(0.5))
CLAMP: Quaternion = (HALF, -HALF, 0.0, 0.0)  # d1 = x, d2 = -z, d3 = y

Top = Float[Array, "3"]  # rotation vector of the whisker at its top, from its direction without loads


class LoadedInSpace(AbstractLoadedRod):
    """The dimensionless equations of one whisker and its forces."""

    force: Float[Array, "forces 3"]  # from the tip to the base
    position: Float[Array, " forces"]
    section: SpaceSection
    straight: Float[Array, "4"]  # rotation at the top without loads
    walks_beyond: bool = eqx.field(static=True)  # whether the tip is beyond the outermost force

    @property
    def uniform(self) -> bool:
        """Whether the rod is the same everywhere."""
        return self.section.uniform

    @property
    def stages(self) -> int:
        """Only the forces grow."""
        return 1

    @property
    def sizes(self) -> list[Scalar]:
        """Size of all forces together."""
        return [jnp.sum(jnp.abs(self.force)) + LEAST_LOAD]

    @property
    def unbent(self) -> Top:
        """The unknowns without forces."""
        return jnp.zeros(3)

    def at_base(self, unknowns: Top, shares: Shares) -> AtBase:
        """The end of the rod, with a share of the forces."""
        return _at_base(walked(unknowns, self, shares[0], NO_POINTS, ROD_STEPS))

    def refined(self, unknowns: Top, shares: Shares) -> tuple[AtBase, Bool[Array, ""]]:
        """The end of a rod with at least twice as many steps, and whether the equilibrium is stable."""
        nodes, weights = gauss(NODES)
        found = walked(unknowns, self, shares[0], nodes, -(-2 * ROD_STEPS // (NODES + 1)))
        along = jnp.ravel(found.lengths[:, None] * weights)
        return _at_base(found), positive_definite(variation(self, found, along))


def loaded_in_space(whisker: Whisker, loads: tuple[PointForce | SpaceForce, ...]) -> LoadedInSpace:
    """The equations of a whisker and its dead forces."""
    length, stiffness = whisker.length, whisker.base_stiffness
    rows = []
    for load in loads:
        if isinstance(load, PointForce):
            force = [load.force * jnp.cos(load.direction), load.force * jnp.sin(load.direction), 0.0]
        else:
            force = [load.fx, load.fy, load.fz]
        place = 1.0 if load.position is None else load.position / length
        rows.append(jnp.array([*(part * length**2 / stiffness for part in force), place], dtype=float))
    table = jnp.stack(rows)
    table = table[jnp.argsort(-table[:, 3])]
    section, zero = space_section(whisker, length, stiffness), jnp.zeros(())
    walks_beyond = all(load.position is not None for load in loads)
    start = (zero, zero, zero), CLAMP
    nothing = SpaceLoad((zero, zero, zero))
    _, unbent = integrate(start, -jnp.ones(()), nothing, section, steps=ROD_STEPS, from_base=zero)
    return LoadedInSpace(table[:, :3], table[:, 3], section, jnp.stack(unbent), walks_beyond)


def _rotation(vector: Top) -> Quaternion:
    """The rotation about a vector by its length, up to a whole turn."""
    x, y, z = vector / 8
    q = small_rotation((x, y, z))
    for _ in range(3):
        q = product(q, q)
    return q


class WalkInSpace(NamedTuple):
    """States and loads at points of the whisker, from the top to the base, and its end there."""

    s: Float[Array, " points"]
    states: SpaceState
    loads: SpaceLoad
    lengths: Float[Array, " stretches"]  # of the stretches between forces
    end: SpaceState
    load: SpaceLoad


def walked(top: Top, rods: LoadedInSpace, factor: Scalar, share: np.ndarray, steps: int) -> WalkInSpace:
    """From the top to the base, with `factor` times the forces.

    Args:
        top: the unknowns.
        rods: see LoadedInSpace.
        factor: of the forces.
        share: points on each stretch between forces: see `stretches`.
        steps: of the rod between two points.
    """
    at, loaded, points, lengths = stretches(rods.position, share, beyond=rods.walks_beyond)

    def onwards(state, load, s, stop):
        return integrate(state, s - stop, load, rods.section, steps=steps, from_base=s), load, None

    def past(load, state, force):
        own: Vector = (force[0], force[1], force[2])
        return SpaceLoad(plus(load.force, own), plus(load.moment, cross(state[0], own)))

    w, x, y, z = rods.straight
    zero = jnp.zeros(())
    still = zero, zero, zero
    start = still, product(_rotation(top), (w, x, y, z))
    force = jnp.zeros((at.size, 3)).at[loaded].set(factor * rods.force)
    found = walk(onwards, past, start, SpaceLoad(still, still), at, force)
    states, loads = jax.tree.map(lambda leaf: jnp.take(leaf, points - 1, mode="clip"), (found.passed, found.loads))
    return WalkInSpace(at[points], states, loads, lengths, found.end, found.load)


def _at_base(found: WalkInSpace) -> AtBase:
    """The rod misses the clamp by a rotation, and its position does not matter."""
    position, rotation = found.end
    # Its derivatives at zero are those of the rotation vector.
    turn = 2 * jnp.stack(product(rotation, inverse_rotation(CLAMP))[1:])
    return AtBase(turn, jnp.stack(position))


def variation(rods: LoadedInSpace, found: WalkInSpace, weights: Float[Array, " points"]) -> Float[Array, "n n"]:
    """Second variation on rotation fields that vanish at the base, integrated with these weights.

    The determinant of the equations does not show whether a straight whisker buckles: two modes lose stability at once.
    """
    fields = jnp.stack(legendre_integrals(found.s, MODES))
    slopes = jnp.stack(jnp.broadcast_arrays(*legendre(found.s, MODES)))
    tangent, force = (jnp.stack(part, axis=-1) for part in (third_axis(found.states[1]), found.loads.force))
    moment = jnp.stack(found.loads.moment_at(found.states[0]), axis=-1)
    flexible = jax.vmap(rods.section.compliance)(found.s)
    bending = jnp.where(flexible > 0, 1 / jnp.where(flexible > 0, flexible, 1.0), 0.0)
    ratio = 1.0 if rods.section.excess is None else 1 / (1 + rods.section.excess)
    return second_variation(BentRod(bending, ratio, tangent, force, moment), fields, slopes, weights)
