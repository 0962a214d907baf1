"""Transitions of the march: the next state after the solved end of a step, for each task.

Each `after_...` function returns the new state, whether a node is to be written, and the node. All cases are computed
and one is selected, because a batch pays for every branch anyway.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import SLACK, Phase
from jaxwhisker._equilibrium.newton import slope_sines
from jaxwhisker._equilibrium.point import Contacts, Point, dot, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import of_object
from jaxwhisker._path import snap_flow
from jaxwhisker._path.approach import FIRST_STEP, approach_of
from jaxwhisker._path.events import (
    AT_STOP,
    MARGIN_NOISE,
    RATE_NOISE,
    TOUCH,
    VERTEX,
    After,
    Facts,
    Happened,
    Lead,
    PathDirection,
    events_of,
    margin_rates,
)
from jaxwhisker._path.law import contact_law
from jaxwhisker._path.march_state import MarchState, Task, Trial
from jaxwhisker._path.path import NO_EVENT, STOP, EventKind, Node, Status, first_case, is_snap
from jaxwhisker._path.trial import dip, first_violated
from jaxwhisker._path.turning_points import FOLD_BRACKET, before_loss, may_fold_twice, step_to_loss, turning_point

PREDICTION_ERROR = 2e-3  # target; states between nodes are then interpolated to about 1e-6 before they are solved for
LONGEST_STEP = 0.25  # of the contacts: a soft spring is stretched over many lengths while they hardly change
SHORTEST_STEP = 1e-10
ARRIVAL_MISS = 0.1  # the equilibrium at which a flow ends is nearer than this
WENT_BACK = 1e-9  # by which a contact may undo what it must not from the end of a flow to the equilibrium near it
NEAR_FOLD = 2e-4  # a loss this near counts as located if no shorter step is solved; u is off by less than its square


def _node(problem: Problem, march: MarchState, trial: Trial) -> Node:
    """A plain node: the path continues as it arrives."""
    point = trial.solution.point
    return Node(
        point,
        point.z,
        trial.tangent,
        trial.tangent,
        march.state,
        march.state,
        march.travel + jnp.abs(point.u - march.point.u),
        jnp.asarray(NO_EVENT),
        jnp.zeros_like(march.state.phase, bool),
        **contact_law(problem).remembered(march.goal, corner=False),
    )


def _moved(march: MarchState, trial: Trial, node: Node) -> MarchState:
    return march._replace(
        state=march.state.now_standing(trial.standing),
        point=trial.solution.point,
        pose=trial.solution.newton.pose,
        tangent=trial.tangent,
        tangent_pose=trial.tangent_pose,
        stuck_at=trial.parameters,
        stance=None if march.stance is None else trial.stance,
        travel=node.travel,
    )


def after_advance(problem: Problem, march: MarchState, trial: Trial, guess: Point):
    """Handle the end of a step along the path: a node, an event in the step, lost stability, or too long a step."""
    scale, law = scale_of(march.point.z), contact_law(problem)
    error, good = _prediction_error(march, trial, guess, scale)
    good &= law.accepts(march, trial, guess)
    violated, target = first_violated(problem, march, trial, march.step)
    dips, share = dip(problem, march, trial, march.step)
    dips &= ~violated
    twice, turn_share = may_fold_twice(march, trial)
    share = jnp.where(twice, turn_share, share)
    dips = good & (dips | twice)
    good &= ~dips
    shorter = march._replace(step=jnp.where(dips, share, 0.4) * march.step)
    too_short = ~good & (shorter.step < SHORTEST_STEP)
    to_event = march._replace(task=jnp.asarray(int(Task.event)), target=target)

    holds, located, reached, rests = turning_point(march, trial)
    node = _node(problem, march, trial)
    moved = _moved(march, trial, node)
    turned = law.after_rest(moved, trial, node, rests)
    closer = before_loss(problem, march, trial, march.step)
    new = first_case(
        # If several whiskers become unstable at once, Newton's method fails close to the fold: this is near enough.
        (too_short & (march.unstable_at < NEAR_FOLD), law.to_snap(march)),
        (too_short, march.stopped(Status.lost)),
        (~good, shorter),
        (violated, to_event),
        (~holds & ~located, closer),
        (~holds, turned),
        (~trial.sound, march.stopped(trial.reason)),
        (reached, turned),
        otherwise=_onwards(problem, march, moved, trial, error, scale),
    )
    return new, good & ~violated & (holds | located) & trial.sound, node


def _prediction_error(march: MarchState, trial: Trial, guess: Point, scale: Contacts) -> tuple[Scalar, Bool[Array, ""]]:
    """Distance between prediction and solution, and whether the step is accepted: solved, near, and not bent back."""
    solution = trial.solution
    miss = Point(solution.point.z - guess.z, solution.point.u - guess.u)
    error = jnp.sqrt(dot(miss, miss, scale))
    straight = dot(march.tangent, trial.tangent, scale) / jnp.sqrt(dot(trial.tangent, trial.tangent, scale))
    return error, solution.converged & (error < 10 * PREDICTION_ERROR) & (straight > 0.5)


def _onwards(
    problem: Problem, march: MarchState, moved: MarchState, trial: Trial, error: Scalar, scale: Contacts
) -> MarchState:
    """The state after an accepted step, with the length of the next step."""
    factor = jnp.clip((PREDICTION_ERROR / jnp.maximum(error, 1e-14)) ** (1 / 3), 0.3, 2.5)
    all_free = jnp.all(march.state.free)
    contacts = trial.tangent._replace(u=jnp.asarray(0.0))
    bending = jnp.sqrt(dot(contacts, contacts, scale))
    longest = jnp.where(all_free, approach_of(problem).longest_step(), LONGEST_STEP / bending)
    left = march.unstable_at - march.step
    # The path is still stable there: lengths along a curve do not quite add up, and the loss is further ahead.
    left = jnp.where(left < FOLD_BRACKET, jnp.inf, left)
    bend = Point((trial.tangent.z - march.tangent.z) / march.step, (trial.tangent.u - march.tangent.u) / march.step)
    # The Illinois rule: otherwise false position creeps towards a fold from one side.
    unstable_turns = march.unstable_turns / 2
    to_loss = step_to_loss(trial.turns, left, unstable_turns)
    return moved._replace(
        bend=bend,
        unstable_at=left,
        unstable_turns=unstable_turns,
        step=jnp.minimum(jnp.minimum(factor * march.step, longest), to_loss),
    )


def after_event(problem: Problem, march: MarchState, trial: Trial, facts: Facts):
    """Handle the point where a margin vanishes: change to the state that holds from here on."""
    solution, target = trial.solution, march.target
    touches = target.whisker & (target.number == TOUCH)
    before = march.point.z if trial.stance.free is None else trial.stance.free
    z_before = jnp.where(touches[:, None], before, solution.point.z)
    good, distance = _reached(problem, march, trial, z_before)

    violated, earlier = first_violated(problem, march, trial, distance)
    dips, share = dip(problem, march, trial, distance)
    dips &= good & ~violated
    good &= ~dips
    again = march._replace(
        task=jnp.asarray(int(Task.advance)), step=jnp.where(dips, share * distance, 0.4 * march.step)
    )
    holds = trial.stable & jnp.all(trial.turns[1:] > -RATE_NOISE)
    unstable = before_loss(problem, march, trial, distance)._replace(task=jnp.asarray(int(Task.advance)))
    node = _event_node(problem, march, trial, facts, z_before)
    cases = []
    if problem.frames_move:
        # Where the whisker touches, its tip may point the other way than where it was expected to touch.
        tip, slack = target.phase == Phase.tip, jnp.where(touches, solution.point.z[:, SLACK], 0.0)
        other = solution.converged & (jnp.where(tip, slack, -slack) > MARGIN_NOISE)
        phase = jnp.where(other, jnp.where(tip, Phase.tangential, Phase.tip), target.phase)
        contact = target.contact.at[:, SLACK].multiply(~other)
        cases = [(jnp.any(other), march._replace(target=target._replace(phase=phase, contact=contact)))]
    new = first_case(
        *cases,
        (~good & (again.step < SHORTEST_STEP), march.stopped(Status.lost)),
        (~good, again),
        (violated, march._replace(target=earlier)),
        (~holds, unstable),
        otherwise=_arrived(problem, march, trial, facts, node),
    )
    return new, jnp.asarray(False), node


def _reached(problem: Problem, march: MarchState, trial: Trial, z_before: Contacts) -> tuple[Bool[Array, ""], Scalar]:
    """Whether the solution is the targeted event, within the last step, and its distance."""
    scale = scale_of(march.point.z)
    chord = Point(z_before - march.point.z, trial.solution.point.u - march.point.u)
    distance = dot(march.tangent, chord, scale)
    reach = jnp.sqrt(dot(chord, chord, scale))
    good = trial.solution.converged & (distance > -1e-9) & (reach <= 1.5 * march.step + 1e-9)
    # If the margin grows, the path comes back from beyond the event, and the event itself lies earlier on the path.
    moving = PathDirection(
        problem, march.state, march.state.free, trial.solution.point.z, trial.tangent.z, trial.tangent_pose
    )
    touch, *others = margin_rates(moving)
    touch = touch if march.target.object is None else of_object(touch, march.target.object)
    growing = jnp.stack(jnp.broadcast_arrays(touch, *others))[march.target.number]
    return good & (jnp.sum(march.target.whisker * growing) < MARGIN_NOISE), distance


def _event_node(problem: Problem, march: MarchState, trial: Trial, facts: Facts, z_before: Contacts) -> Node:
    """The node of an event, in the state that holds from here on."""
    solution, target, events = trial.solution, march.target, events_of(problem)
    z, state = solution.point.z, march.state
    after = After(problem, trial.stance, target.phase, target.side, target.piece, target.limit, trial.parameters)
    for number, event in enumerate(events):
        if not event.continues:
            z, state = event.changed(target.whisker & (target.number == number), z, state, after)
    node = _node(problem, march, trial)
    return node._replace(
        point=Point(z, solution.point.u),
        z_before=z_before,
        state=state,
        travel=jnp.where((target.number == AT_STOP) & (march.goal == 0), 0.0, node.travel),
        kind=facts.kind,
        whiskers=target.whisker,
    )


def _arrived(problem: Problem, march: MarchState, trial: Trial, facts: Facts, node: Node) -> MarchState:
    """The state at an event, before the direction in which the path leaves is determined."""
    target, events = march.target, events_of(problem)
    happened = Happened(problem, node.state, node.point.z, trial.solution.newton.condensed)
    # If the contact state does not change, the path continues as it arrives.
    z = jnp.where(facts.continues, march.tangent.z / scale_of(march.point.z) ** 2, 0.0)
    z = z.at[:, :3].add(target.whisker[:, None] * (facts.leaves * facts.of_contact))
    lead = Lead(z, jnp.zeros_like(march.pose), jnp.where(facts.continues, march.tangent.u, 0.0))
    for number, event in enumerate(events):
        lead = event.lead(target.whisker & (target.number == number), lead, happened)
    moved = _moved(march, trial, node)._replace(state=node.state, point=node.point)
    ahead = jnp.where(slope_sines(problem, moved.state, moved.parameters) < 0, -1.0, 1.0)
    sign = jnp.where(target.whisker & (target.number == TOUCH), ahead, march.before_vertex)
    return moved._replace(
        task=jnp.asarray(int(Task.arrive)),
        lead=lead,
        before_vertex=jnp.where(target.whisker & (target.number == VERTEX), -sign, sign),
        pending=node,
        goal=march.goal + (target.number == AT_STOP),
    )


def after_arrive(
    problem: Problem, march: MarchState, trial: Trial, stops: Float[Array, " stops"], last: Int[Array, ""]
):
    """Handle the point of an event in its new mode: leave along the path, or begin a snap."""
    point, law = trial.solution.point, contact_law(problem)
    stop_kind = march.pending.kind == STOP
    heading = jnp.sign(stops[jnp.minimum(march.goal, last)] - march.point.u)
    turned = stop_kind & (march.goal <= last) & (heading != 0)
    direction = jnp.where(turned, heading, march.direction)
    reversed_ = direction != march.direction
    lead = march.lead
    grows = jnp.sum(lead.z * trial.tangent.z) + jnp.sum(lead.pose * trial.tangent_pose) + lead.u * trial.tangent.u
    sign = jnp.where(grows < 0, -1.0, 1.0) * jnp.where(reversed_, -1.0, 1.0)
    tangent = Point(sign * trial.tangent.z, sign * trial.tangent.u)
    node = march.pending._replace(point=point, leaving=tangent)
    march = march._replace(direction=direction)
    after_snap = is_snap(march.pending.kind)
    # After a snap, and only then, the contact may be on the other side of the vertex.
    at = march._replace(point=point, stuck_at=trial.parameters)
    behind = jnp.where(slope_sines(problem, march.state, at.parameters) < 0, -1.0, 1.0)
    onwards = at._replace(
        task=jnp.asarray(int(Task.advance)),
        pose=trial.solution.newton.pose,
        stance=None if march.stance is None else trial.stance,
        tangent=tangent,
        tangent_pose=sign * trial.tangent_pose,
        bend=jax.tree.map(jnp.zeros_like, tangent),
        step=jnp.asarray(FIRST_STEP),
        unstable_at=jnp.asarray(jnp.inf),
        before_vertex=jnp.where(after_snap, behind, march.before_vertex),
    )
    falls = (march.drive_rate(tangent) <= 0) | ~trial.stable
    moved = Point(point.z - march.point.z, point.u - march.point.u)
    node, moved = law.unforeseen(march, node, moved)
    near = trial.solution.converged & (dot(moved, moved, scale_of(march.point.z)) < ARRIVAL_MISS**2)
    # Newton's method may have violated the mode of the flow, or converged to an equilibrium that the flow cannot reach.
    happens = zip(events_of(problem), trial.there, strict=True)
    changes = [jnp.ravel(margin) for event, margin in happens if not event.continues]
    wrong = jnp.any(jnp.concatenate(changes) < -MARGIN_NOISE)
    wrong |= jnp.any(law.rates(march.state, point.z, moved.z) < -WENT_BACK)
    early = after_snap & (wrong | falls | ~near)
    flowing = march._replace(
        task=jnp.asarray(int(Task.flow)),
        flow=march.flow._replace(near=march.flow.near / 4),
    )
    over = _is_over(problem, march, trial, last, stop_kind)
    ways = law.ways_on(march, onwards, node, trial, falls)
    new = first_case(
        (early, flowing),
        (~near, march.stopped(Status.lost)),
        (over, march.stopped(Status.ok)),
        *ways.others,
        (falls, law.to_snap(ways.onwards)),
        otherwise=ways.onwards,
    )
    return new, near & ~early & (over | ways.first), node


def _is_over(
    problem: Problem, march: MarchState, trial: Trial, last: Int[Array, ""], stop_kind: Bool[Array, ""]
) -> Bool[Array, ""]:
    """Whether the march ends here: at the last stop, or on the way to it after all whiskers have passed the object."""
    last_leg = (march.goal >= last) & (march.direction * problem.onwards > 0) & (march.goal > 0)
    gone = approach_of(problem).is_over(march.state, trial.stance) & last_leg
    return (stop_kind & (march.goal > last)) | gone


def after_flow(problem: Problem, march: MarchState, proposed: snap_flow.Flow, trial: Trial):
    """Handle a step of the overdamped bases."""
    solution, at = trial.solution, trial.stance
    flow, state, z = snap_flow.advance(problem, proposed, march.state, march.point.z, solution, at, trial.parameters)
    rested = snap_flow.at_rest(problem, flow, state, march.point.u)
    freed = flow.slipped & state.free
    kind = jnp.where(jnp.any(freed), EventKind.snap_off, EventKind.snap_through)
    none = jnp.zeros_like(z)
    pending = march.pending._replace(
        state=state,
        travel=march.travel,
        kind=kind,
        whiskers=flow.slipped,
    )
    flowing = march._replace(
        task=jnp.where(rested, Task.arrive, Task.flow),
        state=state,
        point=Point(z, march.point.u),
        pose=flow.pose,
        stuck_at=trial.parameters,
        flow=flow,
        pending=pending,
        lead=Lead(none, jnp.zeros_like(flow.pose), march.direction),
    )
    shorter = march._replace(flow=snap_flow.shortened(march.flow))
    converged, cases = contact_law(problem).judged(march, flow, proposed, trial)
    new = first_case(
        *cases,
        (jnp.where(converged, flow.exhausted, shorter.flow.exhausted), march.stopped(Status.unsettled)),
        (~converged, shorter),
        otherwise=flowing,
    )
    return new, jnp.asarray(False), march.pending
