"""Work and losses of a time step."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.held import Pulls, energies
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
        lost += given - jnp.sum(slid * system.elastic(system.strain(old.z + old.ahead * slid)))
        work += given
    ledger = ledger._replace(work=ledger.work + work, damping=ledger.damping + lost)
    if after.touching is None or before.touching is None:
        return ledger
    turned, shifted = after.angle - before.angle, (after.base - before.base)[:, :2]
    turned, shifted = (system.over_contacts(change) for change in (turned, shifted))
    across, normal, along, tangent = before.touching.directions(after.touching.gap, after.touching.arc)
    closed = jnp.sum(across * turned, axis=-1) + jnp.sum(normal * shifted, axis=-1)
    slipped = jnp.sum(along * turned, axis=-1) + jnp.sum(tangent * shifted, axis=-1)
    done = after.touching.force * closed
    begins = ~before.touching.lasts(after.touching.arc)  # the force that ends an approach takes energy from it
    faded = _faded(system, old, new)
    return ledger._replace(
        impact=ledger.impact + (old.ahead - 0.5) * faded - jnp.sum(jnp.where(begins, done, 0.0)),
        contact=ledger.contact + jnp.sum(jnp.where(begins, 0.0, done)),
        friction=ledger.friction - jnp.sum(after.touching.drag * slipped),
    )


def with_pulls(system: System, old: Moving, ledger: Ledger, pulls: Pulls) -> Ledger:
    """The ledger after a step with these loads of springs on shafts."""
    held, (first, last) = system.rods.held, (pulls.first, pulls.last)
    assert held is not None

    def energy(length):
        return jnp.sum(jax.vmap(lambda held, length: energies(held, system.laws, length))(held, length))

    stored, longer = energy(last.length) - energy(first.length), last.length - first.length
    lost = jnp.sum(pulls.damped * longer)
    faded = (2 * old.ahead - 1) * (jnp.sum(pulls.elastic * longer) - stored)
    given = jnp.sum(pulls.load * (last.at - first.at))
    return ledger._replace(
        work=ledger.work + given + stored + lost + faded,
        damping=ledger.damping + lost,
        impact=ledger.impact + faded,
    )


def _faded(system: System, old: Moving, new: Moving) -> Scalar:
    """Twice the energy of the changes in a step, of which the implicit step after an impact loses the half."""
    changes, spun = new.rod.velocity - old.rod.velocity, new.rod.spin - old.rod.spin
    bent, slid = new.rod.q - old.rod.q, new.z - old.z
    faded = jnp.sum(system.rods.mass[:, None] * changes**2) + jnp.sum(system.rods.inertia * spun**2)
    faded += jnp.sum(bent[:, :, None] * system.rods.stiffness * bent[:, None, :])
    return faded if system.network is None else faded + jnp.sum(slid * system.elastic(slid))
