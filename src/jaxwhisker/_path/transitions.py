"""Decisions of the march: what follows from a solved end of a step, for each task.

Each function returns the new front, whether a node is to be written, and the node.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.newton import Local, PerWhisker, Point, Poses, Solution, dot, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._model.motion import Translation
from jaxwhisker._path import snap_flow
from jaxwhisker._path.march_state import (
    AT_STOP,
    MARGIN_NOISE,
    PHASE,
    RELEASE,
    TOUCH,
    VERTEX,
    Front,
    Lead,
    Target,
    Task,
    Trial,
    dip,
    first_violated,
    stopped,
    turn_of,
)
from jaxwhisker._path.path import NO_EVENT, STOP, EventKind, Node, Status, decided, rates

PREDICTION_ERROR = 2e-3  # aimed at; states between nodes are then interpolated to about 1e-6 before they are solved for
FIRST_STEP = 0.02  # after a corner, in units of length; grows at once where the path is smooth
LONGEST_STEP = 0.25  # of the contacts: a soft spring is stretched over many lengths while they hardly change
GLANCES = 64  # at free whiskers whose drive turns, on its way
SHORTEST_STEP = 1e-10
FOLD_SLOPE = 1e-9  # du per arc length at which a fold counts as found: the state is then exact to it, u to its square
FOLD_BRACKET = 1e-9  # or the step on which stability is lost
NEAR_FOLD = 2e-4  # ... that will do where no shorter step is solved; u is off by less than its square
RESOLVED_STEP = 0.02  # in which du/ds is a parabola ...
PARABOLA_ERROR = 0.25  # ... to a few percent of its change; with a margin
SHORTEST_DIP = 1e-4  # in which du/ds changes by some 1e-6 at most: folds nearer to each other than that are overlooked
ARRIVAL_MISS = 0.1  # a flow ends nearer than this to its equilibrium


def _public_kind(target: Target, phase: Int[Array, " whiskers"]) -> Int[Array, ""]:
    tip = jnp.any(target.whisker & (phase == Phase.tip))
    change = jnp.where(tip, EventKind.tip_to_tangential, EventKind.tangential_to_tip)
    kinds = jnp.array([EventKind.touch, EventKind.release, 0, EventKind.vertex, STOP])
    return jnp.where(target.kind == PHASE, change, kinds[target.kind])


def _next_step(turn: Scalar, unstable_at: Scalar, unstable_turn: Scalar, otherwise: Scalar) -> Scalar:
    # du/ds is nearly linear towards a fold, so its zero is a secant away; a loss without a fold is halved in.
    to_fold = jnp.where(unstable_turn < 0, turn / (turn - unstable_turn), 0.5)
    inside = unstable_at * jnp.clip(to_fold, 1e-3, 0.999)
    return jnp.minimum(otherwise, jnp.where(jnp.isfinite(unstable_at), inside, jnp.inf))


def _node(front: Front, trial: Trial) -> Node:
    # A plain node: the path goes on as it came.
    point = trial.solution.point
    return Node(
        point,
        point.z,
        trial.tangent,
        trial.tangent,
        front.mode.phase,
        front.mode.side,
        front.travel + jnp.abs(point.u - front.point.u),
        jnp.asarray(NO_EVENT),
        jnp.zeros_like(front.mode.phase, bool),
        front.mode.phase,
        front.mode.side,
    )


def _moved(front: Front, trial: Trial, node: Node) -> Front:
    point = trial.solution.point
    return front._replace(
        mode=front.mode._replace(side=trial.side),
        point=point,
        pose=trial.solution.newton.pose,
        tangent=trial.tangent,
        tangent_pose=trial.tangent_pose,
        travel=node.travel,
    )


def _to_snap(front: Front) -> Front:
    return front._replace(
        task=jnp.asarray(int(Task.kick)),
        flow=snap_flow.start(front.mode, front.pose),
        unstable_at=jnp.asarray(jnp.inf),
    )


def _folds_twice(front: Front, trial: Trial, solution: Solution) -> tuple[Bool[Array, ""], Scalar]:
    """Whether u may have turned back and forth within a step whose ends are stable, and at which share of it.

    du/ds between the ends is a parabola with the ends' values and the step's mean. Near a critical stiffness it dips
    towards zero: such a dip is gone through in short steps, and one below zero is a pair of folds.
    """
    start, end = turn_of(front, front.tangent), turn_of(front, trial.tangent)
    mean = front.direction * (solution.point.u - front.point.u) / front.step
    least, highest = jnp.minimum(start, end), jnp.maximum(start, end)
    slope, bend = 6 * mean - 4 * start - 2 * end, 3 * start + 3 * end - 6 * mean
    # The lowest that it may come to, if the slope at either end is wrong by a share of the change.
    wrong = PARABOLA_ERROR * (highest - least)
    bowl = jnp.where(bend > 0, bend, 1.0)
    steeper, flatter = slope - wrong, slope + 2 * bend + wrong
    at = -steeper / (2 * bowl)
    lowest = start + at * (steeper + at * bend)
    inside = (at > 0) & (at < 1) & ((lowest < 0) | ((front.step > RESOLVED_STEP) & (lowest < 0.5 * least)))
    at_end = (slope < 0) & (flatter > 0) & (end < wrong**2 / (4 * bowl))
    possible = trial.stable & (bend > 0) & (least > 0) & (front.step > SHORTEST_DIP)
    return possible & (inside | at_end), jnp.where(inside, jnp.clip(at, 0.2, 0.8), 0.6)


def after_advance(problem: Problem, front: Front, trial: Trial, guess: Point):
    """End of a step along the path: a new node, an event on the way, a loss of stability, or too far."""
    solution = trial.solution
    scale = scale_of(front.point.z)
    miss = Point(solution.point.z - guess.z, solution.point.u - guess.u)
    error = jnp.sqrt(dot(miss, miss, scale))
    straight = dot(front.tangent, trial.tangent, scale) / jnp.sqrt(dot(trial.tangent, trial.tangent, scale))
    good = solution.converged & (error < 10 * PREDICTION_ERROR) & (straight > 0.5)
    violated, target = first_violated(front, trial, front.step)
    dips, share = dip(front, trial, front.step)
    dips &= ~violated
    twice, turn_share = _folds_twice(front, trial, solution)
    share = jnp.where(twice, turn_share, share)
    dips = good & (dips | twice)
    good &= ~dips
    short = front._replace(step=jnp.where(dips, share, 0.4) * front.step)
    too_short = ~good & (short.step < SHORTEST_STEP)

    to_event = front._replace(task=jnp.asarray(int(Task.event)), target=target)

    turn = turn_of(front, trial.tangent)
    found = (jnp.abs(turn) < FOLD_SLOPE) | (front.step < FOLD_BRACKET)
    node = _node(front, trial)
    moved = _moved(front, trial, node)
    fold = _to_snap(moved)
    closer = front._replace(
        unstable_at=front.step,
        unstable_turn=turn,
        step=_next_step(turn_of(front, front.tangent), front.step, turn, jnp.inf),
    )

    factor = jnp.clip((PREDICTION_ERROR / jnp.maximum(error, 1e-14)) ** (1 / 3), 0.3, 2.5)
    all_free = jnp.all(front.mode.phase == Phase.free)
    contacts = trial.tangent._replace(u=jnp.asarray(0.0))
    bending = jnp.sqrt(dot(contacts, contacts, scale))
    longest = jnp.where(all_free, _longest_free(problem), LONGEST_STEP / bending)
    left = front.unstable_at - front.step
    # Stable all the same: lengths along a curve do not quite add up, and the loss lies further on.
    left = jnp.where(left < FOLD_BRACKET, jnp.inf, left)
    bend = Point((trial.tangent.z - front.tangent.z) / front.step, (trial.tangent.u - front.tangent.u) / front.step)
    onwards = moved._replace(
        bend=bend,
        unstable_at=left,
        step=_next_step(turn, left, front.unstable_turn, jnp.minimum(factor * front.step, longest)),
    )
    at_fold = jnp.isfinite(front.unstable_at) & (turn < FOLD_SLOPE)
    new = decided(
        # Where several whiskers lose their hold at once Newton's method fails beside the fold: then it is near enough.
        (too_short & (front.unstable_at < NEAR_FOLD), _to_snap(front)),
        (too_short, stopped(front, Status.lost)),
        (~good, short),
        (violated, to_event),
        (~trial.stable & ~found, closer),
        (~trial.stable, fold),
        (~trial.convex, stopped(front, Status.not_convex)),
        (at_fold, fold),
        otherwise=onwards,
    )
    return new, good & ~violated & (trial.stable | found) & trial.convex, node


def _longest_free(problem: Problem) -> Scalar:
    # A drive that goes straight on meets the object at the end of the step, too; another one may have passed it.
    if problem.motion.ends is None:
        return jnp.inf
    start, stop = problem.motion.ends
    return jnp.abs(stop - start) / problem.unit.control / GLANCES


def after_event(problem: Problem, front: Front, trial: Trial):
    """The point where a margin vanishes: into the mode that holds from here on."""
    solution = trial.solution
    scale = scale_of(front.point.z)
    one, kind = front.target.whisker, front.target.kind
    touches, released, changes = one & (kind == TOUCH), one & (kind == RELEASE), one & (kind == PHASE)
    z_before = jnp.where(touches[:, None], front.point.z, solution.point.z)
    chord = Point(z_before - front.point.z, solution.point.u - front.point.u)
    distance = dot(front.tangent, chord, scale)
    reach = jnp.sqrt(dot(chord, chord, scale))
    good = solution.converged & (distance > -1e-9) & (reach <= 1.5 * front.step + 1e-9)
    # Where the margin grows again the path has been beyond the event: its beginning lies before.
    n = front.mode.phase.shape[0]
    rate = jnp.concatenate(rates(front.mode, trial.tangent, trial.tangent_pose))[: 4 * n].reshape(4, n)
    growing = jnp.where(front.target.kind < AT_STOP, rate[jnp.minimum(front.target.kind, VERTEX)], 0.0)
    good &= jnp.sum(front.target.whisker * growing) < MARGIN_NOISE
    again = front._replace(task=jnp.asarray(int(Task.advance)), step=0.4 * front.step)

    violated, earlier = first_violated(front, trial, distance)
    to_earlier = front._replace(target=earlier)
    dips, share = dip(front, trial, distance)
    dips &= good & ~violated
    good &= ~dips
    again = again._replace(step=jnp.where(dips, share * distance, again.step))

    turn = turn_of(front, trial.tangent)
    unstable = front._replace(
        task=jnp.asarray(int(Task.advance)),
        unstable_at=distance,
        unstable_turn=turn,
        step=_next_step(turn_of(front, front.tangent), distance, turn, jnp.inf),
    )

    tip = front.mode.phase == Phase.tip
    phase = jnp.where(touches, front.target.phase, front.mode.phase)
    side = jnp.where(touches, front.target.side, jnp.where(released, snap_flow.side_of(trial.stance), front.mode.side))
    z, phase = jnp.where(released[:, None], 0.0, solution.point.z), jnp.where(released, Phase.free, phase)
    phase = jnp.where(changes, jnp.where(tip, Phase.tangential, Phase.tip), phase)
    z = z.at[:, 2].set(jnp.where(changes, 0.0, z[:, 2]))
    stops = kind == AT_STOP
    lead_z = jnp.zeros_like(z).at[:, 0].set(touches).at[:, 2].set(changes * jnp.where(tip, 1.0, -1.0))
    # Where nothing of the mode changes the path goes on as it came.
    smooth = stops | (kind == VERTEX)
    lead_z += jnp.where(smooth, front.tangent.z / scale**2, 0.0)
    lead_u = jnp.where(smooth, front.tangent.u, 0.0)
    # A whisker is released to where its contact would have to pull.
    pose_lead, u_lead = _pulling(solution.newton.local)
    lead_pose = jnp.where(released[:, None], pose_lead, 0.0)
    lead_u += jnp.sum(jnp.where(released, u_lead, 0.0))
    node = _node(front, trial)
    at_first = stops & (front.goal == 0)
    node = node._replace(
        point=Point(z, solution.point.u),
        z_before=z_before,
        phase=phase,
        side=side,
        travel=jnp.where(at_first, 0.0, node.travel),
        kind=_public_kind(front.target, front.mode.phase),
        whiskers=one,
    )
    slope_sin = jax.vmap(lambda p: problem.profile.point(p).sin)(z[:, 1])
    passed = one & (kind == VERTEX)
    sign = jnp.where(touches, jnp.where(slope_sin < 0, -1.0, 1.0), front.before_vertex)
    arrived = _moved(front, trial, node)._replace(
        task=jnp.asarray(int(Task.arrive)),
        mode=front.mode._replace(phase=phase, side=side),
        point=node.point,
        lead=Lead(lead_z, lead_pose, lead_u),
        before_vertex=jnp.where(passed, -sign, sign),
        pending=node,
        goal=front.goal + stops,
    )
    new = decided(
        (~good & (again.step < SHORTEST_STEP), stopped(front, Status.lost)),
        (~good, again),
        (violated, to_earlier),
        (~trial.stable, unstable),
        otherwise=arrived,
    )
    return new, jnp.asarray(False), node


def _pulling(at: Local) -> tuple[Poses, PerWhisker]:
    """By which motion of a whisker's base, and by which of the control, the force of its contact falls: weights."""
    by_x = jnp.where(at.by_x == 0, 1.0, at.by_x)[:, None]
    force = at.basis[:, 0, :]
    along = force[:, :1] / by_x
    weight = -jnp.concatenate([along, force[:, 1:] - along * at.pose_by[:, 0, 1:]], axis=1)
    return weight, jnp.zeros_like(by_x[:, 0]) if at.pose_by_u is None else -jnp.sum(weight * at.pose_by_u, axis=1)


