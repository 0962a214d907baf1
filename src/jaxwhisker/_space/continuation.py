"""What the march asks of whiskers in space; friction.py has what it asks besides with friction."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import PathCondition, Point, along, at_arc_length, dot, scale_of, unit
from jaxwhisker._path.approach import crop
from jaxwhisker._path.continuation import Arrival, Continuation, Loss, TargetPoint, WaysOn
from jaxwhisker._path.march_state import Target, Task
from jaxwhisker._path.margins import FAR, Margins, first_crossed, first_dip
from jaxwhisker._path.path import NO_EVENT, STOP, EventKind, Node, Status, select
from jaxwhisker._path.transitions import AT_BASE, FIRST_STEP, LOSS_BRACKET
from jaxwhisker._space.approach import limits_of
from jaxwhisker._space.contact import AHEAD, FORCE, SLACK, UNKNOWNS, Traction
from jaxwhisker._space.flow import FIRST_TIME, after_flow, clinging, sliding
from jaxwhisker._space.free import Nearest
from jaxwhisker._space.jumps import met_on_the_way
from jaxwhisker._space.march_state import (
    AT_STOP,
    PHASE,
    RELEASE,
    SNAP,
    TOUCH,
    AnyTrialInSpace,
    MarchInSpace,
    SpaceFlow,
    TrialInSpace,
)
from jaxwhisker._space.newton import Equations, SpaceSolution, solve_points
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space.second_contact import until_second_contact
from jaxwhisker._space.slip import ContactMotion, SpaceContactState, without_traction
from jaxwhisker._space.stance import SpaceStance, leaves, stance_of
from jaxwhisker._space.step_length import branches, longest_step, step_to_loss

LONGEST_STEP = 4.0  # lengths; the prediction error keeps nearly all steps far below it
INSIDE = 1e-6  # depth of free whiskers that must not be inside the object
TOUCHING = 1e-9  # depth of a free whisker that counts as a touch: one that has just been released is at 0
PASSED = 0.25  # lengths from the object at which a scan right across it ends
MARGIN_NOISE = 1e-11
NODES = 96  # for every whisker on every leg of the drive, and as many more; a scan of one whisker takes about 60
ITERATIONS = 60000  # a march that needs more ends as `too_long`


class ContinuationInSpace(Continuation[MarchInSpace, TrialInSpace]):
    """Whiskers in space without friction."""

    margin_noise, touch, at_stop = MARGIN_NOISE, TOUCH, AT_STOP
    of_drive: tuple[int, ...] = (AT_STOP,)  # numbers of the events that concern no whisker
    first_step = FIRST_STEP

    def __init__(self, problem: SpaceProblem):
        self.problem = problem

    def limits(self, first_stop):
        return limits_of(self.problem, first_stop)

    def crop(self, path, whole, limits):
        return crop(self.problem.onwards, path, limits, whole)

    def checked(self, path):
        return until_second_contact(self.problem, path)

    def capacity(self, stops: int) -> int:
        return NODES * (1 + self.problem.length.size) * (stops - 1)

    def room(self, capacity, last):
        del last
        return capacity

    def iterations(self, room):
        del room
        return ITERATIONS

    def start(self, stops, limits) -> MarchInSpace:
        problem, n, start = self.problem, self.problem.length.size, limits.start
        direction = jnp.where(stops[0] == start, problem.onwards.astype(float), jnp.sign(stops[0] - start))
        z = jnp.zeros((n, UNKNOWNS)).at[:, AHEAD].set(np.array([1.0, 0.0, 0.0]))
        point, still = Point(z, start), Point(jnp.zeros_like(z), direction)
        nobody, zero, one = jnp.zeros(n, bool), jnp.asarray(0), jnp.asarray(1.0)
        phase, good, unknown = jnp.full(n, int(Phase.free)), jnp.asarray(True), jnp.zeros(n)
        state, kind = SpaceContactState(phase), jnp.asarray(NO_EVENT)
        pending = Node(point, z, still, still, state, state, -jnp.abs(start - stops[0]), kind, nobody)
        stance = SpaceStance(phase == Phase.free, Nearest(unknown, z, phase), unknown, one, good, one, good, None, good)
        return MarchInSpace(
            task=jnp.asarray(int(Task.arrive)),
            state=state,
            point=point,
            tangent=still,
            bend=jax.tree.map(jnp.zeros_like, still),
            step=jnp.asarray(self.first_step),
            stance=stance,
            size=one,
            unstable_at=jnp.asarray(jnp.inf),
            unstable_size=jnp.asarray(-1.0),
            target=Target(jnp.asarray(AT_STOP), nobody, jnp.asarray(0.0), stance.nearest),
            pending=pending,
            goal=zero,
            direction=direction,
            travel=pending.travel,
            touched=jnp.asarray(False),
            flow=SpaceFlow(jnp.asarray(FIRST_TIME), zero, z, nobody, good),
            slip=None,
            sunk=None,
            count=zero,
            status=jnp.asarray(int(Status.ok)),
        )

    # A step.

    def trial(self, march: MarchInSpace, stops, last) -> TrialInSpace:
        stop, target = stops[jnp.minimum(march.goal, last)], march.target
        locating, advancing = march.task == Task.event, march.task == Task.advance
        # A touch is solved for as the contact that begins, without force.
        begins = locating & (target.number == TOUCH) & target.whiskers
        distance = jnp.where(locating, target.distance, march.step)
        phase = jnp.where(begins, target.first.phase, march.phase)
        solution, guess = self.solved(march, self.condition(march, stop), distance, begins, phase)
        point, rate = solution.end, self.rate(march, solution, (advancing | locating) & ~jnp.any(begins))
        _, length = unit(without_traction(rate), point.z)
        tangent = jax.tree.map(lambda leaf: leaf / length, rate)
        stance = self.stance(march, phase, solution, tangent)
        return TrialInSpace(solution, tangent, stance, guess, phase, stop, stops, last)

    def condition(self, march: MarchInSpace, stop: Scalar, by_law: Any = False) -> PathCondition:
        """The equation of the task; `by_law` tells whether the law of the contacts has its own."""
        n, target, none = march.phase.size, march.target, jnp.zeros_like(march.point.z)
        locating = march.task == Task.event
        concerned = target.whiskers.astype(float)
        of_force = (target.number == TOUCH) | ((target.number == RELEASE) & locating)
        of_slack = target.number == PHASE
        of_stop = ~of_force & ~of_slack & ~jnp.asarray(by_law)
        weight = none.at[:, FORCE].set(concerned * of_force).at[:, SLACK].set(concerned * of_slack)
        of_stop |= march.task == Task.flow
        weight = jnp.where(march.task == Task.flow, 0.0, weight)
        u = jnp.where(locating, stop, march.point.u)
        at_event = PathCondition(weight, none, of_stop.astype(float), u, jnp.zeros(n))
        ahead = at_arc_length(march.point, without_traction(march.tangent), march.step)
        return select(march.task != Task.advance, at_event, ahead)

    def ahead(self, march: MarchInSpace, distance: Scalar) -> Point:
        """The point at this distance along the path; events that have been solved for are where the march is."""
        moves = (march.task == Task.advance) | (march.task == Task.event)
        return select(moves, along(march.point, march.tangent, distance, march.bend), march.point)

    def solved(
        self, march: MarchInSpace, condition: PathCondition, distance: Scalar, begins: Bool[Array, " whiskers"], phase
    ) -> tuple[SpaceSolution, Point]:
        """The solved end of a step, and its guess; `begins` are the contacts that begin there."""
        guess = self.ahead(march, distance)
        guess = guess._replace(z=jnp.where(begins[:, None], march.target.first.contact, guess.z))
        flows = march.task == Task.flow
        motion = ContactMotion(march.point.z, Traction(None, flows), jnp.where(flows, march.flow.time, march.step))
        guesses = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], guess)
        return solve_points(self.problem, Equations(phase[None], condition, None, motion), guesses), guess

    def rate(self, march: MarchInSpace, solution: SpaceSolution, moves: Bool[Array, ""]) -> Point:
        """Direction of the path at the end of a step; `moves` tells whether the step leads there along the path."""
        del march, moves
        return solution.newton.tangent

    def stance(self, march: MarchInSpace, phase, solution: SpaceSolution, tangent: Point) -> SpaceStance:
        """The stance at the end of a step."""
        del march, tangent
        return stance_of(self.problem, solution.end, phase, solution.newton.at, None)

    def after_flow(self, march: MarchInSpace, trial: TrialInSpace):
        return after_flow(self.problem, march, trial)

    def node(self, march: MarchInSpace, trial: AnyTrialInSpace):
        return self._node(march, trial, trial.tangent)

    def _node(self, march: MarchInSpace, trial: AnyTrialInSpace, tangent: Point) -> Node:
        return march.node(trial.point, tangent)

    def moved(self, march: MarchInSpace, trial: AnyTrialInSpace, moved: MarchInSpace) -> MarchInSpace:
        return moved.replace(
            stance=trial.stance,
            size=trial.stance.stiffness,
            unstable_at=jnp.where(march.unstable_at > march.step, march.unstable_at - march.step, jnp.inf),
            # The Illinois rule keeps false position from creeping.
            unstable_size=march.unstable_size / 2,
        )

    # Margins.

    def margins(self, march: MarchInSpace, at: MarchInSpace | AnyTrialInSpace, stop: Scalar) -> Margins:
        """Margins of all kinds of events at a point on the way to a stop."""
        free, tip, z = march.phase == Phase.free, march.phase == Phase.tip, at.point.z
        touch = jnp.where(free, at.stance.nearest.distance + TOUCHING, FAR)
        release = jnp.where(free, FAR, z[:, FORCE])
        slack = jnp.where(free, FAR, jnp.where(tip, -z[:, SLACK], z[:, SLACK]))
        return touch, release, slack, jnp.reshape(march.direction * (stop - at.point.u), 1)

    def rates(self, phase: Array, tangent: Point) -> Margins:
        """Rates of the margins along the path, those of forces and slacks of contacts only."""
        still, slack, free = jnp.zeros(phase.size), tangent.z[:, SLACK], phase == Phase.free
        slack = jnp.where(phase == Phase.tip, -slack, slack)
        return still, jnp.where(free, 0.0, tangent.z[:, FORCE]), jnp.where(free, 0.0, slack), still[:1]

    def first_violated(self, march: MarchInSpace, trial: TrialInSpace, distance, solved=None):
        here, there = (self.margins(march, at, trial.stop) for at in (march, trial))
        n = march.phase.size
        crossed = first_crossed(here, there, MARGIN_NOISE, n, self.of_drive, solved)
        return crossed.some, Target(crossed.number, crossed.whiskers, crossed.share * distance, trial.stance.nearest)

    def solved_margins(self, march: MarchInSpace, touches: Array, distance: Scalar) -> list[Array]:
        """Margins that vanish at the event itself, like `margins`: its own one, and all of contacts that begin."""
        del distance
        target = march.target
        own = [touches | ((target.number == kind) & target.whiskers) for kind in (TOUCH, RELEASE, PHASE)]
        return [*own, jnp.reshape(target.number == AT_STOP, 1)]

    def before_loss(self, march: MarchInSpace, trial: AnyTrialInSpace, distance):
        size = jnp.where(jnp.isfinite(march.unstable_at), march.size / 2, march.size)
        closer = march.replace(unstable_at=distance, unstable_size=trial.stance.stiffness, size=size)
        return closer.replace(step=step_to_loss(closer))

    # The end of a step along the path.

    def accepts(self, march: MarchInSpace, trial: AnyTrialInSpace):
        if self.problem.friction is not None:
            return trial.stance.sound, jnp.inf
        # A stable path goes on with the drive: there are two folds within a step that goes back.
        back = march.direction * (trial.point.u - march.point.u) < -MARGIN_NOISE
        return trial.stance.sound & ~(trial.stable & back), jnp.inf

    def dip(self, march: MarchInSpace, trial: AnyTrialInSpace, violated):
        straight = dot(march.tangent, self.measured(trial.tangent), scale_of(march.point.z))
        end = Point(trial.tangent.z / straight, trial.tangent.u)
        here, there = (self.margins(march, at, trial.stop) for at in (march, trial))
        leaving, arriving = (self.rates(march.phase, tangent) for tangent in (march.tangent, end))
        dips, share = first_dip(here, there, leaving, arriving, march.step, MARGIN_NOISE)
        return dips & ~violated, share

    def loss(self, march: MarchInSpace, trial: AnyTrialInSpace):
        return Loss(trial.stable, jnp.asarray(march.step < LOSS_BRACKET))

    def after_loss(self, march: MarchInSpace, moved: MarchInSpace, trial: TrialInSpace, node, loss):
        # At a fold, contacts slide on in the direction of the path. A bifurcation is symmetric: they may go either way.
        forks = branches(march, trial)
        return select(forks, march.stopped(Status.undetermined), sliding(self.problem, march))

    def ends(self, march: MarchInSpace, trial: TrialInSpace, loss, turned: MarchInSpace):
        beyond = trial.point.z[:, SLACK] > (1 - AT_BASE) * self.problem.length
        return [
            (self._has_passed(march, trial), march.stopped(Status.ok)),
            (~trial.stance.opens, march.stopped(Status.not_convex)),
            (jnp.any((march.phase == Phase.tangential) & beyond), march.stopped(Status.lost)),
        ]

    def _has_passed(self, march: MarchInSpace, trial: TrialInSpace) -> Bool[Array, ""]:
        """Whether all whiskers have passed all objects and cannot meet them again: the drive moves on along a line."""
        distance, problem = trial.stance.nearest.distance, self.problem
        if problem.ends is not None:
            return jnp.asarray(False)
        recedes = jnp.all((distance > march.stance.nearest.distance) & (distance > PASSED))
        if not problem.surface.is_convex:  # leaving one object, or one side of it, a whisker may come to another
            recedes &= leaves(problem, trial.point.u, march.direction)
        free = jnp.all(march.phase == Phase.free)
        return free & march.touched & (march.goal > 0) & (march.goal >= trial.last) & recedes

    def written(self, march: MarchInSpace, trial: AnyTrialInSpace, node, loss: Loss):
        # While all whiskers are free, nothing happens between events.
        plain = trial.stable & trial.stance.opens & jnp.any(march.phase != Phase.free)
        forks = ~trial.stable & loss.located & branches(march, trial)
        return plain | forks, select(forks, self._bifurcation(march, trial), node)

    def last_node(self, march: MarchInSpace):
        # The base of a free whisker may arrive at a wall: the whisker is free up to there.
        node = march.node(march.point, march.tangent, inner=march.pending.inner)
        ends = (march.status == Status.lost) & jnp.all(march.phase == Phase.free)
        return ends & (march.travel > march.pending.travel), node

    def _bifurcation(self, march: MarchInSpace, trial: AnyTrialInSpace) -> Node:
        """The node where stability is lost, within a short step."""
        share = march.size / (march.size - trial.stance.stiffness)
        middle = march.point.u + share * (trial.point.u - march.point.u)
        node = march.node(march.point._replace(u=middle), march.tangent, inner=march.pending.inner)
        return node._replace(kind=jnp.asarray(int(EventKind.bifurcation)), whiskers=march.phase != Phase.free)

    def onwards(self, march: MarchInSpace, moved: MarchInSpace, trial: TrialInSpace, factor):
        length = jnp.minimum(factor * march.step, jnp.where(jnp.all(moved.phase == Phase.free), jnp.inf, LONGEST_STEP))
        length = jnp.minimum(length, longest_step(self.problem, moved, moved.stance))
        return moved.replace(
            step=jnp.where(jnp.isfinite(moved.unstable_at), jnp.minimum(length, step_to_loss(moved)), length)
        )

    # The point of an event.

    def touching(self, march: MarchInSpace) -> Bool[Array, " whiskers"]:
        """Whiskers whose contacts begin at the event that is sought."""
        return march.target.whiskers & (march.target.number == TOUCH)

    def z_before(self, march: MarchInSpace, trial: TrialInSpace) -> Array:
        """Contacts on arrival at an event: those that begin are free."""
        return jnp.where(self.touching(march)[:, None], march.point.z, trial.point.z)

    def direction(self, march: MarchInSpace, trial: TrialInSpace) -> Point:
        """The direction in which the path arrives at an event."""
        ahead = dot(trial.tangent, without_traction(march.tangent), scale_of(march.point.z))
        forwards = jnp.where(ahead > 0, 1.0, -1.0)
        solved = Point(forwards * trial.tangent.z, forwards * trial.tangent.u)
        return select(jnp.any(self.touching(march)), march.tangent, solved)

    def found(self, march: MarchInSpace, trial: TrialInSpace) -> TargetPoint:
        point, target, touches, scale = trial.point, march.target, self.touching(march), scale_of(march.point.z)
        chord = without_traction(Point(self.z_before(march, trial) - march.point.z, point.u - march.point.u))
        distance, reach = dot(march.tangent, chord, scale), jnp.sqrt(dot(chord, chord, scale))
        # A margin that grows again has vanished before.
        rates = jnp.stack(jnp.broadcast_arrays(*self.rates(trial.phase, self.direction(march, trial))))
        grows = jnp.any(target.whiskers & (rates[target.number] > 0))
        good = trial.converged & ~grows & (distance > -1e-9) & (reach <= 1.5 * march.step + 1e-6)
        # Another margin may vanish before: events close to each other are told apart only here.
        own = self.solved_margins(march, touches, distance)
        violated, earlier = self.first_violated(march, trial, reach, own)
        # Where stability is lost before a margin vanishes, the path never gets there.
        holds = trial.stable | jnp.any(touches) | (distance <= LOSS_BRACKET)
        return TargetPoint(good, distance, 0.5 * jnp.minimum(march.step, target.distance), violated, earlier, holds)

    def state_after(self, march: MarchInSpace, trial: TrialInSpace) -> SpaceContactState:
        """The state that holds from an event on."""
        target, phase = march.target, trial.phase
        other = jnp.where(phase == Phase.tip, Phase.tangential, Phase.tip)
        after = jnp.where(target.whiskers & (target.number == PHASE), other, phase)
        return march.state._replace(phase=jnp.where(target.whiskers & (target.number == RELEASE), Phase.free, after))

    def kinds(self, march: MarchInSpace, trial: TrialInSpace) -> list[Any]:
        """The kinds of events, by their numbers."""
        tip = jnp.any(march.target.whiskers & (trial.phase == Phase.tip))
        changes = jnp.where(tip, EventKind.tip_to_tangential, EventKind.tangential_to_tip)
        return [EventKind.touch, EventKind.release, changes, STOP]

    def event_node(self, march: MarchInSpace, trial: TrialInSpace, found):
        return jnp.asarray(False), self._node(march, trial, self.direction(march, trial))._replace(
            z_before=self.z_before(march, trial),
            state=self.state_after(march, trial),
            kind=jnp.array(self.kinds(march, trial))[march.target.number],
        )

    def arriving(self, march: MarchInSpace, trial: TrialInSpace, arriving: MarchInSpace):
        return arriving.replace(stance=trial.stance, touched=march.touched | jnp.any(self.touching(march)))

    # The point of an event in its new state.

    def leaves(self, march: MarchInSpace, trial: AnyTrialInSpace, direction):
        # The condition makes the force or the slack grow; a tangential contact that becomes a tip contact loses slack.
        number = march.target.number
        back = (number == PHASE) & jnp.any(march.target.whiskers & (march.phase == Phase.tip))
        by_control = (number == RELEASE) | (number == AT_STOP) | (number == SNAP)
        along_drive = jnp.where(trial.tangent.u * direction < 0, -1.0, 1.0)
        return jnp.where(by_control, along_drive, jnp.where(back, -1.0, 1.0))

    def leaving(self, march: MarchInSpace, trial: TrialInSpace, onwards: MarchInSpace, sign):
        del sign
        stance = onwards.stance
        z = jnp.where(stance.free[:, None], stance.nearest.contact, trial.point.z)
        return onwards.replace(
            point=Point(z, trial.point.u),
            step=jnp.minimum(self.first_step, longest_step(self.problem, onwards, stance)),
            size=stance.stiffness,
            unstable_size=jnp.asarray(-1.0),
        )

    def arrived(self, march: MarchInSpace, trial: TrialInSpace, node, falls):
        del falls
        stance, snapped = trial.stance, march.target.number == SNAP
        deep, passes = stance.free & (stance.nearest.distance < -INSIDE), jnp.asarray(False)
        if not self.problem.surface.is_convex:
            before, jumps = march.pending.before.phase, snapped & jnp.any(march.pending.whiskers)
            sides = (march.pending.z_before, before), (march.point.z, march.phase)
            met = met_on_the_way(self.problem, march.point.u, *sides, jumps)
            lands = met.some & stance.free
            march = march.replace(point=march.point._replace(z=jnp.where(lands[:, None], met.contact, march.point.z)))
            deep, passes = deep | lands, jnp.any(met.some & ~lands)
        inside = jnp.any(deep)
        return Arrival(
            node,
            trial.converged & ~inside & ~passes & stance.opens,
            [
                (~trial.converged | (inside & ~snapped), march.stopped(Status.lost)),
                (passes, march.stopped(Status.second_contact)),
                (inside, clinging(march, deep)),
                (~stance.opens, march.stopped(Status.not_convex)),
            ],
        )

    def ways_on(self, march: MarchInSpace, onwards: MarchInSpace, node, trial: AnyTrialInSpace, falls):
        del node, falls
        snapped = march.target.number == SNAP
        return WaysOn([(snapped & ~trial.stable, march.stopped(Status.unsettled))], onwards, jnp.asarray(True))

    def to_snap(self, march: MarchInSpace):
        return sliding(self.problem, march)
