"""Margins of whiskers with several contacts, and the contacts that begin where one vanishes."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState, held_of, lean_of, slack_of
from jaxwhisker._chain.friction import lean_margin, most_lean
from jaxwhisker._chain.gaps import Candidate
from jaxwhisker._chain.march_state import (
    AT_STOP,
    HIGH,
    LEAN,
    LOW,
    TOUCH,
    ChainStance,
    MarchOfChain,
    NewContact,
    PerRow,
    TrialOfChain,
)
from jaxwhisker._chain.newton import of_whiskers
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.rows import without_row
from jaxwhisker._equilibrium.contact import FORCE, PARAMETER, SLACK, Phase
from jaxwhisker._equilibrium.point import Contacts, Point
from jaxwhisker._path.march_state import Target, Task
from jaxwhisker._path.margins import FAR, Ignored, Margins, first_crossed

MARGIN_NOISE = 1e-11
TOUCHING = 2e-9  # depth of a shaft that counts as a touch: one that has just been released is at 0


def margins_of(
    problem: ChainProblem, march: MarchOfChain, z: Array, u: Scalar, stance: ChainStance, stop: Scalar
) -> Margins:
    """Margins of all kinds of events."""
    state, profile = march.state, problem.profile
    free, tip = state.phase == Phase.free, state.phase == Phase.tip
    outermost = jnp.arange(z.shape[0]) % problem.contacts == 0
    touch = stance.gap + TOUCHING
    release = jnp.where(free, FAR, z[:, FORCE])
    slack = slack_of(profile, z, state)
    changes = jnp.where(tip, jnp.minimum(-slack, slack + np.pi), slack)
    changes = jnp.where(outermost & ~free & ~may_turn(problem, state), changes, FAR)
    (low, high), p = piece_ends(problem, march), stance.parameter
    below, above = jnp.where(free, FAR, p - low), jnp.where(free, FAR, high - p)
    lean = lean_margin(problem, state, z, lean_of(profile, problem.friction_angle, z, state))
    return touch, release, changes, below, above, lean, jnp.reshape(march.direction * (stop - u), 1)


def may_turn(problem: ChainProblem, state: ChainState) -> Array:
    """Whether a tip is in an inner corner with friction: its force does not tell in which directions it may point."""
    if problem.friction_angle is None:
        return jnp.zeros_like(state.touches)
    return held_of(problem.profile, state).pinned


def piece_ends(problem: ChainProblem, march: MarchOfChain) -> tuple[Array, Array]:
    """Parameters at which the pieces of all contacts begin and end."""
    profile, state = problem.profile, march.state
    low, high = profile.ends_on(jnp.where(state.touches, state.piece, 0))
    if problem.friction_angle is None:
        return low, high
    wider = jnp.where(held_of(profile, state).pinned, problem.friction_angle, 0.0)
    return low - wider, high + wider


def margin_rates(problem: ChainProblem, march: MarchOfChain, tangent: Point) -> Margins:
    """Rates of the margins along the path, those of forces and slacks of contacts only."""
    state, slack, along = march.state, tangent.z[:, SLACK], tangent.z[:, PARAMETER]
    lean = jnp.zeros(0)
    if problem.friction_angle is not None:
        held, leans = held_of(problem.profile, state), march.point.z
        lean = -jnp.where(held.at_corner, jnp.sign(leans[:, SLACK]) * slack, jnp.sign(leans[:, PARAMETER]) * along)
        lean = jnp.where(held.sticks, lean, 0.0)
        slack, along = jnp.where(held.at_corner, 0.0, slack), jnp.where(held.rolls, 0.0, along)
    free, tip = state.phase == Phase.free, state.phase == Phase.tip
    backwards = march.point.z[:, SLACK] < -np.pi / 2
    slack = jnp.where(tip & ~backwards, -slack, slack)
    outermost = jnp.arange(slack.size) % problem.contacts == 0
    still = jnp.zeros_like(march.stance.gap)
    force = jnp.where(free, 0.0, tangent.z[:, FORCE])
    along = jnp.where(free, 0.0, along)
    changes = jnp.where(outermost & ~free & ~may_turn(problem, state), slack, 0.0)
    return still, force, changes, along, -along, lean, jnp.zeros(1)


def first_violated(
    problem: ChainProblem, march: MarchOfChain, trial: TrialOfChain, distance: Scalar, ignored: Ignored | None = None
):
    """Whether an event lies within a step of this length, and the first such event."""
    here = margins_of(problem, march, march.point.z, march.point.u, march.stance, trial.stop)
    z, parameter = z_before(problem, march, trial)
    stance = trial.stance._replace(parameter=parameter)
    there = margins_of(problem, march, z, trial.point.u, stance, trial.stop)
    if ignored is not None and problem.profile.has_edges:
        # A shaft that turns about a corner touches the next side where the corner becomes that side. This touch is none
        # of its own. It is a double root, from which Newton's method ends as far away as its last step is long.
        early = jnp.where(begins_at(march), problem.rod.newton_tolerance, 0.0)
        there = tuple(margin - early if kind in (LOW, HIGH) else margin for kind, margin in enumerate(there))
    crossed = first_crossed(here, there, MARGIN_NOISE, problem.rows, (TOUCH, AT_STOP), ignored)
    new = new_contact(problem, march, z, trial.candidates, jnp.minimum(crossed.entry, here[0].size - 1))
    touches = crossed.number == TOUCH
    rows = jnp.where(touches, jnp.arange(problem.rows) == new.row, crossed.whiskers)
    limit = jnp.where((march.state.phase == Phase.tip) & (z[:, SLACK] < -np.pi / 2), -np.pi, 0.0)
    low, high = piece_ends(problem, march)
    limit = jnp.where(crossed.number == LOW, low, jnp.where(crossed.number == HIGH, high, limit))
    if problem.friction_angle is not None:
        lean = lean_of(problem.profile, problem.friction_angle, z, march.state)
        limit = jnp.where(crossed.number == LEAN, jnp.sign(jnp.asarray(lean)) * most_lean(problem, z), limit)
    return crossed.some, Target(crossed.number, rows, crossed.share * distance, new, limit)


def new_contact(
    problem: ChainProblem, march: MarchOfChain, z: Array, candidates: Candidate, entry: Array
) -> NewContact:
    """The contact of a candidate, by its number among those of all whiskers."""
    count = candidates.gap.shape[1]
    own = jax.tree.map(lambda leaf: jnp.reshape(leaf, (-1, *leaf.shape[2:]))[entry], candidates)
    whisker = entry // count
    slack = slack_of(problem.profile, z, march.state)
    phase, slack = (values[whisker] for values in of_whiskers(problem, (march.state.phase, slack)))
    beyond = jnp.where(phase == Phase.tip, 0.0, slack)
    new = jnp.where(own.phase == Phase.tip, 0.0, own.numbers[SLACK])
    place = jnp.sum((phase != Phase.free) & (beyond < new))
    # A contact at the tip comes first.
    place = jnp.where(own.phase == Phase.tip, 0, place)
    row = whisker * problem.contacts + jnp.minimum(place, problem.contacts - 1)
    return NewContact(row, own.numbers, own.phase, own.side, own.piece)


def is_full(problem: ChainProblem, march: MarchOfChain, row: Array) -> Bool[Array, ""]:
    """Whether the whisker of a row has no room for another contact."""
    touching = jnp.sum(of_whiskers(problem, march.state.touches), axis=1)
    return touching[row // problem.contacts] == problem.contacts


def begins_at(march: MarchOfChain) -> Bool[Array, ""]:
    """Whether the march solves for a point at which a contact begins."""
    return (march.task == Task.event) & (march.target.number == TOUCH)


def z_before(problem: ChainProblem, march: MarchOfChain, trial: TrialOfChain) -> tuple[Contacts, PerRow]:
    """Contacts on arrival at the end of a step, without one that begins there, and their parameters."""
    rows = (jnp.arange(problem.rows) == march.target.first.row) & begins_at(march)
    z, parameter = trial.point.z, trial.stance.parameter
    return without_row((z, parameter), rows, (jnp.zeros_like(z), jnp.zeros_like(parameter)), problem.contacts)
