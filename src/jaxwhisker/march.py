"""The march: following the path of equilibria through events, folds and snaps.

Pseudo-arclength continuation with one Newton solve an iteration, whatever the iteration is for, because all lanes of a
batch pay for the most expensive branch that any of them takes. An iteration has a task:

    advance   a step along the path; its size follows the prediction error
    event     the point between here and there where a margin vanishes
    arrive    the same point again in the mode that holds from here on: which way does the path leave?
    kick      first step away from an equilibrium that lost its stability
    flow      a step of the overdamped bases at fixed drive, until they come to rest (relax.py)
    done

Stability is judged at every node, never by a failure of the solver. An unstable end of a step means that stability was
lost on the way: steps are shortened until the loss is found, where the path turns back in u (a fold) or, at a corner,
leaves in the wrong direction.
"""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker import relax
from jaxwhisker._types import Scalar
from jaxwhisker.contact import Phase
from jaxwhisker.equilibrium import (
    Contacts,
    Mode,
    PerWhisker,
    Point,
    Row,
    Solution,
    at_control,
    find,
    rest,
    scale_of,
    stable,
)
from jaxwhisker.path import NO_EVENT, STOP, EventKind, Margins, Node, Path, Status, along, dot, margins, rates, unit
from jaxwhisker.scene import Problem

PREDICTION_ERROR = 2e-3  # aimed at; states between nodes are then interpolated to about 1e-6 before they are solved for
FIRST_STEP = 0.02  # after a corner, in units of length; grows at once where the path is smooth
LONGEST_STEP = 0.25
SHORTEST_STEP = 1e-10
FOLD_SLOPE = 2e-6  # du per arc length at which a fold counts as found: u is then exact to about its square
KICK = 0.02  # size of the first step away from an unstable equilibrium
CHUNK = 16  # iterations between two looks at whether all lanes are done


class Task(IntEnum):
    """What an iteration is for."""

    advance = 0
    event = 1
    arrive = 2
    kick = 3
    flow = 4
    done = 5


class Target(NamedTuple):
    """An event being approached: which margin of which whisker (one-hot), and where it is expected."""

    kind: Int[Array, ""]  # index into Margins
    whisker: Bool[Array, " whiskers"]
    distance: Scalar


class Lead(NamedTuple):
    """A weighted sum of the tangent that has to grow on leaving an event: what makes the new mode valid."""

    z: Contacts
    x: PerWhisker
    u: Scalar


class Front(NamedTuple):
    """Where the march has got to."""

    task: Int[Array, ""]
    mode: Mode
    point: Point
    base_x: PerWhisker
    tangent: Point
    tangent_x: PerWhisker
    bend: Point  # change of the tangent per arc length
    step: Scalar
    unstable_at: Scalar  # distance at which instability is known, or infinity; and how u turns there
    unstable_turn: Scalar
    target: Target
    lead: Lead
    before_vertex: PerWhisker  # sign of sin(alpha) until the whisker passes the vertex
    goal: Int[Array, ""]  # index of the stop that the drive heads for
    direction: Scalar
    travel: Scalar
    pending: Node  # node to be written on arrival
    flow: relax.Flow
    count: Int[Array, ""]
    status: Int[Array, ""]


def _select(condition, yes, no):
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def _arclength_row(point: Point, tangent: Point, distance: Scalar) -> Row:
    scale = scale_of(point.z)
    ahead = along(point, tangent, distance)
    none = jnp.zeros_like(point.z[:, 0])
    return Row(tangent.z / scale**2, ahead.z, tangent.u, ahead.u, none, none, none)


_TOUCH, _RELEASE, _PHASE, _VERTEX, _STOP = range(len(Margins._fields))


def _event_row(problem: Problem, front: Front, stop_u: Scalar) -> Row:
    kind, whisker = front.target.kind, front.target.whisker
    none = jnp.zeros_like(front.point.z)
    one = whisker.astype(float)
    weight = none.at[:, 0].set(one * (kind == _RELEASE)).at[:, 2].set(one * (kind == _PHASE))
    first = jnp.where(front.mode.side > 0, problem.touch_right.x, problem.touch_left.x)
    return Row(
        weight,
        none,
        (kind == _STOP).astype(float),
        stop_u,
        vertex=one * (kind == _VERTEX),
        touch=one * (kind == _TOUCH),
        touch_x=jnp.where(jnp.isfinite(first), first, 0.0),
    )


