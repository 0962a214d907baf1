"""The march: following the path of equilibria in space through touches, changes of phase and releases.

This is pseudo-arclength continuation. Each iteration makes one Newton solve, whatever its task, because all elements of
a batch pay for the most expensive branch that any of them takes. The tasks are:

    advance   take a step along the path; its length follows the prediction error
    event     solve for the point within the last step where a margin vanishes
    arrive    solve for the same point in the phase that holds from here on, which gives the direction there
    done      do nothing: the march has ended
    flow      take a time step in which contacts slide over the surface at fixed drive (flow.py)

Stability is checked at every node (sliding.py). If the end of a step is unstable, steps are shortened until the loss is
located. There the drive turns back (a fold), or a symmetric branch goes on, unstable (a bifurcation).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import PathCondition, Point, along, at_arc_length, unit
from jaxwhisker._path.path import NO_EVENT, Status, select
from jaxwhisker._space.contact import AHEAD, FORCE, SLACK, TRACTION, UNKNOWNS, Traction
from jaxwhisker._space.flow import FIRST_TIME, after_flow, at_surface
from jaxwhisker._space.free import Nearest
from jaxwhisker._space.march_state import (
    AT_STOP,
    GRIP,
    LOSS,
    PHASE,
    RELEASE,
    TOUCH,
    March,
    SpaceFlow,
    SpaceNode,
    SpacePath,
    SpaceTarget,
    SpaceTask,
    SpaceTrial,
)
from jaxwhisker._space.newton import Equations, solve_points
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space.slip import (
    ContactMotion,
    SlipMode,
    SlipState,
    ends_of_step,
    grip_of,
    radau,
    stages_of,
    without_traction,
)
from jaxwhisker._space.stance import SpaceStance, stance_of
from jaxwhisker._space.transitions import FIRST_STEP, after_advance, after_arrive, after_event

NODES = 96  # for every whisker on every leg of the drive, and as many more; a scan of one whisker takes about 60
ITERATIONS = 60000  # a march that needs more ends as `too_long`
CHUNK = 16  # iterations between two checks of whether the whole batch is done


def _condition(march: March, stop: Scalar) -> PathCondition:
    """The equation of the task."""
    n = march.phase.size
    target, none = march.target, jnp.zeros_like(march.point.z)
    locating = march.task == SpaceTask.event
    concerned = target.whiskers.astype(float)
    of_grip = (target.margin == GRIP) & locating & (march.slip is not None)
    of_force = (target.margin == TOUCH) | ((target.margin == RELEASE) & locating)
    of_slack = target.margin == PHASE
    of_loss = (target.margin == LOSS) & locating & (march.slip is not None)
    of_stop = ~of_force & ~of_slack & ~of_grip & ~of_loss
    weight = none.at[:, FORCE].set(concerned * of_force).at[:, SLACK].set(concerned * of_slack)
    of_stop |= march.task == SpaceTask.flow
    weight = jnp.where(march.task == SpaceTask.flow, 0.0, weight)
    u = jnp.where(locating, stop, march.point.u)
    at_event = PathCondition(weight, none, of_stop.astype(float), u, jnp.zeros(n))
    ahead = at_arc_length(march.point, without_traction(march.tangent), march.step)
    return select(march.task != SpaceTask.advance, at_event, ahead)


def _trial(problem: SpaceProblem, stops: Float[Array, " stops"], last: Int[Array, ""], march: March) -> SpaceTrial:
    """Predict and solve."""
    stop, target = stops[jnp.minimum(march.goal, last)], march.target
    locating, advancing = march.task == SpaceTask.event, march.task == SpaceTask.advance
    # A touch is solved for as the contact that begins, without force.
    begins = locating & (target.margin == TOUCH) & target.whiskers
    distance = jnp.where(locating, target.distance, march.step)
    places, _ = radau(stages_of(problem))

    def ahead(place):
        return select(
            advancing | locating, along(march.point, march.tangent, place * distance, march.bend), march.point
        )

    guesses = jax.vmap(ahead)(jnp.asarray(places))
    first_contact = jnp.where(begins[:, None], target.first.contact, guesses.z[-1])
    guesses = guesses._replace(z=guesses.z.at[-1].set(first_contact))
    guess = jax.tree.map(lambda leaf: leaf[-1], guesses)
    phase = jnp.where(begins, target.first.phase, march.phase)
    condition, flows = _condition(march, stop), march.task == SpaceTask.flow
    time = jnp.where(flows, march.flow.time, march.step)
    motion = ContactMotion(march.point.z, Traction(problem.friction, flows), time)
    between = None
    if march.slip is not None:
        measure = at_arc_length(march.point, without_traction(march.tangent), jnp.zeros(()))
        between = select(locating, measure, condition)._replace(z0=march.point.z, u0=march.point.u)
        waits = begins | (march.task == SpaceTask.arrive)
        grips = (target.whiskers & locating & (target.margin == GRIP)).astype(float)
        slipping = march.slip.mode == SlipMode.slips
        motion = motion._replace(
            mode=march.slip.mode,
            waits=waits,
            given=jnp.where(begins[:, None], 0.0, march.point.z[:, TRACTION]),
            cone=grips * ~slipping,
            power=grips * slipping,
            turn=(locating & (target.margin == LOSS)).astype(float),
        )
    phases = jnp.broadcast_to(march.phase, (places.size, phase.size)).at[-1].set(phase)
    equations = Equations(phases, condition, between, motion)
    solution = solve_points(problem, equations, guesses)
    point = solution.end
    rate = solution.newton.tangent
    if march.slip is not None:
        _, arriving = ends_of_step(march.slip, march.point, solution.points)
        rate = select((advancing | locating) & ~jnp.any(begins), arriving, rate)
    _, length = unit(without_traction(rate), point.z)
    tangent = jax.tree.map(lambda leaf: leaf / length, rate)
    grip = None if march.slip is None else grip_of(problem, march.slip.mode, phase, point, tangent)
    stance = stance_of(problem, point, phase, solution.newton.at, grip)
    if march.sunk is not None:
        stance = at_surface(stance, march.sunk)
    return SpaceTrial(solution, tangent, stance, guess, phase, stop, stops, last)


def _iterate(problem: SpaceProblem, stops: Float[Array, " stops"], last: Int[Array, ""], march: March):
    """Predict, solve, decide. Return the new state, and the index (-1 for none) and value of the node to write."""
    trial = _trial(problem, stops, last, march)
    new, write, node = jax.lax.switch(
        march.task,
        [
            lambda: after_advance(problem, march, trial),
            lambda: after_event(problem, march, trial),
            lambda: after_arrive(problem, march, trial),
            lambda: (march, jnp.asarray(False), march.pending),
            lambda: after_flow(problem, march, trial),
        ],
    )
    return new._replace(count=new.count + write), jnp.where(write, march.count, -1), node


def _start(problem: SpaceProblem, start: Scalar, stops: Float[Array, " stops"]) -> March:
    """The state in which the first iteration looks where the free whiskers are."""
    n = problem.length.size
    direction = jnp.where(stops[0] == start, problem.onwards.astype(float), jnp.sign(stops[0] - start))
    z = jnp.zeros((n, UNKNOWNS)).at[:, AHEAD].set(np.array([1.0, 0.0, 0.0]))
    point, still = Point(z, start), Point(jnp.zeros_like(z), direction)
    phase = jnp.full(n, int(Phase.free))
    nobody, zero = jnp.zeros(n, bool), jnp.asarray(0)
    slip, inner = None, None
    if problem.friction is not None:
        slip = SlipState(jnp.full(n, int(SlipMode.slips)), zero, jnp.asarray(True), nobody, zero)
        others = stages_of(problem) - 1
        inner = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (others, *jnp.shape(leaf))), point)
    kind, mode = jnp.asarray(NO_EVENT), None if slip is None else slip.mode
    node = SpaceNode(point, z, still, still, phase, phase, -jnp.abs(start - stops[0]), kind, nobody, mode, inner)
    unknown = jnp.zeros(n)
    stance = SpaceStance(
        free=phase == Phase.free,
        nearest=Nearest(unknown, z, phase),
        advance=unknown,
        speed=jnp.asarray(1.0),
        stable=jnp.asarray(True),
        stiffness=jnp.asarray(1.0),
        sound=jnp.asarray(True),
        grip=None if problem.friction is None else unknown,
        opens=jnp.asarray(True),
    )
    return March(
        task=jnp.asarray(int(SpaceTask.arrive)),
        phase=phase,
        point=point,
        tangent=still,
        bend=jax.tree.map(jnp.zeros_like, still),
        step=jnp.asarray(FIRST_STEP),
        stance=stance,
        size=jnp.asarray(1.0),
        unstable_at=jnp.asarray(jnp.inf),
        unstable_size=jnp.asarray(-1.0),
        target=SpaceTarget(jnp.asarray(AT_STOP), nobody, jnp.asarray(0.0), stance.nearest),
        pending=node,
        goal=zero,
        direction=direction,
        travel=node.travel,
        touched=jnp.asarray(False),
        flow=SpaceFlow(jnp.asarray(FIRST_TIME), zero, z, nobody, stance.opens),
        slip=slip,
        sunk=None if slip is None else nobody,
        count=zero,
        status=jnp.asarray(int(Status.ok)),
    )


@jax.custom_batching.custom_vmap
def _any_lane(goes_on: Bool[Array, ""]) -> Bool[Array, ""]:
    """Whether a march goes on, or under `vmap` any of them.

    All of them iterate as long as one does: with a condition of its own for each, all nodes would be copied again and
    again. A march that is done writes nothing.
    """
    return goes_on


@_any_lane.def_vmap
def _(size, batched, goes_on):
    del size, batched
    return _any_lane(jnp.any(goes_on)), False


def capacity_of(problem: SpaceProblem, stops: int) -> int:
    """Number of nodes that a path has room for; with friction, contacts may stick and slip two hundred times."""
    return NODES * (1 + problem.length.size) * (stops - 1) * (1 if problem.friction is None else 24)


def march(
    problem: SpaceProblem, start: Scalar, stops: Float[Array, " stops"], last: Int[Array, ""], *, capacity: int
) -> SpacePath:
    """March from a control at which all whiskers are free to all stops in turn."""
    first = _start(problem, start, stops)
    nodes = jax.tree.map(lambda leaf: jnp.zeros((capacity, *jnp.shape(leaf)), jnp.asarray(leaf).dtype), first.pending)

    def chunk(carry):
        now, nodes, count = carry

        def body(now, _):
            new, index, node = _iterate(problem, stops, last, now)
            return new, (index, node)

        now, (index, written) = jax.lax.scan(body, now, None, length=CHUNK)
        index = jnp.where(index < 0, capacity, index)
        nodes = jax.tree.map(lambda all_, new: all_.at[index].set(new, mode="drop"), nodes, written)
        full = now.count > capacity  # nodes are lost
        return select(full, now.stopped(Status.too_long), now), nodes, count + CHUNK

    def goes_on(carry):
        return _any_lane(carry[0].task != SpaceTask.done) & (carry[2] < ITERATIONS)

    now, nodes, _ = jax.lax.while_loop(goes_on, chunk, (first, nodes, jnp.asarray(0)))
    status = jnp.where(now.task == SpaceTask.done, now.status, int(Status.too_long))
    return SpacePath(nodes, jnp.minimum(now.count, capacity), status)
