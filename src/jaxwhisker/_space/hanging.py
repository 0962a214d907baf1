"""Free whiskers with a weight: how they hang from their bases, and whether they are stable there.

A free whisker is a cantilever that hangs from its base. Springs along the axes of the drive yield to its weight, which
is known. Torsion springs yield to its moment, which depends on how far the base turns.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.implicit import solution_of
from jaxwhisker._base.linear_algebra import positive_definite
from jaxwhisker._base.quadrature import gauss, legendre, legendre_integrals
from jaxwhisker._base.quaternions import first_axis, third_axis
from jaxwhisker._base.rotation import left_jacobian, matrix_of, rotation_matrix
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.weight import grown
from jaxwhisker._rod.rod import Along
from jaxwhisker._rod.second_variation import BentRod, second_variation
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, SpaceState
from jaxwhisker._space.weight import SpaceWeight, newton_step

NODES, MODES = 18, 12  # quadrature points and polynomials for each axis, with which stability is checked

Turn = Float[Array, "3"]  # a rotation vector


class Hanging(NamedTuple):
    """A free whisker with a weight, and the springs of its base; the drive does not turn."""

    weight: SpaceWeight
    length: Scalar
    section: SpaceSection
    mount: Float[Array, "3 3"]  # axes of the body frame on the mount
    compliance: Float[Array, "3"] | None  # of torsion springs about the axes of the drive; None without any
    rest: Turn  # of the base without a load

    def frame(self, turn: Turn) -> Float[Array, "3 3"]:
        """Axes of the body frame at the base."""
        return jnp.sum(rotation_matrix(turn)[:, :, None] * self.mount, axis=1)

    def at_base(self, frame: Float[Array, "3 3"], share: Scalar = 1.0) -> tuple[SpaceWeight, SpaceState, SpaceLoad]:
        """A share of the weight, the state of the rod and the load on it at the base, along these axes."""
        zero, one = jnp.zeros(()), jnp.ones(())
        start = (zero, zero, zero), (one, zero, zero, zero)
        weight = self.weight._replace(along=share * self.weight.along).seen_in(frame)
        return weight, start, weight.beyond(start, zero, self.length, self.section)

    def load(self, turn: Turn, share: Scalar = 1.0) -> Float[Array, "6"]:
        """Load of a share of the weight along the coordinates of a base that has turned."""
        frame = self.frame(turn)
        _, _, load = self.at_base(frame, share)
        force, moment = (jnp.sum(frame * jnp.stack(part), axis=1) for part in (load.force, load.moment))
        return jnp.concatenate([force, jnp.sum(left_jacobian(turn) * moment[:, None], axis=0)])

    def missed(self, yields: Turn, share: Scalar = 1.0) -> Turn:
        """By how much the base has turned too far, if it yields by so much."""
        assert self.compliance is not None
        return yields - self.compliance * self.load(self.rest + yields, share)[3:]


class Hung(NamedTuple):
    """How a free whisker hangs; its shape is that in the frame of its base."""

    position: Float[Array, "points 3"]
    rotation: Float[Array, "points 3 3"]
    load: Float[Array, "6"]  # along the coordinates of its base
    stable: Bool[Array, ""]


def hung(free: Hanging, places: Along) -> Hung:
    """How a free whisker hangs, at fractions of its length that increase from 0."""
    turn, stable = free.rest, jnp.asarray(True)
    if free.compliance is not None:
        still = jax.lax.stop_gradient(free)
        yields = grown(
            lambda share, yields: newton_step(lambda yields: still.missed(yields, share), yields), jnp.zeros(3)
        )
        turn = turn + solution_of(_missed, yields, free)
        root = jnp.sqrt(free.compliance)
        by_turn = jax.jacfwd(lambda turn: free.load(turn)[3:])(turn)
        stiffness = jnp.eye(3) - root[:, None] * (by_turn + by_turn.T) / 2 * root
        stable = positive_definite(stiffness)
    weight, start, load = free.at_base(free.frame(turn))
    (r, q), _ = weight.line(start, load, free.length * places, free.section)
    stable &= _is_stable(free, weight, start, load)
    return Hung(jnp.stack(r, axis=-1), jax.vmap(matrix_of)(jnp.stack(q, axis=-1)), free.load(turn), stable)


def _missed(yields: Turn, free: Hanging) -> Turn:
    return free.missed(yields)


def _is_stable(free: Hanging, weight: SpaceWeight, start: SpaceState, load: SpaceLoad) -> Bool[Array, ""]:
    """Whether the energy of a whisker is least while its base is held."""
    (nodes, weights), section, length = gauss(NODES), free.section, free.length
    s = jnp.append(0.0, length * nodes)
    states, loads = jax.tree.map(lambda leaf: leaf[1:], weight.line(start, load, s, section))
    fields = jnp.stack(legendre_integrals(nodes, MODES))
    slopes = jnp.stack(jnp.broadcast_arrays(*legendre(nodes, MODES))) / length
    tangent, force = (jnp.stack(part, axis=-1) for part in (third_axis(states[1]), loads.force))
    moment = jnp.stack(loads.moment_at(states[0]), axis=-1)
    flexible = jax.vmap(section.compliance)(s[1:])
    bending = jnp.where(flexible > 0, 1 / jnp.where(flexible > 0, flexible, 1.0), 0.0)
    ratio = 1.0 if section.excess is None else 1 / (1 + section.excess)
    lateral = section.lateral_ratio
    if lateral is not None:
        lateral = lateral, jnp.stack(first_axis(states[1]), axis=-1)
    rod = BentRod(bending, ratio, tangent, force, moment, lateral)
    return positive_definite(second_variation(rod, fields, slopes, length * jnp.asarray(weights)))
