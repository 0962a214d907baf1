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

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.friction import newly_slipping, slipping_from
from jaxwhisker._equilibrium.newton import is_light
from jaxwhisker._equilibrium.point import Mode, Point, Row, along, at_arc_length, at_control, at_event, at_force
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.solver import solve_point
from jaxwhisker._path import snap_flow
from jaxwhisker._path.approach import FIRST_STEP, approach_of
from jaxwhisker._path.leaving import after_arrive
from jaxwhisker._path.march_state import Lead, MarchState, Target, Task, evaluate_trial
from jaxwhisker._path.path import (
    AT_STOP,
    HIGH,
    LOW,
    NO_EVENT,
    PHASE,
    RELEASE,
    SLIP,
    TOUCH,
    VERTEX,
    Node,
    Path,
    Status,
    select,
)
from jaxwhisker._path.settling import after_flow
from jaxwhisker._path.transitions import after_advance, after_event

STOPS = 8  # stops of a route that turns are padded to a multiple of this
CHUNK = 16  # iterations between two checks of whether the whole batch is done


def _target_row(state: MarchState, stop_u: Scalar, edges: bool) -> Row:
    kind, lean = state.target.kind, None
    if state.target.lean is not None:
        lean = (kind == LOW) | (kind == HIGH) if edges else kind == SLIP
    return at_event(
        state.target.whisker,
        state.point.z,
        unloaded=(kind == RELEASE) | (kind == TOUCH),
        phase=kind == PHASE,
        vertex=kind == VERTEX,
        control=kind == AT_STOP,
        u0=stop_u,
        lean=lean,
        limit=state.target.lean,
    )


def _iterate(problem: Problem, stops: Float[Array, " stops"], last: Int[Array, ""], state: MarchState):
    """Predict, solve, decide. Return the new state, and the index (-1 for none) and value of the node to write."""
    stop_u = stops[jnp.minimum(state.goal, last)]
    at_target = state.task == Task.event
    distance = jnp.where(at_target, state.target.distance, state.step)
    marching = (state.task == Task.advance) | at_target
    flowing = (state.task == Task.kick) | (state.task == Task.flow)
    ahead = along(state.point, state.tangent, distance, state.bend)
    flow = snap_flow.propose(problem, state.flow, state.mode, state.point)
    kicked = snap_flow.kick(state.flow, state.point, state.tangent, state.tangent_pose)
    flow = select(state.task == Task.kick, kicked, flow)
    guess = select(marching, ahead, state.point)
    guess = select(flowing, Point(flow.guess, state.point.u), guess)
    onwards = at_arc_length(state.point, state.tangent, state.step)
    fixed = at_control(state.point.u, guess.z)
    if state.mode.friction is not None:
        # A contact that sticks from its first touch is solved for where its force first has a direction.
        starts = is_light(state.mode, guess.z) & (state.task == Task.arrive)
        fixed = select(jnp.any(starts), at_force(starts, guess.z), fixed)
    to_target = _target_row(state, stop_u, problem.profile.has_edges)
    row = select(state.task == Task.advance, onwards, select(at_target, to_target, fixed))
    # A touch begins a contact and is solved for as a contact.
    target = state.target
    begins = target.whisker & at_target & (target.kind == TOUCH)
    mode = state.mode._replace(
        phase=jnp.where(begins, target.phase, state.mode.phase),
        side=jnp.where(begins, target.side, state.mode.side),
        separate=flowing,
        held=problem.across(flow.pose),
        friction=newly_slipping(state.mode.friction, begins, target.side),
        piece=select(begins, target.piece, state.mode.piece),
    )
    guess = guess._replace(z=jnp.where(begins[:, None], target.contact, guess.z))
    solution = solve_point(problem, mode, row, guess)
    trial = evaluate_trial(problem, state, solution, stop_u, select(flowing, flow.pose, solution.newton.pose))
    new, write, node = jax.lax.switch(
        jnp.minimum(state.task, Task.kick),
        [
            lambda: after_advance(problem, state, trial, guess),
            lambda: after_event(problem, state, trial),
            lambda: after_arrive(problem, state, trial, stops, last),
            lambda: (state, jnp.asarray(False), state.pending),
            lambda: after_flow(problem, state, flow, trial),
        ],
    )
    return new._replace(count=new.count + write), (jnp.where(write, state.count, -1), node)


