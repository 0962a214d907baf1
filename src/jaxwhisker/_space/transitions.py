"""Transitions of the march in space: what follows from a solved step, by task."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, dot, scale_of
from jaxwhisker._path.path import STOP, EventKind, Status, first_case, select
from jaxwhisker._space.contact import FORCE, SLACK, TRACTION
from jaxwhisker._space.flow import clinging, settling, sliding
from jaxwhisker._space.march_state import (
    AT_STOP,
    GRIP,
    LOSS,
    PHASE,
    RELEASE,
    SNAP,
    TOUCH,
    March,
    Outcome,
    SpaceNode,
    SpaceTarget,
    SpaceTask,
    SpaceTrial,
    node_at,
)
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import Contacts, SpaceProblem
from jaxwhisker._space.slip import (
    SlipMode,
    as_felt,
    defect_of,
    first_traction,
    next_guess,
    slip_after,
    slip_at_corner,
    speeds,
    with_traction,
    without_traction,
)
from jaxwhisker._space.stance import SpaceStance

FIRST_STEP = 0.02  # after a corner
LONGEST_STEP = 4.0  # lengths; the prediction error keeps nearly all steps far below it
SHORTEST_STEP = 1e-10
PREDICTION_ERROR = 2e-3  # at which steps keep their length
SLIP_DEFECT = 1e-6  # the same for the rate at the start of a step with friction, times its length
LOSS_BRACKET = 2e-6  # distance along the path within which a loss is located; its control to the square of it
INSIDE = 1e-6  # depth of free whiskers that must not be inside the object
TOUCHING = 1e-9  # depth of a free whisker that counts as a touch: one that has just been released is at 0
PASSED = 0.25  # lengths from the object at which a scan right across it ends
MARGIN_NOISE = 1e-11
BRIEF_STEP = 1e-6  # behind a corner, within which contacts may begin or cease to slip
LEAST_GRIP = 1e-9  # smaller margins of contacts that stick or slip have just been left
AT_BASE = 0.02  # lengths from the base: forces grow without bound where a contact gets there
FOLD = 1e-3  # rate of the control at a loss, per arc length, below which it is a fold


def margins_of(
    phase: Phases, z: Contacts, stance: SpaceStance, remaining: Scalar, onwards: Scalar
) -> Float[Array, "kinds whiskers"]:
    """Margins of all kinds of events: positive before them. With friction, stability is lost where the drive turns."""
    free, tip = phase == Phase.free, phase == Phase.tip
    touch = jnp.where(free, stance.nearest.distance + TOUCHING, jnp.inf)
    release = jnp.where(free, jnp.inf, z[:, FORCE])
    slack = jnp.where(free, jnp.inf, jnp.where(tip, -z[:, SLACK], z[:, SLACK]))
    stop, loss = (jnp.full_like(touch, jnp.inf).at[0].set(margin) for margin in (remaining, onwards))
    loss = jnp.where(jnp.all(free), jnp.inf, loss)
    return jnp.stack([touch, release, slack, stop, *([] if stance.grip is None else [stance.grip, loss])])


def _rates(phase: Phases, tangent: Point) -> Float[Array, "kinds whiskers"]:
    """Rates of the margins along the path, those of forces and slacks only."""
    still, slack = jnp.zeros_like(tangent.z[:, SLACK]), tangent.z[:, SLACK]
    return jnp.stack([still, tangent.z[:, FORCE], jnp.where(phase == Phase.tip, -slack, slack), *[still] * 3])


def after_advance(problem: SpaceProblem, march: March, trial: SpaceTrial) -> Outcome:
    """Handle the end of a step along the path: a node, an event in the step, lost stability, or too long a step."""
    point, tangent, stance, scale = trial.point, trial.tangent, trial.stance, scale_of(march.point.z)
    slip, friction = march.slip, problem.friction
    miss = Point(point.z - trial.guess.z, point.u - trial.guess.u)
    miss = miss if friction is None else as_felt(friction, march.point.z, miss)
    error, straight = jnp.sqrt(dot(miss, miss, scale)), dot(march.tangent, without_traction(tangent), scale)
    good = trial.solution.converged & (error < 10 * PREDICTION_ERROR) & (straight > 0.5) & stance.sound
    astray = jnp.asarray(False)
    factor = (PREDICTION_ERROR / jnp.maximum(error, 1e-14)) ** (1 / 3)
    if slip is not None and friction is not None:
        # Behind a corner, the tangent is that of the equations.
        defect = defect_of(friction, slip, march.point, march.tangent, trial.solution.points)
        defect = jnp.where(slip.at_corner, 0.0, defect)
        good &= defect < 10 * SLIP_DEFECT
        factor = jnp.minimum(factor, (SLIP_DEFECT / jnp.maximum(defect, 1e-14)) ** (1 / 4))
    # A margin may vanish twice within a step: to its least value, the step finds the first event.
    dip = _dip(march, trial, straight)
    shorter = march._replace(step=jnp.where(good, dip, 0.4) * march.step)
    good &= dip == 1
    violated, target = _first_violated(march, trial, march.step)
    stable, node = stance.stable, node_at(march, point, tangent, trial.solution.points)
    located = good & ~violated & ~stable & (march.step < LOSS_BRACKET)
    # At a fold, contacts slide on in the direction of the path. A bifurcation is symmetric: they may go either way.
    branches = located & (jnp.abs(march.tangent.u) >= FOLD)
    lost = select(branches, march.stopped(Status.undetermined), sliding(problem, march))
    moved = march._replace(
        point=point,
        tangent=tangent,
        stance=stance,
        size=stance.stiffness,
        travel=node.travel,
        bend=Point((tangent.z - march.tangent.z) / march.step, (tangent.u - march.tangent.u) / march.step),
        unstable_at=jnp.where(march.unstable_at > march.step, march.unstable_at - march.step, jnp.inf),
        unstable_size=march.unstable_size / 2,
    )
    if slip is not None:
        assert stance.grip is not None and march.stance.grip is not None and march.sunk is not None
        begins = jnp.any(slip.begins)
        wrong = begins & (~good | jnp.any(slip.begins & (stance.grip < 0)))
        # A contact sticks or slips for a while behind a corner. What seems to end at once is another solution.
        fresh = (march.stance.grip < LEAST_GRIP) | (slip.at_corner & (march.step > BRIEF_STEP))
        ends = jnp.any(fresh & (stance.grip < 0))
        good &= ~wrong & ~ends
        # Where contacts can neither stick nor slip, no equilibrium is near.
        astray = trial.solution.converged & ends & ~begins & (march.step < BRIEF_STEP)
        slip_on = slip._replace(at_corner=jnp.asarray(False), begins=jnp.zeros_like(slip.begins))
        moved = moved._replace(slip=slip_on, sunk=march.sunk & (stance.nearest.distance == 0))
        shorter = shorter._replace(step=jnp.where(wrong | ends, 0.4 * march.step, shorter.step))
        guess, traction = next_guess(slip, march.point.z[:, TRACTION])
        again = march._replace(slip=guess, point=with_traction(march.point, traction))
        guessed = jnp.where(begins & (guess.guess != 0), march.step, shorter.step)
        shorter = select(begins, again, shorter)._replace(step=guessed)
        astray |= ~good & (shorter.step < SHORTEST_STEP) & jnp.any(march.phase != Phase.free)
    at_base = jnp.any((march.phase == Phase.tangential) & (point.z[:, SLACK] > (1 - AT_BASE) * problem.length))
    new = first_case(
        (astray, settling(problem, march)),
        (~good & (shorter.step < SHORTEST_STEP), march.stopped(Status.lost)),
        (~good, shorter),
        (violated, march._replace(task=jnp.asarray(int(SpaceTask.event)), target=target)),
        (located, lost),
        (~stable, _before_loss(march, stance.stiffness)),
        (_is_over(problem, march, trial), march.stopped(Status.ok)),
        (~stance.opens, march.stopped(Status.not_convex)),
        (at_base, march.stopped(Status.lost)),
        otherwise=moved._replace(step=_next_step(moved, factor, march.step)),
    )
    # While all whiskers are free, nothing happens between events.
    write = good & ~violated & stable & stance.opens & jnp.any(march.phase != Phase.free)
    return new, write | branches, select(branches, _bifurcation(march, trial), node)


def _first_violated(
    march: March, trial: SpaceTrial, length: Scalar, solved: Bool[Array, "kinds whiskers"] | None = None
) -> tuple[Bool[Array, ""], SpaceTarget]:
    """Whether a margin vanishes on the way to the trial, of this length, and the first such event.

    Margins that are `solved` for vanish at its end.
    """
    here, there = (
        margins_of(
            march.phase,
            at.point.z,
            at.stance,
            march.direction * (trial.stop - at.point.u),
            march.direction * at.tangent.u,
        )
        for at in (march, trial)
    )
    crossed = there < -MARGIN_NOISE
    if solved is not None:
        crossed &= ~solved
    drop = jnp.where(crossed, here - there, 1.0)
    share = jnp.where(crossed, jnp.clip(here / jnp.where(drop > 0, drop, 1.0), 0.0, 1.0), jnp.inf)
    k = jnp.argmin(share)
    margin, whisker = jnp.unravel_index(k, share.shape)
    whiskers = (jnp.arange(march.phase.size) == whisker) & (margin != AT_STOP) & (margin != LOSS)
    return jnp.any(crossed), SpaceTarget(margin, whiskers, jnp.ravel(share)[k] * length, trial.stance.nearest)


def _dip(march: March, trial: SpaceTrial, straight: Scalar) -> Scalar:
    """Share of the step at which a force or a slack is least, if it vanishes on the way, although not at the end.

    It is 1 if none does. Between the ends, values and tangents give a cubic.
    """
    zero = jnp.zeros(())
    here, there = (margins_of(march.phase, at.point.z, at.stance, zero, zero)[1:3] for at in (march, trial))
    falls, rises = (length * _rates(march.phase, tangent)[1:3] for tangent, length in
                    ((march.tangent, march.step), (trial.tangent, march.step / straight)))  # fmt: skip
    turns = (march.phase != Phase.free) & (falls < 0) & (rises > 0) & (there > 0)
    second, third = 3 * (there - here) - 2 * falls - rises, falls + rises - 2 * (there - here)
    root = jnp.sqrt(jnp.where(turns, second**2 - 3 * third * falls, 1.0))
    share = jnp.where(turns, -falls / jnp.where(turns, second + root, 1.0), 1.0)
    least = here + share * (falls + share * (second + share * third))
    return jnp.min(jnp.where(turns & (least < -MARGIN_NOISE), share, 1.0))


def _bifurcation(march: March, trial: SpaceTrial) -> SpaceNode:
    """The node where stability is lost, within a short step."""
    share = march.size / (march.size - trial.stance.stiffness)
    middle = march.point.u + share * (trial.point.u - march.point.u)
    node = node_at(march, march.point._replace(u=middle), march.tangent)
    return node._replace(kind=jnp.asarray(int(EventKind.bifurcation)), whiskers=march.phase != Phase.free)


def _before_loss(march: March, stiffness: Scalar) -> March:
    """The state with a shorter step, towards the loss of stability within this one."""
    again = jnp.isfinite(march.unstable_at)
    # The Illinois rule keeps false position from creeping.
    size = jnp.where(again, march.size / 2, march.size)
    closer = march._replace(unstable_at=march.step, unstable_size=stiffness, size=size)
    return closer._replace(step=_to_loss(closer))


def _to_loss(march: March) -> Scalar:
    """Length of the step that is expected to reach the loss of stability."""
    share = march.size / (march.size - march.unstable_size)
    share = jnp.where(march.unstable_size < 0, share, 0.5)
    share = jnp.clip(jnp.where(jnp.isfinite(share), share, 0.5), 0.02, 0.98)
    # A last step to the unstable state itself, which false position approaches for ever.
    return march.unstable_at * jnp.where(march.unstable_at < LOSS_BRACKET, 1.0, share)


def _next_step(march: March, factor: Scalar, step: Scalar) -> Scalar:
    factor = jnp.clip(factor, 0.3, 2.5)
    length = jnp.minimum(factor * step, jnp.where(jnp.all(march.phase == Phase.free), jnp.inf, LONGEST_STEP))
    length = jnp.minimum(length, _clear(march.stance, march.tangent))
    return jnp.where(jnp.isfinite(march.unstable_at), jnp.minimum(length, _to_loss(march)), length)


def _clear(stance: SpaceStance, tangent: Point) -> Scalar:
    """Length of a step in which free whiskers cannot pass through the object unnoticed."""
    speed = jnp.maximum(stance.speed * jnp.abs(tangent.u), 1e-12)
    return jnp.min(jnp.where(stance.free, stance.advance / speed, jnp.inf))


def _is_over(problem: SpaceProblem, march: March, trial: SpaceTrial) -> Bool[Array, ""]:
    """Whether all whiskers have passed the object and cannot meet it again: the drive moves on along a line."""
    distance = trial.stance.nearest.distance
    if problem.ends is not None:
        return jnp.asarray(False)
    leaves = jnp.all((distance > march.stance.nearest.distance) & (distance > PASSED))
    return jnp.all(march.phase == Phase.free) & march.touched & (march.goal > 0) & (march.goal >= trial.last) & leaves


def after_event(problem: SpaceProblem, march: March, trial: SpaceTrial) -> Outcome:
    """Handle the point where a margin vanishes."""
    point, tangent, phase, converged = trial.point, trial.tangent, trial.phase, trial.solution.converged
    target, scale = march.target, scale_of(march.point.z)
    touches = target.whiskers & (target.margin == TOUCH)
    z_before = jnp.where(touches[:, None], march.point.z, point.z)
    chord = without_traction(Point(z_before - march.point.z, point.u - march.point.u))
    distance, reach = dot(march.tangent, chord, scale), jnp.sqrt(dot(chord, chord, scale))
    forwards = jnp.where(dot(tangent, without_traction(march.tangent), scale) > 0, 1.0, -1.0)
    arriving = select(jnp.any(touches), march.tangent, Point(forwards * tangent.z, forwards * tangent.u))
    # A margin that grows again has vanished before.
    grows = jnp.any(target.whiskers & (_rates(phase, arriving)[target.margin] > 0))
    good = converged & ~grows & (distance > -1e-9) & (reach <= 1.5 * march.step + 1e-6)
    if march.slip is not None:
        # A step without a length solves the equation of a loss, too.
        good &= (target.margin != LOSS) | (distance > 0.1 * target.distance)
    # Where stability is lost before a margin vanishes, the path never gets there.
    beyond = ~trial.stance.stable & ~jnp.any(touches) & (distance > LOSS_BRACKET)
    closer = march._replace(task=jnp.asarray(int(SpaceTask.advance)), step=distance)
    # The whisker may touch with its tip where its shaft was expected to, or the reverse.
    slack = jnp.where(touches, jnp.where(phase == Phase.tip, point.z[:, SLACK], -point.z[:, SLACK]), -1.0)
    other = converged & (slack > MARGIN_NOISE)
    swapped = jnp.where(target.first.phase == Phase.tip, Phase.tangential, Phase.tip)
    first = target.first._replace(
        phase=jnp.where(other, swapped, target.first.phase),
        contact=target.first.contact.at[:, SLACK].multiply(~other),
    )
    again = march._replace(
        task=jnp.asarray(int(SpaceTask.advance)), step=0.5 * jnp.minimum(march.step, target.distance)
    )
    # Another margin may vanish before: events close to each other are told apart only here.
    kinds_of_margins = 4 if march.slip is None else 6
    of_drive = (target.margin == AT_STOP) | (target.margin == LOSS)
    own = (jnp.arange(kinds_of_margins) == target.margin)[:, None] & (target.whiskers | of_drive)
    if march.slip is not None:
        # The path does not go on in this direction where a contact begins, and turns at corners as it leaves them.
        own = own.at[LOSS].set(own[LOSS] | jnp.any(touches) | (distance < LOSS_BRACKET))
    missed, earlier = _first_violated(march, trial, reach, own | touches)
    tip = jnp.any(target.whiskers & (phase == Phase.tip))
    slip, sticks, loss = march.slip, False, jnp.asarray(False)
    if slip is not None:
        loss = target.margin == LOSS
        sticks = jnp.any(target.whiskers & (slip.mode == SlipMode.sticks))
        heading = jnp.sign(trial.stops[jnp.minimum(march.goal + 1, trial.last)] - point.u)
        turns = (target.margin == AT_STOP) & (march.goal < trial.last) & (heading == -march.direction)
        slip = slip_after(slip, target.whiskers & (target.margin == GRIP), turns, touches)
        traction = first_traction(speeds(problem.surface, point.z, phase, tangent.z))
        point = with_traction(point, jnp.where(touches[:, None], traction, point.z[:, TRACTION]))
    kinds = jnp.array([
        EventKind.touch,
        EventKind.release,
        jnp.where(tip, EventKind.tip_to_tangential, EventKind.tangential_to_tip),
        STOP,
        jnp.where(sticks, EventKind.slip, EventKind.stick),
    ])  # fmt: skip
    swaps = target.whiskers & (target.margin == PHASE)
    after = jnp.where(swaps, jnp.where(phase == Phase.tip, Phase.tangential, Phase.tip), phase)
    after = jnp.where(target.whiskers & (target.margin == RELEASE), Phase.free, after)
    node = node_at(march, point, arriving, trial.solution.points)
    node = node._replace(z_before=z_before, phase=after, kind=kinds[target.margin], whiskers=target.whiskers)
    node = node._replace(travel=jnp.where((target.margin == AT_STOP) & (march.goal == 0), 0.0, node.travel))
    arrived = march._replace(
        task=jnp.asarray(int(SpaceTask.arrive)),
        phase=after,
        point=point,
        pending=node,
        stance=trial.stance,
        travel=node.travel,
        goal=march.goal + (target.margin == AT_STOP),
        touched=march.touched | jnp.any(touches),
        slip=slip,
    )
    cases = [
        (jnp.any(other), march._replace(target=target._replace(first=first))),
        (~good & (again.step < SHORTEST_STEP), march.stopped(Status.lost)),
        (~good, again),
        (beyond, _before_loss(closer, trial.stance.stiffness)),
        (missed, march._replace(target=earlier)),
    ]
    if slip is not None:
        at_loss = march._replace(point=point, tangent=arriving, stance=trial.stance, travel=node.travel)
        # The drive may turn at once, or contacts may neither stick nor slip.
        lost = ~good & (again.step < SHORTEST_STEP) & jnp.any(march.phase != Phase.free)
        cases[1:1] = [
            (loss & ~good & (march.step < LOSS_BRACKET), sliding(problem, march)),
            (lost, settling(problem, march)),
        ]
        cases.append((loss, sliding(problem, at_loss)))
        plain = node_at(march, point, arriving, trial.solution.points)
        node = select(loss, plain, node)
    return first_case(*cases, otherwise=arrived), loss & good & ~missed, node


def after_arrive(problem: SpaceProblem, march: March, trial: SpaceTrial) -> Outcome:
    """Handle the point of an event in its new phase: leave along the path."""
    point, tangent, stance, last = trial.point, trial.tangent, trial.stance, trial.last
    margin, stop_kind = march.target.margin, march.pending.kind == STOP
    heading = jnp.sign(trial.stops[jnp.minimum(march.goal, last)] - march.point.u)
    turned = stop_kind & (march.goal <= last) & (heading != 0)
    direction = jnp.where(turned, heading, march.direction)
    # The condition makes the force or the slack grow; a tangential contact that becomes a tip contact loses slack.
    back = (margin == PHASE) & jnp.any(march.target.whiskers & (march.phase == Phase.tip))
    by_control = (margin == RELEASE) | (margin == AT_STOP) | (margin == SNAP)
    if march.slip is not None:
        assert stance.grip is not None
        slips = jnp.any(march.target.whiskers & (march.slip.mode == SlipMode.slips))
        back |= (margin == GRIP) & slips & jnp.any(march.target.whiskers & (stance.grip < 0))
        by_control |= (margin == GRIP) & ~slips
    sign = jnp.where(by_control, jnp.where(tangent.u * direction < 0, -1.0, 1.0), jnp.where(back, -1.0, 1.0))
    tangent = Point(sign * tangent.z, sign * tangent.u)
    z = jnp.where(stance.free[:, None], stance.nearest.contact, point.z)
    node = march.pending._replace(point=Point(z, point.u), leaving=tangent)
    falls, snapped, changed = tangent.u * direction <= 0, margin == SNAP, None
    stable, size, leaving = stance.stable, stance.stiffness, None
    if march.slip is not None:
        slip, grip = slip_at_corner(problem, march.slip, march.phase, point, tangent)
        stance = stance._replace(grip=grip)
        changed = jnp.any(slip.mode != march.slip.mode)
        leaving = march.slip._replace(changes=jnp.asarray(0), at_corner=jnp.asarray(True))
    onwards = march._replace(
        task=jnp.asarray(int(SpaceTask.advance)),
        point=node.point,
        tangent=tangent,
        bend=jax.tree.map(jnp.zeros_like, tangent),
        stance=stance,
        step=jnp.minimum(FIRST_STEP if march.slip is None else FIRST_STEP / 4, _clear(stance, tangent)),
        direction=direction,
        size=size,
        unstable_at=jnp.asarray(jnp.inf),
        unstable_size=jnp.asarray(-1.0),
        slip=leaving,
    )
    over = stop_kind & (march.goal > last)
    deep = stance.free & (stance.nearest.distance < -INSIDE)
    inside = jnp.any(deep)
    cases = [
        (~trial.solution.converged | (inside & ~snapped), march.stopped(Status.lost)),
        (inside, clinging(march, deep)),
        (~stance.opens, march.stopped(Status.not_convex)),
        (over, march.stopped(Status.ok)),
        (snapped & ~stable, march.stopped(Status.unsettled)),
        # A loss at a corner: the path would have to go back.
        (falls | ~stable, sliding(problem, onwards)),
    ]
    write = trial.solution.converged & ~inside & stance.opens
    if changed is not None:
        again, often = march._replace(slip=slip), slip.changes > 2 * march.phase.size
        cases[4:4] = [(changed & often, settling(problem, onwards)), (changed, again)]
        write &= ~changed | often | over
    return first_case(*cases, otherwise=onwards), write, node
