"""Transitions of the march: the next state after the solved end of a step, for each task.

Each `after_...` function returns the new state, whether a node is to be written, and the node. All cases are computed
and one is selected, because a batch pays for every branch anyway.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import SLACK, Phase
from jaxwhisker._equilibrium.point import Point, dot, scale_of
from jaxwhisker._path.continuation import Continuation
from jaxwhisker._path.march_state import Cases, MarchState, Outcome, Task, Trial
from jaxwhisker._path.path import STOP, Status, first_case

FIRST_STEP = 0.02  # of the march after a corner; steps grow at once where the path is smooth
SHORTEST_STEP = 1e-10
PREDICTION_ERROR = 2e-3  # target; states between nodes are then interpolated to about 1e-6 before they are solved for
AT_BASE = 0.02  # lengths from the base, where no contact begins, and forces grow without bound
LOSS_BRACKET = 2e-6  # distance along the path within which a loss is located; its control to the square of it
SHORTER = 0.4  # of a step that was too long


def after_advance(mechanics: Continuation, march: MarchState, trial: Trial) -> Outcome:
    """Handle the end of a step along the path: a node, an event in the step, lost stability, or too long a step."""
    error, good = _prediction_error(mechanics, march, trial)
    accepted, longest = mechanics.accepts(march, trial)
    good &= accepted
    violated, target = mechanics.first_violated(march, trial, march.step)
    dips, share = mechanics.dip(march, trial, violated)
    dips &= good
    good &= ~dips
    shorter = march.replace(step=jnp.where(dips, share, SHORTER) * march.step)
    good, shorter, astray = mechanics.revised(march, trial, good, shorter)
    to_event = march.replace(task=jnp.asarray(int(Task.event)), target=target)

    loss, node = mechanics.loss(march, trial), mechanics.node(march, trial)
    bend = Point((trial.tangent.z - march.tangent.z) / march.step, (trial.tangent.u - march.tangent.u) / march.step)
    moved = march.replace(point=trial.point, tangent=trial.tangent, bend=bend, travel=node.travel)
    moved = mechanics.moved(march, trial, moved)
    turned = mechanics.after_loss(march, moved, trial, node, loss)
    factor = (PREDICTION_ERROR / jnp.maximum(error, 1e-14)) ** (1 / 3)
    factor = jnp.clip(jnp.minimum(factor, longest), 0.3, 2.5)
    new = first_case(
        (astray, mechanics.astray(march)),
        (~good & (shorter.step < SHORTEST_STEP), march.stopped(Status.lost)),
        (~good, shorter),
        (violated, to_event),
        (~loss.holds & ~loss.located, mechanics.before_loss(march, trial, march.step)),
        (~loss.holds, turned),
        *mechanics.ends(march, trial, loss, turned),
        otherwise=mechanics.onwards(march, moved, trial, factor),
    )
    write, node = mechanics.written(march, trial, node, loss)
    return new, good & ~violated & write, node


def _prediction_error(mechanics: Continuation, march: MarchState, trial: Trial) -> tuple[Scalar, Bool[Array, ""]]:
    """Distance between prediction and solution, and whether the step is solved, near it, and not bent back."""
    scale = scale_of(march.point.z)
    miss = Point(trial.point.z - trial.guess.z, trial.point.u - trial.guess.u)
    miss = mechanics.felt(march.point, miss)
    error = jnp.sqrt(dot(miss, miss, scale))
    tangent = mechanics.measured(trial.tangent)
    straight = dot(march.tangent, tangent, scale) / jnp.sqrt(dot(tangent, tangent, scale))
    return error, trial.converged & (error < 10 * PREDICTION_ERROR) & (straight > 0.5)


def after_event(mechanics: Continuation, march: MarchState, trial: Trial) -> Outcome:
    """Handle the point where a margin vanishes: change to the state that holds from here on."""
    found, target = mechanics.found(march, trial), march.target
    again = march.replace(task=jnp.asarray(int(Task.advance)), step=found.step)
    unstable = mechanics.before_loss(march, trial, found.distance).replace(task=jnp.asarray(int(Task.advance)))
    not_found, if_found = mechanics.at_event(march, trial, found)
    write, node = mechanics.event_node(march, trial, found)
    stops = target.number == mechanics.at_stop
    node = node._replace(whiskers=target.whiskers, travel=jnp.where(stops & (march.goal == 0), 0.0, node.travel))
    arriving = march.replace(
        task=jnp.asarray(int(Task.arrive)),
        state=node.state,
        point=node.point,
        travel=node.travel,
        pending=node,
        goal=march.goal + stops,
    )
    new = first_case(
        *(_touches_otherwise(mechanics, march, trial) if mechanics.may_touch_otherwise() else []),
        *not_found,
        (~found.good & (again.step < SHORTEST_STEP), march.stopped(Status.lost)),
        (~found.good, again),
        (found.violated, march.replace(target=found.earlier)),
        (~found.holds, unstable),
        *if_found,
        otherwise=mechanics.arriving(march, trial, arriving),
    )
    return new, write, node


def _touches_otherwise(mechanics: Continuation, march: MarchState, trial: Trial) -> Cases:
    """Where a whisker touches, its tip may point the other way than where it was expected to touch."""
    target = march.target
    touches = target.whiskers & (target.number == mechanics.touch)
    tip, slack = target.first.phase == Phase.tip, jnp.where(touches, trial.point.z[:, SLACK], 0.0)
    other = trial.converged & (jnp.where(tip, slack, -slack) > mechanics.margin_noise)
    # A base that arrives at the object touches in neither way.
    other &= target.first.contact[:, SLACK] < (1 - AT_BASE) * mechanics.problem.length
    phase = jnp.where(other, jnp.where(tip, Phase.tangential, Phase.tip), target.first.phase)
    first = target.first._replace(phase=phase, contact=target.first.contact.at[:, SLACK].multiply(~other))
    return [(jnp.any(other), march.replace(target=target._replace(first=first)))]


def after_arrive(
    mechanics: Continuation, march: MarchState, trial: Trial, stops: Float[Array, " stops"], last: Int[Array, ""]
) -> Outcome:
    """Handle the point of an event in its new state: leave along the path, or begin a snap."""
    stop_kind = march.pending.kind == STOP
    heading = jnp.sign(stops[jnp.minimum(march.goal, last)] - march.point.u)
    turned = stop_kind & (march.goal <= last) & (heading != 0)
    direction = jnp.where(turned, heading, march.direction)
    sign = mechanics.leaves(march, trial, direction)
    tangent = Point(sign * trial.tangent.z, sign * trial.tangent.u)
    march = march.replace(direction=direction)
    onwards = march.replace(
        task=jnp.asarray(int(Task.advance)),
        point=trial.point,
        tangent=tangent,
        bend=jax.tree.map(jnp.zeros_like, tangent),
        step=jnp.asarray(FIRST_STEP),
        unstable_at=jnp.asarray(jnp.inf),
        stance=None if march.stance is None else trial.stance,
    )
    onwards = mechanics.leaving(march, trial, onwards, sign)
    node = march.pending._replace(point=onwards.point, leaving=tangent)
    falls = (march.drive_rate(tangent) <= 0) | ~trial.stable
    arrival = mechanics.arrived(march, trial, node, falls)
    over = (stop_kind & (march.goal > last)) | mechanics.is_over(march, trial, last)
    ways = mechanics.ways_on(march, onwards, arrival.node, trial, falls)
    new = first_case(
        *arrival.others,
        (over, march.stopped(Status.ok)),
        *ways.others,
        (falls, mechanics.to_snap(ways.onwards)),
        otherwise=ways.onwards,
    )
    return new, arrival.good & (over | ways.first), arrival.node
