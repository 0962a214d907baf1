"""Whiskers at rest that springs on their shafts hold and may bend, in the shape functions of a simulation."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import inverse
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.first_order import first_order
from jaxwhisker._dynamics.held import ends_of, tensions
from jaxwhisker._dynamics.motion_state import angles_of
from jaxwhisker._dynamics.moving import System

# Shares of the tensions, one per iteration of Newton's method: they grow until they are the given ones.
SHARES = np.append(np.repeat(np.linspace(0.0, 1.0, 9)[1:-1], 3), np.ones(12))
FOUND = 1e-9  # last change of the unknowns


class Unloaded(NamedTuple):
    """Whiskers in equilibrium with the springs."""

    q: Float[Array, "whiskers n"]
    z: Float[Array, " free"]
    found: Bool[Array, ""]


def unloaded(system: System) -> Unloaded:
    """The equilibrium that the whiskers reach if the springs on their shafts become tense, from the unbent ones."""
    whiskers = system.rods.length.shape[0]
    start = jnp.concatenate([jnp.zeros(whiskers * system.n), system.at_rest])

    still = jax.lax.stop_gradient(system)

    def improve(carry, share):
        x, _ = carry
        inverted = inverse(jax.jacfwd(lambda x: _forces(still, share, x))(x))
        change = -inverted @ _forces(still, share, x)
        return (x + change, inverted), jnp.max(jnp.abs(change))

    first = jax.lax.stop_gradient(start), jnp.zeros((start.size, start.size))
    last, changes = jax.lax.scan(improve, first, jnp.asarray(SHARES))
    found = changes[-1] < FOUND
    x, inverted = (jnp.where(found, value, 0.0) for value in jax.lax.stop_gradient(last))
    # One more iteration has the derivatives of the equilibrium, by the implicit function theorem.
    x = first_order(x - inverted @ _forces(system, jnp.ones(()), x))
    q, z = jnp.split(x, [whiskers * system.n])
    return Unloaded(q.reshape(whiskers, system.n), z, found)


def _forces(system: System, share: Scalar, x: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
    """Forces of rods and springs along the unknowns, with this share of the tensions of springs on shafts."""
    held, whiskers = system.rods.held, system.rods.length.shape[0]
    assert held is not None
    none = jnp.zeros(3)  # pose of the drive

    def parts(x):
        q, z = jnp.split(x, [whiskers * system.n])
        return q.reshape(whiskers, system.n), z

    def lengths(x):
        q, z = parts(x)
        base = system.bases(z, none)
        own = held, system.rods.length, q, base, angles_of(system, q, base)
        return jax.vmap(ends_of, in_axes=(0, 0, 0, 0, 0, None))(*own, none).length

    length, pulled = jax.vjp(lengths, x)
    (force,) = pulled(share * jax.vmap(lambda held, length: tensions(held, system.laws, length))(held, length))
    q, z = parts(x)
    bending = jnp.einsum("wij,wj->wi", system.rods.stiffness, q)
    return force + jnp.append(jnp.ravel(bending), system.elastic(system.strain(z)))
