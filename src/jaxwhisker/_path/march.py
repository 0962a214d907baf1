"""The march: following the path of equilibria through events, folds and snaps.

Pseudo-arclength continuation with one Newton solve an iteration, whatever the iteration is for, because all lanes of a
batch pay for the most expensive branch that any of them takes. An iteration has a task:

    advance   a step along the path; its size follows the prediction error
    event     the point between here and there where a margin vanishes
    arrive    the same point again in the mode that holds from here on: which way does the path leave?
    done
    kick      first step away from an equilibrium that lost its stability
    flow      a step of the overdamped bases at fixed drive, until they come to rest (snap_flow.py)

Stability is judged at every node, never by a failure of the solver. An unstable end of a step means that stability was
lost on the way: steps are shortened until the loss is found, where the path turns back in u (a fold) or, at a corner,
leaves in the wrong direction.
"""

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.clearance import stance
from jaxwhisker._equilibrium.newton import Mode, Point, Row, along, at_control, find, rest, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._path import snap_flow
from jaxwhisker._path.march_state import (
    AT_STOP,
    PHASE,
    RELEASE,
    TOUCH,
    VERTEX,
    Front,
    Lead,
    Target,
    Task,
    judge,
    stopped,
)
from jaxwhisker._path.path import NO_EVENT, Node, Path, Status, select
from jaxwhisker._path.transitions import FIRST_STEP, after_advance, after_arrive, after_event, after_flow

CHUNK = 16  # iterations between two looks at whether all lanes are done


def _arclength_row(point: Point, tangent: Point, distance: Scalar) -> Row:
    scale = scale_of(point.z)
    ahead = along(point, tangent, distance)
    return Row(tangent.z / scale**2, ahead.z, tangent.u, ahead.u, jnp.zeros_like(point.z[:, 0]))


def _event_row(front: Front, stop_u: Scalar) -> Row:
    kind, whisker = front.target.kind, front.target.whisker
    none = jnp.zeros_like(front.point.z)
    one = whisker.astype(float)
    # Contacts begin and end without force.
    weight = none.at[:, 0].set(one * ((kind == RELEASE) | (kind == TOUCH))).at[:, 2].set(one * (kind == PHASE))
    return Row(weight, none, (kind == AT_STOP).astype(float), stop_u, vertex=one * (kind == VERTEX))


def _iterate(problem: Problem, stops: Float[Array, " stops"], last: Int[Array, ""], front: Front):
    """One iteration: predict, solve, decide. Returns the new front and the node to be written, if any."""
    stop_u = stops[jnp.minimum(front.goal, last)]
    at_event = front.task == Task.event
    distance = jnp.where(at_event, front.target.distance, front.step)
    marching = (front.task == Task.advance) | at_event
    flowing = (front.task == Task.kick) | (front.task == Task.flow)
    ahead = along(front.point, front.tangent, distance, front.bend)
    flow = snap_flow.propose(problem, front.flow, front.mode, front.point)
    kicked = snap_flow.kick(front.flow, front.point, front.tangent, front.tangent_pose)
    flow = select(front.task == Task.kick, kicked, flow)
    guess = select(marching, ahead, front.point)
    guess = select(flowing, Point(flow.guess, front.point.u), guess)
    onwards = _arclength_row(front.point, front.tangent, front.step)
    elsewhere = at_control(front.point.u, guess.z)
    row = select(front.task == Task.advance, onwards, select(at_event, _event_row(front, stop_u), elsewhere))
    # A touch is the beginning of a contact, and solved for as one.
    target = front.target
    begins = target.whisker & at_event & (target.kind == TOUCH)
    mode = front.mode._replace(
        phase=jnp.where(begins, target.phase, front.mode.phase),
        side=jnp.where(begins, target.side, front.mode.side),
        separate=flowing,
        held=None if problem.axes == 1 else flow.pose[:, 1:],
    )
    guess = guess._replace(z=jnp.where(begins[:, None], target.contact, guess.z))
    solution = find(problem, mode, row, guess)
    trial = judge(problem, front, solution, stop_u)
    new, write, node = jax.lax.switch(
        jnp.minimum(front.task, Task.kick),
        [
            lambda: after_advance(problem, front, trial, guess),
            lambda: after_event(problem, front, trial),
            lambda: after_arrive(problem, front, trial, stops, last),
            lambda: (front, jnp.asarray(False), front.pending),
            lambda: after_flow(problem, front, flow, solution),
        ],
    )
    return new._replace(count=new.count + write), (jnp.where(write, front.count, -1), node)


