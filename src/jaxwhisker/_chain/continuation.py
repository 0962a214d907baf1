"""What the march asks of whiskers with several contacts."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.approach import all_free, has_passed, limits_of
from jaxwhisker._chain.changes import changed_contacts
from jaxwhisker._chain.contacts import held_of
from jaxwhisker._chain.friction import changed_slips, come_to_rest, is_wedged, slip_rates, with_changed_slips
from jaxwhisker._chain.landing import (
    after_flow,
    flow_again,
    is_back,
    loosened,
    revised_landing,
    strays,
    to_snap,
    to_snap_from_before,
    towards_loss,
)
from jaxwhisker._chain.march_state import (
    AT_STOP,
    HIGH,
    LEAN,
    LOW,
    PHASE,
    RELEASE,
    SNAP,
    TOUCH,
    ChainFlow,
    ChainStance,
    MarchOfChain,
    NewContact,
    TrialOfChain,
)
from jaxwhisker._chain.margins import (
    MARGIN_NOISE,
    TOUCHING,
    begins_at,
    first_violated,
    is_full,
    margin_rates,
    margins_of,
    z_before,
)
from jaxwhisker._chain.newton import of_whiskers
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.trial import solved_trial
from jaxwhisker._equilibrium.contact import FORCE, SLACK, Phase
from jaxwhisker._equilibrium.point import Point, along, dot, scale_of, unit
from jaxwhisker._path.approach import crop
from jaxwhisker._path.continuation import Arrival, Continuation, Loss, TargetPoint, WaysOn
from jaxwhisker._path.march_state import Target, Task
from jaxwhisker._path.margins import first_dip
from jaxwhisker._path.path import NO_EVENT, Node, Status, select
from jaxwhisker._path.transitions import AT_BASE, FIRST_STEP, LOSS_BRACKET, SHORTER

LONGEST_STEP = 0.1  # lengths
BEHIND = 1e-6  # by which an event may lie behind the step before it, and a new contact beyond an end of its piece
NODES = 400  # for every whisker on every leg of the drive, and as many more
ITERATIONS = 60000  # a march that needs more ends as `too_long`
TRIES = 6  # of the contacts in which whiskers come to rest
OF_ROWS = (RELEASE, PHASE, LOW, HIGH, LEAN)  # kinds of margins that belong to existing contacts
CLEAR_STEP = 2e-4  # lengths by which free whiskers may move although they might dip into an object
FORCE_ERROR = 0.5  # largest relative error of the predicted force of a contact that sticks
MOST_SLIPS = 4  # a contact may change its slip so often at an event, for each combination of the others
CLOSE = 1e-6  # length of a step within which the march ends: a contact begins that there is no room for, for example


class ContinuationOfChain(Continuation[MarchOfChain, TrialOfChain]):
    """Whiskers with several contacts."""

    margin_noise, touch, at_stop = MARGIN_NOISE, TOUCH, AT_STOP

    def __init__(self, problem: ChainProblem):
        self.problem = problem

    def limits(self, first_stop):
        return limits_of(self.problem, first_stop)

    def crop(self, path, whole, limits):
        return crop(self.problem.onwards, path, limits, whole)

    def checked(self, path):
        return path

    def capacity(self, stops: int) -> int:
        return NODES * (1 + self.problem.rows) * max(1, stops - 1)

    def room(self, capacity, last):
        del last
        return capacity

    def iterations(self, room):
        del room
        return ITERATIONS

    def start(self, stops, limits) -> MarchOfChain:
        problem, start = self.problem, limits.start
        direction = jnp.where(stops[0] == start, problem.onwards.astype(float), jnp.sign(stops[0] - start))
        z, state = all_free(problem)
        point, still = Point(z, start), Point(jnp.zeros_like(z), direction)
        nobody, zero, one = jnp.zeros(problem.rows, bool), jnp.asarray(0), jnp.asarray(1.0)
        kind = jnp.asarray(NO_EVENT)
        pending = Node(point, z, still, still, state, state, -jnp.abs(start - stops[0]), kind, nobody)
        turns = jnp.ones(1)
        if problem.friction_angle is not None:
            pending = pending._replace(stop=zero, corner=jnp.asarray(False))
            turns = jnp.ones(1 + problem.rows)
        new = NewContact(zero, jnp.zeros(3), zero, one, zero)
        count = sum(3 if one.has_edges else 2 for one in problem.profile.objects)
        unknown = jnp.zeros((problem.length.size, count)), jnp.zeros(problem.length.size)
        stance = ChainStance(*unknown, jnp.asarray(True), jnp.asarray(True), one, jnp.zeros(problem.rows))
        return MarchOfChain(
            task=jnp.asarray(int(Task.arrive)),
            state=state,
            point=point,
            tangent=still,
            bend=jax.tree.map(jnp.zeros_like, still),
            step=jnp.asarray(FIRST_STEP),
            stance=stance,
            unstable_at=jnp.asarray(jnp.inf),
            target=Target(jnp.asarray(AT_STOP), nobody, jnp.asarray(0.0), new, jnp.zeros(problem.rows)),
            goal=zero,
            direction=direction,
            travel=pending.travel,
            pending=pending,
            flow=ChainFlow(zero, z, start, jnp.asarray(-jnp.inf), zero, zero, start, jnp.zeros(problem.length.size)),
            count=zero,
            status=jnp.asarray(int(Status.ok)),
            turns=turns,
            unstable_turns=-turns,
            touched=jnp.asarray(False),
            slips=jnp.asarray(False),
            slips_tried=zero,
            rests=nobody,
            lead=still,
        )

    # A step.

    def trial(self, march: MarchOfChain, stops, last) -> TrialOfChain:
        return solved_trial(self.problem, march, stops, last)

    def node(self, march: MarchOfChain, trial: TrialOfChain):
        return march.node(trial.point, trial.tangent)

    def moved(self, march: MarchOfChain, trial: TrialOfChain, moved: MarchOfChain) -> MarchOfChain:
        return moved.replace(
            stance=trial.stance,
            turns=trial.turns,
            unstable_at=jnp.where(march.unstable_at > march.step, march.unstable_at - march.step, jnp.inf),
            # The Illinois rule keeps false position from creeping.
            unstable_turns=march.unstable_turns / 2,
        )

    # Margins.

    def first_violated(self, march: MarchOfChain, trial: TrialOfChain, distance):
        return first_violated(self.problem, march, trial, distance)

    def before_loss(self, march: MarchOfChain, trial: TrialOfChain, distance):
        again = jnp.isfinite(march.unstable_at)
        turns = jnp.where(again, march.turns / 2, march.turns)
        closer = march.replace(unstable_at=distance, unstable_turns=trial.turns, turns=turns)
        return closer.replace(step=_to_loss(closer))

    # The end of a step along the path.

    def accepts(self, march: MarchOfChain, trial: TrialOfChain):
        # A touch behind a loss of stability must not hide it.
        touches = jnp.any(trial.stance.gap + TOUCHING < -MARGIN_NOISE)
        good = trial.converged & ~(touches & ~trial.stable & (march.step > CLOSE))
        if march.state.friction is not None:
            # Without any force, a contact that sticks satisfies the equations with every lean.
            predicted, force = trial.guess.z[:, FORCE], trial.point.z[:, FORCE]
            size = jnp.maximum(jnp.abs(predicted), march.point.z[:, FORCE])
            sticks = held_of(self.problem.profile, march.state).sticks
            good &= jnp.all(~sticks | (jnp.abs(force - predicted) < FORCE_ERROR * size))
        return good, jnp.inf

    def dip(self, march: MarchOfChain, trial: TrialOfChain, violated):
        straight = dot(march.tangent, trial.tangent, scale_of(march.point.z))
        end = Point(trial.tangent.z / straight, trial.tangent.u)
        here = margins_of(self.problem, march, march.point.z, march.point.u, march.stance, trial.stop)
        there = margins_of(self.problem, march, trial.point.z, trial.point.u, trial.stance, trial.stop)
        leaving, arriving = (margin_rates(self.problem, march, tangent) for tangent in (march.tangent, end))
        dips, share = first_dip(here, there, leaving, arriving, march.step, MARGIN_NOISE)
        return dips & ~violated, share

    def loss(self, march: MarchOfChain, trial: TrialOfChain):
        return Loss(trial.stable, jnp.asarray(march.step < LOSS_BRACKET))

    def after_loss(self, march: MarchOfChain, moved: MarchOfChain, trial: TrialOfChain, node, loss):
        if march.state.friction is None:
            return self.to_snap(march)
        return select(*come_to_rest(self.problem, march, trial), self.to_snap(march))

    def ends(self, march: MarchOfChain, trial: TrialOfChain, loss, turned: MarchOfChain):
        tangential = march.state.phase == Phase.tangential
        length = jnp.repeat(self.problem.length, self.problem.contacts)
        beyond = trial.point.z[:, SLACK] > (1 - AT_BASE) * length
        return [
            (has_passed(self.problem, march, trial), march.stopped(Status.ok)),
            # All equilibria before the end count.
            (~_sound(trial) & (march.step > CLOSE), march.replace(step=SHORTER * march.step)),
            (~trial.stance.outside, march.stopped(Status.lost)),
            (~trial.stance.opens, march.stopped(Status.not_convex)),
            (jnp.any(tangential & beyond), march.stopped(Status.lost)),
        ]

    def written(self, march: MarchOfChain, trial: TrialOfChain, node, loss: Loss):
        # While all whiskers are free, nothing happens between events.
        return trial.stable & _sound(trial) & jnp.any(march.state.touches), node

    def onwards(self, march: MarchOfChain, moved: MarchOfChain, trial: TrialOfChain, factor):
        touching = jnp.any(moved.state.touches)
        length = jnp.minimum(factor * march.step, jnp.where(touching, LONGEST_STEP, jnp.inf))
        length = jnp.minimum(length, self._clear(moved))
        return moved.replace(
            step=jnp.where(jnp.isfinite(moved.unstable_at), jnp.minimum(length, _to_loss(moved)), length)
        )

    def _clear(self, march: MarchOfChain) -> Scalar:
        """Length of a step in which free whiskers cannot pass through an object unnoticed."""
        free = ~jnp.any(of_whiskers(self.problem, march.state.touches), axis=1)
        speed = jnp.maximum(march.stance.speed * jnp.abs(march.tangent.u), 1e-12)
        advance = jnp.maximum(march.stance.distance, 0.0) + CLEAR_STEP
        return jnp.min(jnp.where(free, advance / speed, jnp.inf))

    # The point of an event.

    def _direction(self, march: MarchOfChain, trial: TrialOfChain) -> Point:
        """The direction in which the path arrives at an event."""
        ahead = dot(trial.tangent, march.tangent, scale_of(march.point.z))
        forwards = jnp.where(ahead > 0, 1.0, -1.0)
        solved = Point(forwards * trial.tangent.z, forwards * trial.tangent.u)
        bent = along(Point(march.tangent.z, march.tangent.u), march.bend, march.target.distance)
        return select(begins_at(march), unit(bent, march.point.z)[0], solved)

    def found(self, march: MarchOfChain, trial: TrialOfChain) -> TargetPoint:
        target, scale = march.target, scale_of(march.point.z)
        begins = begins_at(march)
        z, _ = z_before(self.problem, march, trial)
        chord = Point(z - march.point.z, trial.point.u - march.point.u)
        distance, reach = dot(march.tangent, chord, scale), jnp.sqrt(dot(chord, chord, scale))
        rates = margin_rates(self.problem, march, self._direction(march, trial))
        own = jnp.stack([rates[kind] for kind in OF_ROWS if rates[kind].size > 0])[
            jnp.clip(target.number - OF_ROWS[0], 0, len(OF_ROWS) - 1)
        ]
        grows = ~begins & (target.number != AT_STOP) & jnp.any(target.whiskers & (own > 0))
        good = (
            trial.converged
            & ~grows
            & (_sound(trial) | (target.number != AT_STOP))
            & (distance > -BEHIND)
            & (reach <= 1.5 * march.step + 1e-6)
        )
        # The contact that begins must be as it was expected to be.
        new = trial.point.z[target.first.row, SLACK]
        tip = target.first.phase == Phase.tip
        good &= ~(begins & is_full(self.problem, march, target.first.row))
        good &= ~begins | jnp.where(
            tip, new < MARGIN_NOISE, (new > -MARGIN_NOISE) & (new < self._length(target.first.row))
        )
        low, high = self.problem.profile.ends_on(target.first.piece)
        place = trial.stance.parameter[target.first.row]
        good &= ~begins | ((place > low - BEHIND) & (place < high + BEHIND))
        ignored = [
            jnp.zeros_like(trial.stance.gap, bool),
            *((target.number == kind) & target.whiskers[: rates[kind].size] for kind in OF_ROWS),
            jnp.reshape(target.number == AT_STOP, 1),
        ]
        violated, earlier = first_violated(self.problem, march, trial, reach, ignored)
        # Where stability is lost before a margin vanishes, the path never gets there.
        holds = trial.stable | begins | (distance <= LOSS_BRACKET)
        return TargetPoint(good, distance, 0.5 * jnp.minimum(march.step, target.distance), violated, earlier, holds)

    def _length(self, row: Array) -> Scalar:
        return self.problem.length[row // self.problem.contacts]

    def may_touch_otherwise(self):
        return False

    def at_event(self, march: MarchOfChain, trial: TrialOfChain, found: TargetPoint):
        # Where a whisker touches, its tip may point the other way than where it was expected to touch.
        first = march.target.first
        tip, slack = first.phase == Phase.tip, trial.point.z[first.row, SLACK]
        other = begins_at(march) & trial.converged & (jnp.where(tip, slack, -slack) > MARGIN_NOISE)
        phase = jnp.where(tip, int(Phase.tangential), int(Phase.tip))
        changed = first._replace(phase=phase, numbers=first.numbers.at[SLACK].set(0.0))
        again = march.replace(target=march.target._replace(first=changed))
        full = begins_at(march) & is_full(self.problem, march, first.row)
        one = self.problem.contacts == 1
        ended = march.stopped(Status.second_contact if one else Status.too_many_contacts)
        return [(full & (march.step < CLOSE), ended), (other & ~full, again)], []

    def event_node(self, march: MarchOfChain, trial: TrialOfChain, found):
        z_after, after, kind = changed_contacts(self.problem, march, trial)
        node = march.node(trial.point, self._direction(march, trial))
        return jnp.asarray(False), node._replace(
            point=Point(z_after, trial.point.u),
            z_before=z_before(self.problem, march, trial)[0],
            state=after,
            kind=kind,
            **({} if after.friction is None else {"corner": march.target.number != AT_STOP}),
        )

    def arriving(self, march: MarchOfChain, trial: TrialOfChain, arriving: MarchOfChain):
        number, before = march.target.number, march.state
        same = jnp.all((arriving.state.phase == before.phase) & (arriving.state.piece == before.piece))
        slips = same & ((number == PHASE) | (number == LOW) | (number == HIGH))
        return arriving.replace(stance=trial.stance, touched=march.touched | begins_at(march), slips=slips)

    # The point of an event in its new state.

    def leaves(self, march: MarchOfChain, trial: TrialOfChain, direction):
        # The condition makes the force or the slack grow; a tangential contact that becomes a tip contact loses slack.
        number = march.target.number
        tip = jnp.any(march.target.whiskers & (march.state.phase == Phase.tip))
        along_drive = jnp.where(trial.tangent.u * direction < 0, -1.0, 1.0)
        back = ((number == PHASE) & tip) | (number == LOW)
        by_condition = (number == TOUCH) | (number == PHASE) | (number == LOW) | (number == HIGH)
        sign = jnp.where(by_condition, jnp.where(back, -1.0, 1.0), along_drive)
        if march.state.friction is None:
            return sign
        # A contact that begins to slip must do so, and so must changed slips, or their forces must lean less.
        slips = slip_rates(self.problem, march.state, trial.point.z, trial.tangent.z, -jnp.inf)
        begins = jnp.sum(jnp.where(march.target.whiskers, slips, 0.0))
        changes = jnp.sum(march.lead.z * trial.tangent.z) + march.lead.u * trial.tangent.u
        ahead = jnp.where(march.slips_tried > 0, changes, begins)
        return jnp.where((march.slips_tried > 0) | (number == LEAN), jnp.where(ahead < 0, -1.0, 1.0), sign)

    def leaving(self, march: MarchOfChain, trial: TrialOfChain, onwards: MarchOfChain, sign):
        slipping = slip_rates(self.problem, onwards.state, onwards.point.z, onwards.tangent.z)
        turns = jnp.append(onwards.drive_rate(onwards.tangent), slipping)
        moved = jnp.abs(trial.point.u - march.point.u)
        onwards = onwards.replace(turns=turns, unstable_turns=jnp.full_like(turns, -1.0), travel=onwards.travel + moved)
        return onwards.replace(step=jnp.minimum(FIRST_STEP, self._clear(onwards)))

    def arrived(self, march: MarchOfChain, trial: TrialOfChain, node, falls):
        del falls
        snapped, converged, at_loss = march.target.number == SNAP, trial.converged, march.point.u == march.flow.u
        onwards, shorter, closer = towards_loss(march, trial)
        revised, wrong = revised_landing(self.problem, march, trial)
        converged &= ~snapped | wrong | ~strays(self.problem, march, trial)
        same = is_back(march, trial)
        stays, again = snapped & at_loss & same, march.flow.tries < TRIES
        wedged = is_wedged(self.problem, march.state, march.point.z)
        return Arrival(
            node,
            converged & trial.stance.opens & (~snapped | (at_loss & ~wrong & ~same)),
            [
                (snapped & converged & wrong & again, revised),
                (snapped & ~converged & wedged & again, loosened(self.problem, march)),
                (snapped & ~converged & closer, shorter),
                (snapped & (~converged | wrong) | stays, flow_again(march)),
                (snapped & ~at_loss, onwards),
                (~converged & wedged, march.stopped(Status.undetermined)),
                (~converged & (march.slips_tried > 0), to_snap_from_before(march)),
                (~converged, march.stopped(Status.lost)),
                (~trial.stance.opens, march.stopped(Status.not_convex)),
            ],
        )

    def to_snap(self, march: MarchOfChain):
        return to_snap(march)

    def after_flow(self, march: MarchOfChain, trial: TrialOfChain):
        del trial
        return after_flow(self.problem, march)

    def ways_on(self, march: MarchOfChain, onwards: MarchOfChain, node, trial: TrialOfChain, falls):
        problem, tried = self.problem, march.slips_tried
        unsettled = (march.target.number == SNAP) & ~trial.stable, march.stopped(Status.unsettled)
        if march.state.friction is None:
            return WaysOn([unsettled], onwards, jnp.asarray(True))
        changed, slip = changed_slips(problem, march, node.point, node.leaving, falls)
        changed &= ~march.slips
        retry = with_changed_slips(problem, onwards, node, slip, trial.tangent, rest=False)
        exhausted = changed & (tried > MOST_SLIPS**problem.rows), to_snap_from_before(onwards)
        onwards = onwards.replace(slips_tried=jnp.zeros_like(tried), rests=jnp.zeros_like(march.rests))
        return WaysOn([exhausted, (changed, retry), unsettled], onwards, (tried == 0) | ~changed)


def _sound(trial: TrialOfChain) -> Array:
    """Whether objects are where the equations assume them to be: not around a base, nor on both sides of a contact."""
    return trial.stance.opens & trial.stance.outside


def _to_loss(march: MarchOfChain) -> Scalar:
    """Length of the step that is expected to reach the loss of stability."""
    known = (march.unstable_turns < 0) & jnp.isfinite(march.turns)
    share = jnp.where(known, march.turns / (march.turns - march.unstable_turns), jnp.inf)
    share = jnp.min(share)
    share = jnp.clip(jnp.where(jnp.isfinite(share), share, 0.5), 0.02, 0.98)
    # A last step to the unstable state itself, which false position approaches for ever.
    return march.unstable_at * jnp.where(march.unstable_at < LOSS_BRACKET, 1.0, share)
