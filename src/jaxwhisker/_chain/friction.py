"""Friction of several contacts: which of them slip and which stick, where the path leaves an event.

Along the path, contacts that slip must not turn back, and the lean of those that stick must not grow beyond its limit.
Contacts that break this are changed one after the other until none does; the first of them is changed first, which
cannot run in circles if the motion is unique (Murty, Linear Complementarity, Linear and Nonlinear Programming, 1988,
chapter 5).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._chain.contacts import ChainState, held_of, lean_of, parameter_of, slack_of
from jaxwhisker._chain.march_state import AT_STOP, MarchOfChain, PerRow, TrialOfChain
from jaxwhisker._chain.newton import of_whiskers
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._equilibrium.contact import FORCE, PARAMETER, SLACK, Phase
from jaxwhisker._equilibrium.friction import Friction, slipping_from
from jaxwhisker._equilibrium.point import Contacts, Point, along
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.margins import FAR
from jaxwhisker._path.path import NO_EVENT, EventKind, Node, select

LIGHT = 1e-6  # EI/L^2: smallest force of a contact that sticks: the lean of no force is unknown
RATE_NOISE = 1e-9  # rate, per length of the path, that rounding may cause
LEAN_NOISE = 1e-6  # largest error of the lean of a contact that sticks with hardly any force
CONE_NOISE = 1e-9  # ... and of the force across the normal of others, in EI/L^2
# Share of its limit from which the lean of coarse rods at rest counts as that of a slip. They have drag, and slide
# beyond the place at which a slow slip would end.
NEARLY_SLIPS = 0.5
NEAR = 0.02  # of the object's parameter: error of the places of coarse rods

Rows = Bool[Array, " rows"]


def slip_by_contact(problem: ChainProblem, z: Contacts, state: ChainState) -> Contacts:
    """Derivatives of the distances slipped along the object's tangent, by the numbers of contacts that slip."""
    slips = state.touches if state.friction is None else state.touches & (state.friction.slip != 0)
    piece = jnp.where(state.touches, state.piece, 0)
    placeholders = problem.profile.placeholder_parameter
    assert placeholders is not None

    def speed(piece, p):
        at, rate = jax.jvp(lambda p: problem.profile.point_on(piece, p), (p,), (jnp.ones_like(p),))
        return rate.x * at.cos + rate.y * at.sin

    speeds = jax.vmap(speed)(piece, jnp.where(slips, z[:, PARAMETER], placeholders[0]))
    beyond = jnp.where(state.phase == Phase.tangential, state.side, 0.0)
    return jnp.stack([jnp.zeros_like(speeds), speeds, beyond], axis=1)


def slip_rates(
    problem: ChainProblem, state: ChainState, z: Contacts, z_rate: Contacts, least: float = LIGHT
) -> Float[Array, " rates"]:
    """Rates of slip in the direction of slip, infinite for contacts without one or with a smaller force.

    There are none without friction.
    """
    if state.friction is None:
        return jnp.zeros(0)
    slips = state.touches & (state.friction.slip != 0) & (z[:, FORCE] > least)
    rates = jnp.sum(slip_by_contact(problem, z, state) * z_rate, axis=-1)
    return jnp.where(slips, state.friction.slip * rates, jnp.inf)


def most_lean(problem: ChainProblem, z: Contacts) -> PerRow:
    """The lean beyond which contacts that stick begin to slip; with friction."""
    limit = problem.friction_angle
    assert limit is not None
    return limit + jnp.minimum(LEAN_NOISE, CONE_NOISE / jnp.maximum(z[:, FORCE], CONE_NOISE))


def lean_margin(problem: ChainProblem, state: ChainState, z: Contacts, lean: PerRow | None) -> Float[Array, " rows"]:
    """How much further the forces of contacts that stick may lean; nothing without friction."""
    if lean is None or problem.friction_angle is None:
        return jnp.zeros(0)
    sticks = held_of(problem.profile, state).sticks & (z[:, FORCE] > LIGHT)
    return jnp.where(sticks, most_lean(problem, z) - jnp.abs(lean), FAR)


def is_light(problem: ChainProblem, state: ChainState, z: Contacts) -> Rows:
    """Whether contacts stick whose force is too small for its lean to be known."""
    return held_of(problem.profile, state).sticks & (z[:, FORCE] <= LIGHT)