def after_arrive(problem: Problem, front: Front, trial: Trial, stops: Float[Array, " stops"], last: Int[Array, ""]):
    """An event's point in its new mode: leave along the path, or fall off it."""
    stop_kind = front.pending.kind == STOP
    heading = jnp.sign(stops[jnp.minimum(front.goal, last)] - front.point.u)
    turned = stop_kind & (front.goal <= last) & (heading != 0)
    direction = jnp.where(turned, heading, front.direction)
    reversed_ = direction != front.direction
    lead = front.lead
    grows = jnp.sum(lead.z * trial.tangent.z) + jnp.sum(lead.pose * trial.tangent_pose) + lead.u * trial.tangent.u
    sign = jnp.where(grows < 0, -1.0, 1.0) * jnp.where(reversed_, -1.0, 1.0)
    tangent = Point(sign * trial.tangent.z, sign * trial.tangent.u)
    node = front.pending._replace(point=trial.solution.point, leaving=tangent)
    slope_sin = jax.vmap(lambda p: problem.profile.point(p).sin)(trial.solution.point.z[:, 1])
    # On the way back the vertex is ahead again if it was behind, but where the path turned on it.
    front = front._replace(direction=direction)
    settled = (front.pending.kind == EventKind.snap_off) | (front.pending.kind == EventKind.snap_through)
    behind = jnp.where(slope_sin < 0, -1.0, 1.0)
    onwards = front._replace(
        task=jnp.asarray(int(Task.advance)),
        point=trial.solution.point,
        pose=trial.solution.newton.pose,
        tangent=tangent,
        tangent_pose=sign * trial.tangent_pose,
        bend=jax.tree.map(jnp.zeros_like, tangent),
        step=jnp.asarray(FIRST_STEP),
        unstable_at=jnp.asarray(jnp.inf),
        before_vertex=jnp.where(settled, behind, front.before_vertex),
    )
    falls = (turn_of(front, tangent) <= 0) | ~trial.stable
    over = (stop_kind & (front.goal > last)) | _passed(problem, front, trial, last)
    z = trial.solution.point.z
    moved = Point(z - front.point.z, trial.solution.point.u - front.point.u)
    near = trial.solution.converged & (dot(moved, moved, scale_of(front.point.z)) < ARRIVAL_MISS**2)
    # Newton's method may have left the flow's mode, or found what the flow would not come to: then that goes on.
    found = trial.there
    wrong = jnp.any(jnp.stack([found.touch, found.release, found.phase]) < -MARGIN_NOISE)
    early = settled & (wrong | falls | ~near)
    flowing = front._replace(
        task=jnp.asarray(int(Task.flow)),
        flow=front.flow._replace(near=front.flow.near / 4),
    )
    new = decided(
        (early, flowing),
        (~near, stopped(front, Status.lost)),
        (over, stopped(front, Status.ok)),
        (falls, _to_snap(onwards)),
        otherwise=onwards,
    )
    return new, near & ~early, node


