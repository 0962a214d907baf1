"""What the march asks of whiskers with several contacts."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.approach import all_free, limits_of
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.gaps import Candidate
from jaxwhisker._chain.march_state import (
    AT_STOP,
    HIGH,
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
    inserted,
    removed,
)
from jaxwhisker._chain.newton import ChainSolution, evaluate, of_whiskers, solve_points
from jaxwhisker._chain.polygons import corner_signs
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.rod_flow import flow, landing_of, rods_of
from jaxwhisker._chain.shaft import BaseAt, point_at
from jaxwhisker._chain.stance import bases_of, shafts_of, stance_of
from jaxwhisker._equilibrium.contact import FORCE, PARAMETER, SLACK, Phase, of_each
from jaxwhisker._equilibrium.point import PathCondition, Point, along, at_arc_length, dot, scale_of, unit
from jaxwhisker._path.approach import crop
from jaxwhisker._path.continuation import Arrival, Continuation, Loss, TargetPoint, WaysOn
from jaxwhisker._path.march_state import Target, Task
from jaxwhisker._path.margins import FAR, Margins, first_crossed, first_dip
from jaxwhisker._path.path import NO_EVENT, STOP, EventKind, Node, Status, first_case, select
from jaxwhisker._path.transitions import FIRST_STEP

LONGEST_STEP = 0.1  # lengths
LOSS_BRACKET = 2e-6  # distance along the path within which a loss is located; its control to the square of it
TOUCHING = 2e-9  # depth of a shaft that counts as a touch: one that has just been released is at 0
BEHIND = 1e-6  # distance by which an event may lie behind the step in which it is noticed
PASSED = 0.25  # lengths from the object at which a scan right across it ends
MARGIN_NOISE = 1e-11
RATE_NOISE = 1e-9
NODES = 400  # for every whisker on every leg of the drive, and as many more
ITERATIONS = 60000  # a march that needs more ends as `too_long`
# Distances of the control behind a loss at which rods flow, dimensionless: coarse rods may still be stable close to it.
BEYOND = (3e-3, 2e-2, 1e-1)
SLIPS = 0.02  # along the path, from where a contact slips over an end
SAME = 1e-3  # difference of contacts that have not gone anywhere
TRIES = 6  # of the contacts in which whiskers come to rest
DEEP = 1e-7  # lengths: depth of a shaft where whiskers have come to rest in the wrong contacts
AT_BASE = 0.02  # lengths from the base: forces grow without bound where a contact gets there
OF_ROWS = (RELEASE, PHASE, LOW, HIGH)  # kinds of margins that belong to existing contacts
CLOSE = 1e-6  # length of a step within which a contact begins that there is no room for


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
        new = NewContact(zero, jnp.zeros(3), zero, one, zero)
        count = sum(3 if one.has_edges else 2 for one in problem.profile.objects)
        unknown = jnp.zeros((problem.length.size, count)), jnp.zeros(problem.length.size)
        stance = ChainStance(*unknown, jnp.asarray(True), one)
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
            flow=ChainFlow(jnp.asarray(0.0), z, start, zero),
            count=zero,
            status=jnp.asarray(int(Status.ok)),
            rate=one,
            unstable_rate=-one,
            touched=jnp.asarray(False),
            slips=jnp.asarray(False),
        )

    # A step.

    def trial(self, march: MarchOfChain, stops, last) -> TrialOfChain:
        problem, stop, target = self.problem, stops[jnp.minimum(march.goal, last)], march.target
        locating = march.task == Task.event
        begins = locating & (target.number == TOUCH)
        distance = jnp.where(locating, target.distance, march.step)
        moves = (march.task == Task.advance) | locating
        guess = select(moves, along(march.point, march.tangent, distance, march.bend), march.point)
        more = inserted(guess.z, march.state, target.first, problem.contacts)
        z, state = select(begins, more, (guess.z, march.state))
        guess = guess._replace(z=z)
        solution = solve_points(problem, state, self._condition(march, stop), guess)
        point, newton = solution.point, solution.newton
        tangent, length = unit(newton.tangent, point.z)
        stance, candidates = stance_of(problem, point.u, newton.pose, point.z, state)
        ahead = dot(tangent, march.tangent, scale_of(march.point.z))
        forwards = jnp.where(locating & (ahead < 0), -1.0, 1.0)
        stable = begins | (march.direction * forwards * tangent.u > 0)
        onwards = self._gap_grows(march, solution, jnp.sign(tangent.u) * march.direction / length)
        arrives = (onwards | (target.number != RELEASE)) & ~march.slips
        stable = jnp.where(march.task == Task.arrive, arrives, stable)
        return TrialOfChain(solution, tangent, stance, candidates, guess, state, stop, jnp.asarray(last), stable)

    def _gap_grows(self, march: MarchOfChain, solution: ChainSolution, sign: Scalar) -> Bool[Array, ""]:
        """Whether the contact that has just been released opens as the drive moves on."""
        problem, node, row = self.problem, march.pending, jnp.argmax(march.target.whiskers)
        whisker = row // problem.contacts
        slack = jnp.where(node.before.phase[row] == Phase.tip, 0.0, node.z_before[row, SLACK])
        at = problem.profile.point_on(node.before.piece[row], node.z_before[row, 1])
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

    def _condition(self, march: MarchOfChain, stop: Scalar) -> PathCondition:
        """The equation of the task."""
        target, none = march.target, jnp.zeros_like(march.point.z)
        locating = march.task == Task.event
        assert target.limit is not None
        of_force = (target.number == TOUCH) | ((target.number == RELEASE) & locating)
        of_slack, of_parameter = target.number == PHASE, (target.number == LOW) | (target.number == HIGH)
        rows = jnp.where(target.number == TOUCH, jnp.arange(none.shape[0]) == target.first.row, target.whiskers)
        by_control = ~of_force & ~of_slack & ~of_parameter
        weight = none.at[:, FORCE].set(rows * of_force).at[:, SLACK].set(rows * of_slack)
        weight = weight.at[:, PARAMETER].set(rows * of_parameter)
        z0 = none.at[:, SLACK].set(jnp.where(of_slack & locating, target.limit, 0.0))
        z0 = z0.at[:, PARAMETER].set(jnp.where(of_parameter & rows.astype(bool), target.limit, 0.0))
        u = jnp.where(locating, stop, march.point.u)
        at_event = PathCondition(weight, z0, by_control.astype(float), u, none[:, 0])
        ahead = at_arc_length(march.point, march.tangent, march.step)
        return select(march.task != Task.advance, at_event, ahead)

    def node(self, march: MarchOfChain, trial: TrialOfChain):
        return march.node(trial.point, trial.tangent)

    def moved(self, march: MarchOfChain, trial: TrialOfChain, moved: MarchOfChain) -> MarchOfChain:
        return moved.replace(
            stance=trial.stance,
            rate=march.drive_rate(trial.tangent),
            unstable_at=jnp.where(march.unstable_at > march.step, march.unstable_at - march.step, jnp.inf),
            # The Illinois rule keeps false position from creeping.
            unstable_rate=march.unstable_rate / 2,
        )

    # Margins.

    def margins(self, march: MarchOfChain, z: Array, u: Scalar, stance: ChainStance, stop: Scalar) -> Margins:
        """Margins of all kinds of events."""
        state = march.state
        free, tip = state.phase == Phase.free, state.phase == Phase.tip
        outermost = jnp.arange(z.shape[0]) % self.problem.contacts == 0
        touch = stance.gap + TOUCHING
        release = jnp.where(free, FAR, z[:, FORCE])
        slack = z[:, SLACK]
        changes = jnp.where(tip, jnp.minimum(-slack, slack + np.pi), slack)
        changes = jnp.where(outermost & ~free, changes, FAR)
        (low, high), p = self._ends(march), z[:, PARAMETER]
        below, above = jnp.where(free, FAR, p - low), jnp.where(free, FAR, high - p)
        return touch, release, changes, below, above, jnp.reshape(march.direction * (stop - u), 1)

    def _ends(self, march: MarchOfChain) -> tuple[Array, Array]:
        """Parameters at which the pieces of all contacts begin and end."""
        profile = self.problem.profile
        return profile.ends_on(jnp.where(march.state.touches, march.state.piece, 0))

    def rates(self, march: MarchOfChain, tangent: Point) -> Margins:
        """Rates of the margins along the path, those of forces and slacks of contacts only."""
        state, slack = march.state, tangent.z[:, SLACK]
        free, tip = state.phase == Phase.free, state.phase == Phase.tip
        backwards = march.point.z[:, SLACK] < -np.pi / 2
        slack = jnp.where(tip & ~backwards, -slack, slack)
        outermost = jnp.arange(slack.size) % self.problem.contacts == 0
        still = jnp.zeros_like(march.stance.gap)
        force = jnp.where(free, 0.0, tangent.z[:, FORCE])
        along = jnp.where(free, 0.0, tangent.z[:, PARAMETER])
        return still, force, jnp.where(outermost & ~free, slack, 0.0), along, -along, jnp.zeros(1)

    def first_violated(self, march: MarchOfChain, trial: TrialOfChain, distance):
        return self._first_violated(march, trial, distance, None)

    def _first_violated(self, march: MarchOfChain, trial: TrialOfChain, distance, ignored):
        problem = self.problem
        here = self.margins(march, march.point.z, march.point.u, march.stance, trial.stop)
        z = self._z_before(march, trial)
        there = self.margins(march, z, trial.point.u, trial.stance, trial.stop)
        crossed = first_crossed(here, there, MARGIN_NOISE, problem.rows, (TOUCH, AT_STOP), ignored)
        new = self._new_contact(march, z, trial.candidates, jnp.minimum(crossed.entry, here[0].size - 1))
        touches = crossed.number == TOUCH
        rows = jnp.where(touches, jnp.arange(problem.rows) == new.row, crossed.whiskers)
        limit = jnp.where((march.state.phase == Phase.tip) & (z[:, SLACK] < -np.pi / 2), -np.pi, 0.0)
        low, high = self._ends(march)
        limit = jnp.where(crossed.number == LOW, low, jnp.where(crossed.number == HIGH, high, limit))
        return crossed.some, Target(crossed.number, rows, crossed.share * distance, new, limit)

    def _new_contact(self, march: MarchOfChain, z: Array, candidates: Candidate, entry: Array) -> NewContact:
        """The contact of a candidate, by its number among those of all whiskers."""
        problem, count = self.problem, candidates.gap.shape[1]
        own = jax.tree.map(lambda leaf: jnp.reshape(leaf, (-1, *leaf.shape[2:]))[entry], candidates)
        whisker = entry // count
        phase, slack = (values[whisker] for values in of_whiskers(problem, (march.state.phase, z[:, SLACK])))
        beyond = jnp.where(phase == Phase.tip, 0.0, slack)
        new = jnp.where(own.phase == Phase.tip, 0.0, own.numbers[SLACK])
        place = jnp.sum((phase != Phase.free) & (beyond < new))
        # A contact at the tip comes first.
        place = jnp.where(own.phase == Phase.tip, 0, place)
        row = whisker * problem.contacts + jnp.minimum(place, problem.contacts - 1)
        return NewContact(row, own.numbers, own.phase, own.side, own.piece)

    def _is_full(self, march: MarchOfChain, row: Array) -> Bool[Array, ""]:
        """Whether the whisker of a row has no room for another contact."""
        touching = jnp.sum(of_whiskers(self.problem, march.state.touches), axis=1)
        return touching[row // self.problem.contacts] == self.problem.contacts

    def before_loss(self, march: MarchOfChain, trial: TrialOfChain, distance):
        again = jnp.isfinite(march.unstable_at)
        rate = jnp.where(again, march.rate / 2, march.rate)
        closer = march.replace(unstable_at=distance, unstable_rate=march.drive_rate(trial.tangent), rate=rate)
        return closer.replace(step=_to_loss(closer))

    # The end of a step along the path.

    def accepts(self, march: MarchOfChain, trial: TrialOfChain):
        return trial.converged, jnp.inf

    def dip(self, march: MarchOfChain, trial: TrialOfChain, violated):
        straight = dot(march.tangent, trial.tangent, scale_of(march.point.z))
        end = Point(trial.tangent.z / straight, trial.tangent.u)
        here = self.margins(march, march.point.z, march.point.u, march.stance, trial.stop)
        there = self.margins(march, trial.point.z, trial.point.u, trial.stance, trial.stop)
        leaving, arriving = (self.rates(march, tangent) for tangent in (march.tangent, end))
        dips, share = first_dip(here, there, leaving, arriving, march.step, MARGIN_NOISE)
        return dips & ~violated, share

    def loss(self, march: MarchOfChain, trial: TrialOfChain):
        return Loss(trial.stable, jnp.asarray(march.step < LOSS_BRACKET))

    def after_loss(self, march: MarchOfChain, moved: MarchOfChain, trial: TrialOfChain, node, loss):
        return self.to_snap(march)

    def ends(self, march: MarchOfChain, trial: TrialOfChain, loss, turned: MarchOfChain):
        tangential = march.state.phase == Phase.tangential
        length = jnp.repeat(self.problem.length, self.problem.contacts)
        beyond = trial.point.z[:, SLACK] > (1 - AT_BASE) * length
        return [
            (self._has_passed(march, trial), march.stopped(Status.ok)),
            (~trial.stance.opens, march.stopped(Status.not_convex)),
            (jnp.any(tangential & beyond), march.stopped(Status.lost)),
        ]

    def _has_passed(self, march: MarchOfChain, trial: TrialOfChain) -> Bool[Array, ""]:
        """Whether all whiskers have passed the objects and cannot meet them again: the drive moves on along a line."""
        if self.problem.ends is not None:
            return jnp.asarray(False)
        here, there = march.stance.distance, trial.stance.distance
        leaves = jnp.all((there > here) & (there > PASSED)) & ~jnp.any(march.state.touches)
        far = march.direction * (trial.point.u - self._far()) > 0
        return march.touched & (march.goal > 0) & (march.goal >= trial.last) & leaves & far

    def _far(self) -> Scalar:
        """A control beyond which whiskers have passed the lowest points of all objects."""
        problem = self.problem
        base = problem.in_scene(jnp.zeros(()), problem.rest)
        lowest = jnp.stack([jnp.asarray(one.vertex()[0], dtype=float) for one in problem.profile.objects])
        way = problem.onwards.astype(float)
        return way * (jnp.max(way * lowest) - jnp.min(way * base.x)) + way * jnp.max(problem.length)

    def written(self, march: MarchOfChain, trial: TrialOfChain, node, loss: Loss):
        # While all whiskers are free, nothing happens between events.
        return trial.stable & trial.stance.opens & jnp.any(march.state.touches), node

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

    def _begins(self, march: MarchOfChain) -> Bool[Array, ""]:
        return (march.task == Task.event) & (march.target.number == TOUCH)

    def _z_before(self, march: MarchOfChain, trial: TrialOfChain) -> Array:
        """Contacts on arrival at the end of a step: without one that begins there."""
        rows = (jnp.arange(self.problem.rows) == march.target.first.row) & self._begins(march)
        return removed(trial.point.z, trial.state, rows, self.problem.contacts)[0]

    def _direction(self, march: MarchOfChain, trial: TrialOfChain) -> Point:
        """The direction in which the path arrives at an event."""
        ahead = dot(trial.tangent, march.tangent, scale_of(march.point.z))
        forwards = jnp.where(ahead > 0, 1.0, -1.0)
        solved = Point(forwards * trial.tangent.z, forwards * trial.tangent.u)
        bent = along(Point(march.tangent.z, march.tangent.u), march.bend, march.target.distance)
        bent, _ = unit(bent, march.point.z)
        return select(self._begins(march), bent, solved)

    def found(self, march: MarchOfChain, trial: TrialOfChain) -> TargetPoint:
        target, scale = march.target, scale_of(march.point.z)
        begins = self._begins(march)
        z = self._z_before(march, trial)
        chord = Point(z - march.point.z, trial.point.u - march.point.u)
        distance, reach = dot(march.tangent, chord, scale), jnp.sqrt(dot(chord, chord, scale))
        rates = self.rates(march, self._direction(march, trial))
        own = jnp.stack([rates[kind] for kind in OF_ROWS])[jnp.clip(target.number - OF_ROWS[0], 0, len(OF_ROWS) - 1)]
        grows = ~begins & (target.number != AT_STOP) & jnp.any(target.whiskers & (own > 0))
        good = trial.converged & ~grows & (distance > -BEHIND) & (reach <= 1.5 * march.step + 1e-6)
        # The contact that begins must be as it was expected to be.
        new = trial.point.z[target.first.row, SLACK]
        tip = target.first.phase == Phase.tip
        good &= ~(begins & self._is_full(march, target.first.row))
        good &= ~begins | jnp.where(
            tip, new < MARGIN_NOISE, (new > -MARGIN_NOISE) & (new < self._length(target.first.row))
        )
        ignored = [
            jnp.zeros_like(trial.stance.gap, bool),
            *((target.number == kind) & target.whiskers for kind in OF_ROWS),
            jnp.reshape(target.number == AT_STOP, 1),
        ]
        violated, earlier = self._first_violated(march, trial, reach, ignored)
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
        other = self._begins(march) & trial.converged & (jnp.where(tip, slack, -slack) > MARGIN_NOISE)
        phase = jnp.where(tip, int(Phase.tangential), int(Phase.tip))
        changed = first._replace(phase=phase, numbers=first.numbers.at[SLACK].set(0.0))
        again = march.replace(target=march.target._replace(first=changed))
        full = self._begins(march) & self._is_full(march, first.row)
        one = self.problem.contacts == 1
        ended = march.stopped(Status.second_contact if one else Status.too_many_contacts)
        return [(full & (march.step < CLOSE), ended), (other & ~full, again)], []

    def event_node(self, march: MarchOfChain, trial: TrialOfChain, found):
        problem, target, state, z = self.problem, march.target, trial.state, trial.point.z
        number, rows = target.number, target.whiskers
        assert target.limit is not None
        gone = removed(z, state, rows & (number == RELEASE), problem.contacts)
        tip, changes = state.phase == Phase.tip, rows & (number == PHASE)
        signs = corner_signs(problem.profile)
        at_corner = signs[jnp.where(state.touches, state.piece, 0)] > 0
        # A corner of an object that slips off the tip, and a tip that slides over a corner.
        changes &= tip | ~at_corner
        way = jnp.where(number == LOW, -1, jnp.where(number == HIGH, 1, 0))
        next_piece = jnp.clip(state.piece + way, 0, signs.size - 1)
        passes = rows & (way != 0) & jnp.where(tip, signs[next_piece] <= 0, signs[next_piece] >= 0)
        other = jnp.where(tip, int(Phase.tangential), int(Phase.tip))
        turned = changes & (target.limit < 0)
        changed = (
            z.at[:, SLACK].set(jnp.where(changes, 0.0, z[:, SLACK])),
            state._replace(
                phase=jnp.where(changes, other, state.phase),
                side=jnp.where(turned, -state.side, state.side),
                piece=jnp.where(passes, next_piece, state.piece),
            ),
        )
        z_after, after = select(number == RELEASE, gone, changed)
        changed_phase = int(EventKind.tip_to_tangential), int(EventKind.tangential_to_tip)
        edge = int(EventKind.edge)
        kinds = jnp.array([int(EventKind.touch), int(EventKind.release), 0, edge, edge, STOP])
        kinds = kinds.at[PHASE].set(jnp.where(jnp.any(tip & rows), *changed_phase))
        node = march.node(trial.point, self._direction(march, trial))
        return jnp.asarray(False), node._replace(
            point=Point(z_after, trial.point.u),
            z_before=self._z_before(march, trial),
            state=after,
            kind=kinds[number],
        )

    def arriving(self, march: MarchOfChain, trial: TrialOfChain, arriving: MarchOfChain):
        number, before = march.target.number, march.state
        same = jnp.all((arriving.state.phase == before.phase) & (arriving.state.piece == before.piece))
        slips = same & ((number == PHASE) | (number == LOW) | (number == HIGH))
        return arriving.replace(stance=trial.stance, touched=march.touched | self._begins(march), slips=slips)

    # The point of an event in its new state.

    def leaves(self, march: MarchOfChain, trial: TrialOfChain, direction):
        # The condition makes the force or the slack grow; a tangential contact that becomes a tip contact loses slack.
        number = march.target.number
        tip = jnp.any(march.target.whiskers & (march.state.phase == Phase.tip))
        along_drive = jnp.where(trial.tangent.u * direction < 0, -1.0, 1.0)
        back = ((number == PHASE) & tip) | (number == LOW)
        by_condition = (number == TOUCH) | (number == PHASE) | (number == LOW) | (number == HIGH)
        return jnp.where(by_condition, jnp.where(back, -1.0, 1.0), along_drive)

    def leaving(self, march: MarchOfChain, trial: TrialOfChain, onwards: MarchOfChain, sign):
        onwards = onwards.replace(unstable_rate=jnp.asarray(-1.0))
        onwards = onwards.replace(rate=onwards.drive_rate(onwards.tangent))
        return onwards.replace(step=jnp.minimum(FIRST_STEP, self._clear(onwards)))

    def arrived(self, march: MarchOfChain, trial: TrialOfChain, node, falls):
        del falls
        snapped, converged = march.target.number == SNAP, trial.converged
        at_loss = march.point.u == march.flow.u
        onwards = march.replace(point=trial.point._replace(u=march.flow.u))
        revised, wrong = self._revised_landing(march, trial)
        before = march.pending
        same = (
            jnp.where(state_differs(march.state, before.before), jnp.inf, 0.0)
            + jnp.max(jnp.abs(trial.point.z - before.z_before) / scale_of(before.z_before))
        ) < SAME
        stays = snapped & at_loss & same
        again = march.flow.tries < TRIES
        return Arrival(
            node,
            converged & trial.stance.opens & (~snapped | (at_loss & ~wrong & ~same)),
            [
                (snapped & converged & wrong & again, revised),
                (snapped & (~converged | wrong) | stays, self._flow_again(march)),
                (snapped & ~at_loss, onwards),
                (~converged, march.stopped(Status.lost)),
                (~trial.stance.opens, march.stopped(Status.not_convex)),
            ],
        )

    def _revised_landing(self, march: MarchOfChain, trial: TrialOfChain) -> tuple[MarchOfChain, Bool[Array, ""]]:
        """Contacts in which whiskers may rest instead of those that pull, or have the wrong phase, or are missing."""
        problem, state, z = self.problem, march.state, trial.point.z
        margins = self.margins(march, z, trial.point.u, trial.stance, trial.point.u + march.direction)
        pulls, other = margins[RELEASE] < -MARGIN_NOISE, margins[PHASE] < -MARGIN_NOISE
        deep = jnp.ravel(trial.stance.gap) < -DEEP
        new = self._new_contact(march, z, trial.candidates, jnp.argmin(jnp.ravel(trial.stance.gap)))
        first_pull = pulls & (jnp.cumsum(pulls) == 1)
        less = removed(z, state, first_pull, problem.contacts)
        tip = state.phase == Phase.tip
        phase = jnp.where(other, jnp.where(tip, int(Phase.tangential), int(Phase.tip)), state.phase)
        turned = z.at[:, SLACK].set(jnp.where(other, 0.0, z[:, SLACK])), state._replace(phase=phase)
        more = inserted(z, state, new, problem.contacts)
        full = self._is_full(march, new.row)
        z, state = first_case((jnp.any(pulls), less), (jnp.any(other), turned), otherwise=more)
        flow_ = march.flow._replace(tries=march.flow.tries + 1)
        revised = march.replace(point=march.point._replace(z=z), state=state, flow=flow_)
        only_deep = jnp.any(deep) & ~jnp.any(pulls) & ~jnp.any(other)
        revised = select(only_deep & full, march.stopped(Status.too_many_contacts), revised)
        return revised, jnp.any(pulls) | jnp.any(other) | jnp.any(deep)

    def _flow_again(self, march: MarchOfChain) -> MarchOfChain:
        """The state in which rods flow at a control further behind the loss, or the march ends."""
        farther = march.flow.beyond < BEYOND[-1]
        before, beyond = march.pending, jnp.asarray(BEYOND)
        beyond = beyond[jnp.minimum(jnp.sum(beyond <= march.flow.beyond), len(BEYOND) - 1)]
        flowing = march.replace(
            task=jnp.asarray(int(Task.flow)),
            point=Point(before.z_before, march.flow.u),
            state=before.before,
            flow=march.flow._replace(beyond=beyond, tries=jnp.asarray(0)),
        )
        return select(farther, flowing, march.stopped(Status.unsettled))

    def ways_on(self, march: MarchOfChain, onwards: MarchOfChain, node, trial: TrialOfChain, falls):
        del node, falls
        snapped = march.target.number == SNAP
        return WaysOn([(snapped & ~trial.stable, march.stopped(Status.unsettled))], onwards, jnp.asarray(True))

    def to_snap(self, march: MarchOfChain):
        pending = march.node(march.point, march.tangent)
        # A contact that slips over an end begins to flow beyond it.
        z = march.point.z + jnp.where(march.slips, SLIPS, 0.0) * march.tangent.z
        return march.replace(
            task=jnp.asarray(int(Task.flow)),
            flow=ChainFlow(jnp.where(march.slips, BEYOND[1], BEYOND[0]), z, march.point.u, jnp.asarray(0)),
            pending=pending,
            slips=jnp.asarray(False),
        )

    def after_flow(self, march: MarchOfChain, trial: TrialOfChain):
        problem, begins = self.problem, march.task == Task.flow
        before = march.pending
        u = march.flow.u + march.direction * march.flow.beyond
        at = evaluate(problem, march.flow.start, march.point.u, before.before)
        pose = problem.rest + problem.displacement(at.load)
        shafts = shafts_of(problem, march.point.u, pose, march.flow.start, before.before)
        rods = flow(problem, u, rods_of(problem, shafts, at.load), begins)
        landing = landing_of(problem, u, rods)
        each = of_whiskers(problem, (before.before.touches, landing.state.touches))
        freed = jnp.any(each[0], axis=1) & ~jnp.any(each[1], axis=1)
        kind = jnp.where(jnp.any(freed), int(EventKind.snap_off), int(EventKind.snap_through))
        first = jnp.arange(problem.rows) % problem.contacts == 0
        whiskers = first & jnp.repeat(jnp.where(jnp.any(freed), freed, jnp.any(each[0], axis=1)), problem.contacts)
        landed = march.replace(
            task=jnp.asarray(int(Task.arrive)),
            state=landing.state,
            point=Point(landing.z, u),
            target=march.target._replace(number=jnp.asarray(SNAP), whiskers=jnp.zeros(problem.rows, bool)),
            pending=before._replace(state=landing.state, kind=kind, whiskers=whiskers),
        )
        new = first_case(
            (landing.too_many, march.stopped(Status.too_many_contacts)),
            (~landing.settled, self._flow_again(march)),
            otherwise=landed,
        )
        return new, jnp.asarray(False), march.pending


CLEAR_STEP = 2e-4  # lengths by which free whiskers may move although they might dip into an object


def _to_loss(march: MarchOfChain) -> Scalar:
    """Length of the step that is expected to reach the loss of stability."""
    share = march.rate / (march.rate - march.unstable_rate)
    share = jnp.where(march.unstable_rate < 0, share, 0.5)
    share = jnp.clip(jnp.where(jnp.isfinite(share), share, 0.5), 0.02, 0.98)
    # A last step to the unstable state itself, which false position approaches for ever.
    return march.unstable_at * jnp.where(march.unstable_at < LOSS_BRACKET, 1.0, share)


def state_differs(one: ChainState, other: ChainState) -> Bool[Array, ""]:
    """Whether contacts touch in another way."""
    return jnp.any((one.phase != other.phase) | (one.piece != other.piece))
