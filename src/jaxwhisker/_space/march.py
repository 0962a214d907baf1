"""The march: following the path of equilibria in space through touches, changes of phase and releases.

This is pseudo-arclength continuation. Each iteration makes one Newton solve, whatever its task, because all elements of
a batch pay for the most expensive branch that any of them takes. The tasks are:

    advance   take a step along the path; its length follows the prediction error
    event     solve for the point within the last step where a margin vanishes
    arrive    solve for the same point in the phase that holds from here on, which gives the direction there
    done      do nothing: the march has ended
    flow      take a time step in which contacts slide over the surface at fixed drive, until they come to rest

Stability is checked at every node (sliding.py). If the end of a step is unstable, steps are shortened until the loss is
located. There the drive turns back (a fold), or a symmetric branch goes on, unstable (a bifurcation).

From a fold, contacts slide. The sliding is overdamped: a traction, proportional to the speed of the material point that
touches, holds each contact back. The energy falls all the way, and the equilibria do not depend on the factor. Time steps
are implicit and grow until the contacts are at rest. A whisker whose contact force vanishes on the way comes free, and
stays free if its unloaded shape clears the object.
"""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import PathCondition, Point, along, at_arc_length, at_control, dot, scale_of, unit
from jaxwhisker._path.path import NO_EVENT, STOP, EventKind, Status, first_case, select
from jaxwhisker._space.contact import AHEAD, FORCE, POINT, SLACK, TRACTION, UNKNOWNS
from jaxwhisker._space.free import Nearest
from jaxwhisker._space.newton import Phases, Sliding, Solution, phase_by_slack, solve_points
from jaxwhisker._space.problem import Contacts, SpaceProblem
from jaxwhisker._space.stance import Stance, stance_of

CAPACITY = 192  # nodes; a scan of one whisker takes about 40
ITERATIONS = 2000  # a march that needs more ends as `too_long`
CHUNK = 16  # iterations between two checks of whether the whole batch is done
FIRST_STEP = 0.02  # after a corner
LONGEST_STEP = 0.25
SHORTEST_STEP = 1e-10
PREDICTION_ERROR = 2e-3  # at which steps keep their length
LOSS_BRACKET = 2e-6  # distance along the path within which a loss is located; its control to the square of it
LEAST_ADVANCE = 2e-4  # lengths by which free whiskers move at least in a step; shallower dips are missed
INSIDE = 1e-6  # depth of free whiskers that must not be inside the object
TOUCHING = 1e-9  # depth of a free whisker that counts as a touch: one that has just been released is at 0
MARGIN_NOISE = 1e-11
FOLD = 1e-3  # rate of the control at a loss, per arc length, below which it is a fold


class Task(IntEnum):
    """Task of an iteration."""

    advance = 0
    event = 1
    arrive = 2
    done = 3
    flow = 4


TOUCH, RELEASE, PHASE, AT_STOP, SNAP = range(5)  # kinds of margins, and what follows from a loss


class Node(NamedTuple):
    """An equilibrium on the path, and the path's directions before and after it."""

    point: Point
    z_before: Contacts  # on arrival, which differs for a whisker that begins to touch
    arriving: Point
    leaving: Point
    phase: Phases  # from here on
    phase_before: Phases
    travel: Scalar  # distance that the drive has travelled since the first stop; negative on the approach
    kind: Int[Array, ""]  # EventKind, NO_EVENT or STOP
    whiskers: Bool[Array, " whiskers"]


class SpacePath(NamedTuple):
    """Nodes 0 to count - 1, in padded arrays. The status says why the path ends where it does."""

    nodes: Node
    count: Int[Array, ""]
    status: Int[Array, ""]


class Target(NamedTuple):
    """An event to be solved for."""

    margin: Int[Array, ""]
    whiskers: Bool[Array, " whiskers"]
    distance: Scalar  # along the path, expected
    first: Nearest  # contacts that may begin, fields (whiskers, ...)


class Flow(NamedTuple):
    """Contacts that slide after a loss of stability."""

    time: Scalar  # length of the next time step
    steps: Int[Array, ""]
    start: Contacts  # at the loss


