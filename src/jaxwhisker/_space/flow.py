"""What follows from a loss of stability: contacts slide over the surface at fixed drive until they come to rest.

The sliding is overdamped: a traction, proportional to the speed of the material point that touches, holds each contact
back. The energy falls all the way, and the equilibria do not depend on the factor. Time steps are implicit and grow
until the contacts are at rest. A whisker whose contact force vanishes on the way comes free, and stays free if its
unloaded shape clears the object. If not, it lands on the object again: its contact slides on from where it came free,
held to the surface until it comes to rest there.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, along
from jaxwhisker._path.march_state import Outcome, Task
from jaxwhisker._path.path import EventKind, Status, first_case, select
from jaxwhisker._space.contact import FORCE, POINT, TRACTION
from jaxwhisker._space.march_state import SETTLED, SNAP, MarchInSpace, SpaceFlow, TrialInSpace
from jaxwhisker._space.newton import phase_by_slack
from jaxwhisker._space.problem import Contacts, SpaceProblem
from jaxwhisker._space.slip import FAINT, SlipMode, with_traction
from jaxwhisker._space.stance import SpaceStance

KICK = 0.02  # along the path, from a fold
SHARE = 0.2  # of the least force, that the kick may be with friction: light contacts slide very little
SETTLING = 1e-5  # of the control, dimensionless
FIRST_TIME = 1e-4  # dimensionless: a contact with the stiffness 1 moves by 1e-4 of its way
LONGEST_TIME, SHORTEST_TIME = 1e8, 1e-12
HELD = 1e2  # dimensionless: with friction, a contact that is at rest for so long is held
STRIDE = 0.08  # lengths that a contact may slide in a step
REST = 1e-9  # lengths that a contact at rest may slide in the longest time
FLOW_STEPS = 400
# Where contacts stick and slip in turn before they come free, each cycle is shorter than the one before, in proportion
# to the force. At last, a force cannot be told from rounding errors: the contact is released a little early.
LIGHT = 2e-4  # dimensionless force of such a contact
SUNK = 5e-5  # lengths by which its unloaded whisker may still be inside the object
SLID = 1e-3  # lengths: whiskers whose contacts slide further take part in a snap


def sliding(problem: SpaceProblem, march: MarchInSpace) -> MarchInSpace:
    """The state in which contacts begin to slide."""
    kick = KICK if problem.friction is None else _kick(march)
    return _flowing(problem, march, along(march.point, march.tangent, kick).z, march.point.u)


def settling(problem: SpaceProblem, march: MarchInSpace) -> MarchInSpace:
    """The state in which contacts that can neither stick nor slip settle, as the drive moves on a little."""
    onwards = march.tangent.u * march.direction
    # Nearly straight whiskers hardly yield: the path to where the drive would move by as much may be very long.
    distance = jnp.minimum(SETTLING / jnp.maximum(jnp.abs(onwards), SETTLING), _kick(march))
    point = along(march.point, march.tangent, jnp.where(onwards < 0, -distance, distance))
    return _flowing(problem, march, point.z, jnp.asarray(point.u))


def _kick(march: MarchInSpace) -> Scalar:
    """How far contacts with friction are kicked along the path."""
    force = jnp.where(march.phase == Phase.free, jnp.inf, jnp.maximum(march.point.z[:, FORCE], FAINT))
    return jnp.minimum(KICK, SHARE * jnp.min(force))


def _flowing(problem: SpaceProblem, march: MarchInSpace, z: Contacts, u: Scalar) -> MarchInSpace:
    if problem.friction is not None:
        # In a flow, tractions are forces. Tangents may point out of the cone of friction.
        traction = z[:, TRACTION] / jnp.maximum(1.0, jnp.sqrt(jnp.sum(z[:, TRACTION] ** 2, axis=1, keepdims=True)))
        z = z.at[:, TRACTION].set(problem.friction * jnp.maximum(z[:, FORCE, None], 0.0) * traction)
    nobody = jnp.zeros_like(march.flow.clings)
    flow = SpaceFlow(jnp.asarray(FIRST_TIME), jnp.asarray(0), march.point.z, nobody, jnp.asarray(True))
    return march.replace(
        task=jnp.asarray(int(Task.flow)),
        point=Point(z, u),
        flow=flow,
        pending=march.node(march.point._replace(u=u), march.tangent, inner=march.pending.inner),
    )


def clinging(march: MarchInSpace, whiskers: Bool[Array, " whiskers"]) -> MarchInSpace:
    """The state in which these whiskers, which have come free inside the object, slide on."""
    phase = phase_by_slack(march.point.z, jnp.where(whiskers, int(Phase.tip), march.phase))
    return march.replace(
        task=jnp.asarray(int(Task.flow)),
        state=march.state._replace(phase=phase),
        flow=march.flow._replace(clings=march.flow.clings | whiskers),
    )


def _let_go(march: MarchInSpace, light: Bool[Array, " whiskers"]) -> MarchInSpace:
    """The state in which contacts come free that are too light to be followed."""
    state = march.state._replace(phase=jnp.where(light, int(Phase.free), march.phase))
    return march.replace(
        task=jnp.asarray(int(Task.arrive)),
        state=state,
        point=march.point._replace(z=march.flow.start),
        sunk=light,
        pending=march.pending._replace(state=state, kind=jnp.asarray(int(EventKind.release)), whiskers=light),
        target=march.target._replace(number=jnp.asarray(SNAP)),
    )


def at_surface(stance: SpaceStance, sunk: Bool[Array, " whiskers"]) -> SpaceStance:
    """The stance in which whiskers that leave the object, but are still a little inside, are at its surface."""
    distance = stance.nearest.distance
    inside = sunk & (distance < 0) & (distance > -2 * SUNK)
    return stance._replace(nearest=stance.nearest._replace(distance=jnp.where(inside, 0.0, distance)))


def after_flow(problem: SpaceProblem, march: MarchInSpace, trial: TrialInSpace) -> Outcome:
    """Handle a time step in which contacts slide."""
    z, before, time = trial.point.z, march.point.z, march.flow.time
    moved = jnp.max(jnp.abs(z[:, POINT] - before[:, POINT]))
    good = trial.solution.converged & (moved < STRIDE)
    touching = march.phase != Phase.free
    pulled = touching & (z[:, FORCE] < 0)
    released = pulled & ~march.flow.clings
    phase = jnp.where(released, int(Phase.free), phase_by_slack(z, march.phase))
    enough = LONGEST_TIME / 4 if march.slip is None else HELD
    rests = good & (((moved < REST) & (time >= enough)) | jnp.all(phase == Phase.free))
    growth = jnp.where(moved < STRIDE / 1000, 10.0, jnp.where(moved < STRIDE / 3, 3.0, 1.0))
    longer = jnp.minimum(growth * time, LONGEST_TIME)
    time = jnp.where(good, longer, time / 4)
    opens = march.flow.opens & (trial.stance.opens | ~good)
    flow = march.flow._replace(time=time, steps=march.flow.steps + 1, opens=opens)
    # Nearly straight whiskers may be unable to reach where the kick has put their contacts.
    at_first = march.flow.time == FIRST_TIME * 0.25**march.flow.steps
    nearer = with_traction(Point((before + march.flow.start) / 2, march.point.u), before[:, TRACTION])
    again = march.replace(flow=flow, point=select(at_first, nearer, march.point))
    settles = rests & (phase != Phase.free)
    pulls = rests & jnp.any(pulled & ~released)
    freed = (phase == Phase.free) & (march.pending.before.phase != Phase.free)
    moved = jnp.max(jnp.abs(z - flow.start)[:, POINT], axis=1) > SLID
    traction, kind = z[:, TRACTION], jnp.asarray(int(EventKind.snap_through))
    resting, state, slip = jnp.zeros_like(traction), march.state._replace(phase=phase), march.slip
    if slip is not None:
        assert problem.friction is not None
        kind = jnp.where(jnp.any(moved & touching), kind, SETTLED)
        largest = problem.friction * jnp.maximum(z[:, FORCE], FAINT)
        resting = traction / jnp.maximum(largest, jnp.sqrt(jnp.sum(traction**2, axis=1)))[:, None]
        slip = slip._replace(changes=jnp.asarray(0))
        state = state._replace(mode=jnp.where(rests, int(SlipMode.sticks), state.mode))
    rested = march.replace(
        task=jnp.where(rests, int(Task.arrive), int(Task.flow)),
        state=state,
        # Whiskers that have come free may have to slide on.
        point=with_traction(Point(z, march.point.u), jnp.where(settles[:, None], resting, traction)),
        slip=select(rests, slip, march.slip),
        stance=trial.stance,
        flow=flow,
        pending=march.pending._replace(
            state=state,
            kind=jnp.where(jnp.any(freed), EventKind.snap_off, kind),
            whiskers=freed | (moved & touching),
        ),
        target=march.target._replace(number=jnp.asarray(SNAP)),
    )
    # A contact that splits in two slides on as two; as one, it may never come to rest.
    failed = march.stopped(jnp.where(opens, int(Status.unsettled), int(Status.not_convex)))
    if march.sunk is not None:
        light = touching & (before[:, FORCE] < LIGHT) & (trial.stance.nearest.distance > -SUNK)
        failed = select(jnp.any(light), _let_go(march, light), failed)
    new = first_case(
        ((flow.steps >= FLOW_STEPS) | (flow.time < SHORTEST_TIME), failed),
        (~good, again),
        (~trial.stance.sound, march.stopped(Status.lost)),
        (pulls, failed),
        otherwise=rested,
    )
    return new, jnp.asarray(False), march.pending
