"""What the march asks of whiskers in space with friction: contacts stick and slip (slip.py).

There are two more kinds of events: a contact begins or ceases to slip, and stability is lost, which is where the drive
would turn. Steps have stages, and begin where contacts may have just begun.
"""

import jax
import jax.numpy as jnp

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import at_arc_length
from jaxwhisker._path.continuation import WaysOn
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.path import EventKind, select
from jaxwhisker._path.transitions import FIRST_STEP, LOSS_BRACKET, SHORTER, SHORTEST_STEP
from jaxwhisker._space.contact import TRACTION, Traction
from jaxwhisker._space.continuation import ContinuationInSpace
from jaxwhisker._space.flow import at_surface, settling, sliding
from jaxwhisker._space.march_state import AT_STOP, GRIP, LOSS, MarchInSpace, TrialInSpace
from jaxwhisker._space.newton import Equations, solve_points
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space.slip import (
    ContactMotion,
    SlipMode,
    SlipState,
    as_felt,
    defect_of,
    ends_of_step,
    first_traction,
    grip_of,
    mode_after,
    mode_at_corner,
    next_guess,
    radau,
    speeds,
    stages_of,
    with_traction,
    without_traction,
)
from jaxwhisker._space.stance import stance_of

SLIP_DEFECT = 1e-6  # of the rate at the start of a step, times its length, at which steps keep their length
BRIEF_STEP = 1e-6  # behind a corner, within which contacts may begin or cease to slip
LEAST_GRIP = 1e-9  # smaller margins of contacts that stick or slip have just been left
# Contacts with less friction slip back as soon as they turn: they would stick over a travel of about mu f only, and
# with no friction nothing could hold them.
HARDLY_ANY = 1e-5
CYCLES = 24  # times as many nodes as without friction: contacts may stick and slip two hundred times


