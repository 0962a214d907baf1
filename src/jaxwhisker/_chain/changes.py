"""How contacts change at the events of whiskers with several contacts."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxwhisker._chain.contacts import ChainState, held_of, lean_of, slack_of
from jaxwhisker._chain.march_state import (
    AT_STOP,
    HIGH,
    LEAN,
    LOW,
    PHASE,
    RELEASE,
    TOUCH,
    MarchOfChain,
    PerRow,
    TrialOfChain,
    removed,
)
from jaxwhisker._chain.polygons import corner_signs
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._equilibrium.contact import FORCE, SLACK, Phase
from jaxwhisker._equilibrium.friction import Friction
from jaxwhisker._path.path import STOP, EventKind, select

KINDS = {
    TOUCH: EventKind.touch,
    RELEASE: EventKind.release,
    PHASE: EventKind.tip_to_tangential,
    LOW: EventKind.edge,
    HIGH: EventKind.edge,
    LEAN: EventKind.slip,
    AT_STOP: STOP,
}


def changed_contacts(
    problem: ChainProblem, march: MarchOfChain, trial: TrialOfChain
) -> tuple[RowsOfContacts, ChainState, Int[Array, ""]]:
    """The contacts behind the event that a march has solved for, their state, and the kind of the event."""
    target, state, z = march.target, trial.state, trial.point.z
    number, rows = target.number, target.whiskers
    assert target.limit is not None
    gone = removed(z, state, rows & (number == RELEASE), problem.contacts)
    tip, changes = state.phase == Phase.tip, rows & (number == PHASE)
    signs = corner_signs(problem.profile)
    at_corner = signs[jnp.where(state.touches, state.piece, 0)] > 0
    # A corner of an object that slips off the tip, and a tip that slides over a corner.
    changes &= tip | ~at_corner
    way = jnp.where(number == LOW, -1, jnp.where(number == HIGH, 1, 0))
    next_piece = jnp.clip(state.piece + way, 0, signs.size - 1)
    passes = rows & (way != 0) & jnp.where(tip, signs[next_piece] <= 0, signs[next_piece] >= 0)
    other = jnp.where(tip, int(Phase.tangential), int(Phase.tip))
    turned = changes & (target.limit < 0)
    changed = (
        z.at[:, SLACK].set(jnp.where(changes, 0.0, z[:, SLACK])),
        state._replace(
            phase=jnp.where(changes, other, state.phase),
            side=jnp.where(turned, -state.side, state.side),
            piece=jnp.where(passes, next_piece, state.piece),
        ),
    )
    if state.friction is not None:
        happens = rows & (changes | passes | (number == LEAN))
        changed = _with_friction(problem, happens, way, trial, changed, target.limit)
    kinds = jnp.asarray([int(KINDS[k]) for k in range(len(KINDS))])
    kind = jnp.where((number == PHASE) & ~jnp.any(tip & rows), int(EventKind.tangential_to_tip), kinds[number])
    return *select(number == RELEASE, gone, changed), kind


def _with_friction(
    problem: ChainProblem,
    rows: Bool[Array, " rows"],
    way: Int[Array, ""],
    trial: TrialOfChain,
    after: tuple[RowsOfContacts, ChainState],
    limit: PerRow,
) -> tuple[RowsOfContacts, ChainState]:
    """The contacts behind an event at one of them, which may change what its numbers mean.

    Args:
        problem: the problem.
        rows: one-hot: the contact.
        way: -1 where it passes the beginning of its piece, +1 at its end, 0 otherwise.
        trial: the contacts at the event, in their state before it.
        after: numbers and state behind it, without friction.
        limit: the lean or parameter at which it happens.
    """
    z, before, profile = trial.point.z, trial.state, problem.profile
    friction, most = before.friction, problem.friction_angle
    assert friction is not None and most is not None
    slack, lean = slack_of(profile, z, before), jnp.asarray(lean_of(profile, most, z, before))
    (z_after, state), then = after, held_of(profile, before)
    now = held_of(profile, state)
    enters, leaves = rows & now.pinned & ~then.pinned, rows & then.pinned & ~now.pinned
    passes = rows & (state.piece != before.piece)
    # In an inner corner, the force may lean further than normal to both faces.
    parameter = jnp.where(passes & then.rolls, limit, trial.stance.parameter)
    further = jnp.where(enters, way * most, jnp.where(leaves, -way * most, 0.0))
    parameter += further
    # The tangent turns with the parameter there, the whisker does not.
    slack = jnp.where(state.phase != before.phase, 0.0, slack - state.side * further)
    slip = jnp.where(enters, 0, jnp.where(leaves, way, friction.slip))
    slip = jnp.where(rows & then.sticks & (way == 0) & (state.phase == before.phase), jnp.sign(limit).astype(int), slip)
    beyond = jnp.where(state.phase == Phase.tangential, slack, 0.0)
    # Contacts that stick go on from where they are.
    moves = rows & then.sticks & ((state.piece != before.piece) | (state.side != before.side))
    places = jnp.where(moves, parameter, friction.parameter), jnp.where(moves, beyond, friction.beyond)
    state = state._replace(friction=Friction(slip, *places))
    now = held_of(profile, state)
    changed = jnp.stack(
        [z_after[:, FORCE], jnp.where(now.rolls, lean, parameter), jnp.where(now.at_corner, lean, slack)], axis=1
    )
    return jnp.where(rows[:, None], changed, z_after), state
