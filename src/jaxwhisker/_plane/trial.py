"""Trials: how the end of a step is predicted, solved for and evaluated, and which event within the step comes first."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import PARAMETER, SLACK, Phase, beyond
from jaxwhisker._equilibrium.friction import LIGHT
from jaxwhisker._equilibrium.newton import Apart, contact_parameters, slope_sines
from jaxwhisker._equilibrium.pieces import ends_of
from jaxwhisker._equilibrium.point import Contacts, Point, along, at_arc_length, dot, scale_of, unit
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.solver import Solution, solve_point
from jaxwhisker._equilibrium.stability import is_stable
from jaxwhisker._equilibrium.stance import PerWhisker, Poses, Stance
from jaxwhisker._path.march_state import Target, Task
from jaxwhisker._path.margins import FAR, first_crossed, first_dip
from jaxwhisker._path.path import Status, select
from jaxwhisker._plane import snap_flow
from jaxwhisker._plane.events import (
    AT_STOP,
    MARGIN_NOISE,
    RELEASE,
    TOUCH,
    PathDirection,
    Seen,
    condition_of,
    events_of,
    facts_of,
    limit_of,
    margin_rates,
    margins,
)
from jaxwhisker._plane.law import contact_law
from jaxwhisker._plane.march_state import FirstContact, MarchInPlane, Proposed, TrialInPlane

SHORTEST_CHORD = 1e-6  # shortest chord that determines a direction; for a shorter one the path keeps its direction
LEVEL = 1e-10  # slope of a face that is level but for rounding: the contact passes the vertex where it leaves this face


def solved_trial(problem: Problem, march: MarchInPlane, stop_u: Scalar) -> TrialInPlane:
    """Predict and solve for the end of a step on the way to a stop."""
    target, state = march.target, march.state
    at_target = march.task == Task.event
    marching = (march.task == Task.advance) | at_target
    flowing = (march.task == Task.kick) | (march.task == Task.flow)
    distance = jnp.where(at_target, target.distance, march.step)
    ahead = along(march.point, march.tangent, distance, march.bend)
    flow = snap_flow.propose(problem, march.flow, state, march.point)
    kicked = snap_flow.kick(march.flow, march.point, march.tangent, march.tangent_pose)
    flow = select(march.task == Task.kick, kicked, flow)
    guess = select(marching, ahead, march.point)
    guess = select(flowing, Point(flow.guess, march.point.u), guess)
    onwards = at_arc_length(march.point, march.tangent, march.step)
    fixed = contact_law(problem).destination(march, guess)
    tip = jnp.any(target.whiskers & (state.phase == Phase.tip))
    facts = facts_of(events_of(problem), target.number, tip)
    to_target = condition_of(facts, target.whiskers, guess.z, target.limit, stop_u)
    condition = select(march.task == Task.advance, onwards, select(at_target, to_target, fixed))
    # A touch begins a contact and is solved for as a contact.
    begins = target.whiskers & at_target & (target.number == TOUCH)
    state = state.begun(begins, target.first.phase, target.first.side, target.first.piece)
    guess = guess._replace(z=jnp.where(begins[:, None], target.first.contact, guess.z))
    solution = solve_point(problem, state, condition, guess, Apart(flowing, problem.across(flow.pose)))
    free_pose = select(flowing, flow.pose, solution.newton.pose)
    return evaluate_trial(problem, march, Proposed(guess, facts, flow), solution, stop_u, free_pose)


def evaluate_trial(
    problem: Problem, march: MarchInPlane, proposed: Proposed, solution: Solution, stop_u: Scalar, free_pose: Poses
) -> TrialInPlane:
    """Evaluate the solved end of a step: direction of the path, stability, convexity, margins.

    Args:
        problem: the problem.
        march: the state before the step.
        proposed: the step before it was solved for.
        solution: its solved end.
        stop_u: control of the next stop.
        free_pose: coordinates, at the end, of bases that are not solved for.
    """
    newton = solution.newton
    free = march.state.free
    tangent, length = unit(newton.tangent, solution.point.z)
    ahead = jnp.where(dot(march.tangent, tangent, scale_of(march.point.z)) < 0, -1.0, 1.0) / length
    tangent, tangent_pose = Point(ahead * length * tangent.z, ahead * length * tangent.u), ahead * newton.tangent_pose
    # A touch is solved for as a contact, but the path arrives without it.
    touches = (march.task == Task.event) & (march.target.number == TOUCH)
    pose = jnp.where(problem.solved(march.state.phase)[:, None], newton.pose, free_pose)
    before, after = march.point, solution.point
    there = problem.stance(after.u, pose, after.z)
    here = problem.stance(before.u, march.pose, before.z) if march.stance is None else march.stance
    arriving = _direction_of_parabola(march, solution, free, there)
    tangent, tangent_pose = select(touches, arriving, (tangent, tangent_pose))
    convex = jax.vmap(problem.profile.convex_on)(march.state.piece, solution.point.z[:, PARAMETER])
    sound, reason = _soundness(problem, convex | free, solution.point.z, march.state.phase)
    parameters = contact_parameters(problem, after.z, march.state)
    seen_there = seen(problem, march, after, there, stop_u, parameters)
    margins_there = margins(seen_there)
    # The touching whisker satisfies its contact's equations; its margin, interpolated in its outline, is less accurate.
    touching = touched = touches & march.target.whiskers
    if march.target.first.object is not None:
        touched &= jnp.arange(len(problem.profile.objects))[:, None] == march.target.first.object
    margins_there = (jnp.where(touched, FAR, margins_there[TOUCH]), *margins_there[1:])
    return TrialInPlane(
        proposed,
        solution,
        tangent,
        tangent_pose,
        is_stable(problem, march.state, newton.condensed, None if problem.attached is None else touching),
        sound,
        here=margins(seen(problem, march, before, here, stop_u, march.parameters)),
        there=margins_there,
        stance=there,
        standing=problem.updated_side(free, march.state.standing, there),
        turns=contact_law(problem).turns(march, after.z, tangent, LIGHT),
        reason=reason,
        ends=seen_there.ends,
        parameters=None if march.stuck_at is None else parameters,
    )


def _soundness(
    problem: Problem, convex: Bool[Array, " whiskers"], z: Contacts, phase: Int[Array, " whiskers"]
) -> tuple[Bool[Array, ""], Status | Int[Array, ""]]:
    """Whether contacts lie on a convex part of the profile and above all springs, and the status if they do not."""
    if problem.attached is None:
        return jnp.all(convex), Status.not_convex
    arcs = problem.length - beyond(z[:, SLACK], phase)
    above = jnp.all((phase == Phase.free) | (arcs >= problem.attached.held_by.top))
    return jnp.all(convex) & above, jnp.where(above, int(Status.not_convex), int(Status.at_spring))


def _direction_of_parabola(
    march: MarchInPlane, solution: Solution, free: Bool[Array, " whiskers"], at: Stance
) -> tuple[Point, Poses]:
    """Direction at the end of a step, up to which whiskers are free, along a parabola that starts along the tangent."""
    change = 0.0 if at.free is None else at.free - march.point.z
    change = jnp.where(free[:, None], change, solution.point.z - march.point.z)
    chord = Point(change, solution.point.u - march.point.u)
    distance = dot(march.tangent, chord, scale_of(march.point.z))
    known = distance > SHORTEST_CHORD
    twice = jnp.where(known, 2 / jnp.where(known, distance, 1.0), 0.0)
    sign = jnp.where(known, -1.0, 1.0)
    direction = Point(twice * chord.z + sign * march.tangent.z, twice * chord.u + sign * march.tangent.u)
    return direction, twice * (solution.newton.pose - march.pose) + sign * march.tangent_pose


def seen(
    problem: Problem, march: MarchInPlane, point: Point, at: Stance, stop_u: Scalar, parameters: PerWhisker
) -> Seen:
    """A point on the way to the next stop, with contacts at these parameters, as margins see it."""
    ends = None
    if problem.profile.has_edges and march.state.piece is not None:
        ends = ends_of(problem.profile, march.state.piece)
        # Beyond its piece, the slope of a contact means nothing.
        parameters = jnp.clip(parameters, *ends)
    ahead = march.before_vertex * slope_sines(problem, march.state, parameters)
    ahead = ahead if ends is None else ahead + LEVEL
    remaining = march.direction * (stop_u - point.u)
    return Seen(problem, march.state, march.state.free, point.z, at, ahead, remaining, ends)


def first_violated(
    problem: Problem, march: MarchInPlane, trial: TrialInPlane, distance: Scalar
) -> tuple[Bool[Array, ""], Target]:
    """Whether an event lies within a step of this length, and the first such event."""
    events, n = events_of(problem), march.state.side.size
    ignored = None
    if any(event.before_release for event in events):
        ended, none = trial.there[RELEASE] < -MARGIN_NOISE, [jnp.zeros(m.size, bool) for m in trial.there]
        ignored = [ended if event.before_release else no for event, no in zip(events, none, strict=True)]
    crossed = first_crossed(trial.here, trial.there, MARGIN_NOISE, n, (AT_STOP,), ignored)
    number, touched = crossed.number, None
    if march.state.sides is not None:
        touched = jnp.full(n, jnp.minimum(crossed.entry // n, len(march.state.sides) - 1))
    stance, side = trial.stance.of(touched), march.state.side_of(touched)
    piece = march.state.piece
    if piece is not None:
        touch = stance.first(side)
        for k, event in enumerate(events):
            onto = event.piece(march.state, touch)
            piece = piece if onto is None else jnp.where(number == k, onto, piece)
    return crossed.some, Target(
        number,
        crossed.whiskers,
        crossed.share * distance,
        FirstContact(*snap_flow.touching(stance, side), piece, touched),
        limit_of(events, number, problem, trial.solution.point.z, trial.ends),
    )


def dip(problem: Problem, march: MarchInPlane, trial: TrialInPlane, distance: Scalar) -> tuple[Bool[Array, ""], Scalar]:
    """Whether a margin is negative within a step but not at its ends, and the share of the step up to where it is."""
    free = march.state.free
    start = PathDirection(problem, march.state, free, march.point.z, march.tangent.z, march.tangent_pose)
    end = PathDirection(problem, march.state, free, trial.solution.point.z, trial.tangent.z, trial.tangent_pose)
    return first_dip(trial.here, trial.there, margin_rates(start), margin_rates(end), distance, MARGIN_NOISE)