class March(NamedTuple):
    """State of the march between two iterations."""

    task: Int[Array, ""]
    phase: Phases
    point: Point
    tangent: Point
    bend: Point  # change of the tangent per arc length
    step: Scalar
    stance: Stance  # of free whiskers
    size: Scalar  # determinant of the sliding stiffness here; halved by the Illinois rule
    unstable_at: Scalar  # distance ahead of a known unstable state, or infinity
    unstable_size: Scalar  # the determinant there
    target: Target
    pending: Node
    goal: Int[Array, ""]
    direction: Scalar  # +1 while the drive moves towards larger u
    travel: Scalar
    touched: Bool[Array, ""]
    flow: Flow
    count: Int[Array, ""]
    status: Int[Array, ""]

    def stopped(self, status: Status | Array) -> "March":
        """The state after the march has ended with this status."""
        return self._replace(task=jnp.asarray(int(Task.done)), status=jnp.asarray(status, dtype=int))


def _condition(march: March, guess: Point, stop_u: Scalar) -> PathCondition:
    """The equation of the task."""
    n = march.phase.size
    target, none = march.target, jnp.zeros_like(march.point.z)
    locating = march.task == Task.event
    concerned = target.whiskers.astype(float)
    of_force = (target.margin == TOUCH) | ((target.margin == RELEASE) & locating)
    of_slack = target.margin == PHASE
    of_stop = ~of_force & ~of_slack
    weight = none.at[:, FORCE].set(concerned * of_force).at[:, SLACK].set(concerned * of_slack)
    of_stop |= march.task == Task.flow
    weight = jnp.where(march.task == Task.flow, 0.0, weight)
    u = jnp.where(locating, stop_u, march.point.u)
    at_event = PathCondition(weight, none, of_stop.astype(float), u, jnp.zeros(n))
    return select(march.task != Task.advance, at_event, at_arc_length(march.point, march.tangent, march.step))


def _iterate(problem: SpaceProblem, stops: Float[Array, " stops"], last: Int[Array, ""], march: March):
    stop_u = stops[jnp.minimum(march.goal, last)]
    locating, advancing = march.task == Task.event, march.task == Task.advance
    target = march.target
    begins = locating & (target.margin == TOUCH) & target.whiskers
    distance = jnp.where(locating, target.distance, march.step)
    guess = select(advancing | locating, along(march.point, march.tangent, distance, march.bend), march.point)
    guess = guess._replace(z=jnp.where(begins[:, None], target.first.contact, guess.z))
    phase = jnp.where(begins, target.first.phase, march.phase)
    sliding = Sliding(march.task == Task.flow, march.flow.time, march.point.z)
    solution = solve_points(problem, phase, _condition(march, guess, stop_u), guess, sliding)
    tangent, _ = unit(solution.newton.tangent, solution.point.z)
    stance = stance_of(problem, solution.point, phase, solution.newton.at)
    new, write, node = jax.lax.switch(
        march.task,
        [
            lambda: _after_advance(problem, march, solution, tangent, stance, guess, stop_u, last),
            lambda: _after_event(problem, march, solution, tangent, stance, phase),
            lambda: _after_arrive(problem, march, solution, tangent, stance, stops, last),
            lambda: (march, jnp.asarray(False), march.pending),
            lambda: _after_flow(march, solution, stance),
        ],
    )
    return new._replace(count=new.count + write), jnp.where(write, march.count, -1), node


def margins_of(phase: Phases, z: Contacts, stance: Stance, remaining: Scalar) -> Float[Array, "kinds whiskers"]:
    """Margins of the four kinds of events: positive before them."""
    free, tip = phase == Phase.free, phase == Phase.tip
    touch = jnp.where(free, stance.nearest.distance + TOUCHING, jnp.inf)
    release = jnp.where(free, jnp.inf, z[:, FORCE])
    slack = jnp.where(free, jnp.inf, jnp.where(tip, -z[:, SLACK], z[:, SLACK]))
    stop = jnp.full_like(touch, jnp.inf).at[0].set(remaining)
    return jnp.stack([touch, release, slack, stop])


