"""Impulses at the end of a step, which stop the motion of touching whiskers along the normal: no restitution.

With friction, Coulomb's law holds for the force of the step together with the impulse at its end: the impulse along the
tangent stops a contact that sticks if friction is large enough; otherwise friction is mu times the normal force.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import inverse, solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.motion_state import Moving, Rod
from jaxwhisker._dynamics.moving import Rods, System


class Impulse(NamedTuple):
    """Impulses on whiskers, and what they do to them."""

    velocity: Float[Array, "*whiskers 2 nodes"]  # changes
    spin: Float[Array, "*whiskers"]
    normal: Float[Array, "*contacts"]
    drag: Float[Array, "*contacts"]
    reaction: Float[Array, "*whiskers 3"]  # of the support
    work: Float[Array, "*whiskers"]  # of the support
    loss: Float[Array, "*whiskers"]


def stopped(system: System, new: Moving, rate: Float[Array, "3"], h: Scalar) -> tuple[Moving, Impulse]:
    """The state after these impulses at the end of a step of this length, with the drive moving at this rate."""
    touching = new.rod.touching
    assert touching is not None

    def impulses():
        return _impulses(system, new, rate, h)

    def none():
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), jax.eval_shape(impulses))

    impulse = jax.lax.cond(jnp.any(touching.touches), impulses, none)
    ledger = new.ledger._replace(
        impact=new.ledger.impact + jnp.sum(impulse.loss), work=new.ledger.work + jnp.sum(impulse.work)
    )
    rod = new.rod._replace(velocity=new.rod.velocity + impulse.velocity, spin=new.rod.spin + impulse.spin)
    return new._replace(rod=rod, ledger=ledger), impulse


def _impulses(system: System, new: Moving, rate: Float[Array, "3"], h: Scalar) -> Impulse:
    _, carried = jax.jvp(lambda drive: system.bases(new.z, drive), (new.drive,), (rate,))
    cos, sin = jnp.cos(new.drive[2]), jnp.sin(new.drive[2])
    frame = jnp.stack([jnp.stack([cos, -sin]), jnp.stack([sin, cos])])

    def one(rods, rod, carried, free):
        return _impulse(system, rods, rod, carried, free, frame, h)

    return jax.vmap(one)(system.rods, new.rod, carried, system.is_free)


def _impulse(
    system: System, rods: Rods, rod: Rod, carried: Array, free: Bool[Array, "3"], frame: Float[Array, "2 2"], h: Scalar
) -> Impulse:
    """The impulse on one whisker; `carried` is the velocity of its base if the springs kept their lengths."""
    touching, shapes, inertia = rod.touching, system.basis, rods.inertia
    assert touching is not None
    turning = jnp.stack([-jnp.sin(rod.angle), jnp.cos(rod.angle)])
    apart = rod.at - rod.base[:2, None]
    about = jnp.stack([-apart[1], apart[0]])  # velocities of the nodes when the base turns
    moves = rods.length * (shapes.reach @ (turning[:, :, None] * shapes.angles))
    if system.contacts == 1:
        gradients = [jnp.stack([touching.gap.across, touching.gap.along]) @ shapes.angles]
        turns = jnp.stack([jnp.sum(touching.gap.across), jnp.sum(touching.gap.along)])
        directions = jnp.stack([touching.gap.normal, touching.gap.tangent])
    else:
        gradients = [touching.gap.across @ shapes.angles]
        turns, directions = jnp.sum(touching.gap.across, axis=1), touching.gap.normal
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
    if system.contacts == 1:
        so_far = h * jnp.stack([touching.force, touching.drag])
        given = jnp.where(touching.touches, balanced(system.friction, touching.slip, so_far, rates, ease), 0.0)
        normal, drag = given[0], given[1]
    else:
        given = normal = pushes(touching.touches, h * touching.force, rates, ease)
        drag = jnp.zeros_like(given)
    change = given @ answers
    velocity, spun = moves @ change, change[-1] if system.free else jnp.zeros(())
    pushed = jnp.sum(rods.mass * velocity, axis=-1) - given @ directions
    twisted = jnp.sum(rods.mass * about * velocity) + inertia * spun - given @ turns
    reaction = jnp.append(pushed, twisted)
    loss = -given @ rates - given @ ease @ given / 2
    return Impulse(velocity, spun, normal, drag, reaction, carried @ reaction, loss)


def pushes(
    touches: Bool[Array, " contacts"],
    so_far: Float[Array, " contacts"],
    rates: Float[Array, " contacts"],
    ease: Float[Array, "contacts contacts"],
) -> Float[Array, " contacts"]:
    """Normal impulses at several contacts of one whisker; contacts that would have to pull are left out.

    Args:
        touches: where there are contacts.
        so_far: impulses during this step.
        rates: velocities along the normals.
        ease: their changes by impulses.
    """
    acts, given = touches, jnp.zeros_like(rates)
    for _ in range(touches.size):
        matrix = jnp.where(acts[:, None] & acts, ease, jnp.eye(touches.size))
        given = solve(matrix, jnp.where(acts, -rates, 0.0)[:, None])[:, 0]
        acts &= so_far + given >= 0
    return jnp.where(acts, given, 0.0)


def balanced(
    friction: Scalar | None,
    slip: Int[Array, ""],
    so_far: Float[Array, "2"],
    rates: Float[Array, "2"],
    ease: Float[Array, "2 2"],
) -> Float[Array, "2"]:
    """Normal and tangential impulse at a contact.

    Args:
        friction: its coefficient, if any.
        slip: direction in the step that ends here; 0 if the contact sticks.
        so_far: impulses during this step, to which Coulomb's law adds those that are returned.
        rates: velocities along normal and tangent.
        ease: their changes by impulses.
    """
    if friction is None:
        return jnp.stack([-rates[0] / ease[0, 0], jnp.zeros(())])
    pressed, dragged = so_far

    def dragging(ratio):
        """Impulses with which friction is the normal force times this ratio."""
        shift = ratio * pressed - dragged
        normal = -(rates[0] + ease[0, 1] * shift) / (ease[0, 0] + ratio * ease[0, 1])
        return jnp.stack([normal, shift + ratio * normal])

    def pushes_inwards(ratio):  # Painleve's paradox
        return ease[0, 0] + ratio * ease[0, 1] <= 0

    det = ease[0, 0] * ease[1, 1] - ease[0, 1] * ease[1, 0]
    stops = jnp.stack([ease[0, 1] * rates[1] - ease[1, 1] * rates[0], ease[1, 0] * rates[0] - ease[0, 0] * rates[1]])
    stops /= det
    total = dragged + stops[1]
    most = jnp.sign(total) * friction
    within = jnp.abs(total) <= friction * (pressed + stops[0])
    stops = jnp.where(within | pushes_inwards(most), stops, dragging(most))
    # Sliding friction may push a contact into the object, or turn its slip round: such contacts stick.
    against = -friction * slip
    sliding = dragging(against)
    still = pushes_inwards(against) | (slip * (rates[1] + ease[1] @ sliding) < 0)
    return jnp.where((slip == 0) | still, stops, sliding)
