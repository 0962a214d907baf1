"""What the march asks of whiskers in space with several contacts."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, dot, scale_of, unit
from jaxwhisker._path.continuation import Arrival, TargetPoint
from jaxwhisker._path.march import any_lane
from jaxwhisker._path.march_state import Target, Task
from jaxwhisker._path.margins import FAR, Margins, first_crossed
from jaxwhisker._path.path import NO_EVENT, STOP, EventKind, Node, Status, select
from jaxwhisker._path.transitions import AT_BASE, FIRST_STEP, LOSS_BRACKET
from jaxwhisker._space.contact import FORCE, POINT, SLACK, UNKNOWNS
from jaxwhisker._space.continuation import PASSED, ContinuationInSpace
from jaxwhisker._space.flow import FIRST_TIME, KICK
from jaxwhisker._space.free import Nearest
from jaxwhisker._space.march_state import AT_STOP, PHASE, RELEASE, SNAP, TOUCH, MarchInSpace
from jaxwhisker._space.problem import of_each
from jaxwhisker._space.slip import SpaceContactState
from jaxwhisker._space.stance import leaves
from jaxwhisker._space.step_length import branches, step_to_loss
from jaxwhisker._space_chain.flow import flow_onwards, sliding
from jaxwhisker._space_chain.march_state import (
    FlowOfChainInSpace,
    NewContactInSpace,
    TrialOfChainInSpace,
    inserted,
    removed,
)
from jaxwhisker._space_chain.newton import MotionOfChain, of_whiskers, outermost, phases_in_flow, solve_points
from jaxwhisker._space_chain.shaft import point_at
from jaxwhisker._space_chain.stance import ChainStanceInSpace, bases_of, chains_of, stance_of, steps_of

NODES = 200  # for every contact on every leg of the drive, and as many more
LONGEST_STEP = 0.1  # lengths
CLEAR_STEP = 2e-4  # lengths by which free whiskers may move although they might dip into an object
MARGIN_NOISE = 1e-11
TOUCHING = 1e-8  # depth of a shaft that counts as a touch: one that has just been released is at 0
BEHIND = 1e-6  # distance by which an event may lie behind the step in which it is noticed
CLOSE = 1e-6  # length of a step within which the march ends: a contact begins that there is no room for
RATE_NOISE = 1e-9  # rates that are rounding errors


class ContinuationOfChainInSpace(ContinuationInSpace):
    """Whiskers in space with several contacts."""

    of_drive = (TOUCH, AT_STOP)

    def checked(self, path):
        return path

    def capacity(self, stops):
        return NODES * (1 + self.rows) * max(1, stops - 1)

    @property
    def rows(self) -> int:
        """Number of contacts that there is room for, of all whiskers."""
        return self.problem.length.size * self.problem.contacts

    def start(self, stops, limits) -> MarchInSpace:
        problem, n, start = self.problem, self.problem.length.size, limits.start
        direction = jnp.where(stops[0] == start, problem.onwards.astype(float), jnp.sign(stops[0] - start))
        z = jnp.zeros((self.rows, UNKNOWNS))
        point, still = Point(z, start), Point(jnp.zeros_like(z), direction)
        nobody, zero, one, good = jnp.zeros(self.rows, bool), jnp.asarray(0), jnp.asarray(1.0), jnp.asarray(True)
        phase = jnp.full(self.rows, int(Phase.free))
        state, kind = SpaceContactState(phase), jnp.asarray(NO_EVENT)
        pending = Node(point, z, still, still, state, state, -jnp.abs(start - stops[0]), kind, nobody)
        places = (n, 2 * len(problem.surface.objects))
        nearest = Nearest(jnp.zeros(places), jnp.zeros((*places, UNKNOWNS)), jnp.zeros(places, int))
        stance = ChainStanceInSpace(nearest, jnp.zeros(n), good, good, one, good, one, good)
        new = NewContactInSpace(zero, jnp.zeros(UNKNOWNS), zero)
        return MarchInSpace(
            task=jnp.asarray(int(Task.arrive)),
            state=state,
            point=point,
            tangent=still,
            bend=jax.tree.map(jnp.zeros_like, still),
            step=jnp.asarray(FIRST_STEP),
            stance=stance,
            size=one,
            unstable_at=jnp.asarray(jnp.inf),
            unstable_size=jnp.asarray(-1.0),
            target=Target(jnp.asarray(AT_STOP), nobody, jnp.asarray(0.0), new),
            pending=pending,
            goal=zero,
            direction=direction,
            travel=pending.travel,
            touched=jnp.asarray(False),
            flow=FlowOfChainInSpace(jnp.asarray(FIRST_TIME), zero, z, z[:, POINT], good, nobody, z, phase),
            slip=None,
            sunk=None,
            count=zero,
            status=jnp.asarray(int(Status.ok)),
        )

    # A step.

    def trial(self, march: MarchInSpace, stops, last) -> Any:
        problem, target, contacts = self.problem, march.target, self.problem.contacts
        stop, locating = stops[jnp.minimum(march.goal, last)], march.task == Task.event
        begins, flows = self._begins(march), march.task == Task.flow
        guess = self.ahead(march, jnp.where(locating, target.distance, march.step))
        more = inserted(guess.z, march.phase, target.first, contacts)
        z, phase = select(begins, more, (guess.z, march.phase))
        guess = guess._replace(z=z)
        motion = MotionOfChain(march.point.z, jnp.where(flows, march.flow.time, 1.0), flows)
        solution = solve_points(problem, phase, self.condition(march, stop), motion, guess)
        tangent, length = unit(solution.newton.tangent, solution.point.z)
        sliding_on = jax.vmap(phases_in_flow)(*of_whiskers(problem, (solution.point.z, phase)))
        phase = jnp.where(flows, jnp.reshape(sliding_on, phase.shape), phase)
        stance = stance_of(problem, solution.point, phase, solution.newton)
        released = (march.task == Task.arrive) & (target.number == RELEASE)
        sign = jnp.sign(tangent.u) * march.direction / length
        grows = jax.lax.cond(
            any_lane(released), lambda: self._gap_grows(march, solution, sign), lambda: jnp.asarray(True)
        )
        stable = (begins | stance.stable) & (grows | ~released)
        return TrialOfChainInSpace(solution, tangent, stance, guess, phase, stop, jnp.asarray(last), stable)

    def _begins(self, march: MarchInSpace) -> Bool[Array, ""]:
        """Whether the march solves for a point at which a contact begins."""
        return (march.task == Task.event) & (march.target.number == TOUCH)

    def _gap_grows(self, march: MarchInSpace, solution, sign: Scalar) -> Bool[Array, ""]:
        """Whether the contact that has just been released opens as the drive moves on."""
        problem, node, row = self.problem, march.pending, jnp.argmax(march.target.whiskers)
        whisker, steps, newton = row // problem.contacts, steps_of(problem), solution.newton
        slack = jnp.where(node.before.phase[row] == Phase.tip, 0.0, node.z_before[row, SLACK])
        out = problem.surface.normal(node.z_before[row, POINT])

        def position(z, u, pose):
            own = chains_of(problem, u, z, march.phase), of_whiskers(problem, march.phase), bases_of(problem, u, pose)
            places = of_each(
                problem,
                lambda body, chain, phase, base, b: point_at(body, steps, chain, phase, base, b),
                *own,
                jnp.full_like(problem.length, slack),
            )
            return places[whisker]

        point, tangent = solution.point, newton.tangent
        rates = sign * tangent.z, sign * jnp.asarray(tangent.u), sign * newton.tangent_pose
        _, moved = jax.jvp(position, (point.z, jnp.asarray(point.u), newton.pose), rates)
        return jnp.sum(moved * out) > -RATE_NOISE

    def after_flow(self, march: MarchInSpace, trial: Any):
        return flow_onwards(self.problem, march, trial, self.new_contact(march, trial.point.z, trial.stance.candidates))

    # Margins.

    def z_before(self, march: MarchInSpace, trial: Any) -> RowsOfContacts:
        rows = (jnp.arange(self.rows) == march.target.first.row) & self._begins(march)
        return removed(trial.point.z, trial.phase, rows, self.problem.contacts)[0]

    def margins(self, march: MarchInSpace, at: Any, stop: Scalar) -> Margins:
        phase = march.phase
        free, tip = phase == Phase.free, phase == Phase.tip
        z = self.z_before(march, at) if isinstance(at, TrialOfChainInSpace) else at.point.z
        touch = jnp.asarray(at.stance.candidates.distance) + TOUCHING
        release = jnp.where(free, FAR, z[:, FORCE])
        slack = jnp.where(free | ~outermost(self.problem), FAR, jnp.where(tip, -z[:, SLACK], z[:, SLACK]))
        return touch, release, slack, jnp.reshape(march.direction * (stop - at.point.u), 1)

    def rates(self, phase: Array, tangent: Point) -> Margins:
        free, slack = phase == Phase.free, tangent.z[:, SLACK]
        slack = jnp.where(phase == Phase.tip, -slack, slack)
        still = jnp.zeros((self.problem.length.size, 2 * len(self.problem.surface.objects)))
        force = jnp.where(free, 0.0, tangent.z[:, FORCE])
        return still, force, jnp.where(free | ~outermost(self.problem), 0.0, slack), jnp.zeros(1)

    def first_violated(self, march: MarchInSpace, trial: Any, distance, solved=None):
        here, there = (self.margins(march, at, trial.stop) for at in (march, trial))
        crossed = first_crossed(here, there, MARGIN_NOISE, self.rows, self.of_drive, solved)
        entry = jnp.minimum(crossed.entry, here[TOUCH].size - 1)
        new = self.new_contact(march, self.z_before(march, trial), trial.stance.candidates, entry)
        rows = jnp.where(crossed.number == TOUCH, jnp.arange(self.rows) == new.row, crossed.whiskers)
        return crossed.some, Target(crossed.number, rows, crossed.share * distance, new)

    def new_contact(
        self, march: MarchInSpace, z: RowsOfContacts, candidates: Nearest, entry: Array | None = None
    ) -> NewContactInSpace:
        """The contact of a candidate, by its number among those of all whiskers; by default the deepest one."""
        contacts, gaps = self.problem.contacts, jnp.asarray(candidates.distance)
        count = gaps.shape[1]
        if entry is None:
            entry = jnp.argmin(jnp.ravel(gaps))
        own = jax.tree.map(lambda leaf: jnp.reshape(leaf, (-1, *leaf.shape[2:]))[entry], candidates)
        whisker, tip = entry // count, own.phase == Phase.tip
        phase, slack = (values[whisker] for values in of_whiskers(self.problem, (march.phase, z[:, SLACK])))
        beyond = jnp.where(phase == Phase.tip, 0.0, slack)
        place = jnp.sum((phase != Phase.free) & (beyond < own.contact[SLACK]))
        # A contact at the tip comes first.
        place = jnp.where(tip, 0, jnp.minimum(place, contacts - 1))
        return NewContactInSpace(whisker * contacts + place, own.contact, own.phase)

    def _is_full(self, march: MarchInSpace) -> Bool[Array, ""]:
        """Whether the whisker that touches has no room for another contact."""
        touching = jnp.all(of_whiskers(self.problem, march.phase) != Phase.free, axis=1)
        return touching[march.target.first.row // self.problem.contacts]

    # The end of a step along the path.

    def accepts(self, march: MarchInSpace, trial: Any):
        good, longest = super().accepts(march, trial)
        # A touch behind a loss of stability must not hide it.
        touches = jnp.any(trial.stance.candidates.distance + TOUCHING < -MARGIN_NOISE)
        return good & ~(touches & ~trial.stable & (march.step > CLOSE)), longest

    def ends(self, march: MarchInSpace, trial: Any, loss, turned: MarchInSpace):
        beyond = trial.point.z[:, SLACK] > (1 - AT_BASE) * jnp.repeat(self.problem.length, self.problem.contacts)
        return [
            (self._is_past(march, trial), march.stopped(Status.ok)),
            (~trial.stance.outside, march.stopped(Status.lost)),
            (~trial.stance.opens, march.stopped(Status.not_convex)),
            (jnp.any((march.phase == Phase.tangential) & beyond), march.stopped(Status.lost)),
        ]

    def _is_past(self, march: MarchInSpace, trial: Any) -> Bool[Array, ""]:
        """Whether all whiskers have passed all objects and cannot meet them again: the drive moves on along a line."""
        if self.problem.ends is not None:
            return jnp.asarray(False)
        here, there = march.stance.distance, trial.stance.distance
        recedes = jnp.all((there > here) & (there > PASSED)) & leaves(self.problem, trial.point.u, march.direction)
        free = jnp.all(march.phase == Phase.free)
        return free & march.touched & (march.goal > 0) & (march.goal >= trial.last) & recedes

    def onwards(self, march: MarchInSpace, moved: MarchInSpace, trial: Any, factor):
        longest = jnp.where(jnp.all(moved.phase == Phase.free), jnp.inf, LONGEST_STEP)
        length = jnp.minimum(jnp.minimum(factor * march.step, longest), self._clear(moved))
        return moved.replace(
            step=jnp.where(jnp.isfinite(moved.unstable_at), jnp.minimum(length, step_to_loss(moved)), length)
        )

    def _clear(self, march: MarchInSpace) -> Float[Array, ""]:
        """Length of a step in which no free whisker passes an object, and no contact where its curvature jumps."""
        free = ~jnp.any(of_whiskers(self.problem, march.phase) != Phase.free, axis=1)
        speed = jnp.maximum(march.stance.speed * jnp.abs(march.tangent.u), 1e-12)
        advance = jnp.where(free, (jnp.maximum(march.stance.distance, 0.0) + CLEAR_STEP) / speed, jnp.inf)
        even = jax.vmap(self.problem.surface.steps_to_joint)(march.point.z[:, POINT], march.tangent.z[:, POINT])
        return jnp.minimum(jnp.min(advance), jnp.min(jnp.where(march.phase == Phase.free, jnp.inf, even)))

    # The point of an event.

    def may_touch_otherwise(self):
        return False

    def found(self, march: MarchInSpace, trial: Any) -> TargetPoint:
        point, target, scale, begins = trial.point, march.target, scale_of(march.point.z), self._begins(march)
        chord = Point(self.z_before(march, trial) - march.point.z, point.u - march.point.u)
        distance, reach = dot(march.tangent, chord, scale), jnp.sqrt(dot(chord, chord, scale))
        # A margin that grows again has vanished before.
        _, force, slack, _ = self.rates(march.phase, self.direction(march, trial))
        own = jnp.where(target.number == RELEASE, force, slack)
        grows = ~begins & (target.number != AT_STOP) & jnp.any(target.whiskers & (own > 0))
        good = trial.converged & ~grows & (distance > -BEHIND) & (reach <= 1.5 * march.step + 1e-6)
        # The contact that begins must be as it was expected to be.
        new, tip = point.z[target.first.row, SLACK], target.first.phase == Phase.tip
        length = self.problem.length[target.first.row // self.problem.contacts]
        as_expected = jnp.where(tip, new < MARGIN_NOISE, (new > -MARGIN_NOISE) & (new < length))
        good &= ~begins | (as_expected & ~self._is_full(march))
        rows = target.whiskers & ~begins
        ignored = [
            jnp.zeros_like(trial.stance.candidates.distance, bool),
            *(rows & (target.number == kind) for kind in (RELEASE, PHASE)),
            jnp.reshape(target.number == AT_STOP, 1),
        ]
        violated, earlier = self.first_violated(march, trial, reach, ignored)
        # Where stability is lost before a margin vanishes, the path never gets there.
        holds = trial.stable | begins | (distance <= LOSS_BRACKET)
        return TargetPoint(good, distance, 0.5 * jnp.minimum(march.step, target.distance), violated, earlier, holds)

    def at_event(self, march: MarchInSpace, trial: Any, found: TargetPoint):
        # Where a whisker touches, its tip may point the other way than where it was expected to touch.
        first, begins = march.target.first, self._begins(march)
        tip, slack = first.phase == Phase.tip, trial.point.z[first.row, SLACK]
        other = begins & trial.converged & (jnp.where(tip, slack, -slack) > MARGIN_NOISE)
        phase = jnp.where(tip, int(Phase.tangential), int(Phase.tip))
        changed = first._replace(phase=phase, contact=first.contact.at[SLACK].set(0.0))
        again = march.replace(target=march.target._replace(first=changed))
        full = begins & self._is_full(march)
        ended = march.stopped(Status.too_many_contacts)
        return [(full & (march.step < CLOSE), ended), (other & ~full, again)], []

    def event_node(self, march: MarchInSpace, trial: Any, found):
        target, phase, z = march.target, trial.phase, trial.point.z
        changes = target.whiskers & (target.number == PHASE)
        other = jnp.where(phase == Phase.tip, int(Phase.tangential), int(Phase.tip))
        turned = z.at[:, SLACK].set(jnp.where(changes, 0.0, z[:, SLACK])), jnp.where(changes, other, phase)
        gone = removed(z, phase, target.whiskers & (target.number == RELEASE), self.problem.contacts)
        z_after, after = select(target.number == RELEASE, gone, turned)
        tip = jnp.any(changes & (phase == Phase.tip))
        change = jnp.where(tip, int(EventKind.tip_to_tangential), int(EventKind.tangential_to_tip))
        kinds = jnp.stack([*map(jnp.asarray, (int(EventKind.touch), int(EventKind.release), change, STOP))])
        return jnp.asarray(False), march.node(trial.point, self.direction(march, trial))._replace(
            point=Point(z_after, trial.point.u),
            z_before=self.z_before(march, trial),
            state=march.state._replace(phase=after),
            kind=kinds[target.number],
        )

    def direction(self, march: MarchInSpace, trial: Any) -> Point:
        # The contact that begins has no rate on arrival.
        begins = self._begins(march)
        solved = select(begins, march.tangent, trial.tangent)
        ahead = dot(solved, march.tangent, scale_of(march.point.z))
        forwards = jnp.where(ahead > 0, 1.0, -1.0)
        return Point(forwards * solved.z, forwards * solved.u)

    def arriving(self, march: MarchInSpace, trial: Any, arriving: MarchInSpace):
        return arriving.replace(stance=trial.stance, touched=march.touched | self._begins(march))

    # The point of an event in its new state.

    def leaving(self, march: MarchInSpace, trial: Any, onwards: MarchInSpace, sign):
        del sign
        return onwards.replace(
            step=jnp.minimum(FIRST_STEP, self._clear(onwards)),
            size=onwards.stance.stiffness,
            unstable_size=jnp.asarray(-1.0),
        )

    def arrived(self, march: MarchInSpace, trial: Any, node, falls):
        del falls
        snapped, stance = march.target.number == SNAP, trial.stance
        deep = jnp.any(stance.candidates.distance < -10 * TOUCHING) | ~stance.outside
        return Arrival(
            node,
            trial.converged & stance.opens & ~deep,
            [
                (~trial.converged, march.stopped(Status.lost)),
                (deep, march.stopped(jnp.where(snapped, int(Status.unsettled), int(Status.lost)))),
                (~stance.opens, march.stopped(Status.not_convex)),
            ],
        )

    def to_snap(self, march: MarchInSpace):
        # A contact whose release leads nowhere would close again ahead: it opens on the way back.
        return sliding(march, jnp.where(march.target.number == RELEASE, -KICK, KICK))

    def after_loss(self, march: MarchInSpace, moved: MarchInSpace, trial: Any, node, loss):
        del moved, node, loss
        # At a fold, contacts slide on in the direction of the path. A bifurcation is symmetric: they may go either way.
        return select(branches(march, trial), march.stopped(Status.undetermined), sliding(march))