def is_wedged(problem: ChainProblem, state: ChainState, z: Contacts) -> Bool[Array, ""]:
    """Whether two neighbouring contacts stick: the force along a straight part between them is not determined."""
    if state.friction is None:
        return jnp.asarray(False)
    sticks = of_whiskers(problem, held_of(problem.profile, state).sticks & (z[:, FORCE] > LIGHT))
    return jnp.any(sticks[:, 1:] & sticks[:, :-1])


def lean_rates(problem: ChainProblem, state: ChainState, z_rate: Contacts) -> PerRow:
    """Rates of the leans of contacts that stick; meaningless for others."""
    return jnp.where(held_of(problem.profile, state).at_corner, z_rate[:, SLACK], z_rate[:, PARAMETER])


class NumberOfRow(NamedTuple):
    """The number of a contact that is known at an event, if friction changes which one it is."""

    changes: Rows
    column: Int[Array, " rows"]
    size: PerRow  # the sign with which this number grows with the parameter
    limit: PerRow


def by_friction(problem: ChainProblem, march: MarchOfChain, of_lean: Array, ends: Array) -> NumberOfRow:
    """What friction changes in the condition of an event: of leans, and of contacts that roll over ends of pieces."""
    friction, side, limit = march.state.friction, march.state.side, march.target.limit
    assert friction is not None and limit is not None
    held, arrives = held_of(problem.profile, march.state), march.task == Task.arrive
    by_slack = (ends & held.rolls) | (of_lean & held.at_corner)
    column = jnp.where(by_slack, SLACK, PARAMETER)
    here = jnp.where(by_slack, march.point.z[:, SLACK], march.point.z[:, PARAMETER])
    # Only straight sides have ends.
    rolled_to = friction.beyond - side * (limit - friction.parameter)
    there = jnp.where(ends & held.rolls, rolled_to, limit)
    size = jnp.where(ends & held.rolls, -side, 1.0)
    return NumberOfRow(by_slack | (ends & arrives), column, size, jnp.where(arrives, here, there))


def with_slips(
    problem: ChainProblem, z: Contacts, parameter: PerRow, state: ChainState, slip: Int[Array, " rows"]
) -> tuple[Contacts, ChainState]:
    """The same contacts, at these parameters, which from here on slip in these directions or stick (0)."""
    old, limit, profile = state.friction, problem.friction_angle, problem.profile
    assert old is not None and limit is not None
    slack, lean = slack_of(profile, z, state), jnp.asarray(lean_of(profile, limit, z, state))
    begins = state.touches & (slip == 0) & (old.slip != 0)
    beyond = jnp.where(state.phase == Phase.tangential, slack, 0.0)
    friction = Friction(slip, jnp.where(begins, parameter, old.parameter), jnp.where(begins, beyond, old.beyond))
    state = state._replace(friction=friction)
    held, light = held_of(profile, state), begins & (z[:, FORCE] <= LIGHT)
    # A first guess: the force that begins to bend a straight whisker acts across it.
    lean = jnp.where(light, state.side * jnp.minimum(slack, 0.0), jnp.clip(lean, -limit, limit))
    force = jnp.where(light, LIGHT, z[:, FORCE])
    own = jnp.where(held.rolls, lean, parameter), jnp.where(held.at_corner, lean, slack)
    return jnp.stack([force, *own], axis=1), state