class ContinuationWithFriction(ContinuationInSpace):
    """Whiskers in space with friction."""

    of_drive = (AT_STOP, LOSS)
    first_step = FIRST_STEP / 4  # behind a corner

    def __init__(self, problem: SpaceProblem):
        super().__init__(problem)
        assert problem.friction is not None
        self.friction = problem.friction
        self.slips_back = self.friction < HARDLY_ANY

    def capacity(self, stops):
        return CYCLES * super().capacity(stops)

    def start(self, stops, limits):
        begun = super().start(stops, limits)
        nobody, unknown = jnp.zeros_like(begun.phase, bool), jnp.zeros(begun.phase.size)
        state = begun.state._replace(mode=jnp.full_like(begun.phase, int(SlipMode.slips)))
        others = stages_of(self.problem) - 1
        inner = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (others, *jnp.shape(leaf))), begun.point)
        return begun.replace(
            state=state,
            step=jnp.asarray(FIRST_STEP),
            pending=begun.pending._replace(state=state, before=state, inner=inner),
            stance=begun.stance._replace(grip=unknown),
            slip=SlipState(jnp.asarray(0), jnp.asarray(True), nobody, jnp.asarray(0)),
            sunk=nobody,
        )

    # A step.

    def condition(self, march: MarchInSpace, stop, by_law=False):
        number = march.target.number
        return super().condition(march, stop, (march.task == Task.event) & ((number == GRIP) | (number == LOSS)))

    def solved(self, march: MarchInSpace, condition, distance, begins, phase):
        target, mode, locating = march.target, march.state.mode, march.task == Task.event
        flows = march.task == Task.flow
        places, _ = radau(stages_of(self.problem))
        guesses = jax.vmap(lambda place: self.ahead(march, place * distance))(jnp.asarray(places))
        first_contact = jnp.where(begins[:, None], target.first.contact, guesses.z[-1])
        guesses = guesses._replace(z=guesses.z.at[-1].set(first_contact))
        measure = at_arc_length(march.point, without_traction(march.tangent), jnp.zeros(()))
        between = select(locating, measure, condition)._replace(z0=march.point.z, u0=march.point.u)
        grips = (target.whiskers & locating & (target.number == GRIP)).astype(float)
        slipping = mode == SlipMode.slips
        motion = ContactMotion(
            march.point.z,
            Traction(self.friction, flows),
            jnp.where(flows, march.flow.time, march.step),
            mode=mode,
            waits=begins | (march.task == Task.arrive),
            given=jnp.where(begins[:, None], 0.0, march.point.z[:, TRACTION]),
            cone=grips * ~slipping,
            power=grips * slipping,
            turn=(locating & (target.number == LOSS)).astype(float),
        )
        phases = jnp.broadcast_to(march.phase, (places.size, phase.size)).at[-1].set(phase)
        equations = Equations(phases, condition, between, motion)
        return solve_points(self.problem, equations, guesses), jax.tree.map(lambda leaf: leaf[-1], guesses)

    def rate(self, march: MarchInSpace, solution, moves):
        assert march.slip is not None
        _, arriving = ends_of_step(march.slip, march.point, solution.points)
        return select(moves, arriving, solution.newton.tangent)

    def stance(self, march: MarchInSpace, phase, solution, tangent):
        assert march.sunk is not None
        grip = grip_of(self.problem, march.state.mode, phase, solution.end, tangent)
        stance = stance_of(self.problem, solution.end, phase, solution.newton.at, grip)
        return at_surface(stance, march.sunk)

    def felt(self, at, change):
        return as_felt(self.friction, at.z, change)

    def measured(self, direction):
        return without_traction(direction)

    # Margins.

    def margins(self, march: MarchInSpace, at, stop):
        loss = jnp.where(jnp.all(march.phase == Phase.free), jnp.inf, march.drive_rate(at.tangent))
        return *super().margins(march, at, stop), at.stance.grip, jnp.reshape(loss, 1)

    def rates(self, phase, tangent):
        still = jnp.zeros(phase.size)
        return *super().rates(phase, tangent), still, still[:1]

    def solved_margins(self, march: MarchInSpace, touches, distance):
        target = march.target
        own = touches | ((target.number == GRIP) & target.whiskers)
        # The path does not go on in this direction where a contact begins, and turns at corners as it leaves them.
        loss = (target.number == LOSS) | jnp.any(touches) | (distance < LOSS_BRACKET)
        return [*super().solved_margins(march, touches, distance), own, jnp.reshape(loss, 1)]

    # The end of a step along the path.

    def accepts(self, march: MarchInSpace, trial: TrialInSpace):
        assert march.slip is not None
        sound, longest = super().accepts(march, trial)
        # Behind a corner, the tangent is that of the equations.
        defect = defect_of(self.friction, march.slip, march.point, march.tangent, trial.solution.points)
        defect = jnp.where(march.slip.at_corner, 0.0, defect)
        longest = jnp.minimum(longest, (SLIP_DEFECT / jnp.maximum(defect, 1e-14)) ** (1 / 4))
        return sound & (defect < 10 * SLIP_DEFECT), longest

    def _node(self, march: MarchInSpace, trial: TrialInSpace, tangent):
        # The other stages of the step are nodes of the polynomial on which states between them lie.
        inner = jax.tree.map(lambda leaf: leaf[:-1], trial.solution.points)
        return march.node(trial.point, tangent, inner=inner)

    def moved(self, march: MarchInSpace, trial: TrialInSpace, moved: MarchInSpace):
        assert march.slip is not None and march.sunk is not None
        slip = march.slip._replace(at_corner=jnp.asarray(False), begins=jnp.zeros_like(march.slip.begins))
        sunk = march.sunk & (trial.stance.nearest.distance == 0)
        return super().moved(march, trial, moved).replace(slip=slip, sunk=sunk)

    def revised(self, march: MarchInSpace, trial: TrialInSpace, good, shorter: MarchInSpace):
        slip, grip = march.slip, trial.stance.grip
        assert slip is not None and grip is not None
        begins = jnp.any(slip.begins)
        wrong = begins & (~good | jnp.any(slip.begins & (grip < 0)))
        # A contact sticks or slips for a while behind a corner. What seems to end at once is another solution.
        fresh = (march.stance.grip < LEAST_GRIP) | (slip.at_corner & (march.step > BRIEF_STEP))
        ends = jnp.any(fresh & (grip < 0))
        good &= ~wrong & ~ends
        # Where contacts can neither stick nor slip, no equilibrium is near.
        astray = trial.converged & ends & ~begins & (march.step < BRIEF_STEP)
        length = jnp.where(wrong | ends, SHORTER * march.step, shorter.step)
        guess, mode, traction = next_guess(slip, march.state.mode, march.point.z[:, TRACTION])
        again = march.replace(
            state=march.state._replace(mode=mode), slip=guess, point=with_traction(march.point, traction)
        )
        guessed = jnp.where(begins & (guess.guess != 0), march.step, length)
        shorter = select(begins, again, shorter).replace(step=guessed)
        astray |= ~good & (shorter.step < SHORTEST_STEP) & jnp.any(march.phase != Phase.free)
        return good, shorter, astray

    def astray(self, march: MarchInSpace):
        return settling(self.problem, march)

    def after_loss(self, march: MarchInSpace, moved: MarchInSpace, trial: TrialInSpace, node, loss):
        return march  # stability is lost at an event

    # The point of an event.

    def found(self, march: MarchInSpace, trial: TrialInSpace):
        found = super().found(march, trial)
        # A step without a length solves the equation of a loss, too.
        target = march.target
        return found._replace(good=found.good & ((target.number != LOSS) | (found.distance > 0.1 * target.distance)))

    def at_event(self, march: MarchInSpace, trial: TrialInSpace, found):
        loss = march.target.number == LOSS
        # The drive may turn at once, or contacts may neither stick nor slip.
        lost = ~found.good & (found.step < SHORTEST_STEP) & jnp.any(march.phase != Phase.free)
        travel = march.travel + jnp.abs(trial.point.u - march.point.u)
        arriving = self.direction(march, trial)
        at_loss = march.replace(point=trial.point, tangent=arriving, stance=trial.stance, travel=travel)
        return [
            (loss & ~found.good & (march.step < LOSS_BRACKET), sliding(self.problem, march)),
            (lost, settling(self.problem, march)),
        ], [(loss, sliding(self.problem, at_loss))]

    def state_after(self, march: MarchInSpace, trial: TrialInSpace):
        target, state = march.target, super().state_after(march, trial)
        heading = jnp.sign(trial.stops[jnp.minimum(march.goal + 1, trial.last)] - trial.point.u)
        turns = (target.number == AT_STOP) & (march.goal < trial.last) & (heading == -march.direction)
        grips = target.whiskers & (target.number == GRIP)
        return state._replace(mode=mode_after(march.state.mode, grips, turns, self.touching(march)))

    def _slipping_back(self, before, mode, traction):
        """Modes and tractions after contacts that slipped and would now stick, if they slip back instead."""
        back = self.slips_back & (mode - before == SlipMode.sticks - SlipMode.slips)
        return jnp.where(back, before, mode), jnp.where(back[:, None], -traction, traction)

    def kinds(self, march: MarchInSpace, trial: TrialInSpace):
        sticks = jnp.any(march.target.whiskers & (march.state.mode == SlipMode.sticks))
        return [*super().kinds(march, trial), jnp.where(sticks, EventKind.slip, EventKind.stick)]

    def event_node(self, march: MarchInSpace, trial: TrialInSpace, found):
        _, node = super().event_node(march, trial, found)
        begun = first_traction(speeds(self.problem.surface, trial.point.z, trial.phase, trial.tangent.z))
        mode, traction = self._slipping_back(march.state.mode, node.state.mode, trial.point.z[:, TRACTION])
        traction = jnp.where(self.touching(march)[:, None], begun, traction)
        node = node._replace(point=with_traction(node.point, traction), state=node.state._replace(mode=mode))
        # At a loss, the path goes on as it arrives until contacts slide.
        loss = march.target.number == LOSS
        plain = self._node(march, trial, self.direction(march, trial))
        return loss & found.good & ~found.violated, select(loss, plain, node)

    def arriving(self, march: MarchInSpace, trial: TrialInSpace, arriving: MarchInSpace):
        assert march.slip is not None
        none = jnp.zeros_like(march.slip.changes)
        slip = march.slip._replace(changes=none, begins=self.touching(march), guess=none)
        return super().arriving(march, trial, arriving).replace(slip=slip)

    # The point of an event in its new state.

    def leaves(self, march: MarchInSpace, trial: TrialInSpace, direction):
        assert trial.stance.grip is not None
        number, concerned = march.target.number, march.target.whiskers
        slips = jnp.any(concerned & (march.state.mode == SlipMode.slips))
        back = jnp.where(jnp.any(concerned & (trial.stance.grip < 0)), -1.0, 1.0)
        along_drive = jnp.where(trial.tangent.u * direction < 0, -1.0, 1.0)
        of_grip = jnp.where(slips & ~self.slips_back, back, along_drive)
        return jnp.where(number == GRIP, of_grip, super().leaves(march, trial, direction))

    def leaving(self, march: MarchInSpace, trial: TrialInSpace, onwards: MarchInSpace, sign):
        assert march.slip is not None
        grip = grip_of(self.problem, march.state.mode, march.phase, trial.point, onwards.tangent)
        leaving = march.slip._replace(changes=jnp.asarray(0), at_corner=jnp.asarray(True))
        onwards = onwards.replace(stance=onwards.stance._replace(grip=grip), slip=leaving)
        return super().leaving(march, trial, onwards, sign)

    def ways_on(self, march: MarchInSpace, onwards: MarchInSpace, node, trial: TrialInSpace, falls):
        assert march.slip is not None
        smooth = super().ways_on(march, onwards, node, trial, falls)
        mode, _ = mode_at_corner(self.problem, march.state, march.slip.begins, trial.point, onwards.tangent)
        changed = jnp.any(mode != march.state.mode)
        changes = march.slip.changes + 1
        often = changes > 2 * march.phase.size
        mode, traction = self._slipping_back(march.state.mode, mode, march.point.z[:, TRACTION])
        again = march.replace(
            state=march.state._replace(mode=mode),
            slip=march.slip._replace(changes=changes),
            point=with_traction(march.point, traction),
        )
        cases = [(changed & often, settling(self.problem, onwards)), (changed, again)]
        return WaysOn([*cases, *smooth.others], onwards, ~changed | often)


def continuation_of(problem: SpaceProblem) -> ContinuationInSpace:
    """What the march asks of the whiskers of a problem."""
    return ContinuationInSpace(problem) if problem.friction is None else ContinuationWithFriction(problem)
