"""What follows from a loss of stability: where whiskers come to rest, and in which contacts.

Coarse rods flow at a control a little behind the loss (rod_flow.py). The contacts in which they come to rest are solved
for exactly, there and at the loss itself; contacts that pull, have the wrong phase or are missing are exchanged.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._chain.changes import changed_contacts
from jaxwhisker._chain.contacts import ChainState, held_of, lean_of, parameter_of
from jaxwhisker._chain.friction import keeps_places, slips_of, with_slips
from jaxwhisker._chain.march_state import (
    HIGH,
    LEAN,
    LOW,
    PHASE,
    RELEASE,
    SNAP,
    ChainFlow,
    MarchOfChain,
    TrialOfChain,
    inserted,
    removed,
)
from jaxwhisker._chain.margins import MARGIN_NOISE, is_full, margins_of, new_contact, piece_ends
from jaxwhisker._chain.newton import evaluate, of_whiskers
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.rod_flow import Landing, flow, landing_of, rods_of
from jaxwhisker._chain.stance import shafts_of
from jaxwhisker._equilibrium.contact import FORCE, SLACK, Phase
from jaxwhisker._equilibrium.point import Contacts, Point, scale_of
from jaxwhisker._path.march import any_lane
from jaxwhisker._path.march_state import Outcome, Task
from jaxwhisker._path.path import EventKind, Node, Status, first_case, select

# Distances of the control behind a loss at which rods flow, dimensionless, in the order in which they are tried: coarse
# rods may still be stable close to it, but where objects have short waves, other events follow soon.
BEYOND = (3e-3, 2e-2, 1e-1, 3e-4)
FIRST, OF_SLIPS = 0, 1
CLOSEST = 1e-6  # difference of controls from which contacts cannot be followed towards the loss
SLIPS = 0.02  # along the path, from where a contact slips over an end
MOST_SNAPS, STILL = 8, 1e-9  # at a control, and by how much this may differ
# Difference from the forces on rods at rest, relative and in EI/L^2: less than half of the lowest buckling load.
STRAYS, LIGHT = 0.5, 1.0
SAME = 1e-3  # difference of contacts that have not gone anywhere
DEEP = 1e-7  # lengths: depth of a shaft where whiskers have come to rest in the wrong contacts


def to_snap(march: MarchOfChain) -> MarchOfChain:
    """The state that is about to leave an equilibrium that has lost its stability."""
    corner = {} if march.state.friction is None else {"corner": jnp.asarray(True)}
    pending = march.node(march.point, march.tangent, **corner)
    # A contact that slips over an end begins to flow beyond it.
    z = march.point.z + jnp.where(march.slips, SLIPS, 0.0) * march.tangent.z
    push = jnp.zeros_like(march.flow.push)
    attempt = jnp.where(march.slips, OF_SLIPS, FIRST)
    snaps = jnp.where(march.travel - march.flow.travel < STILL, march.flow.snaps + 1, 0)
    flowing = march.replace(
        task=jnp.asarray(int(Task.flow)),
        flow=ChainFlow(attempt, z, march.point.u, march.travel, snaps, jnp.asarray(0), march.point.u, push),
        pending=pending,
        slips=jnp.asarray(False),
    )
    # Whiskers that snap to and fro do not come to rest.
    return select(snaps > MOST_SNAPS, march.stopped(Status.unsettled), flowing)


def to_snap_from_before(march: MarchOfChain) -> MarchOfChain:
    """The state where contacts can move on slowly in no way: about to leave that before their slips were changed."""
    before = march.pending
    point, none = before.point._replace(z=before.z_before), jnp.zeros_like(march.slips_tried)
    return to_snap(march.replace(state=before.before, point=point, slips_tried=none, rests=jnp.zeros_like(march.rests)))


def after_flow(problem: ChainProblem, march: MarchOfChain) -> Outcome:
    """Let rods flow until they come to rest, and take their contacts as a guess for an equilibrium.

    The flow of one lane of a batch costs as much as that of all: lanes wait until no other one is on its way.
    """
    begins, before = march.task == Task.flow, march.pending
    waits = any_lane(~begins & (march.task != Task.done))
    u = march.flow.u + march.direction * jnp.asarray(BEYOND)[march.flow.attempt]

    def landed_in() -> Landing:
        at = evaluate(problem, march.flow.start, march.point.u, before.before)
        pose = problem.rest + problem.displacement(at.load)
        shafts = shafts_of(problem, march.point.u, pose, march.flow.start, before.before)
        slips = slips_of(problem, march.flow.start, before.before)
        rods = rods_of(problem, march.point.u, shafts, at.load, slips)
        landing = landing_of(problem, u, flow(problem, march.flow.u, u, rods, begins))
        return landing._replace(state=keeps_places(problem, before.before, landing.state))

    nowhere = Landing(march.point.z, march.state, jnp.asarray(False), jnp.asarray(False))
    landing = jax.lax.cond(any_lane(begins) & ~waits, landed_in, lambda: nowhere)
    landed = march.replace(
        task=jnp.asarray(int(Task.arrive)),
        state=landing.state,
        point=Point(landing.z, u),
        flow=march.flow._replace(landed=u, push=_push(problem, landing.z, landing.state)),
        target=march.target._replace(number=jnp.asarray(SNAP), whiskers=jnp.zeros(problem.rows, bool)),
        pending=_snap(problem, before, landing.state),
    )
    new = first_case(
        (landing.too_many, march.stopped(Status.too_many_contacts)),
        (~landing.settled, flow_again(march)),
        otherwise=landed,
    )
    return select(waits, march, new), jnp.asarray(False), march.pending


def _push(problem: ChainProblem, z: Contacts, state: ChainState) -> Float[Array, " whiskers"]:
    force = jnp.where(state.touches, z[:, FORCE], 0.0)
    return jnp.sum(of_whiskers(problem, force), axis=1)


def strays(problem: ChainProblem, march: MarchOfChain, trial: TrialOfChain) -> Bool[Array, ""]:
    """Whether the equilibrium is not the one in which rods have come to rest: Newton's method knows unstable ones, too.

    Contacts that are exchanged share the force in another way.
    """
    push = march.flow.push
    return jnp.any(jnp.abs(_push(problem, trial.point.z, march.state) - push) > STRAYS * push + LIGHT)


def _snap(problem: ChainProblem, before: Node, state: ChainState) -> Node:
    """The node of a snap into this state."""
    touched, touches = (jnp.any(each, axis=1) for each in of_whiskers(problem, (before.before.touches, state.touches)))
    freed = touched & ~touches
    off = jnp.any(freed)
    kind = jnp.where(off, int(EventKind.snap_off), int(EventKind.snap_through))
    first = jnp.arange(problem.rows) % problem.contacts == 0
    whiskers = first & jnp.repeat(jnp.where(off, freed, touched), problem.contacts)
    return before._replace(state=state, kind=kind, whiskers=whiskers)


def revised_landing(
    problem: ChainProblem, march: MarchOfChain, trial: TrialOfChain
) -> tuple[MarchOfChain, Bool[Array, ""]]:
    """Contacts in which whiskers may rest instead of those that pull, or have the wrong phase, or are missing."""
    state, z = march.state, trial.point.z
    margins = margins_of(problem, march, z, trial.point.u, trial.stance, trial.point.u + march.direction)
    pulls, other = margins[RELEASE] < -MARGIN_NOISE, margins[PHASE] < -MARGIN_NOISE
    deep = jnp.ravel(trial.stance.gap) < -DEEP
    new = new_contact(problem, march, z, trial.candidates, jnp.argmin(jnp.ravel(trial.stance.gap)))
    first_pull = pulls & (jnp.cumsum(pulls) == 1)
    less = removed(z, state, first_pull, problem.contacts)
    tip = state.phase == Phase.tip
    phase = jnp.where(other, jnp.where(tip, int(Phase.tangential), int(Phase.tip)), state.phase)
    turned = z.at[:, SLACK].set(jnp.where(other, 0.0, z[:, SLACK])), state._replace(phase=phase)
    leans = jnp.zeros_like(pulls)
    if state.friction is not None:
        leans = margins[LEAN] < -MARGIN_NOISE
        lean = jnp.asarray(lean_of(problem.profile, problem.friction_angle, z, state))
        slip = jnp.where(leans, jnp.sign(lean).astype(int), state.friction.slip)
        slipping = with_slips(problem, z, trial.stance.parameter, state, slip)
        places = state.friction._replace(beyond=jnp.where(other, 0.0, state.friction.beyond))
        turned = turned[0], turned[1]._replace(friction=places)
        turned = select(jnp.any(other), turned, slipping)
    other |= leans
    more = inserted(z, state, new, problem.contacts)
    full = is_full(problem, march, new.row)
    # A contact beyond an end of its piece is on the next one.
    low, high = margins[LOW] < -DEEP, margins[HIGH] < -DEEP
    astray = (low | high) & (jnp.cumsum(low | high) == 1)
    number, (begin, end) = jnp.where(jnp.any(low & astray), LOW, HIGH), piece_ends(problem, march)
    target = march.target._replace(number=number, whiskers=astray, limit=jnp.where(low, begin, end))
    passed = changed_contacts(problem, march.replace(target=target), trial)[:2]
    z, state = first_case((jnp.any(pulls), less), (jnp.any(other), turned), (jnp.any(astray), passed), otherwise=more)
    flow_ = march.flow._replace(tries=march.flow.tries + 1)
    pending = _snap(problem, march.pending, state)
    revised = march.replace(point=march.point._replace(z=z), state=state, flow=flow_, pending=pending)
    only_deep = jnp.any(deep) & ~jnp.any(pulls) & ~jnp.any(other) & ~jnp.any(astray)
    revised = select(only_deep & full, march.stopped(Status.too_many_contacts), revised)
    return revised, jnp.any(pulls) | jnp.any(other) | jnp.any(deep) | jnp.any(astray)


def loosened(problem: ChainProblem, march: MarchOfChain) -> MarchOfChain:
    """Contacts in which whiskers may rest instead of those that are wedged: the one whose force leans most slips."""
    state, z = march.state, march.point.z
    if state.friction is None:
        return march
    lean = jnp.asarray(lean_of(problem.profile, problem.friction_angle, z, state))
    most = jnp.argmax(jnp.where(held_of(problem.profile, state).sticks, jnp.abs(lean), -1.0))
    slip = state.friction.slip.at[most].set(jnp.where(lean[most] < 0, -1, 1))
    z, state = with_slips(problem, z, parameter_of(problem.profile, z, state), state, slip)
    flow_ = march.flow._replace(tries=march.flow.tries + 1)
    pending = _snap(problem, march.pending, state)
    return march.replace(point=march.point._replace(z=z), state=state, flow=flow_, pending=pending)


def flow_again(march: MarchOfChain) -> MarchOfChain:
    """The state in which rods flow at another control behind the loss, or the march ends."""
    again, before = march.flow.attempt + 1 < len(BEYOND), march.pending
    flowing = march.replace(
        task=jnp.asarray(int(Task.flow)),
        point=Point(before.z_before, march.flow.u),
        state=before.before,
        flow=march.flow._replace(attempt=march.flow.attempt + 1, tries=jnp.asarray(0)),
    )
    return select(again, flowing, march.stopped(Status.unsettled))


def towards_loss(march: MarchOfChain, trial: TrialOfChain) -> tuple[MarchOfChain, MarchOfChain, Bool[Array, ""]]:
    """The ways from contacts in which whiskers rest to those at the loss itself.

    Returns the states of the march that follow if the contacts have been solved for and if they have not, and whether
    the latter is worth while.
    """
    loss, landed = march.flow.u, march.flow.landed
    onwards = march.replace(point=trial.point._replace(u=loss), flow=march.flow._replace(landed=trial.point.u))
    shorter = march.replace(point=march.point._replace(u=(march.point.u + landed) / 2))
    return onwards, shorter, jnp.abs(march.point.u - landed) > CLOSEST


def is_back(march: MarchOfChain, trial: TrialOfChain) -> Bool[Array, ""]:
    """Whether whiskers that have snapped are where they were before."""
    before = march.pending
    moved = jnp.max(jnp.abs(trial.point.z - before.z_before) / scale_of(before.z_before))
    return ~state_differs(march.state, before.before) & (moved < SAME)


def state_differs(one: ChainState, other: ChainState) -> Bool[Array, ""]:
    """Whether whiskers touch in other places; the phase of a contact changes without going anywhere."""
    return jnp.any((one.touches != other.touches) | (one.piece != other.piece))
