"""Impulses at the end of a step, which stop the motion of touching whiskers along the normal: no restitution.

With friction, Coulomb's law holds for the force of the step together with the impulse at its end: the impulse along the
tangent stops a contact that sticks if friction is large enough; otherwise friction is mu times the normal force.

Several contacts of one whisker stop together. Each of them is open, stops or slides, and its law is one or two linear
equations. Whatever the solution contradicts is changed, until nothing is.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import inverse, solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.features import wedged
from jaxwhisker._dynamics.motion_state import Moving, Rod
from jaxwhisker._dynamics.moving import Rods, System
from jaxwhisker._dynamics.outline import ObjectChain

SOFT = 1e-9  # relative to the ease of all contacts: resistance to impulses that would change nothing
ROUNDS = 6  # changes of the mode per contact


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
        gap, parts = touching.gap, 1 if system.friction is None else 2
        levers = jnp.concatenate([gap.across, gap.along][:parts])
        gradients, turns = [levers @ shapes.angles], jnp.sum(levers, axis=1)
        directions = jnp.concatenate([gap.normal, gap.tangent][:parts])
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
        so_far = h * jnp.concatenate([touching.force, touching.drag][:parts])
        sticks = touching.slip == 0
        if system.may_wedge:
            assert isinstance(system.profile, ObjectChain) and touching.piece is not None
            sticks &= ~wedged(system.profile, touching.piece, touching.arc, touching.touches)
        given = balanced_together(system.friction, touching.touches, sticks, touching.slip, so_far, rates, ease)
        count = system.contacts
        normal, drag = given[:count], given[count:] if system.friction is not None else jnp.zeros(count)
    change = given @ answers
    velocity, spun = moves @ change, change[-1] if system.free else jnp.zeros(())
    pushed = jnp.sum(rods.mass * velocity, axis=-1) - given @ directions
    twisted = jnp.sum(rods.mass * about * velocity) + inertia * spun - given @ turns
    reaction = jnp.append(pushed, twisted)
    loss = -given @ rates - given @ ease @ given / 2
    return Impulse(velocity, spun, normal, drag, reaction, carried @ reaction, loss)


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


class _Mode(NamedTuple):
    """What several contacts do in an impulse."""

    acts: Bool[Array, " contacts"]  # the others are open
    stops: Bool[Array, " contacts"]  # along the tangent; the others slide
    drag: Int[Array, " contacts"]  # direction of friction where contacts slide


def balanced_together(
    friction: Scalar | None,
    touches: Bool[Array, " contacts"],
    sticks: Bool[Array, " contacts"],
    slip: Int[Array, " contacts"],
    so_far: Float[Array, " impulses"],
    rates: Float[Array, " impulses"],
    ease: Float[Array, "impulses impulses"],
) -> Float[Array, " impulses"]:
    """Impulses at several contacts of one whisker: all along normals, and with friction then all along tangents.

    Args:
        friction: its coefficient, if any.
        touches: where there are contacts.
        sticks: which of them stick in the step that ends here.
        slip: directions in this step; 0 for contacts that stick, or that do without friction.
        so_far: impulses during this step.
        rates: velocities along normals and tangents.
        ease: their changes by impulses.
    """
    law, count = (friction, so_far, rates, ease), touches.size
    known = jax.lax.stop_gradient(law)

    def improve(carry):
        mode, _, k = carry
        new = _revised(mode, known)
        changes = (new.acts != mode.acts) | new.acts & (new.stops != mode.stops)
        return new, jnp.any(changes), k + 1

    start = _Mode(touches, sticks, -slip), jnp.any(touches), 0
    rounds = ROUNDS * count
    mode, changes, _ = jax.lax.while_loop(lambda carry: carry[1] & (carry[2] < rounds), improve, start)
    # Contacts without a consistent mode stop, which loses energy.
    return _given(mode._replace(stops=mode.stops | changes), law)


def _given(mode: _Mode, law: tuple) -> Float[Array, " impulses"]:
    friction, so_far, rates, ease = law
    acts, matrix, right, own = mode.acts, ease, -rates, jnp.eye(rates.size)
    if friction is not None:
        count = acts.size
        acts, slides = jnp.append(acts, acts), jnp.append(acts & False, ~mode.stops)
        # Two contacts on a straight stretch cannot move differently along it.
        matrix += jnp.diag(jnp.repeat(jnp.array([0.0, SOFT]), count) * jnp.trace(ease))
        ratio = jnp.append(jnp.zeros(count), friction * mode.drag)
        matrix = jnp.where(slides[:, None], own - ratio[:, None] * jnp.roll(own, count, axis=1), matrix)
        right = jnp.where(slides, ratio * jnp.roll(so_far, count) - so_far, right)
    matrix = jnp.where(acts[:, None], jnp.where(acts, matrix, 0.0), own)
    return solve(matrix, jnp.where(acts, right, 0.0)[:, None])[:, 0]


def _revised(mode: _Mode, law: tuple) -> _Mode:
    """The mode without what its impulses contradict."""
    (friction, so_far, rates, ease), count = law, mode.acts.size
    given = _given(mode, law)
    total, left = so_far + given, rates + ease @ given
    acts = mode.acts & (total[:count] >= 0)
    if friction is None:
        return mode._replace(acts=acts)
    drag = jnp.sign(total[count:]).astype(int)

    def pushes_inwards(direction):  # Painleve's paradox
        return jnp.diag(ease)[:count] + friction * direction * jnp.diag(ease, count) <= 0

    gives = (jnp.abs(total[count:]) > friction * total[:count]) & ~pushes_inwards(drag)
    turned = (mode.drag * left[count:] > 0) | pushes_inwards(mode.drag)
    return _Mode(acts, jnp.where(mode.stops, ~gives, turned), jnp.where(mode.stops, drag, mode.drag))
