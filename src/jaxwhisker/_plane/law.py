"""Contact laws: what the march asks about contacts, besides the events that they know (events.py).

`Law` is contact without friction: contacts have no memory, and only the drive must not turn back. Each of its methods
is a place where another law has its say. `Coulomb` is friction: contacts remember where they began to stick, and slips
must not turn back either. A further law is a further class here, with its events.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._equilibrium.contact import FORCE, LEAN
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.newton import is_light, with_slips
from jaxwhisker._equilibrium.point import Contacts, PathCondition, Point, at_control, at_force
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._path.continuation import WaysOn
from jaxwhisker._path.march_state import Cases, Task
from jaxwhisker._path.path import Node, Status, select
from jaxwhisker._path.slips import RATE_NOISE
from jaxwhisker._plane import snap_flow
from jaxwhisker._plane.march_state import MarchInPlane, TrialInPlane
from jaxwhisker._plane.slips import (
    changed_slips,
    disagreement,
    goes_astray,
    partly,
    repeated,
    slip_rates,
    with_changed_slips,
)

FOLD_SLOPE = 1e-9  # du/ds below which a fold counts as located: the error of the state is of this size, of u its square
FORCE_ERROR = 0.5  # largest relative error of the predicted force of a contact that sticks

Turns = Float[Array, " rates"]  # of the drive, and of what contacts must not undo


class Law:
    """Contact without friction."""

    def __init__(self, problem: Problem):
        self.problem = problem

    def memory(self) -> dict[str, Array]:
        """Fields of the march's state in which contacts remember what has happened to them, at the start."""
        return {}

    def remembered(self, goal: Int[Array, ""], corner: bool) -> dict[str, Array]:
        """Fields of a node: the next stop, and whether contacts change their slips at the node before it."""
        del goal, corner
        return {}

    def destination(self, march: MarchInPlane, guess: Point) -> PathCondition:
        """The condition under which the point of an event is solved for in its new state."""
        return at_control(march.point.u, guess.z)

    def rates(
        self, state: ContactState, z: Contacts, z_rate: Contacts, least: float = -jnp.inf
    ) -> Float[Array, " rates"]:
        """Rates of what contacts must not undo, negative if they do; infinite where there is nothing to undo.

        Args:
            state: of the contacts.
            z: the contacts.
            z_rate: their rates.
            least: force below which contacts do not count.
        """
        del state, z, z_rate, least
        return jnp.zeros(0)

    def turns(self, march: MarchInPlane, z: Contacts, tangent: Point, least: float = -jnp.inf) -> Turns:
        """Rates, along the path, of all that must not turn back: of the drive first."""
        return jnp.concatenate(
            [jnp.reshape(march.drive_rate(tangent), 1), self.rates(march.state, z, tangent.z, least)]
        )

    def accepts(self, march: MarchInPlane, trial: TrialInPlane) -> Bool[Array, ""] | bool:
        """Whether a solved step has not ended on another path close by."""
        del march, trial
        return True

    def after_rest(
        self, moved: MarchInPlane, trial: TrialInPlane, node: Node, rests: Bool[Array, " rates"]
    ) -> MarchInPlane:
        """The state where the drive or something else comes to rest: the path loses its stability at a fold."""
        del trial, node, rests
        return self.to_snap(moved)

    def to_snap(self, march: MarchInPlane) -> MarchInPlane:
        """The state that is about to leave an equilibrium that has lost its stability."""
        return march.replace(
            pending=march.pending._replace(
                z_before=march.point.z,
                arriving=march.tangent,
                before=march.state,
                **self.remembered(march.goal, corner=True),
            ),
            task=jnp.asarray(int(Task.kick)),
            flow=snap_flow.start(march.state, march.pose, march.point.z, march.flow.way is not None),
            unstable_at=jnp.asarray(jnp.inf),
        )

    def unforeseen(self, march: MarchInPlane, node: Node, moved: Point) -> tuple[Node, Point]:
        """The node of an event, and how far its point has moved in its new state, without what was unknown before."""
        del march
        return node, moved

    def ways_on(
        self, march: MarchInPlane, onwards: MarchInPlane, node: Node, trial: TrialInPlane, falls: Bool[Array, ""]
    ) -> WaysOn:
        """How the path may go on from an event.

        Args:
            march: the state at the event.
            onwards: the state that goes on along the path.
            node: the node of the event.
            trial: the event, solved for in its new state.
            falls: whether the path cannot go on without a snap.
        """
        del march, node, trial, falls
        return WaysOn([], onwards, jnp.asarray(True))

    def judged(self, march: MarchInPlane, trial: TrialInPlane) -> tuple[Bool[Array, ""], Cases]:
        """Whether a step of a snap counts as solved, and what follows if contacts do not move in it as was assumed."""
        del march
        return trial.solution.converged, []