def _margins(problem: Problem, front: Front, point: Point, base_x: PerWhisker, stop_u: Scalar) -> Margins:
    slope_sin = jax.vmap(lambda p: problem.profile.point(p).sin)(point.z[:, 1])
    way = front.direction * (stop_u - point.u)
    return margins(problem, front.mode, point, base_x, front.before_vertex * slope_sin, way)


MARGIN_NOISE = 1e-12  # margins are exact to this: two events at once are not each other's violation


def _first_violated(front: Front, here: Margins, there: Margins, distance: Scalar) -> tuple[Bool[Array, ""], Target]:
    n = here.touch.shape[0]
    now, then = jnp.concatenate(here), jnp.concatenate(there)
    violated = then < -MARGIN_NOISE
    share = jnp.where(violated, jnp.clip(now / (now - then), 0.0, 1.0), jnp.inf)
    first = jnp.argmin(share)
    hit = jnp.arange(4 * n + 1) == first
    target = Target(first // n, jnp.any(hit[: 4 * n].reshape(4, n), axis=0), jnp.min(share) * distance)
    return jnp.any(violated), target


def _dip(front: Front, trial: "_Trial", here: Margins, there: Margins) -> tuple[Bool[Array, ""], Scalar]:
    """Whether a margin is negative on the way though not at its ends, and at which share of the way most."""
    now, then = jnp.concatenate(here), jnp.concatenate(there)
    start = front.step * jnp.concatenate(rates(front.mode, front.tangent, front.tangent_x))
    end = front.step * jnp.concatenate(rates(front.mode, trial.tangent, trial.tangent_x))
    t = jnp.linspace(0.0, 1.0, DIP_POINTS + 2)[1:-1, None]
    within = now + t * (start + t * ((3 * (then - now) - 2 * start - end) + t * (start + end - 2 * (then - now))))
    # A margin that has just been left is zero at the start; rounding is no dip.
    within = jnp.where((start < 0) & (end > 0) & jnp.isfinite(within), within, 0.0)
    return jnp.any(within < -MARGIN_NOISE), t[jnp.argmin(jnp.min(within, axis=1)), 0]


DIP_POINTS = 7


def _public_kind(target: Target, phase: Int[Array, " whiskers"]) -> Int[Array, ""]:
    tip = jnp.any(target.whisker & (phase == Phase.tip))
    change = jnp.where(tip, EventKind.tip_to_tangential, EventKind.tangential_to_tip)
    kinds = jnp.array([EventKind.touch, EventKind.release, 0, EventKind.vertex, STOP])
    return jnp.where(target.kind == _PHASE, change, kinds[target.kind])


def _turn(front: Front, tangent: Point) -> Scalar:
    return front.direction * tangent.u


def _next_step(turn: Scalar, unstable_at: Scalar, unstable_turn: Scalar, otherwise: Scalar) -> Scalar:
    # du/ds is nearly linear towards a fold, so its zero is a secant away; a loss without a fold is halved in.
    to_fold = jnp.where(unstable_turn < 0, turn / (turn - unstable_turn), 0.5)
    inside = unstable_at * jnp.clip(to_fold, 1e-3, 0.999)
    return jnp.minimum(otherwise, jnp.where(jnp.isfinite(unstable_at), inside, jnp.inf))


class _Trial(NamedTuple):
    """A solved end of a step, judged."""

    solution: Solution
    tangent: Point
    tangent_x: PerWhisker
    stable: Bool[Array, ""]
    convex: Bool[Array, ""]


def _judge(problem: Problem, front: Front, solution: Solution) -> _Trial:
    newton = solution.newton
    tangent, length = unit(newton.tangent, solution.point.z)
    ahead = jnp.where(dot(front.tangent, tangent, scale_of(front.point.z)) < 0, -1.0, 1.0)
    tangent = Point(ahead * tangent.z, ahead * tangent.u)
    touching = front.mode.phase != Phase.free
    convex = jax.vmap(problem.profile.convex)(solution.point.z[:, 1])
    return _Trial(
        solution,
        tangent,
        ahead * newton.base_x_tangent / length,
        stable(problem, front.mode, newton.local),
        jnp.all(convex | ~touching),
    )


def _stopped(front: Front, status: Status) -> Front:
    return front._replace(task=jnp.asarray(int(Task.done)), status=jnp.asarray(int(status)))


def _node(front: Front, trial: _Trial) -> Node:
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


def _moved(front: Front, trial: _Trial, node: Node) -> Front:
    point = trial.solution.point
    return front._replace(
        point=point,
        base_x=trial.solution.newton.base_x,
        tangent=trial.tangent,
        tangent_x=trial.tangent_x,
        travel=node.travel,
    )


def _to_snap(front: Front) -> Front:
    return front._replace(
        task=jnp.asarray(int(Task.kick)),
        flow=relax.start(front.mode, front.base_x),
        unstable_at=jnp.asarray(jnp.inf),
    )


def _after_advance(problem: Problem, front: Front, trial: _Trial, guess: Point, stop_u: Scalar):
    """End of a step along the path: a new node, an event on the way, a loss of stability, or too far."""
    solution = trial.solution
    scale = scale_of(front.point.z)
    miss = Point(solution.point.z - guess.z, solution.point.u - guess.u)
    error = jnp.sqrt(dot(miss, miss, scale))
    straight = dot(front.tangent, trial.tangent, scale) / jnp.sqrt(dot(trial.tangent, trial.tangent, scale))
    good = solution.converged & (error < 10 * PREDICTION_ERROR) & (straight > 0.5)
    here = _margins(problem, front, front.point, front.base_x, stop_u)
    there = _margins(problem, front, solution.point, solution.newton.base_x, stop_u)
    violated, target = _first_violated(front, here, there, front.step)
    dips, share = _dip(front, trial, here, there)
    dips &= good & ~violated
    good &= ~dips
    short = front._replace(step=jnp.where(dips, share, 0.4) * front.step)
    short = _select(short.step < SHORTEST_STEP, _stopped(front, Status.lost), short)

    to_event = front._replace(task=jnp.asarray(int(Task.event)), target=target)

    turn = _turn(front, trial.tangent)
    found = (jnp.abs(turn) < FOLD_SLOPE) | (front.step < SHORTEST_STEP)
    node = _node(front, trial)
    moved = _moved(front, trial, node)
    fold = _to_snap(moved)
    closer = front._replace(
        unstable_at=front.step,
        unstable_turn=turn,
        step=_next_step(_turn(front, front.tangent), front.step, turn, jnp.inf),
    )
    lost = _select(found, fold, closer)

    factor = jnp.clip((PREDICTION_ERROR / jnp.maximum(error, 1e-14)) ** (1 / 3), 0.3, 2.5)
    all_free = jnp.all(front.mode.phase == Phase.free)
    longest = jnp.where(all_free, jnp.inf, LONGEST_STEP)
    left = front.unstable_at - front.step
    bend = Point((trial.tangent.z - front.tangent.z) / front.step, (trial.tangent.u - front.tangent.u) / front.step)
    onwards = moved._replace(
        bend=bend,
        unstable_at=left,
        step=_next_step(turn, left, front.unstable_turn, jnp.minimum(factor * front.step, longest)),
    )
    at_fold = jnp.isfinite(left) & (turn < FOLD_SLOPE)
    onwards = _select(at_fold, fold, onwards)
    onwards = _select(trial.convex, onwards, _stopped(front, Status.not_convex))

    accepted = good & ~violated & (trial.stable | found)
    result = _select(trial.stable, onwards, lost)
    result = _select(violated, to_event, result)
    return _select(good, result, short), accepted & trial.convex, node


def _after_event(problem: Problem, front: Front, trial: _Trial, stop_u: Scalar):
    """The point where a margin vanishes: into the mode that holds from here on."""
    solution = trial.solution
    scale = scale_of(front.point.z)
    chord = Point(solution.point.z - front.point.z, solution.point.u - front.point.u)
    distance = dot(front.tangent, chord, scale)
    reach = jnp.sqrt(dot(chord, chord, scale))
    good = solution.converged & (distance > -1e-9) & (reach <= 1.5 * front.step + 1e-9)
    again = front._replace(task=jnp.asarray(int(Task.advance)), step=0.4 * front.step)
    again = _select(again.step < SHORTEST_STEP, _stopped(front, Status.lost), again)

    here = _margins(problem, front, front.point, front.base_x, stop_u)
    there = _margins(problem, front, solution.point, solution.newton.base_x, stop_u)
    violated, earlier = _first_violated(front, here, there, distance)
    to_earlier = front._replace(target=earlier)

    turn = _turn(front, trial.tangent)
    unstable = front._replace(
        task=jnp.asarray(int(Task.advance)),
        unstable_at=distance,
        unstable_turn=turn,
        step=_next_step(_turn(front, front.tangent), distance, turn, jnp.inf),
    )

    one, kind = front.target.whisker, front.target.kind
    touches, released, changes = one & (kind == _TOUCH), one & (kind == _RELEASE), one & (kind == _PHASE)
    tip = front.mode.phase == Phase.tip
    z, phase = relax.enter_contact(problem, front.mode.side, touches, solution.point.z, front.mode.phase)
    z, phase = jnp.where(released[:, None], 0.0, z), jnp.where(released, Phase.free, phase)
    phase = jnp.where(changes, jnp.where(tip, Phase.tangential, Phase.tip), phase)
    z = z.at[:, 2].set(jnp.where(changes, 0.0, z[:, 2]))
    stops = kind == _STOP
    lead_z = jnp.zeros_like(z).at[:, 0].set(touches).at[:, 2].set(changes * jnp.where(tip, 1.0, -1.0))
    # Where nothing of the mode changes the path goes on as it came.
    smooth = stops | (kind == _VERTEX)
    lead_z += jnp.where(smooth, front.tangent.z / scale**2, 0.0)
    lead_u = jnp.where(smooth, front.tangent.u, 0.0)
    node = _node(front, trial)
    at_first = stops & (front.goal == 0)
    node = node._replace(
        point=Point(z, solution.point.u),
        phase=phase,
        travel=jnp.where(at_first, 0.0, node.travel),
        kind=_public_kind(front.target, front.mode.phase),
        whiskers=one,
    )
    slope_sin = jax.vmap(lambda p: problem.profile.point(p).sin)(z[:, 1])
    passed = one & (kind == _VERTEX)
    sign = jnp.where(touches, jnp.where(slope_sin < 0, -1.0, 1.0), front.before_vertex)
    arrived = _moved(front, trial, node)._replace(
        task=jnp.asarray(int(Task.arrive)),
        mode=front.mode._replace(phase=phase),
        point=node.point,
        lead=Lead(lead_z, jnp.where(released, front.mode.side, 0.0), lead_u),
        before_vertex=jnp.where(passed, -sign, sign),
        pending=node,
        goal=front.goal + stops,
    )
    result = _select(trial.stable, arrived, unstable)
    result = _select(violated, to_earlier, result)
    return _select(good, result, again), jnp.asarray(False), node


def _after_arrive(problem: Problem, front: Front, trial: _Trial, stops: Float[Array, " stops"], last: Int[Array, ""]):
    """An event's point in its new mode: leave along the path, or fall off it."""
    stop_kind = front.pending.kind == STOP
    heading = jnp.sign(stops[jnp.minimum(front.goal, last)] - front.point.u)
    turned = stop_kind & (front.goal <= last) & (heading != 0)
    direction = jnp.where(turned, heading, front.direction)
    reversed_ = direction != front.direction
    lead = front.lead
    grows = jnp.sum(lead.z * trial.tangent.z) + jnp.sum(lead.x * trial.tangent_x) + lead.u * trial.tangent.u
    sign = jnp.where(grows < 0, -1.0, 1.0) * jnp.where(reversed_, -1.0, 1.0)
    tangent = Point(sign * trial.tangent.z, sign * trial.tangent.u)
    node = front.pending._replace(point=trial.solution.point, leaving=tangent)
    slope_sin = jax.vmap(lambda p: problem.profile.point(p).sin)(front.point.z[:, 1])
    # On the way back the vertex is ahead again if it was behind, but where the path turned on it.
    front = front._replace(direction=direction)
    settled = (front.pending.kind == EventKind.snap_off) | (front.pending.kind == EventKind.snap_through)
    behind = jnp.where(slope_sin < 0, -1.0, 1.0)
    onwards = front._replace(
        task=jnp.asarray(int(Task.advance)),
        point=trial.solution.point,
        base_x=trial.solution.newton.base_x,
        tangent=tangent,
        tangent_x=sign * trial.tangent_x,
        bend=jax.tree.map(jnp.zeros_like, tangent),
        step=jnp.asarray(FIRST_STEP),
        unstable_at=jnp.asarray(jnp.inf),
        before_vertex=jnp.where(settled, behind, front.before_vertex),
    )
    falls = (_turn(front, tangent) <= 0) | ~trial.stable
    result = _select(falls, _to_snap(onwards), onwards)
    result = _select(settled & falls, _stopped(front, Status.unsettled), result)
    over = (stop_kind & (front.goal > last)) | _passed(problem, front, last)
    result = _select(over, _stopped(front, Status.ok), result)
    # The flow hands over near its end, perhaps on the wrong side of a corner: then the other mode is tried.
    z = trial.solution.point.z
    found = _margins(problem, front, trial.solution.point, trial.solution.newton.base_x, front.point.u)
    begins, ends, changes = (settled & (m < -MARGIN_NOISE) for m in (found.touch, found.release, found.phase))
    tip = front.mode.phase == Phase.tip
    phase = jnp.where(changes, jnp.where(tip, Phase.tangential, Phase.tip), front.mode.phase)
    phase = jnp.where(ends, Phase.free, phase)
    near, phase = relax.enter_contact(problem, front.mode.side, begins, jnp.where(ends[:, None], 0.0, z), phase)
    wrong = begins | ends | changes
    other = front._replace(
        mode=front.mode._replace(phase=phase),
        point=Point(near, front.point.u),
        pending=front.pending._replace(phase=phase),
    )
    result = _select(jnp.any(wrong), other, result)
    moved = Point(z - front.point.z, trial.solution.point.u - front.point.u)
    good = trial.solution.converged & (dot(moved, moved, scale_of(front.point.z)) < ARRIVAL_MISS**2)
    return _select(good, result, _stopped(front, Status.lost)), good & ~jnp.any(wrong), node


ARRIVAL_MISS = 0.1  # a flow ends nearer than this to its equilibrium


def _passed(problem: Problem, front: Front, last: Int[Array, ""]) -> Bool[Array, ""]:
    # On the last way, leftwards, with every whisker free on the left of the object: nothing can happen any more.
    left = (front.mode.phase == Phase.free) & (front.mode.side < 0) & (front.base_x < problem.touch_left.x)
    return jnp.all(left) & (front.goal >= last) & (front.direction < 0) & (front.goal > 0)


def _after_flow(problem: Problem, front: Front, solution: Solution):
    """A step of the overdamped bases."""
    flow, mode, z = relax.advance(problem, front.flow, front.mode, solution)
    rested = relax.at_rest(problem, flow, mode, solution, front.point.u)
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
        base_x=flow.base_x,
        flow=flow,
        pending=pending,
        lead=Lead(none, none[:, 0], front.direction),
    )
    return _select(flow.exhausted, _stopped(front, Status.unsettled), flowing), jnp.asarray(False), front.pending