def _start(problem: Problem, stops: Float[Array, " stops"]) -> MarchState:
    n, onwards = problem.length.shape[0], problem.motion.onwards
    u = approach_of(problem).start(stops[0])
    z, pose = problem.unloaded(u)
    side, none = approach_of(problem).unloaded(u).side, jnp.zeros(n)
    beside = number = None
    if len(problem.profile.objects) > 1:
        beside, side, number = side, side[0], jnp.zeros(n, int)
    edges = problem.profile.has_edges
    friction = None if problem.friction_angle is None else slipping_from(side)
    piece = jnp.zeros(n, int) if problem.profile.has_pieces else None
    mode = Mode(jnp.zeros(n, int), side, jnp.asarray(False), friction=friction, piece=piece, beside=beside)
    point = Point(z, u)
    still = Point(jnp.zeros_like(z), jnp.asarray(float(onwards)))
    pending = Node(
        point, z, still, still, mode.phase, mode.side, -jnp.abs(u - stops[0]), jnp.asarray(NO_EVENT),
        jnp.zeros(n, bool), mode.phase, mode.side, friction, friction,
        *([] if friction is None else [jnp.asarray(0), jnp.asarray(False)]),
        piece=piece, piece_before=piece, beside=beside,
    )  # fmt: skip
    zero = jnp.asarray(0.0)
    return MarchState(
        task=jnp.asarray(int(Task.arrive)),
        mode=mode,
        point=point,
        pose=pose,
        tangent=still,
        tangent_pose=jnp.full_like(pose, problem.rest_rate(float(onwards))),
        bend=jax.tree.map(jnp.zeros_like, still),
        step=jnp.asarray(FIRST_STEP),
        unstable_at=jnp.asarray(jnp.inf),
        unstable_turn=zero if friction is None else jnp.zeros(1 + n),
        target=Target(
            jnp.asarray(0),
            jnp.zeros(n, bool),
            zero,
            z,
            mode.phase,
            mode.side,
            none if edges or friction is not None else None,
            piece,
            number,
        ),
        lead=Lead(still.z, jnp.zeros_like(pose), still.u),
        before_vertex=none + 1.0,
        goal=jnp.asarray(0),
        direction=still.u,
        travel=pending.travel,
        pending=pending,
        flow=snap_flow.start(mode, pose, z, edges),
        count=jnp.asarray(0),
        status=jnp.asarray(int(Status.ok)),
        tries=None if friction is None else jnp.asarray(0),
        rests=None if friction is None else jnp.zeros(n, bool),
    )


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
    state = _start(problem, stops)
    clear = approach_of(problem).starts_clear(state.point.u)
    state = select(clear, state, state.stopped(Status.lost))
    # A node is written as one row of a table: one write per field would be slow to compile.
    blank, unpacked = ravel_pytree(state.pending)
    empty = jnp.zeros((capacity, blank.size)), jnp.asarray(0)
    # In a batch, all values of the loop have lanes from the start: JAX traces the loop again for those that get them.
    start = jax.tree.map(
        lambda valid, invalid: jax.lax.select(problem.valid, valid, invalid),
        (state, *empty),
        (state.stopped(Status.invalid), *empty),
    )
    room = capacity
    if problem.friction_angle is not None:
        # A traced control is padded with more stops than it needs, and has no more room for them.
        used_stops = STOPS * -(-(last + 1) // STOPS)
        room = jnp.minimum(capacity, capacity_of(problem, 2) * jnp.where(last <= 1, 1, used_stops // 2))
    most = 8 * room // CHUNK

    def running(carry):
        # The second condition is never the first to fail. Without it, XLA takes the task for a counter and analyses the
        # body again and again to count the iterations, which makes compilation 40 % longer.
        state, _, used = carry
        return (state.task != Task.done) & (used <= most)

    def chunk(carry):
        state, table, used = carry

        def iteration(state, _):
            state, (index, node) = _iterate(problem, stops, last, state)
            return state, (index, ravel_pytree(node)[0])

        state, (index, rows) = jax.lax.scan(iteration, state, None, length=CHUNK)
        table = table.at[jnp.where(index < 0, capacity, index)].set(rows, mode="drop")
        full = (state.count >= room) | (used >= most)
        return select(full, state.stopped(Status.too_long), state), table, used + 1

    state, table, _ = jax.lax.while_loop(running, chunk, start)
    return Path(jax.vmap(unpacked)(table), jnp.minimum(state.count, capacity).astype(int), state.status.astype(int))


def no_path(problem: Problem, capacity: int) -> Path:
    """A path without nodes, in arrays of the same size as those of a march with this capacity."""
    state = _start(problem, jnp.zeros(1))
    nodes = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), state.pending)
    return Path(nodes, state.count.astype(int), state.status.astype(int))