def _after_advance(
    problem: SpaceProblem,
    march: March,
    solution: Solution,
    tangent: Point,
    stance: Stance,
    guess: Point,
    stop_u: Scalar,
    last: Int[Array, ""],
):
    """Handle the end of a step along the path: a node, an event in the step, lost stability, or too long a step."""
    point, scale = solution.point, scale_of(march.point.z)
    miss = Point(point.z - guess.z, point.u - guess.u)
    error = jnp.sqrt(dot(miss, miss, scale))
    straight = dot(march.tangent, tangent, scale)
    good = solution.converged & (error < 10 * PREDICTION_ERROR) & (straight > 0.5) & stance.sound
    here = margins_of(march.phase, march.point.z, march.stance, march.direction * (stop_u - march.point.u))
    there = margins_of(march.phase, point.z, stance, march.direction * (stop_u - point.u))
    crossed = there < -MARGIN_NOISE
    drop = jnp.where(crossed, here - there, 1.0)
    share = jnp.where(crossed, jnp.clip(here / jnp.where(drop > 0, drop, 1.0), 0.0, 1.0), jnp.inf)
    violated = jnp.any(crossed)
    k = jnp.argmin(share)
    margin, whisker = jnp.unravel_index(k, share.shape)
    target = Target(
        margin,
        (jnp.arange(march.phase.size) == whisker) & (margin != AT_STOP),
        jnp.ravel(share)[k] * march.step,
        _first_contacts(problem, march, stance),
    )
    size, stable = stance.stiffness, stance.stable
    node = _node(march, point, tangent)
    located = good & ~violated & ~stable & (march.step < LOSS_BRACKET)
    branches = located & (jnp.abs(march.tangent.u) >= FOLD)
    share_to_loss = march.size / (march.size - size)
    middle = march.point.u + share_to_loss * (point.u - march.point.u)
    bifurcation = _node(march, march.point._replace(u=middle), march.tangent)
    bifurcation = bifurcation._replace(kind=jnp.asarray(int(EventKind.bifurcation)), whiskers=march.phase != Phase.free)
    shorter = march._replace(step=0.4 * march.step)
    # A loss further ahead than this one is forgotten; the Illinois rule keeps false position from creeping.
    closer = march._replace(
        unstable_at=march.step,
        unstable_size=size,
        size=jnp.where(jnp.isfinite(march.unstable_at), march.size / 2, march.size),
    )
    closer = closer._replace(step=_to_loss(closer))
    moved = march._replace(
        point=point,
        tangent=tangent,
        stance=stance,
        size=size,
        travel=node.travel,
        bend=Point((tangent.z - march.tangent.z) / march.step, (tangent.u - march.tangent.u) / march.step),
        unstable_at=jnp.where(march.unstable_at > march.step, march.unstable_at - march.step, jnp.inf),
        unstable_size=march.unstable_size / 2,
    )
    onwards = moved._replace(step=_next_step(moved, error, march.step))
    # At a fold, contacts slide on in the direction of the path. A bifurcation is symmetric: they may go either way.
    falls = select(branches, march.stopped(Status.undetermined), _sliding(march))
    new = first_case(
        (march.count >= CAPACITY - 1, march.stopped(Status.too_long)),
        (~good & (shorter.step < SHORTEST_STEP), march.stopped(Status.lost)),
        (~good, shorter),
        (violated, march._replace(task=jnp.asarray(int(Task.event)), target=target)),
        (located, falls),
        (~stable, closer),
        (_is_over(problem, march, stance, last), march.stopped(Status.ok)),
        (~stance.opens, march.stopped(Status.not_convex)),
        otherwise=onwards,
    )
    # While all whiskers are free, nothing happens between events.
    write = good & ~violated & stable & stance.opens & jnp.any(march.phase != Phase.free)
    node = select(branches, bifurcation, node)
    return new, (write | branches) & (march.count < CAPACITY - 1), node


def _to_loss(march: March) -> Scalar:
    """Length of the step that is expected to reach the loss of stability."""
    share = march.size / (march.size - march.unstable_size)
    share = jnp.where(march.unstable_size < 0, share, 0.5)
    share = jnp.clip(jnp.where(jnp.isfinite(share), share, 0.5), 0.02, 0.98)
    # A last step to the unstable state itself, which false position approaches for ever.
    return march.unstable_at * jnp.where(march.unstable_at < LOSS_BRACKET, 1.0, share)


def _next_step(march: March, error: Scalar, step: Scalar) -> Scalar:
    factor = jnp.clip((PREDICTION_ERROR / jnp.maximum(error, 1e-14)) ** (1 / 3), 0.3, 2.5)
    length = jnp.minimum(factor * step, jnp.where(jnp.all(march.phase == Phase.free), jnp.inf, LONGEST_STEP))
    length = jnp.minimum(length, _clear(march.stance, march.tangent))
    return jnp.where(jnp.isfinite(march.unstable_at), jnp.minimum(length, _to_loss(march)), length)