def _iterate(problem: Problem, stops: Float[Array, " stops"], last: Int[Array, ""], front: Front):
    """One iteration: predict, solve, decide. Returns the new front and the node to be written, if any."""
    stop_u = stops[jnp.minimum(front.goal, last)]
    distance = jnp.where(front.task == Task.event, front.target.distance, front.step)
    marching = (front.task == Task.advance) | (front.task == Task.event)
    flowing = (front.task == Task.kick) | (front.task == Task.flow)
    ahead = along(front.point, front.tangent, distance, front.bend)
    flow = relax.propose(problem, front.flow, front.mode, front.point)
    kicked = relax.kick(front.flow, front.point, front.tangent, front.tangent_x, KICK)
    flow = _select(front.task == Task.kick, kicked, flow)
    guess = _select(marching, ahead, front.point)
    guess = _select(flowing, Point(flow.guess, front.point.u), guess)
    row = _select(
        front.task == Task.advance,
        _arclength_row(front.point, front.tangent, front.step),
        _select(front.task == Task.event, _event_row(problem, front, stop_u), at_control(front.point.u, guess.z)),
    )
    mode = front.mode._replace(separate=flowing)
    solution = find(problem, mode, row, guess)
    trial = _judge(problem, front, solution)
    front = front._replace(flow=_select(flowing, flow, front.flow))
    new, write, node = jax.lax.switch(
        jnp.minimum(front.task, Task.kick),
        [
            lambda: _after_advance(problem, front, trial, guess, stop_u),
            lambda: _after_event(problem, front, trial, stop_u),
            lambda: _after_arrive(problem, front, trial, stops, last),
            lambda: _after_flow(problem, front, solution),
        ],
    )
    done = front.task == Task.done
    new = _select(done, front, new)
    write &= ~done
    return new._replace(count=new.count + write), (jnp.where(write, front.count, -1), node)