def _passed(problem: Problem, front: Front, trial: Trial, last: Int[Array, ""]) -> Bool[Array, ""]:
    # On the last way, with every whisker free beyond the object: nothing can happen any more if it goes straight on.
    if not isinstance(problem.motion, Translation):
        return jnp.asarray(False)
    onwards, at = problem.motion.onwards, trial.stance
    gone = jnp.where(onwards < 0, at.x < at.left.x, at.x > at.right.x)
    beyond = (front.mode.phase == Phase.free) & (front.mode.side * onwards > 0) & gone
    return jnp.all(beyond) & (front.goal >= last) & (front.direction * onwards > 0) & (front.goal > 0)


def after_flow(problem: Problem, front: Front, proposed: snap_flow.Flow, solution: Solution):
    """A step of the overdamped bases."""
    flow, mode, z = snap_flow.advance(problem, proposed, front.mode, solution)
    rested = snap_flow.at_rest(problem, flow, mode, solution, front.point.u)
    freed = flow.slipped & (mode.phase == Phase.free)
    kind = jnp.where(jnp.any(freed), EventKind.snap_off, EventKind.snap_through)
    n = mode.phase.shape[0]
    none = jnp.zeros((n, 3))
    pending = front.pending._replace(
        phase=mode.phase,
        side=mode.side,
        travel=front.travel,
        kind=kind,
        whiskers=flow.slipped,
    )
    flowing = front._replace(
        task=jnp.where(rested, Task.arrive, Task.flow),
        mode=mode,
        point=Point(z, front.point.u),
        pose=flow.pose,
        flow=flow,
        pending=pending,
        lead=Lead(none, jnp.zeros_like(flow.pose), front.direction),
    )
    shorter = front._replace(flow=snap_flow.shortened(front.flow))
    followed = solution.converged
    new = decided(
        (jnp.where(followed, flow.exhausted, shorter.flow.exhausted), stopped(front, Status.unsettled)),
        (~followed, shorter),
        otherwise=flowing,
    )
    return new, jnp.asarray(False), front.pending
