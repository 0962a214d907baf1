"""Friction of several contacts: their slips and leans, where the path leaves an event and where a snap lands."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._chain.contacts import ChainState, held_of, lean_of, parameter_of, slack_of
from jaxwhisker._chain.march_state import AT_STOP, MarchOfChain, PerRow, TrialOfChain
from jaxwhisker._chain.newton import of_whiskers
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._equilibrium.contact import FORCE, PARAMETER, SLACK, Phase
from jaxwhisker._equilibrium.friction import LIGHT, Friction, slipping_from
from jaxwhisker._equilibrium.point import Point, along
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.margins import FAR
from jaxwhisker._path.path import Node
from jaxwhisker._path.slips import (
    LEAN_NOISE,
    RATE_NOISE,
    LeavingContacts,
    corrected_slips,
    first_leans,
    lead_of,
    leaving_with,
)

CONE_NOISE = 1e-9  # largest error of the force across the normal, in EI/L^2
# Share of its limit from which the lean of coarse rods at rest counts as that of a slip. They have drag, and slide
# beyond the place at which a slow slip would end.
NEARLY_SLIPS = 0.5
NEAR = 0.02  # of the object's parameter: error of the places of coarse rods

Rows = Bool[Array, " rows"]


def slip_by_contact(problem: ChainProblem, z: RowsOfContacts, state: ChainState) -> RowsOfContacts:
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
    problem: ChainProblem, state: ChainState, z: RowsOfContacts, z_rate: RowsOfContacts, least: float = LIGHT
) -> Float[Array, " rates"]:
    """Rates of slip in the direction of slip, infinite for contacts without one or with a smaller force.

    There are none without friction.
    """
    if state.friction is None:
        return jnp.zeros(0)
    slips = state.touches & (state.friction.slip != 0) & (z[:, FORCE] > least)
    rates = jnp.sum(slip_by_contact(problem, z, state) * z_rate, axis=-1)
    return jnp.where(slips, state.friction.slip * rates, jnp.inf)


def most_lean(problem: ChainProblem, z: RowsOfContacts) -> PerRow:
    """The lean beyond which contacts that stick begin to slip; with friction."""
    limit = problem.friction_angle
    assert limit is not None
    return limit + jnp.minimum(LEAN_NOISE, CONE_NOISE / jnp.maximum(z[:, FORCE], CONE_NOISE))


def lean_margin(
    problem: ChainProblem, state: ChainState, z: RowsOfContacts, lean: PerRow | None
) -> Float[Array, " margins"]:
    """How much further the forces of contacts that stick may lean; nothing without friction."""
    if lean is None or problem.friction_angle is None:
        return jnp.zeros(0)
    sticks = held_of(problem.profile, state).sticks & (z[:, FORCE] > LIGHT)
    return jnp.where(sticks, most_lean(problem, z) - jnp.abs(lean), FAR)


def is_light(problem: ChainProblem, state: ChainState, z: RowsOfContacts) -> Rows:
    """Whether contacts stick whose force is too small for its lean to be known."""
    return held_of(problem.profile, state).sticks & (z[:, FORCE] <= LIGHT)


def is_wedged(problem: ChainProblem, state: ChainState, z: RowsOfContacts) -> Bool[Array, ""]:
    """Whether two neighbouring contacts stick: the force along a straight part between them is not determined."""
    if state.friction is None:
        return jnp.asarray(False)
    sticks = of_whiskers(problem, held_of(problem.profile, state).sticks & (z[:, FORCE] > LIGHT))
    return jnp.any(sticks[:, 1:] & sticks[:, :-1])


def lean_rates(problem: ChainProblem, state: ChainState, z_rate: RowsOfContacts) -> PerRow:
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
    problem: ChainProblem, z: RowsOfContacts, parameter: PerRow, state: ChainState, slip: Int[Array, " rows"]
) -> tuple[RowsOfContacts, ChainState]:
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
    held, leans = held_of(problem.profile, state), lean_of(problem.profile, limit, point.z, state)
    assert state.friction is not None and limit is not None and leans is not None
    contacts = LeavingContacts(
        slip=state.friction.slip,
        force=point.z[:, FORCE],
        lean=leans,
        lean_rate=lean_rates(problem, state, tangent.z),
        slip_rate=slip_rates(problem, state, point.z, tangent.z, -jnp.inf),
        sticks=held.sticks,
        slips_either_way=state.touches & ~held.pinned,
        light=is_light(problem, state, march.point.z),
    )
    return corrected_slips(contacts, limit, falls, march.slips_tried, march.rests)


def with_changed_slips(
    problem: ChainProblem, march: MarchOfChain, node: Node, slip: Int[Array, " rows"], arriving: Point, *, rest: bool
) -> MarchOfChain:
    """The state at a node, before the direction in which the path leaves with these slips is determined.

    See `leaving_with` for the arguments; the state of the march has its stance.
    """
    before, limit = march.state.friction, problem.friction_angle
    assert before is not None and limit is not None
    z, state = with_slips(problem, node.point.z, march.stance.parameter, march.state, slip)
    light, at_corner = is_light(problem, state, z), held_of(problem.profile, state).at_corner
    of_lean = jnp.where(at_corner, SLACK, PARAMETER)[:, None] == jnp.arange(3)
    if not rest:
        by_contact = slip_by_contact(problem, march.point.z, march.state)
        other = march.pending.arriving
        known, leans = first_leans(by_contact, before.slip, limit, march.direction, arriving, other)
        starts = light & (before.slip != 0) & known
        z = jnp.where(starts[:, None] & of_lean, leans[:, None], z)
    assert state.friction is not None
    new, changes = leaving_with(march, node, z, state.friction, arriving, rest=rest)
    lead = lead_of(new, changes, before.slip, light, of_lean, slip_by_contact(problem, z, state), rest=rest)
    # What has led here has been judged.
    target = march.target._replace(number=jnp.asarray(AT_STOP), whiskers=jnp.zeros_like(changes))
    return new.replace(target=target, lead=lead)


def slips_of(problem: ChainProblem, z: RowsOfContacts, state: ChainState) -> tuple[Array, Array, Array] | None:
    """Number of the object, slip, and length of the whisker beyond all contacts, as coarse rods take them."""
    if state.friction is None:
        return None
    number = problem.profile.object_of(jnp.where(state.touches, state.piece, 0))
    beyond = jnp.where(state.phase == Phase.tangential, slack_of(problem.profile, z, state), 0.0)
    return jnp.where(state.touches, jnp.asarray(number), -1), state.friction.slip, beyond


def landed(
    problem: ChainProblem, z: RowsOfContacts, state: ChainState, lean: PerRow
) -> tuple[RowsOfContacts, ChainState]:
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
