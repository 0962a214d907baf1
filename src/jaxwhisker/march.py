"""The march: following the path of equilibria through events, folds and snaps.

Pseudo-arclength continuation with one Newton solve an iteration, whatever the iteration is for, because all lanes of a
batch pay for the most expensive branch that any of them takes. An iteration has a task:

    advance   a step along the path; its size follows the prediction error
    event     the point between here and there where a margin vanishes
    arrive    the same point again in the mode that holds from here on: which way does the path leave?
    done
    kick      first step away from an equilibrium that lost its stability
    flow      a step of the overdamped bases at fixed drive, until they come to rest (relax.py)

Stability is judged at every node, never by a failure of the solver. An unstable end of a step means that stability was
lost on the way: steps are shortened until the loss is found, where the path turns back in u (a fold) or, at a corner,
leaves in the wrong direction.
"""

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from jaxwhisker import relax
from jaxwhisker._types import Scalar
from jaxwhisker.decide import FIRST_STEP, after_advance, after_arrive, after_event, after_flow
from jaxwhisker.equilibrium import Mode, Point, Row, at_control, find, rest, scale_of
from jaxwhisker.front import (
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
from jaxwhisker.path import NO_EVENT, Node, Path, Status, along, select
from jaxwhisker.scene import Problem

CHUNK = 16  # iterations between two looks at whether all lanes are done


def _arclength_row(point: Point, tangent: Point, distance: Scalar) -> Row:
    scale = scale_of(point.z)
    ahead = along(point, tangent, distance)
    none = jnp.zeros_like(point.z[:, 0])
    return Row(tangent.z / scale**2, ahead.z, tangent.u, ahead.u, none, none, none)


def _event_row(problem: Problem, front: Front, stop_u: Scalar) -> Row:
    kind, whisker = front.target.kind, front.target.whisker
    none = jnp.zeros_like(front.point.z)
    one = whisker.astype(float)
    weight = none.at[:, 0].set(one * (kind == RELEASE)).at[:, 2].set(one * (kind == PHASE))
    first = jnp.where(front.mode.side > 0, problem.touch_right.x, problem.touch_left.x)
    return Row(
        weight,
        none,
        (kind == AT_STOP).astype(float),
        stop_u,
        vertex=one * (kind == VERTEX),
        touch=one * (kind == TOUCH),
        touch_x=jnp.where(jnp.isfinite(first), first, 0.0),
    )


def _iterate(problem: Problem, stops: Float[Array, " stops"], last: Int[Array, ""], front: Front):
    """One iteration: predict, solve, decide. Returns the new front and the node to be written, if any."""
    stop_u = stops[jnp.minimum(front.goal, last)]
    distance = jnp.where(front.task == Task.event, front.target.distance, front.step)
    marching = (front.task == Task.advance) | (front.task == Task.event)
    flowing = (front.task == Task.kick) | (front.task == Task.flow)
    ahead = along(front.point, front.tangent, distance, front.bend)
    flow = relax.propose(problem, front.flow, front.mode, front.point)
    kicked = relax.kick(front.flow, front.point, front.tangent, front.tangent_x)
    flow = select(front.task == Task.kick, kicked, flow)
    guess = select(marching, ahead, front.point)
    guess = select(flowing, Point(flow.guess, front.point.u), guess)
    row = select(
        front.task == Task.advance,
        _arclength_row(front.point, front.tangent, front.step),
        select(front.task == Task.event, _event_row(problem, front, stop_u), at_control(front.point.u, guess.z)),
    )
    mode = front.mode._replace(separate=flowing)
    solution = find(problem, mode, row, guess)
    trial = judge(problem, front, solution, stop_u)
    new, write, node = jax.lax.switch(
        jnp.minimum(front.task, Task.kick),
        [
            lambda: after_advance(front, trial, guess),
            lambda: after_event(problem, front, trial),
            lambda: after_arrive(problem, front, trial, stops, last),
            lambda: (front, jnp.asarray(False), front.pending),
            lambda: after_flow(problem, front, flow, solution),
        ],
    )
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
    front = select(problem.valid, front, stopped(front, Status.invalid))
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


def nowhere(problem: Problem, capacity: int) -> Path:
    """A path without nodes, as large as that of a march with the same capacity."""
    front = _start(problem, jnp.zeros(1))
    nodes = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), front.pending)
    return Path(nodes, front.count.astype(int), front.status.astype(int))