def _start(problem: Problem, stops: Float[Array, " stops"]) -> Front:
    n = problem.length.shape[0]
    first = jnp.max(jnp.where(problem.reaches, problem.touch_right.x - rest(problem, jnp.asarray(0.0)), -jnp.inf))
    u = jnp.where(stops[0] > first, stops[0], first + FIRST_STEP)
    z, none = jnp.zeros((n, 3)), jnp.zeros(n)
    mode = Mode(jnp.zeros(n, int), jnp.ones(n), jnp.asarray(False))
    point = Point(z, u)
    still = Point(z, jnp.asarray(-1.0))
    base_x = rest(problem, u)
    pending = Node(
        point, z, still, still, mode.phase, mode.side, -jnp.abs(u - stops[0]), jnp.asarray(NO_EVENT),
        jnp.zeros(n, bool), mode.phase, mode.side,
    )  # fmt: skip
    zero = jnp.asarray(0.0)
    return Front(
        task=jnp.asarray(int(Task.arrive)),
        mode=mode,
        point=point,
        base_x=base_x,
        tangent=still,
        tangent_x=none - 1.0,
        bend=jax.tree.map(jnp.zeros_like, still),
        step=jnp.asarray(FIRST_STEP),
        unstable_at=jnp.asarray(jnp.inf),
        unstable_turn=zero,
        target=Target(jnp.asarray(0), jnp.zeros(n, bool), zero),
        lead=Lead(z, none, jnp.asarray(-1.0)),
        before_vertex=none + 1.0,
        goal=jnp.asarray(0),
        direction=jnp.asarray(-1.0),
        travel=pending.travel,
        pending=pending,
        flow=relax.start(mode, base_x),
        count=jnp.asarray(0),
        status=jnp.asarray(int(Status.ok)),
    )


def march(problem: Problem, stops: Float[Array, " stops"], last: Int[Array, ""], *, capacity: int) -> Path:
    """Follow the path from beyond the first touch to stops[0], stops[1], ..., stops[last].

    The drive comes from the right, all whiskers free. The march ends at the last stop, when all whiskers have passed
    the object for good, or where the path is lost; the status then tells why.
    """
    front = _start(problem, stops)
    front = _select(problem.valid, front, _stopped(front, Status.invalid))
    nodes = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), front.pending)

    def running(carry):
        return carry[0].task != Task.done

    def chunk(carry):
        front, nodes, used = carry
        front, (index, written) = jax.lax.scan(
            lambda front, _: _iterate(problem, stops, last, front), front, None, length=CHUNK
        )
        where = jnp.where(index < 0, capacity, index)
        nodes = jax.tree.map(lambda all_, new: all_.at[where].set(new, mode="drop"), nodes, written)
        full = (front.count >= capacity) | (used >= 8 * capacity // CHUNK)
        return _select(full, _stopped(front, Status.too_long), front), nodes, used + 1

    front, nodes, _ = jax.lax.while_loop(running, chunk, (front, nodes, jnp.asarray(0)))
    return Path(nodes, jnp.minimum(front.count, capacity), front.status)