def first_touch(problem: Problem) -> Scalar:
    """The control at which the first whisker touches, of a drive that comes along x; -+inf if none ever does."""
    onwards = problem.motion.onwards
    at = stance(problem, jnp.asarray(0.0), rest(problem, jnp.asarray(0.0)))
    first = at.right if onwards < 0 else at.left
    ahead = jnp.where(first.reaches, -onwards * (first.x - at.x), -jnp.inf)
    return -onwards * jnp.max(ahead)


def _start(problem: Problem, stops: Float[Array, " stops"]) -> Front:
    n, onwards = problem.length.shape[0], problem.motion.onwards
    if problem.motion.ends is None:
        first = first_touch(problem)
        u = jnp.where(-onwards * (stops[0] - first) > 0, stops[0], first - onwards * FIRST_STEP)
    else:
        u = problem.motion.ends[0] / problem.unit.control
        u = jnp.where(-onwards * (stops[0] - u) > 0, stops[0], u)
    pose = rest(problem, u)
    at = stance(problem, u, pose)
    side = snap_flow.side_of(at)
    z, none = jnp.zeros((n, 3)), jnp.zeros(n)
    mode = Mode(jnp.zeros(n, int), side, jnp.asarray(False))
    point = Point(z, u)
    still = Point(z, jnp.asarray(float(onwards)))
    pending = Node(
        point, z, still, still, mode.phase, mode.side, -jnp.abs(u - stops[0]), jnp.asarray(NO_EVENT),
        jnp.zeros(n, bool), mode.phase, mode.side,
    )  # fmt: skip
    zero = jnp.asarray(0.0)
    return Front(
        task=jnp.asarray(int(Task.arrive)),
        mode=mode,
        point=point,
        pose=pose,
        tangent=still,
        tangent_pose=jnp.full_like(pose, float(onwards) if problem.axes == 1 else 0.0),
        bend=jax.tree.map(jnp.zeros_like, still),
        step=jnp.asarray(FIRST_STEP),
        unstable_at=jnp.asarray(jnp.inf),
        unstable_turn=zero,
        target=Target(jnp.asarray(0), jnp.zeros(n, bool), zero, z, mode.phase, mode.side),
        lead=Lead(z, jnp.zeros_like(pose), still.u),
        before_vertex=none + 1.0,
        goal=jnp.asarray(0),
        direction=still.u,
        travel=pending.travel,
        pending=pending,
        flow=snap_flow.start(mode, pose),
        count=jnp.asarray(0),
        status=jnp.asarray(int(Status.ok)),
    )


def march(problem: Problem, stops: Float[Array, " stops"], last: Int[Array, ""], *, capacity: int) -> Path:
    """Follow the path from beyond the first touch to stops[0], stops[1], ..., stops[last].

    The drive comes from the right, all whiskers free. The march ends at the last stop, when all whiskers have passed
    the object for good, or where the path is lost; the status then tells why.
    """
    front = _start(problem, stops)
    front = select(problem.valid, front, stopped(front, Status.invalid))
    if problem.motion.ends is not None:
        clear = jnp.all(snap_flow.clear(stance(problem, front.point.u, front.pose)))
        front = select(clear | ~problem.valid, front, stopped(front, Status.lost))
    # A node is written as one row of a table: a write for each of its fields would be slow to compile.
    blank, unpacked = ravel_pytree(front.pending)
    table = jnp.zeros((capacity, blank.size))

    def running(carry):
        return carry[0].task != Task.done

    def chunk(carry):
        front, table, used = carry

        def iteration(front, _):
            front, (index, node) = _iterate(problem, stops, last, front)
            return front, (index, ravel_pytree(node)[0])

        front, (index, rows) = jax.lax.scan(iteration, front, None, length=CHUNK)
        table = table.at[jnp.where(index < 0, capacity, index)].set(rows, mode="drop")
        full = (front.count >= capacity) | (used >= 8 * capacity // CHUNK)
        return select(full, stopped(front, Status.too_long), front), table, used + 1

    front, table, _ = jax.lax.while_loop(running, chunk, (front, table, jnp.asarray(0)))
    return Path(jax.vmap(unpacked)(table), jnp.minimum(front.count, capacity).astype(int), front.status.astype(int))


def no_path(problem: Problem, capacity: int) -> Path:
    """A path without nodes, as large as that of a march with the same capacity."""
    front = _start(problem, jnp.zeros(1))
    nodes = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), front.pending)
    return Path(nodes, front.count.astype(int), front.status.astype(int))