def _clear(stance: Stance, tangent: Point) -> Scalar:
    """Length of a step in which free whiskers cannot pass through the object unnoticed."""
    speed = jnp.maximum(stance.speed * jnp.abs(tangent.u), 1e-12)
    return jnp.min(jnp.where(stance.free, (jnp.maximum(stance.nearest.distance, 0.0) + LEAST_ADVANCE) / speed, jnp.inf))


def _first_contacts(problem: SpaceProblem, march: March, stance: Stance) -> Nearest:
    del problem, march
    return stance.nearest


def _node(march: March, point: Point, tangent: Point) -> Node:
    travel = march.travel + jnp.abs(point.u - march.point.u)
    nobody = jnp.zeros_like(march.phase, bool)
    return Node(point, point.z, tangent, tangent, march.phase, march.phase, travel, jnp.asarray(NO_EVENT), nobody)


def _is_over(problem: SpaceProblem, march: March, stance: Stance, last: Int[Array, ""]) -> Bool[Array, ""]:
    """Whether all whiskers have passed the object and cannot meet it again: the drive moves on along a line."""
    distance = stance.nearest.distance
    if problem.ends is not None:
        return jnp.asarray(False)
    leaves = jnp.all((distance > march.stance.nearest.distance) & (distance > PASSED))
    return jnp.all(march.phase == Phase.free) & march.touched & (march.goal > 0) & (march.goal >= last) & leaves


PASSED = 0.25  # lengths from the object at which a scan right across it ends


def _after_event(
    problem: SpaceProblem, march: March, solution: Solution, tangent: Point, stance: Stance, phase: Phases
):
    """Handle the point where a margin vanishes."""
    point, target, scale = solution.point, march.target, scale_of(march.point.z)
    touches = target.whiskers & (target.margin == TOUCH)
    z_before = jnp.where(touches[:, None], march.point.z, point.z)
    chord = Point(z_before - march.point.z, point.u - march.point.u)
    distance, reach = dot(march.tangent, chord, scale), jnp.sqrt(dot(chord, chord, scale))
    good = solution.converged & (distance > -1e-9) & (reach <= 1.5 * march.step + 1e-6)
    # The whisker may touch with its tip where its shaft was expected to, or the reverse.
    slack = jnp.where(touches, jnp.where(phase == Phase.tip, point.z[:, SLACK], -point.z[:, SLACK]), -1.0)
    other = solution.converged & (slack > MARGIN_NOISE)
    swapped = jnp.where(target.first.phase == Phase.tip, Phase.tangential, Phase.tip)
    first = target.first._replace(
        phase=jnp.where(other, swapped, target.first.phase),
        contact=target.first.contact.at[:, SLACK].multiply(~other),
    )
    again = march._replace(task=jnp.asarray(int(Task.advance)), step=0.5 * jnp.minimum(march.step, target.distance))
    tip = jnp.any(target.whiskers & (phase == Phase.tip))
    kinds = jnp.array([
        EventKind.touch,
        EventKind.release,
        jnp.where(tip, EventKind.tip_to_tangential, EventKind.tangential_to_tip),
        STOP,
    ])  # fmt: skip
    swaps = target.whiskers & (target.margin == PHASE)
    after = jnp.where(swaps, jnp.where(phase == Phase.tip, Phase.tangential, Phase.tip), phase)
    after = jnp.where(target.whiskers & (target.margin == RELEASE), Phase.free, after)
    forwards = dot(tangent, march.tangent, scale) > 0
    arriving = select(forwards, tangent, Point(-tangent.z, -tangent.u))
    arriving = select(jnp.any(touches), march.tangent, arriving)
    node = _node(march, point, arriving)
    node = node._replace(z_before=z_before, phase=after, kind=kinds[target.margin], whiskers=target.whiskers)
    node = node._replace(travel=jnp.where((target.margin == AT_STOP) & (march.goal == 0), 0.0, node.travel))
    arrived = march._replace(
        task=jnp.asarray(int(Task.arrive)),
        phase=after,
        point=point,
        pending=node,
        stance=stance,
        travel=node.travel,
        goal=march.goal + (target.margin == AT_STOP),
        touched=march.touched | jnp.any(touches),
    )
    new = first_case(
        (jnp.any(other), march._replace(target=target._replace(first=first))),
        (~good & (again.step < SHORTEST_STEP), march.stopped(Status.lost)),
        (~good, again),
        otherwise=arrived,
    )
    return new, jnp.asarray(False), node


