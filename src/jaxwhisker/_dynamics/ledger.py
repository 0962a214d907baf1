"""Work and losses of a time step."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.motion_state import Ledger, Moving
from jaxwhisker._dynamics.moving import System


def booked(
    system: System,
    old: Moving,
    new: Moving,
    reaction: Float[Array, "whiskers 3"],
    load: Float[Array, " free"],
    h: Scalar,
) -> Ledger:
    """The ledger after a step, without impulses at its end; with the mean reactions and loads of the springs."""
    before, after = old.rod, new.rod
    bent, slid, ledger = after.q - before.q, new.z - old.z, old.ledger
    lost = system.mass_damping / h * jnp.sum(system.rods.mass[:, None] * (after.at - before.at) ** 2)
    lost += system.stiffness_damping / h * jnp.sum(bent[:, :, None] * system.rods.stiffness * bent[:, None, :])
    work = jnp.sum(reaction * (after.base - before.base))
    if system.network is not None:
        given = jnp.sum(slid * load)
        stored = system.strain(new.z) + system.strain(old.z)
        lost += given - jnp.sum(slid * system.elastic(stored / 2))
        work += given
    ledger = ledger._replace(work=ledger.work + work, damping=ledger.damping + lost)
    if after.touching is None or before.touching is None:
        return ledger
    turned, shifted = after.angle - before.angle, (after.base - before.base)[:, :2]
    first, last = before.touching, after.touching
    closed = jnp.sum((first.across + last.across) / 2 * turned, axis=-1)
    closed += jnp.sum((first.normal + last.normal) / 2 * shifted, axis=-1)
    slipped = jnp.sum((first.along + last.along) / 2 * turned, axis=-1)
    slipped += jnp.sum((first.tangent + last.tangent) / 2 * shifted, axis=-1)
    done = last.force * closed
    begins = ~first.touches  # the force that ends an approach takes energy from it
    return ledger._replace(
        impact=ledger.impact - jnp.sum(jnp.where(begins, done, 0.0)),
        contact=ledger.contact + jnp.sum(jnp.where(begins, 0.0, done)),
        friction=ledger.friction - jnp.sum(last.drag * slipped),
    )