def changed_slips(
    problem: ChainProblem, march: MarchOfChain, point: Point, tangent: Point, falls: Bool[Array, ""]
) -> tuple[Bool[Array, ""], Int[Array, " rows"]]:
    """Whether a contact breaks a law of friction along the tangent, and the slips after the first one is changed."""
    state, limit = march.state, problem.friction_angle
    assert state.friction is not None and limit is not None
    onwards = slip_rates(problem, state, point.z, tangent.z, -jnp.inf)
    slip, force = state.friction.slip, point.z[:, FORCE]
    held, leans = held_of(problem.profile, state), lean_of(problem.profile, limit, point.z, state)
    assert leans is not None
    # A contact that has just begun may slip either way or, if neither presses on, stick.
    unloaded = (slip != 0) & (force <= LIGHT)
    backwards = (onwards < -RATE_NOISE) | (state.touches & ~held.pinned & unloaded & falls & (limit > 0))
    rates = lean_rates(problem, state, tangent.z)
    exceeds = (jnp.abs(leans) > limit - RATE_NOISE) & (jnp.sign(leans) * rates > RATE_NOISE)
    # A contact that sticks from its first touch may have a lean that no friction allows.
    beyond = jnp.abs(leans) >= limit + LEAN_NOISE
    exceeds = held.sticks & ~march.rests & (exceeds | (beyond & is_light(problem, state, march.point.z)))
    can_stick = (~unloaded | (march.slips_tried > 0)) & (limit > 0)
    changed = jnp.where(exceeds, jnp.sign(leans).astype(int), jnp.where(can_stick, 0, -slip))
    wrong = backwards | exceeds
    first = wrong & (jnp.cumsum(wrong) == 1)
    return jnp.any(wrong), jnp.where(first, changed, slip)


def with_changed_slips(
    problem: ChainProblem, march: MarchOfChain, node: Node, slip: Int[Array, " rows"], arriving: Point, *, rest: bool
) -> MarchOfChain:
    """The state at a node, before the direction in which the path leaves with these slips is determined.

    Args:
        problem: the problem.
        march: the state of the march, at the node, with its stance.
        node: the node, with the slips before.
        slip: the new slips.
        arriving: direction of the path before.
        rest: whether the slips that change have come to rest, so that the path goes on without a corner.
    """
    before, earlier = march.state.friction, march.pending.before.friction
    assert before is not None
    z, state = with_slips(problem, node.point.z, march.stance.parameter, march.state, slip)
    held, changes, sticking = held_of(problem.profile, state), slip != before.slip, slip == 0
    light = is_light(problem, state, z)
    of_lean = jnp.where(held.at_corner, SLACK, PARAMETER)[:, None] == jnp.arange(3)
    if not rest:
        known, leans = _first_leans(problem, march, arriving)
        starts = (light & (before.slip != 0) & known)[:, None] & of_lean
        z = jnp.where(starts, leans[:, None], z)
    fresh = march.slips_tried == 0
    # Slips at an event are changed after the event itself.
    z_before = jnp.where(fresh, node.point.z, march.pending.z_before)
    friction_before = select(fresh, before, earlier)
    differ = slip != friction_before.slip
    sticks, begins = differ & sticking, differ & (friction_before.slip == 0)
    kind = jnp.where(jnp.any(sticks), EventKind.stick, jnp.where(jnp.any(begins), EventKind.slip, NO_EVENT))
    pending = node._replace(
        point=node.point._replace(z=z),
        z_before=z_before,
        arriving=arriving,
        state=node.state._replace(friction=state.friction),
        before=march.state._replace(friction=friction_before),
        kind=kind,
        whiskers=sticks | begins,
        corner=jnp.asarray(True),
    )
    inwards = jnp.where(light[:, None], jnp.arange(3) == FORCE, -before.slip[:, None] * of_lean)
    ahead = slip[:, None] * slip_by_contact(problem, z, state)
    lead = jnp.where(changes[:, None], jnp.where(sticking[:, None], inwards, ahead), 0.0)
    lead = Point(lead, jnp.asarray(0.0))
    if rest:
        # A lean does not change at first; all else goes on as before.
        same = jnp.where(changes[:, None] & of_lean, 0.0, arriving.z)
        lead = Point(same, arriving.u)
    return march.replace(
        task=jnp.asarray(int(Task.arrive)),
        state=state,
        point=pending.point,
        # What has led here has been judged.
        target=march.target._replace(number=jnp.asarray(AT_STOP), whiskers=jnp.zeros_like(changes)),
        lead=lead,
        pending=pending,
        slips_tried=march.slips_tried + 1,
        rests=changes & sticking if rest else march.rests,
    )