def _after_arrive(
    problem: SpaceProblem,
    march: March,
    solution: Solution,
    tangent: Point,
    stance: Stance,
    stops: Float[Array, " stops"],
    last: Int[Array, ""],
):
    """Handle the point of an event in its new phase: leave along the path."""
    margin, stop_kind = march.target.margin, march.pending.kind == STOP
    heading = jnp.sign(stops[jnp.minimum(march.goal, last)] - march.point.u)
    turned = stop_kind & (march.goal <= last) & (heading != 0)
    direction = jnp.where(turned, heading, march.direction)
    # The condition makes the force or the slack grow; a tangential contact that becomes a tip contact loses slack.
    back = (margin == PHASE) & jnp.any(march.target.whiskers & (march.phase == Phase.tip))
    by_control = (margin == RELEASE) | (margin == AT_STOP) | (margin == SNAP)
    sign = jnp.where(by_control, jnp.where(tangent.u * direction < 0, -1.0, 1.0), jnp.where(back, -1.0, 1.0))
    tangent = Point(sign * tangent.z, sign * tangent.u)
    z = jnp.where(stance.free[:, None], stance.nearest.contact, solution.point.z)
    node = march.pending._replace(point=Point(z, solution.point.u), leaving=tangent)
    falls, snapped = tangent.u * direction <= 0, margin == SNAP
    onwards = march._replace(
        task=jnp.asarray(int(Task.advance)),
        point=node.point,
        tangent=tangent,
        bend=jax.tree.map(jnp.zeros_like, tangent),
        stance=stance,
        step=jnp.minimum(FIRST_STEP, _clear(stance, tangent)),
        direction=direction,
        size=stance.stiffness,
        unstable_at=jnp.asarray(jnp.inf),
        unstable_size=jnp.asarray(-1.0),
    )
    over = stop_kind & (march.goal > last)
    inside = jnp.any(stance.free & (stance.nearest.distance < -INSIDE))
    new = first_case(
        (~solution.converged | (inside & ~snapped), march.stopped(Status.lost)),
        (inside, march.stopped(Status.unsettled)),
        (over, march.stopped(Status.ok)),
        (snapped & ~stance.stable, march.stopped(Status.unsettled)),
        # A loss at a corner: the path would have to go back.
        (falls | ~stance.stable, _sliding(onwards)),
        otherwise=onwards,
    )
    return new, solution.converged, node


def _sliding(march: March) -> March:
    """The state in which contacts begin to slide."""
    kicked = along(march.point, march.tangent, KICK)
    flow = Flow(jnp.asarray(FIRST_TIME), jnp.asarray(0), march.point.z)
    return march._replace(
        task=jnp.asarray(int(Task.flow)),
        point=Point(kicked.z, march.point.u),
        flow=flow,
        pending=_node(march, march.point, march.tangent),
    )


def _after_flow(march: March, solution: Solution, stance: Stance):
    """Handle a time step in which contacts slide."""
    z, before, time = solution.point.z, march.point.z, march.flow.time
    moved = jnp.max(jnp.abs(z[:, POINT] - before[:, POINT]))
    good = solution.converged & (moved < STRIDE)
    touching = march.phase != Phase.free
    released = touching & (z[:, FORCE] < 0)
    phase = jnp.where(released, int(Phase.free), phase_by_slack(z, march.phase))
    rests = good & (((moved < REST) & (time >= LONGEST_TIME / 4)) | jnp.all(phase == Phase.free))
    longer = jnp.minimum(time * jnp.where(moved < STRIDE / 3, 3.0, 1.0), LONGEST_TIME)
    time = jnp.where(good, longer, time / 4)
    flow = march.flow._replace(time=time, steps=march.flow.steps + 1)
    freed = (phase == Phase.free) & (march.pending.phase_before != Phase.free)
    moved = jnp.max(jnp.abs(z - flow.start)[:, POINT], axis=1) > SLID
    rested = march._replace(
        task=jnp.where(rests, int(Task.arrive), int(Task.flow)),
        phase=phase,
        point=Point(z.at[:, TRACTION].multiply(~rests), march.point.u),
        stance=stance,
        flow=flow,
        pending=march.pending._replace(
            phase=phase,
            kind=jnp.where(jnp.any(freed), EventKind.snap_off, EventKind.snap_through),
            whiskers=freed | (moved & touching),
        ),
        target=march.target._replace(margin=jnp.asarray(SNAP)),
    )
    new = first_case(
        ((flow.steps >= FLOW_STEPS) | (flow.time < SHORTEST_TIME), march.stopped(Status.unsettled)),
        (~good, march._replace(flow=flow)),
        otherwise=rested,
    )
    return new, jnp.asarray(False), march.pending


