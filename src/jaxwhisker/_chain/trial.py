"""The solved end of a step, and what it is like there."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import slack_of
from jaxwhisker._chain.friction import by_friction, is_light, slip_rates
from jaxwhisker._chain.march_state import HIGH, LEAN, LOW, PHASE, RELEASE, TOUCH, MarchOfChain, TrialOfChain, inserted
from jaxwhisker._chain.newton import ChainSolution, of_whiskers, solve_points
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.shaft import BaseAt, point_at
from jaxwhisker._chain.stance import bases_of, stance_of
from jaxwhisker._equilibrium.contact import FORCE, PARAMETER, SLACK, Phase, of_each
from jaxwhisker._equilibrium.point import PathCondition, along, at_arc_length, at_force, dot, scale_of, unit
from jaxwhisker._path.march import any_lane
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.path import select
from jaxwhisker._path.slips import RATE_NOISE


def solved_trial(
    problem: ChainProblem, march: MarchOfChain, stops: Float[Array, " stops"], last: Int[Array, ""]
) -> TrialOfChain:
    """Predict and solve for the end of a step."""
    stop, target = stops[jnp.minimum(march.goal, last)], march.target
    locating = march.task == Task.event
    begins = locating & (target.number == TOUCH)
    distance = jnp.where(locating, target.distance, march.step)
    moves = (march.task == Task.advance) | locating
    guess = select(moves, along(march.point, march.tangent, distance, march.bend), march.point)
    more = inserted(guess.z, march.state, target.first, problem.contacts)
    z, state = select(begins, more, (guess.z, march.state))
    guess = guess._replace(z=z)
    solution = solve_points(problem, state, condition_of(problem, march, stop), guess)
    point, newton = solution.point, solution.newton
    tangent, length = unit(newton.tangent, point.z)
    stance, candidates = stance_of(problem, point.u, newton.pose, point.z, state)
    ahead = dot(tangent, march.tangent, scale_of(march.point.z))
    forwards = jnp.where(locating & (ahead < 0), -1.0, 1.0)
    stable = begins | (march.direction * forwards * tangent.u > 0)
    arriving = march.task == Task.arrive
    sign = jnp.sign(tangent.u) * march.direction / length
    released = any_lane(arriving & (target.number == RELEASE))
    onwards = jax.lax.cond(released, lambda: gap_grows(problem, march, solution, sign), lambda: jnp.asarray(True))
    arrives = (onwards | (target.number != RELEASE)) & ~march.slips
    slipping = slip_rates(problem, state, point.z, forwards * tangent.z)
    turns = jnp.append(march.direction * forwards * tangent.u, slipping)
    stable = jnp.where(arriving, arrives, stable & jnp.all(turns[1:] > -RATE_NOISE))
    return TrialOfChain(solution, tangent, stance, candidates, guess, state, stop, jnp.asarray(last), stable, turns)


def condition_of(problem: ChainProblem, march: MarchOfChain, stop: Scalar) -> PathCondition:
    """The equation of the task."""
    target, none = march.target, jnp.zeros_like(march.point.z)
    locating = march.task == Task.event
    assert target.limit is not None
    touches, ends = target.number == TOUCH, (target.number == LOW) | (target.number == HIGH)
    of_force = touches | ((target.number == RELEASE) & locating)
    of_slack, of_lean = target.number == PHASE, (target.number == LEAN) & locating
    rows = jnp.where(touches, jnp.arange(none.shape[0]) == target.first.row, target.whiskers)
    by_control = ~of_force & ~of_slack & ~ends & ~of_lean
    column = jnp.where(of_force, FORCE, jnp.where(of_slack, SLACK, PARAMETER))
    limit = jnp.where(of_force | (of_slack & ~locating), 0.0, target.limit)
    number, size = jnp.full_like(march.state.piece, column), jnp.ones(none.shape[0])
    if problem.friction_angle is not None:
        at = by_friction(problem, march, of_lean, ends)
        number, size = jnp.where(at.changes, at.column, number), jnp.where(at.changes, at.size, size)
        limit = jnp.where(at.changes, at.limit, limit)
        by_control |= (march.task == Task.arrive) & (march.slips_tried > 0)
    weight = jnp.where((rows & ~by_control)[:, None], size[:, None] * (jnp.arange(3) == number[:, None]), 0.0)
    z0 = jnp.where(weight != 0, limit[:, None], 0.0)
    u = jnp.where(locating, stop, march.point.u)
    at_event = PathCondition(weight, z0, by_control.astype(float), u, none[:, 0])
    if problem.friction_angle is not None:
        # A contact that sticks from its first touch is solved for where its force first has a direction.
        starts = is_light(problem, march.state, march.point.z) & (march.task == Task.arrive)
        at_event = select(jnp.any(starts), at_force(starts, march.point.z), at_event)
    ahead = at_arc_length(march.point, march.tangent, march.step)
    return select(march.task != Task.advance, at_event, ahead)


def gap_grows(problem: ChainProblem, march: MarchOfChain, solution: ChainSolution, sign: Scalar) -> Bool[Array, ""]:
    """Whether the contact that has just been released opens as the drive moves on."""
    node, row = march.pending, jnp.argmax(march.target.whiskers)
    whisker = row // problem.contacts
    profile, before = problem.profile, node.before
    slack = jnp.where(before.phase[row] == Phase.tip, 0.0, slack_of(profile, node.z_before, before)[row])
    # The stance is still that of the event.
    at = profile.point_on(before.piece[row], march.stance.parameter[row])
    newton = solution.newton

    def position(z, u, pose):
        own = of_whiskers(problem, (z, march.state))
        bases = bases_of(problem, u, pose)
        beyond = jnp.full_like(problem.length, slack)
        places = of_each(
            problem.bodies(u),
            lambda body, z, state, x, y, cos, sin, b: point_at(body, z, state, BaseAt(x, y, cos, sin), b),
            *own,
            *bases,
            beyond,
        )
        return places[whisker]

    point, tangent = solution.point, newton.tangent
    rates = sign * tangent.z, sign * jnp.asarray(tangent.u), sign * newton.tangent_pose
    _, moved = jax.jvp(position, (point.z, jnp.asarray(point.u), newton.pose), rates)
    return moved[0] * at.sin - moved[1] * at.cos > -RATE_NOISE