class Coulomb(Law):
    """Contact with friction: contacts slip, or stick until their force leans too far."""

    def __init__(self, problem: Problem):
        super().__init__(problem)
        assert problem.friction_angle is not None
        self.limit = problem.friction_angle

    def memory(self):
        none = jnp.zeros_like(self.problem.length)
        return {"slips_tried": jnp.asarray(0), "rests": none.astype(bool), "stuck_at": none}

    def remembered(self, goal, corner):
        return {"stop": goal, "corner": jnp.asarray(corner)}

    def destination(self, march, guess):
        # A contact that sticks from its first touch is solved for where its force first has a direction.
        starts = is_light(march.state, guess.z) & (march.task == Task.arrive)
        return select(jnp.any(starts), at_force(starts, guess.z), super().destination(march, guess))

    def rates(self, state, z, z_rate, least=-jnp.inf):
        rates = slip_rates(self.problem, state, z, z_rate)
        return rates if least == -jnp.inf else jnp.where(z[:, FORCE] > least, rates, jnp.inf)

    def accepts(self, march, trial):
        # A stable path does not turn back. A nearly straight whisker that sticks has another equilibrium close by.
        goes_on = ~trial.stable | (march.drive_rate(trial.tangent) > -FOLD_SLOPE)
        # Without any force, a contact at rest satisfies the equations with every lean: where forces are small, Newton's
        # method may arrive there.
        predicted, force = trial.guess.z[:, FORCE], trial.solution.point.z[:, FORCE]
        size = jnp.maximum(jnp.abs(predicted), march.point.z[:, FORCE])
        return goes_on & jnp.all(~march.state.sticks | (jnp.abs(force - predicted) < FORCE_ERROR * size))

    def after_rest(self, moved, trial, node, rests):
        slips, slip = trial.turns[1:], moved.state.slip
        sticks = (slips < -RATE_NOISE) | rests
        sticks &= slips < moved.drive_rate(trial.tangent)
        # Without any friction, slips that come to rest turn back at once.
        slip = jnp.where(sticks, jnp.where(self.limit > 0, 0, -slip), slip)
        stick = with_changed_slips(self.problem, moved, node, slip, trial.tangent, rest=True)
        return select(jnp.any(sticks), stick, self.to_snap(moved))

    def unforeseen(self, march, node, moved):
        # The lean of a contact that sticks from its first touch, and where its force first has a direction.
        starts = is_light(march.state, march.point.z)
        further = jnp.where(jnp.any(starts), march.direction * moved.u, 0.0)
        return node._replace(travel=node.travel + further), moved._replace(z=moved.z.at[:, LEAN].multiply(~starts))

    def ways_on(self, march, onwards, node, trial, falls):
        assert march.slips_tried is not None
        changed, slip = changed_slips(self.problem, march, node.point, node.leaving, falls)
        retry = with_changed_slips(self.problem, onwards, node, slip, trial.tangent, rest=False)
        undetermined = march.stopped(Status.undetermined)
        others: Cases = [
            (changed & (march.slips_tried > 4**march.state.phase.size), undetermined),
            (changed, retry),
            ((march.drive_rate(node.leaving) <= 0) & trial.stable, undetermined),
        ]
        onwards = onwards.replace(slips_tried=jnp.zeros_like(march.slips_tried), rests=jnp.zeros_like(march.state.free))
        return WaysOn(others, onwards, (march.slips_tried == 0) | ~changed)

    def judged(self, march, trial):
        before, after, first = march.point.z, trial.solution.point.z, march.task == Task.kick
        astray = goes_astray(march.state, before, trial.proposed.flow.guess, after)
        # The first step goes along the path at a fixed drive, but frames that move with the drive move along the path.
        converged = trial.solution.converged & ~(astray & (~first | (not self.problem.frames_move)))
        # The first step must not leave the object: contacts may be lighter than it is long.
        converged &= ~first | ~jnp.any(march.state.touches & (after[:, FORCE] < 0))
        found = disagreement(self.problem, march.flow, march.state, before, after)
        stuck, other = with_slips(self.problem, before, march.state, found.slip, march.parameters)
        again = march.replace(
            task=jnp.asarray(int(Task.flow)),
            state=other,
            point=march.point._replace(z=stuck),
            stuck_at=march.parameters,
            flow=repeated(march.flow, found.slip != march.state.slip),
        )
        cut = march.replace(flow=partly(march.flow, found.share))
        exhausted = cut.flow.exhausted & converged & (found.wrong | (found.share < 1))
        return converged, [
            (exhausted, march.stopped(Status.unsettled)),
            (converged & found.wrong, again),
            (converged & (found.share < 1), cut),
        ]


def contact_law(problem: Problem) -> Law:
    """The law of a problem's contacts."""
    return Law(problem) if problem.friction_angle is None else Coulomb(problem)