KICK = 0.02  # along the path, from a fold
FIRST_TIME = 1e-3  # dimensionless: a contact with the stiffness 1 moves by a thousandth of its way
LONGEST_TIME, SHORTEST_TIME = 1e8, 1e-12
STRIDE = 0.08  # lengths that a contact may slide in a step
REST = 1e-9  # lengths that a contact at rest may slide in the longest time
FLOW_STEPS = 400
SLID = 1e-3  # lengths: whiskers whose contacts slide further take part in a snap


def _start(problem: SpaceProblem, start: Scalar, stops: Float[Array, " stops"]) -> March:
    """The state in which the first iteration looks where the free whiskers are."""
    n = problem.length.size
    direction = jnp.where(stops[0] == start, problem.onwards.astype(float), jnp.sign(stops[0] - start))
    z = jnp.zeros((n, UNKNOWNS)).at[:, AHEAD].set(np.array([1.0, 0.0, 0.0]))
    point, still = Point(z, start), Point(jnp.zeros_like(z), direction)
    phase = jnp.full(n, int(Phase.free))
    nobody, zero = jnp.zeros(n, bool), jnp.asarray(0)
    node = Node(point, z, still, still, phase, phase, -jnp.abs(start - stops[0]), jnp.asarray(NO_EVENT), nobody)
    unknown = jnp.zeros(n)
    stance = Stance(
        free=phase == Phase.free,
        nearest=Nearest(unknown, z, phase),
        speed=jnp.asarray(1.0),
        stable=jnp.asarray(True),
        stiffness=jnp.asarray(1.0),
        sound=jnp.asarray(True),
        opens=jnp.asarray(True),
    )
    return March(
        task=jnp.asarray(int(Task.arrive)),
        phase=phase,
        point=point,
        tangent=still,
        bend=jax.tree.map(jnp.zeros_like, still),
        step=jnp.asarray(FIRST_STEP),
        stance=stance,
        size=jnp.asarray(1.0),
        unstable_at=jnp.asarray(jnp.inf),
        unstable_size=jnp.asarray(-1.0),
        target=Target(jnp.asarray(AT_STOP), nobody, jnp.asarray(0.0), stance.nearest),
        pending=node,
        goal=zero,
        direction=direction,
        travel=node.travel,
        touched=jnp.asarray(False),
        flow=Flow(jnp.asarray(FIRST_TIME), zero, z),
        count=zero,
        status=jnp.asarray(int(Status.ok)),
    )


def march(problem: SpaceProblem, start: Scalar, stops: Float[Array, " stops"], last: Int[Array, ""]) -> SpacePath:
    """March from a control at which all whiskers are free to all stops in turn."""
    first = _start(problem, start, stops)
    nodes = jax.tree.map(lambda leaf: jnp.zeros((CAPACITY, *jnp.shape(leaf)), jnp.asarray(leaf).dtype), first.pending)

    def chunk(carry):
        now, nodes, count = carry

        def body(now, _):
            new, index, node = _iterate(problem, stops, last, now)
            return new, (index, node)

        now, (index, written) = jax.lax.scan(body, now, None, length=CHUNK)
        index = jnp.where(index < 0, CAPACITY, index)
        nodes = jax.tree.map(lambda all_, new: all_.at[index].set(new, mode="drop"), nodes, written)
        return now, nodes, count + CHUNK

    def goes_on(carry):
        return (carry[0].task != Task.done) & (carry[2] < ITERATIONS)

    now, nodes, _ = jax.lax.while_loop(goes_on, chunk, (first, nodes, jnp.asarray(0)))
    status = jnp.where(now.task == Task.done, now.status, int(Status.too_long))
    return SpacePath(nodes, now.count, status)
