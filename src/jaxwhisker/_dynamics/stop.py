"""Impulses at the end of a step, which stop the motion of touching whiskers along the normal: no restitution.

With friction, the impulse along the tangent stops contacts that stick, and is the normal one times mu against the slip
of all others.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import inverse
from jaxwhisker._dynamics.motion_state import Moving, Rod
from jaxwhisker._dynamics.moving import Rods, System


class Impulse(NamedTuple):
    """Impulses on whiskers, and what they do to them."""

    velocity: Float[Array, "*whiskers 2 nodes"]  # changes
    spin: Float[Array, "*whiskers"]
    normal: Float[Array, "*whiskers"]
    drag: Float[Array, "*whiskers"]
    reaction: Float[Array, "*whiskers 3"]  # of the support
    work: Float[Array, "*whiskers"]  # of the support
    loss: Float[Array, "*whiskers"]


def stopped(system: System, new: Moving, rate: Float[Array, "3"]) -> tuple[Moving, Impulse]:
    """The state after these impulses, with the drive moving at this rate."""
    touching = new.rod.touching
    assert touching is not None
    impulse = jax.lax.cond(
        jnp.any(touching.touches),
        lambda: _impulses(system, new, rate),
        lambda: jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), jax.eval_shape(lambda: _impulses(system, new, rate))),
    )
    ledger = new.ledger._replace(
        impact=new.ledger.impact + jnp.sum(impulse.loss), work=new.ledger.work + jnp.sum(impulse.work)
    )
    rod = new.rod._replace(velocity=new.rod.velocity + impulse.velocity, spin=new.rod.spin + impulse.spin)
    return new._replace(rod=rod, ledger=ledger), impulse


def _impulses(system: System, new: Moving, rate: Float[Array, "3"]) -> Impulse:
    _, carried = jax.jvp(lambda drive: system.bases(new.z, drive), (new.drive,), (rate,))
    cos, sin = jnp.cos(new.drive[2]), jnp.sin(new.drive[2])
    frame = jnp.stack([jnp.stack([cos, -sin]), jnp.stack([sin, cos])])

    def one(rods, rod, carried, free):
        return _impulse(system, rods, rod, carried, free, frame)

    return jax.vmap(one)(system.rods, new.rod, carried, system.is_free)


def _impulse(
    system: System, rods: Rods, rod: Rod, carried: Array, free: Bool[Array, "3"], frame: Float[Array, "2 2"]
) -> Impulse:
    """The impulse on one whisker; `carried` is the velocity of its base if the springs kept their lengths."""
    touching, shapes, inertia = rod.touching, system.basis, rods.inertia
    assert touching is not None
    turning = jnp.stack([-jnp.sin(rod.angle), jnp.cos(rod.angle)])
    apart = rod.at - rod.base[:2, None]
    about = jnp.stack([-apart[1], apart[0]])  # velocities of the nodes when the base turns
    moves = rods.length * (shapes.reach @ (turning[:, :, None] * shapes.angles))
    gradients = [jnp.stack([touching.gap.across, touching.gap.along]) @ shapes.angles]
    turns = jnp.stack([jnp.sum(touching.gap.across), jnp.sum(touching.gap.along)])
    directions = jnp.stack([touching.gap.normal, touching.gap.tangent])
    own, spin = rod.velocity - carried[:2, None] - carried[2] * about, rod.spin - carried[2]
    if system.free:
        shifts = jnp.broadcast_to(frame[:, None, :], (*apart.shape, 2))
        moves = jnp.concatenate([moves, jnp.concatenate([shifts, about[..., None]], axis=-1) * free], axis=-1)
        gradients.append(jnp.concatenate([directions @ frame, turns[:, None]], axis=-1) * free)
    gradients = jnp.concatenate(gradients, axis=-1)
    size = moves.shape[-1]
    heavy = rods.mass[:, None] * moves
    total = jnp.sum(jnp.swapaxes(moves, 1, 2) @ heavy, axis=0)
    momentum = jnp.sum(heavy * own[..., None], axis=(0, 1))
    if system.free:
        held = jnp.pad(~free, (system.n, 0))
        turned = jnp.arange(size) == size - 1
        total += jnp.diag(jnp.where(held, 1.0, jnp.where(turned, inertia, 0.0)))
        momentum += jnp.where(turned & ~held, inertia * spin, 0.0)
    inverted = inverse(total)
    speed, answers = inverted @ momentum, gradients @ inverted
    rates = gradients @ speed + directions @ carried[:2] + turns * carried[2]
    ease = gradients @ answers.T
    given = jnp.where(touching.touches, _balanced(system, touching.slip, rates, ease), 0.0)
    change = given @ answers
    velocity, spun = moves @ change, change[-1] if system.free else jnp.zeros(())
    pushed = jnp.sum(rods.mass * velocity, axis=-1) - given @ directions
    twisted = jnp.sum(rods.mass * about * velocity) + inertia * spun - given @ turns
    reaction = jnp.append(pushed, twisted)
    loss = -given @ rates - given @ ease @ given / 2
    return Impulse(velocity, spun, given[0], given[1], reaction, carried @ reaction, loss)


def _balanced(system: System, slip: Array, rates: Float[Array, "2"], ease: Float[Array, "2 2"]) -> Float[Array, "2"]:
    """Normal and tangential impulse for these velocities at the contact."""
    if system.friction is None:
        return jnp.stack([-rates[0] / ease[0, 0], jnp.zeros(())])
    against = -system.friction * slip
    slides = -rates[0] / (ease[0, 0] + against * ease[0, 1])
    det = ease[0, 0] * ease[1, 1] - ease[0, 1] * ease[1, 0]
    stops = jnp.stack([ease[0, 1] * rates[1] - ease[1, 1] * rates[0], ease[1, 0] * rates[0] - ease[0, 0] * rates[1]])
    # Sliding friction may push a contact into the object (Painleve), or turn its slip round: such contacts stick.
    sliding = jnp.stack([slides, against * slides])
    still = (ease[0, 0] + against * ease[0, 1] <= 0) | (slip * (rates[1] + ease[1] @ sliding) < 0)
    return jnp.where((slip == 0) | still, stops / det, sliding)
