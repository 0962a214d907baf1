"""What follows from a loss of stability: contacts slide over the surface at fixed drive until they come to rest.

As with a single contact (flow.py of space), tractions hold the contacts back. On the way, contacts that pull are
released, and those begin whose gaps close. A whisker that has lost all contacts comes free, if nothing is on the way to
its unloaded shape. What cannot be followed so ends the scan.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, along
from jaxwhisker._path.march_state import Outcome, Task
from jaxwhisker._path.path import EventKind, Node, Status, first_case, select
from jaxwhisker._space.contact import AHEAD, FORCE, POINT, SLACK, TRACTION, Contact
from jaxwhisker._space.flow import FIRST_TIME, FLOW_STEPS, KICK, LONGEST_TIME, REST, SHORTEST_TIME, STRIDE
from jaxwhisker._space.free import contact_at, in_scene
from jaxwhisker._space.jumps import met_on_the_way
from jaxwhisker._space.march_state import SNAP, MarchInSpace
from jaxwhisker._space.problem import SpaceProblem, of_each
from jaxwhisker._space.stance import bases_at_rest
from jaxwhisker._space_chain.march_state import (
    FlowOfChainInSpace,
    NewContactInSpace,
    TrialOfChainInSpace,
    inserted,
    removed,
)
from jaxwhisker._space_chain.newton import PhasesOfRows, of_whiskers, outermost

INSIDE = 1e-6  # lengths: depth of free whiskers that must not be inside an object
SHALLOW = 1e-3  # lengths: depth of a shaft in an object at which a contact begins in a flow
TOUCHING = 1e-8  # lengths: depth that counts as a touch
RETURNING = 1e-5  # lengths: contacts that slide back by less may do so because of rounding errors


def sliding(march: MarchInSpace, kick: Scalar = KICK) -> MarchInSpace:
    """The state in which contacts begin to slide, from so far along the path."""
    z, nobody = march.point.z, jnp.zeros_like(march.phase, bool)
    flow = FlowOfChainInSpace(
        jnp.asarray(FIRST_TIME),
        jnp.asarray(0),
        z,
        jnp.zeros_like(z[:, POINT]),
        jnp.asarray(True),
        nobody,
        z,
        jnp.full_like(march.phase, int(Phase.free)),
    )
    return march.replace(
        task=jnp.asarray(int(Task.flow)),
        point=Point(along(march.point, march.tangent, kick).z, march.point.u),
        flow=flow,
        pending=march.node(march.point, march.tangent),
    )


def flow_onwards(
    problem: SpaceProblem, march: MarchInSpace, trial: TrialOfChainInSpace, new: NewContactInSpace
) -> Outcome:
    """Handle a time step in which contacts slide; `new` is the contact that begins if a gap has closed."""
    z, before, time, contacts = trial.point.z, march.point.z, march.flow.time, problem.contacts
    phase = trial.phase
    touching = phase != Phase.free
    way = jnp.where(touching[:, None], (z - before)[:, POINT], 0.0)
    moved = jnp.max(jnp.abs(way))
    # Near an unstable equilibrium, an implicit step that is too long ends on its other side.
    returns = (jnp.sum(way * march.flow.way) < 0) & (moved > RETURNING)
    gap = jnp.min(trial.stance.candidates.distance)
    touches = gap < -TOUCHING
    good = trial.converged & (moved < STRIDE) & (gap > -SHALLOW) & ~returns
    negative = touching & (z[:, FORCE] < 0)
    # A contact that is held to the surface is not needed any more as soon as its whisker has another one.
    alone = jnp.sum(of_whiskers(problem, touching), axis=1) == 1
    pulled = negative & ~(march.flow.clings & jnp.repeat(alone, contacts))
    first_pulled = pulled & (jnp.cumsum(pulled) == 1)
    pulls = good & jnp.any(pulled)
    begins = good & touches & ~pulls
    gone = removed(z, phase, first_pulled & pulls, contacts)
    less, lands = _with_landed(problem, march, (z, phase), gone)
    more = inserted(z, phase, new, contacts)
    full = jnp.all(of_whiskers(problem, touching), axis=1)[new.row // contacts]
    z_next, phase_next = first_case((pulls, less), (begins, more), otherwise=(z, phase))

    growth = jnp.where(moved < STRIDE / 1000, 10.0, jnp.where(moved < STRIDE / 3, 3.0, 1.0))
    longer = jnp.where(begins | pulls, time, jnp.minimum(growth * time, LONGEST_TIME))
    opens = march.flow.opens & (trial.stance.opens | ~good)
    flow = march.flow._replace(
        time=jnp.where(good, longer, time / 4),
        steps=march.flow.steps + 1,
        way=jnp.where(good & ~begins & ~pulls, way, jnp.where(good, 0.0, march.flow.way)),
        opens=opens,
    )
    # Nearly straight whiskers may be unable to reach where the kick has put their contacts.
    at_first = march.flow.time == FIRST_TIME * 0.25**march.flow.steps
    nearer = Point((before + march.flow.start) / 2, march.point.u)
    again = march.replace(flow=flow, point=select(at_first, nearer, march.point))
    # A whisker that has come free inside an object lands on it again.
    inside = jnp.min(trial.stance.candidates.distance, axis=1) < -INSIDE
    inside &= of_whiskers(problem, march.phase)[:, 0] == Phase.free
    landed = jnp.repeat(inside, contacts) & (march.flow.last_phase != Phase.free)
    landing = march.replace(
        state=march.state._replace(phase=jnp.where(landed, march.flow.last_phase, march.phase)),
        point=march.point._replace(z=jnp.where(landed[:, None], march.flow.last, before)),
        flow=march.flow._replace(
            steps=march.flow.steps + 1, way=jnp.zeros_like(way), clings=march.flow.clings | landed
        ),
    )
    still = (moved < REST) & (time >= LONGEST_TIME / 4)
    rests = good & ~pulls & ~begins & (still | ~jnp.any(touching))

    state = march.state._replace(phase=phase_next)
    frees = pulls & jnp.any(_freed(problem, phase, phase_next))
    flow = flow._replace(
        clings=(flow.clings | (lands & pulls)) & (phase_next != Phase.free),
        last=jnp.where(frees, z, flow.last),
        last_phase=jnp.where(frees, phase, flow.last_phase),
    )
    onwards = march.replace(
        state=state,
        point=Point(jnp.where(rests, z_next.at[:, TRACTION].set(0.0), z_next), march.point.u),
        stance=trial.stance,
        flow=flow,
    )
    rested = onwards.replace(
        task=jnp.asarray(int(Task.arrive)),
        pending=_snap(problem, march.pending, state.phase),
        target=march.target._replace(number=jnp.asarray(SNAP), whiskers=jnp.zeros_like(touching)),
    )
    # A contact that splits in two slides on as two.
    failed = march.stopped(jnp.where(opens, int(Status.unsettled), int(Status.not_convex)))
    new_state = first_case(
        ((flow.steps >= FLOW_STEPS) | (flow.time < SHORTEST_TIME), failed),
        (jnp.any(landed), landing),
        (~good, again),
        (rests & jnp.any(negative), failed),
        (begins & full, march.stopped(Status.too_many_contacts)),
        (rests, rested),
        otherwise=onwards,
    )
    return new_state, jnp.asarray(False), march.pending


def _with_landed(
    problem: SpaceProblem,
    march: MarchInSpace,
    before: tuple[RowsOfContacts, PhasesOfRows],
    after: tuple[RowsOfContacts, PhasesOfRows],
) -> tuple[tuple[RowsOfContacts, PhasesOfRows], Bool[Array, " rows"]]:
    """The contacts after a release, and those among them that whiskers meet on the way to their unloaded shapes."""
    if problem.surface.is_convex:
        return after, jnp.zeros_like(march.phase, bool)
    z, phase = (values[:, 0] for values in of_whiskers(problem, before))
    freed = _freed(problem, before[1], after[1])
    sides = (z, phase), (z, jnp.where(freed, int(Phase.free), phase))
    met = met_on_the_way(problem, march.point.u, *sides, jnp.any(freed))
    rows = jnp.asarray(outermost(problem)) & jnp.repeat(met.some & freed, problem.contacts)
    rest = of_each(
        problem,
        lambda _, outline, base: in_scene(outline, base).rotation,
        problem.outline,
        bases_at_rest(problem, march.point.u),
    )
    contact = jax.vmap(lambda *own: _rolled(problem, *own))(met.contact, problem.length, rest)
    contact = jnp.repeat(contact, problem.contacts, axis=0)
    begun = jnp.where(contact[:, SLACK] > 0, int(Phase.tangential), int(Phase.tip))
    return (jnp.where(rows[:, None], contact, after[0]), jnp.where(rows, begun, after[1])), rows


def _rolled(
    problem: SpaceProblem, contact: Contact, length: Scalar, rest: Float[Array, "points 3 3"]
) -> Float[Array, "11"]:
    """The contact of a whisker whose unloaded cross-section has turned without twisting, by the change of its tangent.

    `rest` are the directors of the unloaded whisker.
    """
    slack, out = contact[SLACK], problem.surface.normal(contact[POINT])
    chi = jnp.minimum(slack, 0.0)
    tangent = jnp.cos(chi) * contact[AHEAD] + jnp.sin(chi) * out
    place = jnp.clip(1 - jnp.maximum(slack, 0.0) / length, 0.0, 1.0) * (rest.shape[0] - 1)
    first, _, before = rest[jnp.round(place).astype(int)].T
    turn = jnp.cross(before, tangent)
    # The shortest rotation; it is not defined for opposite tangents.
    along = jnp.sum(turn * first) / jnp.maximum(1 + jnp.sum(before * tangent), 1e-3)
    side = first * jnp.sum(before * tangent) + jnp.cross(turn, first) + along * turn
    begun = contact_at(contact[POINT], out, tangent, side, jnp.maximum(slack, 0.0))
    return begun.at[FORCE].set(contact[FORCE])


def _freed(problem: SpaceProblem, before: PhasesOfRows, after: PhasesOfRows) -> Bool[Array, " whiskers"]:
    """Whiskers that have had contacts and have none any more."""
    touched, touches = (jnp.any(each != Phase.free, axis=1) for each in of_whiskers(problem, (before, after)))
    return touched & ~touches


def _snap(problem: SpaceProblem, before: Node, phase: PhasesOfRows) -> Node:
    """The node of a snap into these phases."""
    freed, touched = _freed(problem, before.before.phase, phase), of_whiskers(problem, before.before.phase)[:, 0]
    off, touched = jnp.any(freed), touched != Phase.free
    kind = jnp.where(off, int(EventKind.snap_off), int(EventKind.snap_through))
    whiskers = outermost(problem) & jnp.repeat(jnp.where(off, freed, touched), problem.contacts)
    return before._replace(state=before.state._replace(phase=phase), kind=kind, whiskers=whiskers)