def _first_leans(problem: ChainProblem, march: MarchOfChain, tangent: Point) -> tuple[Rows, PerRow]:
    """Leans of contacts that stick from their first touch, where neither slip is possible; and whether they are known.

    At vanishing force the equations are linear. The path with a contact that sticks is therefore that combination of
    the paths with slips in both directions in which the contact does not slip. The tangent is that with the present
    slips, and the pending node arrives along that with the slips tried before.
    """
    limit, other, friction = problem.friction_angle, march.pending.arriving, march.state.friction
    assert limit is not None and friction is not None
    by_contact = slip_by_contact(problem, march.point.z, march.state)
    rate, other_rate = (jnp.sum(by_contact * one.z, axis=-1) for one in (tangent, other))
    force, other_force = other_rate * tangent.z[:, FORCE], -rate * other.z[:, FORCE]
    onwards = jnp.where(march.direction * (other_rate * tangent.u - rate * other.u) < 0, -1.0, 1.0)
    across = friction.slip * jnp.sin(limit) * (force - other_force)
    along = jnp.cos(limit) * (force + other_force)
    return onwards * along > 0, jnp.arctan2(onwards * across, onwards * along)


def slips_of(problem: ChainProblem, z: Contacts, state: ChainState) -> tuple[Array, Array, Array] | None:
    """Number of the object, slip, and length of the whisker beyond all contacts, as coarse rods take them."""
    if state.friction is None:
        return None
    number = problem.profile.object_of(jnp.where(state.touches, state.piece, 0))
    beyond = jnp.where(state.phase == Phase.tangential, slack_of(problem.profile, z, state), 0.0)
    return jnp.where(state.touches, jnp.asarray(number), -1), state.friction.slip, beyond


def landed(problem: ChainProblem, z: Contacts, state: ChainState, lean: PerRow) -> tuple[Contacts, ChainState]:
    """Contacts at rest after a snap, whose forces lean like this: they slip as they came to rest, or they stick there.

    Without friction, they stay as they are.
    """
    limit = problem.friction_angle
    if limit is None:
        return z, state
    begun = slipping_from(state.side)
    slipping = state._replace(friction=begun._replace(slip=jnp.where(lean < 0, -1, 1)))
    sticks = state.touches & (jnp.abs(lean) < NEARLY_SLIPS * limit)
    assert slipping.friction is not None
    z, stuck = with_slips(problem, z, z[:, PARAMETER], slipping, jnp.where(sticks, 0, slipping.friction.slip))
    held = held_of(problem.profile, stuck)
    z = z.at[:, PARAMETER].set(jnp.where(held.rolls, lean, z[:, PARAMETER]))
    return z.at[:, SLACK].set(jnp.where(held.at_corner, lean, z[:, SLACK])), stuck


def keeps_places(problem: ChainProblem, before: ChainState, after: ChainState) -> ChainState:
    """The state after a snap, in which contacts that stick on stay where they are: coarse rods know it roughly."""
    if before.friction is None or after.friction is None:
        return after
    held, was_held = held_of(problem.profile, after), held_of(problem.profile, before)
    near = jnp.abs(after.friction.parameter - before.friction.parameter) < NEAR
    same = (before.piece == after.piece) & held.sticks & was_held.sticks & near
    places = (jnp.where(same, a, b) for a, b in zip(before.friction[1:], after.friction[1:], strict=True))
    return after._replace(friction=Friction(after.friction.slip, *places))


def come_to_rest(
    problem: ChainProblem, march: MarchOfChain, trial: TrialOfChain
) -> tuple[Bool[Array, ""], MarchOfChain]:
    """Whether slips come to rest where something turns back within a step, and the state in which they stick there."""
    friction, limit = march.state.friction, problem.friction_angle
    assert friction is not None and limit is not None
    there = trial.turns[1:]
    sticks = (there < -RATE_NOISE) & (there < trial.turns[0])
    here = slip_rates(problem, march.state, march.point.z, march.tangent.z)
    share = jnp.min(jnp.where(sticks & jnp.isfinite(here), here / (here - there), 1.0))
    at = along(march.point, march.tangent, jnp.clip(share, 0.0, 1.0) * march.step, march.bend)
    node = march.node(at, march.tangent)
    # Without any friction, slips that come to rest turn back at once.
    slip = jnp.where(sticks, jnp.where(limit > 0, 0, -friction.slip), friction.slip)
    stance = march.stance._replace(parameter=parameter_of(problem.profile, at.z, march.state))
    march = march.replace(point=at, travel=node.travel, stance=stance)
    return jnp.any(sticks), with_changed_slips(problem, march, node, slip, march.tangent, rest=True)
