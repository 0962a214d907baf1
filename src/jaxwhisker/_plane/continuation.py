"""What the march asks of whiskers in the plane."""

import jax
import jax.numpy as jnp

from jaxwhisker._equilibrium.contact_state import all_free
from jaxwhisker._equilibrium.newton import slope_sines
from jaxwhisker._equilibrium.point import Contacts, Point, dot, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import Stance, of_object
from jaxwhisker._path.continuation import Arrival, Continuation, Loss, TargetPoint
from jaxwhisker._path.march import STOPS
from jaxwhisker._path.march_state import Target, Task
from jaxwhisker._path.path import NO_EVENT, EventKind, Node, Status, first_case, is_snap, select
from jaxwhisker._path.slips import RATE_NOISE
from jaxwhisker._path.transitions import FIRST_STEP, SHORTER, SHORTEST_STEP
from jaxwhisker._plane import snap_flow
from jaxwhisker._plane.approach import approach_of
from jaxwhisker._plane.events import (
    AT_STOP,
    MARGIN_NOISE,
    TOUCH,
    VERTEX,
    After,
    Happened,
    Lead,
    PathDirection,
    events_of,
    limit_of,
    margin_rates,
)
from jaxwhisker._plane.gains import without_gains
from jaxwhisker._plane.law import contact_law
from jaxwhisker._plane.march_state import FirstContact, MarchInPlane, TrialInPlane
from jaxwhisker._plane.trial import dip, first_violated, solved_trial
from jaxwhisker._plane.turning_points import FOLD_BRACKET, before_loss, may_fold_twice, step_to_loss, turning_point

LONGEST_STEP = 0.25  # of the contacts: a soft spring is stretched over many lengths while they hardly change
ARRIVAL_MISS = 0.1  # the equilibrium at which a flow ends is nearer than this
WENT_BACK = 1e-9  # by which a contact may undo what it must not from the end of a flow to the equilibrium near it
NEAR_FOLD = 2e-4  # a loss this near counts as located if no shorter step is solved; u is off by less than its square


