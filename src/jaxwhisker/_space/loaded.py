"""The equilibrium of one clamped whisker under given loads in space.

The rod is integrated from its tip past all loads to the base. Only differences of positions enter the moments. The
rotation at the tip is therefore the only unknown, and the rotation of the base the only equation. The unknowns are
twice the quaternion of that rotation: a moment may turn the tip several times, and no three numbers describe all
rotations without a singularity. The length of the quaternion is one more equation.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import eigenvalues_are_positive, solve
from jaxwhisker._base.quadrature import gauss, legendre, legendre_integrals
from jaxwhisker._base.quaternions import Vector, first_axis, inverse_rotation, product, third_axis
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.line_loads import ScaledLineLoad, density_of, ends_of_lines, lines_of
from jaxwhisker._model.loads import LineLoad
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.deflection import LEAST_LOAD, ROD_STEPS, AbstractLoadedRod, AtBase, Shares
from jaxwhisker._rod.second_variation import BentRod, Followers, stiffness_by_followers, stiffness_of
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, SpaceState, integrate
from jaxwhisker._rod.space_line import integrate_under
from jaxwhisker._rod.walk import NO_POINTS, in_order, stretches, walk
from jaxwhisker._space.given import CLAMP, GivenInSpace, LoadsInSpace, sorted_in_space
from jaxwhisker._space.section import space_section

NODES, MODES = 18, 12  # quadrature points on a stretch and polynomials for each axis, with which stability is checked

Top = Float[Array, "4"]  # twice the quaternion of the rotation at the top


class LoadedInSpace(AbstractLoadedRod):
    """The dimensionless equations of one whisker and its loads."""

    loads: LoadsInSpace
    lines: tuple[ScaledLineLoad, ...]
    section: SpaceSection
    straight: Top  # without loads
    walks_beyond: bool = eqx.field(static=True)  # whether the tip is beyond the outermost load at a point

    @property
    def uniform(self) -> bool:
        """Whether the rod is the same everywhere."""
        return self.section.uniform

    @property
    def stages(self) -> int:
        """Only the loads grow."""
        return 1

    @property
    def sizes(self) -> list[Scalar]:
        """Size of all loads together."""
        size = jnp.sum(jnp.abs(self.loads.force)) + jnp.sum(jnp.abs(self.loads.moment)) + LEAST_LOAD
        return [size + sum(line.size for line in self.lines)]

    @property
    def unbent(self) -> Top:
        """The unknowns without loads."""
        return self.straight

    def at_base(self, unknowns: Top, shares: Shares) -> AtBase:
        """The end of the rod, with a share of the loads."""
        return _at_base(unknowns, walked(unknowns, self, shares[0], NO_POINTS, ROD_STEPS))

    def refined(self, unknowns: Top, shares: Shares) -> tuple[AtBase, Bool[Array, ""]]:
        """The end of a rod with at least twice as many steps, and whether the equilibrium is stable.

        Moments and followers have no potential. An equilibrium is called stable if each small disturbance fades while
        the rod resists its bending and twisting by a damping in proportion to its stiffness, without inertia. Under
        dead forces, this is so where the second variation of the energy is positive.
        """
        nodes, weights = gauss(NODES)
        found = walked(unknowns, self, shares[0], nodes, -(-2 * ROD_STEPS // (NODES + 1)))
        elastic, loaded = stiffness(self, found, jnp.ravel(found.lengths[:, None] * weights))
        return _at_base(unknowns, found), eigenvalues_are_positive(solve(elastic, loaded))


def loaded_in_space(whisker: Whisker, loads: GivenInSpace) -> LoadedInSpace:
    """The equations of a whisker and its loads."""
    section, zero = space_section(whisker, whisker.length, whisker.base_stiffness), jnp.zeros(())
    at_points, lines = sorted_in_space(whisker, loads), lines_of(whisker, loads)
    places = [load.position for load in loads if not isinstance(load, LineLoad)]
    walks_beyond = bool(places) and None not in places
    start = (zero, zero, zero), CLAMP
    nothing = SpaceLoad((zero, zero, zero))
    _, unbent = integrate(start, -jnp.ones(()), nothing, section, steps=ROD_STEPS, from_base=zero)
    return LoadedInSpace(at_points, lines, section, 2 * jnp.stack(unbent), walks_beyond)


class WalkInSpace(NamedTuple):
    """States and loads at points of the whisker, from the top to the base, and its end there."""

    s: Float[Array, " points"]
    states: SpaceState
    loads: SpaceLoad
    lengths: Float[Array, " stretches"]  # of the stretches between loads
    given: tuple[Vector, Vector]  # forces and moments that act at loads
    end: SpaceState
    load: SpaceLoad


def walked(top: Top, rods: LoadedInSpace, factor: Scalar, share: np.ndarray, steps: int) -> WalkInSpace:
    """From the top to the base, with `factor` times the loads.

    Args:
        top: the unknowns.
        rods: see LoadedInSpace.
        factor: of the loads.
        share: points on each stretch between loads at points: see `stretches`.
        steps: of the rod between two points.
    """
    at, loaded, points, lengths = stretches(rods.loads.position, share, beyond=rods.walks_beyond)
    order = in_order(at, ends_of_lines(rods.lines))
    places = jax.tree.map(lambda leaf: jnp.zeros((at.size, *leaf.shape[1:])).at[loaded].set(leaf), rods.loads)

    def onwards(state, load, s, stop):
        density = density_of(rods.lines, s, stop, factor)
        if density is None:
            return integrate(state, s - stop, load, rods.section, steps=steps, from_base=s), load, None
        return *integrate_under(state, load, s - stop, rods.section, density, steps=steps, from_base=s), None

    def past(load, state, place):
        return place.added(load, state, factor)

    w, x, y, z = top / jnp.sqrt(jnp.sum(top**2))
    zero = jnp.zeros(())
    still = zero, zero, zero
    start = still, (w, x, y, z)
    found = walk(onwards, past, start, SpaceLoad(still, still), order.at, order.spread(0, places))
    # There is no way to the first place, which is a load or the tip, and never one of the points.
    rotations = jax.tree.map(jnp.append, start[1], found.passed[1])
    own = order.ranks[0][loaded]
    rotations = jax.tree.map(lambda part: part[own], rotations)
    given = jax.vmap(lambda load, q: load.acting(q, factor))(rods.loads, rotations)
    own = order.ranks[0][points] - 1
    states, loads = jax.tree.map(lambda leaf: leaf[own], (found.passed, found.loads))
    return WalkInSpace(at[points], states, loads, lengths, given, found.end, found.load)


def _at_base(top: Top, found: WalkInSpace) -> AtBase:
    """The rod misses the clamp by a rotation, and its position does not matter."""
    position, rotation = found.end
    # Its derivatives at zero are those of the rotation vector.
    turn = 2 * jnp.stack(product(rotation, inverse_rotation(CLAMP))[1:])
    length = jnp.sum(top**2) / 4 - 1
    return AtBase(jnp.append(length, turn), jnp.stack(position))


def stiffness(
    rods: LoadedInSpace, found: WalkInSpace, weights: Float[Array, " points"]
) -> tuple[Float[Array, "n n"], Float[Array, "n n"]]:
    """Stiffness against rotations that vanish at the base, integrated with these weights: without loads, and with them.

    The determinant of the equations does not show whether a straight whisker buckles: two modes lose stability at once.
    """
    fields = jnp.stack(legendre_integrals(found.s, MODES))
    slopes = jnp.stack(jnp.broadcast_arrays(*legendre(found.s, MODES)))
    tangent, force = (jnp.stack(part, axis=-1) for part in (third_axis(found.states[1]), found.loads.force))
    moment = jnp.stack(found.loads.moment_at(found.states[0]), axis=-1)
    flexible = jax.vmap(rods.section.compliance)(found.s)
    bending = jnp.where(flexible > 0, 1 / jnp.where(flexible > 0, flexible, 1.0), 0.0)
    ratio = 1.0 if rods.section.excess is None else 1 / (1 + rods.section.excess)
    lateral = rods.section.lateral_ratio
    if lateral is not None:
        lateral = lateral, jnp.stack(first_axis(found.states[1]), axis=-1)
    rod, none = BentRod(bending, ratio, tangent, force, moment, lateral), jnp.zeros_like(force)
    elastic = stiffness_of(rod._replace(force=none, moment=none), fields, slopes, weights)
    places, follows = rods.loads.position, rods.loads.follower[:, None]
    before = jnp.where(found.s < places[:, None], 1.0, 0.0)
    at_places = jnp.stack(legendre_integrals(places, MODES))
    forces, moments = (follows * jnp.stack(part, axis=-1) for part in found.given)
    by = Followers(forces, moments, before, at_places)
    return elastic, stiffness_of(rod, fields, slopes, weights) + stiffness_by_followers(by, rod, fields, weights)
