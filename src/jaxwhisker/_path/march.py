"""The march: following the path of equilibria through events, folds and snaps.

This is pseudo-arclength continuation. Each iteration makes one Newton solve, whatever its task, because all elements of
a batch pay for the most expensive branch that any of them takes. The tasks are:

    advance   take a step along the path; its length follows the prediction error
    event     solve for the point within the last step where a margin vanishes
    arrive    solve for the same point in the mode that holds from here on, and determine in which direction to leave
    done      do nothing: the march has ended
    kick      take the first step away from an equilibrium that lost its stability
    flow      take a step of the overdamped bases at fixed drive, until they come to rest (snap_flow.py)

Stability is checked at every node; a failure of the solver does not count as a loss of stability. If the end of a step
is unstable, stability was lost within the step, and steps are shortened until the loss is located. There the path turns
back in u (a fold) or, at a corner, leaves in the wrong direction.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import all_free
from jaxwhisker._equilibrium.newton import Apart
from jaxwhisker._equilibrium.point import Point, along, at_arc_length
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.solver import solve_point
from jaxwhisker._equilibrium.stance import Stance
from jaxwhisker._path import snap_flow
from jaxwhisker._path.approach import FIRST_STEP, approach_of
from jaxwhisker._path.events import TOUCH, Lead, condition_of, events_of, facts_of, limit_of
from jaxwhisker._path.law import contact_law
from jaxwhisker._path.march_state import MarchState, Target, Task
from jaxwhisker._path.path import NO_EVENT, Node, Path, Status, select
from jaxwhisker._path.transitions import after_advance, after_arrive, after_event, after_flow
from jaxwhisker._path.trial import evaluate_trial

STOPS = 8  # stops of a route with turns: so many, or twice as many, or four times ... after padding
TRACED_STOPS = 16 * STOPS  # of a traced control: turns are cheap, nodes are not
TRACED_SWEEPS = 2 * STOPS  # so many stops of a traced control have room for the nodes of a sweep past the object
CHUNK = 16  # iterations between two checks of whether the whole batch is done


def _iterate(problem: Problem, stops: Float[Array, " stops"], last: Int[Array, ""], now: MarchState):
    """Predict, solve, decide. Return the new state, and the index (-1 for none) and value of the node to write."""
    stop_u = stops[jnp.minimum(now.goal, last)]
    at_target = now.task == Task.event
    distance = jnp.where(at_target, now.target.distance, now.step)
    marching = (now.task == Task.advance) | at_target
    flowing = (now.task == Task.kick) | (now.task == Task.flow)
    ahead = along(now.point, now.tangent, distance, now.bend)
    flow = snap_flow.propose(problem, now.flow, now.state, now.point)
    kicked = snap_flow.kick(now.flow, now.point, now.tangent, now.tangent_pose)
    flow = select(now.task == Task.kick, kicked, flow)
    guess = select(marching, ahead, now.point)
    guess = select(flowing, Point(flow.guess, now.point.u), guess)
    onwards = at_arc_length(now.point, now.tangent, now.step)
    fixed = contact_law(problem).destination(now, guess)
    target = now.target
    tip = jnp.any(target.whisker & (now.state.phase == Phase.tip))
    facts = facts_of(events_of(problem), target.number, tip)
    to_target = condition_of(facts, target.whisker, guess.z, target.limit, stop_u)
    condition = select(now.task == Task.advance, onwards, select(at_target, to_target, fixed))
    # A touch begins a contact and is solved for as a contact.
    begins = target.whisker & at_target & (target.number == TOUCH)
    state = now.state.begun(begins, target.phase, target.side, target.piece)
    guess = guess._replace(z=jnp.where(begins[:, None], target.contact, guess.z))
    solution = solve_point(problem, state, condition, guess, Apart(flowing, problem.across(flow.pose)))
    trial = evaluate_trial(problem, now, solution, stop_u, select(flowing, flow.pose, solution.newton.pose))
    new, write, node = jax.lax.switch(
        jnp.minimum(now.task, Task.kick),
        [
            lambda: after_advance(problem, now, trial, guess),
            lambda: after_event(problem, now, trial, facts),
            lambda: after_arrive(problem, now, trial, stops, last),
            lambda: (now, jnp.asarray(False), now.pending),
            lambda: after_flow(problem, now, flow, trial),
        ],
    )
    return new._replace(count=new.count + write), (jnp.where(write, now.count, -1), node)


def _start(problem: Problem, stops: Float[Array, " stops"]) -> MarchState:
    n, onwards = problem.length.shape[0], problem.onwards.astype(float)
    u = approach_of(problem).start(stops[0])
    z, pose = problem.unloaded(u)
    state, none = all_free(problem, approach_of(problem).unloaded(u).side), jnp.zeros(n)
    law, events = contact_law(problem), events_of(problem)
    point = Point(z, u)
    still = Point(jnp.zeros_like(z), onwards)
    pending = Node(
        point,
        z,
        still,
        still,
        state,
        state,
        -jnp.abs(u - stops[0]),
        jnp.asarray(NO_EVENT),
        jnp.zeros(n, bool),
        **law.remembered(jnp.asarray(0), corner=False),
    )
    zero = jnp.asarray(0.0)
    return MarchState(
        task=jnp.asarray(int(Task.arrive)),
        state=state,
        point=point,
        pose=pose,
        tangent=still,
        tangent_pose=jnp.full_like(pose, problem.rest_rate(onwards)),
        bend=jax.tree.map(jnp.zeros_like, still),
        step=jnp.asarray(FIRST_STEP),
        unstable_at=jnp.asarray(jnp.inf),
        unstable_turns=jnp.zeros(1 + law.rates(state, z, z).size),
        target=Target(
            jnp.asarray(0),
            jnp.zeros(n, bool),
            zero,
            z,
            state.phase,
            state.side,
            limit_of(events, jnp.asarray(0), problem, z, (none, none)),
            state.piece,
            None if state.sides is None else jnp.zeros(n, int),
        ),
        lead=Lead(still.z, jnp.zeros_like(pose), still.u),
        before_vertex=none + 1.0,
        goal=jnp.asarray(0),
        direction=still.u,
        travel=pending.travel,
        pending=pending,
        flow=snap_flow.start(state, pose, z, problem.profile.has_edges),
        count=jnp.asarray(0),
        status=jnp.asarray(int(Status.ok)),
        # The first task is to arrive, which computes the stance.
        stance=None if problem.stance_is_known else _blank(jax.eval_shape(problem.stance, u, pose, z)),
        **law.memory(),
    )


def _blank(shapes: Stance) -> Stance:
    return jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)


def sweeps_of(last: Any) -> tuple[int, ...]:
    """The number of stops that a path has room for if the drive passes the object before each, if it is not all."""
    return (TRACED_SWEEPS,) if checks.is_traced(last) else ()


def capacity_of(problem: Problem, stops: int) -> int:
    """Largest number of nodes on a path to this many stops."""
    n, objects = problem.length.shape[0], problem.profile.objects
    pieces = sum(1 + one.breaks().size for one in objects)
    return ((256 + 60 * n) * len(objects) + 4 * pieces * n) * max(1, stops // 2)


def march(problem: Problem, stops: Float[Array, " stops"], last: Int[Array, ""], *, capacity: int) -> Path:
    """Follow the path from where all whiskers are free to stops[0], stops[1], ..., stops[last].

    The march ends with status `ok` at the last stop or as soon as all whiskers have passed the object for good. If the
    path cannot be followed any further, the march ends there, and the status of the path says why.
    """
    now = _start(problem, stops)
    clear = approach_of(problem).starts_clear(now.point.u)
    now = select(clear, now, now.stopped(Status.lost))
    # A node is written as one row of a table: one write per field would be slow to compile.
    blank, unpacked = ravel_pytree(now.pending)
    empty = jnp.zeros((capacity, blank.size)), jnp.asarray(0)
    # In a batch, all values of the loop have lanes from the start: JAX traces the loop again for those that get them.
    start = jax.tree.map(
        lambda valid, invalid: jax.lax.select(problem.valid, valid, invalid),
        (now, *empty),
        (now.stopped(Status.invalid), *empty),
    )
    # A traced control is padded with more stops than it needs, and has no more room for them.
    used_stops = STOPS * -(-(last + 1) // STOPS)
    room = jnp.minimum(capacity, capacity_of(problem, 2) * jnp.where(last <= 1, 1, used_stops // 2))
    most = 8 * room // CHUNK

    def running(carry):
        # The second condition is never the first to fail. Without it, XLA takes the task for a counter and analyses the
        # body again and again to count the iterations, which makes compilation 40 % longer.
        now, _, used = carry
        return (now.task != Task.done) & (used <= most)

    def chunk(carry):
        now, table, used = carry

        def iteration(now, _):
            now, (index, node) = _iterate(problem, stops, last, now)
            return now, (index, ravel_pytree(node)[0])

        now, (index, rows) = jax.lax.scan(iteration, now, None, length=CHUNK)
        table = table.at[jnp.where(index < 0, capacity, index)].set(rows, mode="drop")
        full = (now.count >= room) | (used >= most)
        return select(full, now.stopped(Status.too_long), now), table, used + 1

    now, table, _ = jax.lax.while_loop(running, chunk, start)
    return Path(jax.vmap(unpacked)(table), jnp.minimum(now.count, capacity).astype(int), now.status.astype(int))


def no_path(problem: Problem, capacity: int) -> Path:
    """A path without nodes, in arrays of the same size as those of a march with this capacity."""
    now = _start(problem, jnp.zeros(1))
    nodes = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), now.pending)
    return Path(nodes, now.count.astype(int), now.status.astype(int))