class ContinuationInPlane(Continuation[MarchInPlane, TrialInPlane]):
    """Whiskers in the plane."""

    margin_noise, touch, at_stop = MARGIN_NOISE, TOUCH, AT_STOP

    def __init__(self, problem: Problem):
        self.problem, self.law = problem, contact_law(problem)
        self.events, self.approach = events_of(problem), approach_of(problem)

    def limits(self, first_stop):
        del first_stop
        return self.approach.limits()

    def crop(self, path, whole, limits):
        return self.approach.crop(path, whole, limits)

    def checked(self, path):
        return without_gains(self.problem, path)

    def capacity(self, stops: int) -> int:
        n, objects = self.problem.length.shape[0], self.problem.profile.objects
        pieces = sum(1 + one.breaks().size for one in objects)
        return ((256 + 60 * n) * len(objects) + 4 * pieces * n) * max(1, stops // 2)

    def room(self, capacity, last):
        # A traced control is padded with more stops than it needs, and has no more room for them.
        used_stops = STOPS * -(-(last + 1) // STOPS)
        return jnp.minimum(capacity, self.capacity(2) * jnp.where(last <= 1, 1, used_stops // 2))

    def iterations(self, room):
        return 8 * room

    def start(self, stops, limits) -> MarchInPlane:
        del limits
        problem, n = self.problem, self.problem.length.shape[0]
        onwards, zero, none = problem.onwards.astype(float), jnp.asarray(0.0), jnp.zeros(n)
        u = self.approach.start(stops[0])
        z, pose = problem.unloaded(u)
        state = all_free(problem, self.approach.unloaded(u).side)
        still, nobody, number = Point(jnp.zeros_like(z), onwards), jnp.zeros(n, bool), jnp.asarray(0)
        travel, kind = -jnp.abs(u - stops[0]), jnp.asarray(NO_EVENT)
        pending = Node(Point(z, u), z, still, still, state, state, travel, kind, nobody)
        pending = pending._replace(**self.law.remembered(number, corner=False))
        several = None if state.sides is None else jnp.zeros(n, int)
        first = FirstContact(z, state.phase, state.side, state.piece, several)
        begun = MarchInPlane(
            task=jnp.asarray(int(Task.arrive)),
            state=state,
            point=pending.point,
            pose=pose,
            tangent=still,
            tangent_pose=jnp.full_like(pose, problem.rest_rate(onwards)),
            bend=jax.tree.map(jnp.zeros_like, still),
            step=jnp.asarray(FIRST_STEP),
            unstable_at=jnp.asarray(jnp.inf),
            unstable_turns=jnp.zeros(1 + self.law.rates(state, z, z).size),
            target=Target(number, nobody, zero, first, limit_of(self.events, number, problem, z, (none, none))),
            lead=Lead(still.z, jnp.zeros_like(pose), still.u),
            before_vertex=none + 1.0,
            goal=number,
            direction=still.u,
            travel=pending.travel,
            pending=pending,
            flow=snap_flow.start(state, pose, z, problem.profile.has_edges),
            count=number,
            status=jnp.asarray(int(Status.ok)),
            # The first task is to arrive, which computes the stance.
            stance=None if problem.stance_is_known else _blank(jax.eval_shape(problem.stance, u, pose, z)),
            **self.law.memory(),
        )
        return select(self.approach.starts_clear(u), begun, begun.stopped(Status.lost))

    def trial(self, march: MarchInPlane, stops, last) -> TrialInPlane:
        return solved_trial(self.problem, march, stops[jnp.minimum(march.goal, last)])

    def node(self, march: MarchInPlane, trial: TrialInPlane) -> Node:
        return march.node(trial.point, trial.tangent, **self.law.remembered(march.goal, corner=False))

    def moved(self, march: MarchInPlane, trial: TrialInPlane, moved: MarchInPlane) -> MarchInPlane:
        return self._solved(trial, moved).replace(state=march.state.now_standing(trial.standing))

    def _solved(self, trial: TrialInPlane, march: MarchInPlane) -> MarchInPlane:
        """The state with what the plane alone knows of a solved point."""
        return march.replace(
            pose=trial.solution.newton.pose,
            tangent_pose=trial.tangent_pose,
            stuck_at=trial.parameters,
            stance=None if march.stance is None else trial.stance,
        )

    def first_violated(self, march: MarchInPlane, trial: TrialInPlane, distance):
        return first_violated(self.problem, march, trial, distance)

    def before_loss(self, march: MarchInPlane, trial: TrialInPlane, distance):
        return before_loss(self.problem, march, trial, distance)

    def accepts(self, march: MarchInPlane, trial: TrialInPlane):
        return self.law.accepts(march, trial), jnp.inf

    def dip(self, march: MarchInPlane, trial: TrialInPlane, violated):
        dips, share = dip(self.problem, march, trial, march.step)
        twice, turn_share = may_fold_twice(march, trial)
        return (dips & ~violated) | twice, jnp.where(twice, turn_share, share)

    def revised(self, march: MarchInPlane, trial: TrialInPlane, good, shorter: MarchInPlane):
        # If several whiskers become unstable at once, Newton's method fails close to the fold: this is near enough.
        return good, shorter, ~good & (shorter.step < SHORTEST_STEP) & (march.unstable_at < NEAR_FOLD)

    def astray(self, march: MarchInPlane):
        return self.law.to_snap(march)

    def loss(self, march: MarchInPlane, trial: TrialInPlane) -> Loss:
        return turning_point(march, trial)

    def after_loss(self, march: MarchInPlane, moved: MarchInPlane, trial: TrialInPlane, node, loss):
        assert loss.rests is not None
        return self.law.after_rest(moved, trial, node, loss.rests)

    def ends(self, march: MarchInPlane, trial: TrialInPlane, loss: Loss, turned: MarchInPlane):
        return [(~trial.sound, march.stopped(trial.reason)), (loss.reached, turned)]

    def written(self, march: MarchInPlane, trial: TrialInPlane, node, loss: Loss):
        return (loss.holds | loss.located) & trial.sound, node

    def onwards(self, march: MarchInPlane, moved: MarchInPlane, trial: TrialInPlane, factor):
        scale = scale_of(march.point.z)
        contacts = trial.tangent._replace(u=jnp.asarray(0.0))
        bending = jnp.sqrt(dot(contacts, contacts, scale))
        longest = jnp.where(jnp.all(march.state.free), self.approach.longest_step(), LONGEST_STEP / bending)
        left = march.unstable_at - march.step
        # The path is still stable there: lengths along a curve do not quite add up, and the loss is further ahead.
        left = jnp.where(left < FOLD_BRACKET, jnp.inf, left)
        # The Illinois rule: otherwise false position creeps towards a fold from one side.
        unstable_turns = march.unstable_turns / 2
        to_loss = step_to_loss(trial.turns, left, unstable_turns)
        return moved.replace(
            unstable_at=left,
            unstable_turns=unstable_turns,
            step=jnp.minimum(jnp.minimum(factor * march.step, longest), to_loss),
        )

    def found(self, march: MarchInPlane, trial: TrialInPlane) -> TargetPoint:
        """Whether the solution is the targeted event, within the last step, and nothing happens before."""
        problem, target, scale = self.problem, march.target, scale_of(march.point.z)
        chord = Point(self._before(march, trial) - march.point.z, trial.point.u - march.point.u)
        distance = dot(march.tangent, chord, scale)
        reach = jnp.sqrt(dot(chord, chord, scale))
        good = trial.converged & (distance > -1e-9) & (reach <= 1.5 * march.step + 1e-9)
        # If the margin grows, the path comes back from beyond the event, and the event itself lies earlier on the path.
        state = march.state
        moving = PathDirection(problem, state, state.free, trial.point.z, trial.tangent.z, trial.tangent_pose)
        touch, *others = margin_rates(moving)
        touch = touch if target.first.object is None else of_object(touch, target.first.object)
        growing = jnp.stack(jnp.broadcast_arrays(touch, *others))[target.number]
        good &= jnp.sum(target.whiskers * growing) < MARGIN_NOISE
        violated, earlier = first_violated(problem, march, trial, distance)
        dips, share = dip(problem, march, trial, distance)
        dips &= good & ~violated
        step = jnp.where(dips, share * distance, SHORTER * march.step)
        holds = trial.stable & jnp.all(trial.turns[1:] > -RATE_NOISE)
        return TargetPoint(good & ~dips, distance, step, violated, earlier, holds)

    def _before(self, march: MarchInPlane, trial: TrialInPlane) -> Contacts:
        """Contacts on arrival at an event: those that begin are free."""
        touches = march.target.whiskers & (march.target.number == TOUCH)
        before = march.point.z if trial.stance.free is None else trial.stance.free
        return jnp.where(touches[:, None], before, trial.point.z)

    def may_touch_otherwise(self):
        return self.problem.frames_move

    def event_node(self, march: MarchInPlane, trial: TrialInPlane, found):
        target, first, z, state = march.target, march.target.first, trial.point.z, march.state
        after = After(self.problem, trial.stance, first.phase, first.side, first.piece, target.limit, trial.parameters)
        for number, event in enumerate(self.events):
            if not event.continues:
                z, state = event.changed(target.whiskers & (target.number == number), z, state, after)
        node = self.node(march, trial)
        return jnp.asarray(False), node._replace(
            point=Point(z, trial.point.u),
            z_before=self._before(march, trial),
            state=state,
            kind=trial.proposed.facts.kind,
        )

    def arriving(self, march: MarchInPlane, trial: TrialInPlane, arriving: MarchInPlane):
        target, facts = march.target, trial.proposed.facts
        happened = Happened(self.problem, arriving.state, arriving.point.z, trial.solution.newton.condensed)
        # If the contact state does not change, the path continues as it arrives.
        z = jnp.where(facts.continues, march.tangent.z / scale_of(march.point.z) ** 2, 0.0)
        z = z.at[:, :3].add(target.whiskers[:, None] * (facts.leaves * facts.of_contact))
        lead = Lead(z, jnp.zeros_like(march.pose), jnp.where(facts.continues, march.tangent.u, 0.0))
        for number, event in enumerate(self.events):
            lead = event.lead(target.whiskers & (target.number == number), lead, happened)
        arriving = self._solved(trial, arriving)
        ahead = jnp.where(slope_sines(self.problem, arriving.state, arriving.parameters) < 0, -1.0, 1.0)
        sign = jnp.where(target.whiskers & (target.number == TOUCH), ahead, march.before_vertex)
        passes = target.whiskers & (target.number == VERTEX)
        return arriving.replace(lead=lead, before_vertex=jnp.where(passes, -sign, sign))

    def leaves(self, march: MarchInPlane, trial: TrialInPlane, direction):
        lead, reverses = march.lead, direction != march.direction
        grows = jnp.sum(lead.z * trial.tangent.z) + jnp.sum(lead.pose * trial.tangent_pose) + lead.u * trial.tangent.u
        return jnp.where(grows < 0, -1.0, 1.0) * jnp.where(reverses, -1.0, 1.0)

    def leaving(self, march: MarchInPlane, trial: TrialInPlane, onwards: MarchInPlane, sign):
        onwards = onwards.replace(stuck_at=trial.parameters)
        # After a snap, and only then, the contact may be on the other side of the vertex.
        behind = jnp.where(slope_sines(self.problem, march.state, onwards.parameters) < 0, -1.0, 1.0)
        return onwards.replace(
            pose=trial.solution.newton.pose,
            tangent_pose=sign * trial.tangent_pose,
            before_vertex=jnp.where(is_snap(march.pending.kind), behind, march.before_vertex),
        )

    def arrived(self, march: MarchInPlane, trial: TrialInPlane, node, falls):
        point, after_snap = trial.point, is_snap(march.pending.kind)
        moved = Point(point.z - march.point.z, point.u - march.point.u)
        node, moved = self.law.unforeseen(march, node, moved)
        near = trial.converged & (dot(moved, moved, scale_of(march.point.z)) < ARRIVAL_MISS**2)
        # Newton's method may have violated the mode of the flow, or converged to an equilibrium that the flow cannot
        # reach.
        happens = zip(self.events, trial.there, strict=True)
        changes = [jnp.ravel(margin) for event, margin in happens if not event.continues]
        wrong = jnp.any(jnp.concatenate(changes) < -MARGIN_NOISE)
        wrong |= jnp.any(self.law.rates(march.state, point.z, moved.z) < -WENT_BACK)
        early = after_snap & (wrong | falls | ~near)
        flowing = march.replace(
            task=jnp.asarray(int(Task.flow)),
            flow=march.flow._replace(near=march.flow.near / 4),
        )
        return Arrival(node, near & ~early, [(early, flowing), (~near, march.stopped(Status.lost))])

    def is_over(self, march: MarchInPlane, trial: TrialInPlane, last):
        last_leg = (march.goal >= last) & (march.direction * self.problem.onwards > 0) & (march.goal > 0)
        return self.approach.is_over(march.state, trial.stance) & last_leg

    def ways_on(self, march: MarchInPlane, onwards: MarchInPlane, node, trial: TrialInPlane, falls):
        return self.law.ways_on(march, onwards, node, trial, falls)

    def to_snap(self, march: MarchInPlane):
        return self.law.to_snap(march)

    def after_flow(self, march: MarchInPlane, trial: TrialInPlane):
        problem, at, proposed, z = self.problem, trial.stance, trial.proposed.flow, march.point.z
        flow, state, z = snap_flow.advance(problem, proposed, march.state, z, trial.solution, at, trial.parameters)
        rested = snap_flow.at_rest(problem, flow, state, march.point.u)
        freed = flow.slipped & state.free
        kind = jnp.where(jnp.any(freed), EventKind.snap_off, EventKind.snap_through)
        pending = march.pending._replace(state=state, travel=march.travel, kind=kind, whiskers=flow.slipped)
        flowing = march.replace(
            task=jnp.where(rested, Task.arrive, Task.flow),
            state=state,
            point=Point(z, march.point.u),
            pose=flow.pose,
            stuck_at=trial.parameters,
            flow=flow,
            pending=pending,
            lead=Lead(jnp.zeros_like(z), jnp.zeros_like(flow.pose), march.direction),
        )
        shorter = march.replace(flow=snap_flow.shortened(march.flow))
        converged, cases = self.law.judged(march, trial)
        new = first_case(
            *cases,
            (jnp.where(converged, flow.exhausted, shorter.flow.exhausted), march.stopped(Status.unsettled)),
            (~converged, shorter),
            otherwise=flowing,
        )
        return new, jnp.asarray(False), march.pending


def _blank(shapes: Stance) -> Stance:
    return jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
