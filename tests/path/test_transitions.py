"""What follows from a step along the path and from the point of an event, for steps and events made by hand."""

# pyright: reportArgumentType=false, reportCallIssue=false
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import begun_march, dimensionless
from exact_contacts import scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.friction import Friction
from jaxwhisker._equilibrium.newton import Condensed, NewtonStep
from jaxwhisker._equilibrium.point import Point, along
from jaxwhisker._equilibrium.solver import Solution
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.path import NO_EVENT, STOP, EventKind, Status
from jaxwhisker._path.transitions import PREDICTION_ERROR, SHORTER, SHORTEST_STEP, after_advance, after_event
from jaxwhisker._plane.continuation import LONGEST_STEP, NEAR_FOLD, ContinuationInPlane
from jaxwhisker._plane.events import AT_STOP, PHASE, RELEASE, TOUCH, VERTEX, events_of, facts_of
from jaxwhisker._plane.law import FOLD_SLOPE
from jaxwhisker._plane.march_state import Proposed, TrialInPlane

ROUNDING = 1e-12
STEP, TRAVEL, DRIVEN = 0.05, 0.9, 0.1
AT = Point(jnp.array([[2.0, 0.6, -0.4]]), jnp.asarray(0.1))
ONWARDS = Point(jnp.array([[0.0, 0.8, 0.0]]), jnp.asarray(-0.6))  # of unit length; the drive moves towards -x
BACK = Point(jnp.array([[0.0, 0.98, 0.0]]), jnp.asarray(np.sqrt(1 - 0.98**2)))  # the drive moves back


def _advanced(problem, march, trial):
    return after_advance(ContinuationInPlane(problem), march, trial)


def _arrived(problem, march, trial):
    return after_event(ContinuationInPlane(problem), march, trial)


advanced, arrived = Program(_advanced), Program(_arrived)


class March:
    """A problem of one whisker in contact, and trial steps of a march that is at AT."""

    def __init__(self, **options):
        self.problem = dimensionless(scene(jw.Support.fb(70.0), **options))
        begun = begun_march(self.problem, jnp.array([1.0, -1.0]))
        self.pose = jnp.full((1, self.problem.axes), 0.3)
        touching = begun.state._replace(phase=jnp.array([int(Phase.tip)]))
        self.state = begun.replace(
            task=jnp.asarray(int(Task.advance)),
            state=touching,
            point=AT,
            pose=self.pose,
            tangent=ONWARDS,
            tangent_pose=jnp.zeros_like(self.pose).at[0, 0].set(-0.5),
            step=jnp.asarray(STEP),
            goal=jnp.asarray(1),
            travel=jnp.asarray(TRAVEL),
        )

    def trial(
        self,
        end,
        guess=None,
        facts=None,
        tangent=ONWARDS,
        *,
        converged=True,
        stable=True,
        sound=True,
        here=None,
        there=None,
        rates=(),
        **more,
    ):
        """A trial step with this end, whose margins are 1 unless others are given by the numbers of their events."""
        axes = self.problem.axes
        force_by_step, x_by_step = 2.0, 0.5
        basis = jnp.zeros((1, 3, axes)).at[0, 0, 0].set(force_by_step)
        condensed = Condensed(None, basis, None, None, x_by_step * jnp.eye(axes)[None], *[None] * 6)
        moved = self.pose + DRIVEN
        newton = NewtonStep(None, None, condensed, None, moved, None, None)
        margins = []
        for given in (here or {}, there or {}):
            margins.append(tuple(jnp.array([given.get(k, 1.0)]) for k in range(len(events_of(self.problem)))))
        return TrialInPlane(
            Proposed(end if guess is None else guess, facts, self.state.flow),
            Solution(end, newton, jnp.asarray(converged), jnp.asarray(1)),
            tangent,
            self.state.tangent_pose,
            jnp.asarray(stable),
            jnp.asarray(sound),
            *margins,
            self.problem.stance(end.u, moved),
            jnp.ones(1),
            jnp.concatenate([jnp.reshape(self.state.drive_rate(tangent), 1), jnp.asarray(rates)]),
            reason=jnp.asarray(int(Status.not_convex)),
            **more,
        )

    def advance(self, state=None, *, miss=(0.0, 0.0, 0.0), end=None, **trial):
        """The march after a step whose end misses the prediction by this much; or that ends where it was predicted."""
        state = self.state if state is None else state
        guess = along(state.point, state.tangent, state.step)
        found = guess._replace(z=guess.z + jnp.array([miss]))
        found, guess = (found, guess) if end is None else (end, end)
        return advanced(self.problem, state, self.trial(found, guess, **trial))

    def event(self, number, state=None, *, distance=STEP / 2, end=None, **trial):
        """The march after it has solved for an event."""
        state = self.state if state is None else state
        one = jnp.array([number != AT_STOP])
        target = state.target
        first = target.first._replace(phase=jnp.array([int(Phase.tip)]))
        target = target._replace(number=jnp.asarray(number), whiskers=one, first=first)
        facts = facts_of(events_of(self.problem), target.number, jnp.any(one & (state.state.phase == Phase.tip)))
        state = state.replace(task=jnp.asarray(int(Task.event)), target=target)
        end = along(AT, state.tangent, jnp.asarray(distance)) if end is None else end
        return arrived(self.problem, state, self.trial(end, None, facts, **trial))


@pytest.fixture(scope="module")
def march():
    return March()


def with_phase(state, phase):
    return state.replace(state=state.state._replace(phase=jnp.array([int(phase)])))


def check_tries_again(outcome, step, point=AT):
    """The march is where it was, at this point, and tries a step of this length."""
    new, write, _ = outcome
    assert new.task == Task.advance and not write
    np.testing.assert_array_equal(new.point.z, point.z)
    np.testing.assert_allclose(new.step, step, rtol=ROUNDING)


def test_the_end_of_a_smooth_step_is_a_node(march):
    tangent = Point(jnp.array([[0.6, 0.7, 0.1]]), jnp.asarray(-0.67))
    new, write, node = march.advance(tangent=tangent)
    assert write and new.task == Task.advance and node.kind == NO_EVENT and not node.whiskers.any()
    end = along(AT, ONWARDS, STEP)
    for point in (new.point, node.point):
        np.testing.assert_allclose(point.z, end.z, rtol=ROUNDING)
    np.testing.assert_allclose([new.travel, node.travel], TRAVEL + 0.6 * STEP, rtol=ROUNDING)
    np.testing.assert_allclose(new.pose, march.pose + DRIVEN, rtol=ROUNDING)
    np.testing.assert_allclose(new.tangent.z, tangent.z, rtol=ROUNDING)
    # The next step is predicted along a parabola.
    np.testing.assert_allclose(new.bend.z, (tangent.z - ONWARDS.z) / STEP, rtol=ROUNDING)
    np.testing.assert_allclose(new.bend.u, (tangent.u - ONWARDS.u) / STEP, rtol=ROUNDING)


@pytest.mark.parametrize(
    ("error", "factor"),
    [(0.0, 2.5), (PREDICTION_ERROR / 1000, 2.5), (PREDICTION_ERROR / 8, 2.0), (8 * PREDICTION_ERROR, 0.5)],
)
def test_errors_of_predictions_are_cubes_of_steps(march, error, factor):
    # Changes of a force of 2 are measured in 1 + 2.
    for miss in ((0.0, 0.0, error), (3 * error, 0.0, 0.0)):
        new, write, _ = march.advance(miss=miss)
        assert write
        np.testing.assert_allclose(new.step, factor * STEP, rtol=1e-9)


def test_contacts_change_by_a_quarter_at_most_in_a_step(march):
    long = march.state.replace(step=jnp.asarray(0.2))
    np.testing.assert_allclose(march.advance(long)[0].step, LONGEST_STEP / 0.8, rtol=ROUNDING)
    # Free whiskers have none.
    np.testing.assert_allclose(march.advance(with_phase(long, Phase.free))[0].step, 2.5 * 0.2, rtol=ROUNDING)


TOO_LONG = {
    "not solved": {"converged": False},
    "far from its prediction": {"miss": (0.0, 0.0, 10.1 * PREDICTION_ERROR)},
    "bent back": {"tangent": Point(-ONWARDS.z, ONWARDS.u)},
}


@pytest.mark.parametrize("reason", TOO_LONG)
def test_too_long_a_step_is_shortened_until_nothing_is_left_of_it(march, reason):
    check_tries_again(march.advance(**TOO_LONG[reason]), SHORTER * STEP)
    shortest = march.state.replace(step=jnp.asarray(SHORTEST_STEP))
    new, write, _ = march.advance(shortest, **TOO_LONG[reason])
    assert new.task == Task.done and new.status == Status.lost and not write
    # Where a loss of stability is known to be near, it counts as located.
    new, write, _ = march.advance(shortest.replace(unstable_at=jnp.asarray(NEAR_FOLD / 2)), **TOO_LONG[reason])
    assert new.task == Task.kick and not write


@pytest.mark.parametrize("stable", [True, False])
def test_an_event_within_a_step_is_solved_for(march, stable):
    new, write, _ = march.advance(there={RELEASE: -3.0}, stable=stable)
    assert new.task == Task.event and not write
    assert new.target.number == RELEASE and new.target.whiskers.all()
    np.testing.assert_allclose(new.target.distance, STEP / 4, rtol=ROUNDING)
    np.testing.assert_array_equal(new.point.z, AT.z)


def bending(force_rate):
    """Directions in which the force falls and then grows at this rate."""
    u = jnp.asarray(-np.sqrt(1 - (force_rate / 3) ** 2))
    return (Point(jnp.array([[rate, 0.0, 0.0]]), u) for rate in (-force_rate, force_rate))


def test_a_step_in_which_an_event_happens_and_is_undone_is_tried_again_up_to_its_middle(march):
    # The margin is a parabola, which falls by a quarter of the rate times the step.
    before, after = bending(0.6)
    falling, low = march.state.replace(tangent=before), 0.6 * STEP / 4
    trial = {"tangent": after, "here": {RELEASE: 0.9 * low}, "there": {RELEASE: 0.9 * low}}
    check_tries_again(march.advance(falling, **trial), STEP / 2)
    above = {RELEASE: 1.1 * low}
    assert march.advance(falling, **trial | {"here": above, "there": above})[1]
    check_tries_again(march.event(AT_STOP, falling, distance=STEP, **trial), STEP / 2)


def test_a_step_in_which_the_drive_may_turn_twice_is_tried_again_up_to_its_middle(march):
    # du/ds is the parabola 1 - 5 t + 5 t^2, of mean 1/6.
    straight = Point(0 * AT.z, jnp.asarray(-1.0))
    end = Point(AT.z, AT.u - STEP / 6)
    state = march.state.replace(tangent=straight)
    check_tries_again(march.advance(state, end=end, tangent=straight), STEP / 2)


def test_a_loss_of_stability_within_a_step_is_a_secant_away(march):
    # du/ds falls from 0.6 to about -0.2.
    turn = float(BACK.u)
    outcome = march.advance(tangent=BACK, stable=False)
    check_tries_again(outcome, STEP * 0.6 / (0.6 + turn))
    np.testing.assert_allclose([outcome[0].unstable_at, outcome[0].unstable_turns[0]], [STEP, -turn], rtol=ROUNDING)
    # At an event within the step, it lies before the event.
    distance = STEP / 2
    outcome = march.event(PHASE, distance=distance, tangent=BACK, stable=False)
    check_tries_again(outcome, distance * 0.6 / (0.6 + turn))
    np.testing.assert_allclose(outcome[0].unstable_at, distance, rtol=ROUNDING)


def test_steps_approach_a_known_loss_of_stability(march):
    known = march.state.replace(unstable_at=jnp.asarray(3 * STEP), unstable_turns=jnp.array([-0.4]))
    new, write, _ = march.advance(known)
    assert write
    # The Illinois rule halves what is known of the far end.
    np.testing.assert_allclose([new.unstable_at, new.unstable_turns[0]], [2 * STEP, -0.2], rtol=ROUNDING)
    np.testing.assert_allclose(new.step, 2 * STEP * 0.6 / (0.6 + 0.2), rtol=ROUNDING)
    # If the path is still stable where it was thought to be lost, the loss is not known any more.
    new, _, _ = march.advance(known.replace(unstable_at=jnp.asarray(STEP)))
    assert new.unstable_at == jnp.inf


@pytest.mark.parametrize("stable", [True, False])
def test_a_snap_begins_at_a_fold(march, stable):
    # Where the drive turns back, the path is unstable, or still stable where a loss is known to be ahead.
    fold = Point(jnp.array([[0.0, 1.0, 0.0]]), jnp.asarray(FOLD_SLOPE / 2))
    state = march.state.replace(unstable_at=jnp.asarray(2 * STEP if stable else np.inf))
    new, write, _ = march.advance(state, tangent=fold, stable=stable)
    assert write and new.task == Task.kick
    np.testing.assert_allclose(new.point.z, along(AT, ONWARDS, STEP).z, rtol=ROUNDING)
    np.testing.assert_allclose(new.pending.arriving.z, fold.z, rtol=ROUNDING)
    np.testing.assert_allclose(new.flow.pose, march.pose + DRIVEN, rtol=ROUNDING)


def test_a_march_ends_with_the_reason_why_its_contacts_are_not_sound(march):
    new, write, _ = march.advance(sound=False)
    assert new.task == Task.done and new.status == Status.not_convex and not write


HALF_WAY = along(AT, ONWARDS, jnp.asarray(STEP / 2))  # where events happen


def check_arrives(outcome, kind, lead):
    """The event has happened; it is written when the path leaves it, in the direction with a positive sum by `lead`."""
    new, write, node = outcome
    assert new.task == Task.arrive and not write
    assert node.kind == new.pending.kind == kind
    np.testing.assert_allclose(new.lead.z, [lead], rtol=ROUNDING)
    np.testing.assert_array_equal(new.point.z, node.point.z)


@pytest.mark.parametrize(
    ("phase", "kind", "then", "lead"),
    [
        (Phase.tip, EventKind.tip_to_tangential, Phase.tangential, 1.0),
        (Phase.tangential, EventKind.tangential_to_tip, Phase.tip, -1.0),
    ],
)
def test_a_change_of_phase(march, phase, kind, then, lead):
    outcome = march.event(PHASE, with_phase(march.state, phase))
    new, _, node = outcome
    check_arrives(outcome, kind, [0.0, 0.0, lead])
    assert new.state.phase.tolist() == [then] and node.whiskers.all()
    np.testing.assert_allclose(node.point.z, HALF_WAY.z * np.array([1.0, 1.0, 0.0]), rtol=ROUNDING)
    np.testing.assert_allclose(node.z_before, HALF_WAY.z, rtol=ROUNDING)
    np.testing.assert_allclose(node.travel, TRAVEL + 0.6 * STEP / 2, rtol=ROUNDING)


def test_after_a_release_the_whisker_is_free_and_leaves_where_the_contact_would_have_to_pull(march):
    outcome = march.event(RELEASE)
    new, _, node = outcome
    check_arrives(outcome, EventKind.release, [0.0, 0.0, 0.0])
    assert new.state.phase.tolist() == [Phase.free]
    np.testing.assert_allclose(node.z_before, HALF_WAY.z, rtol=ROUNDING)
    assert not node.point.z.any()
    # The force grows by 2 and x by 0.5 per step along the branch.
    np.testing.assert_allclose(new.lead.pose, [[-4.0]], rtol=ROUNDING)


def test_a_touch_begins_a_contact_of_growing_force(march):
    free = with_phase(march.state, Phase.free).replace(point=Point(0 * AT.z, AT.u))
    first = Point(jnp.array([[0.0, 0.7, -0.3]]), AT.u - 0.6 * STEP / 2)
    still = Point(0 * AT.z, jnp.asarray(-1.0))
    outcome = march.event(TOUCH, free.replace(tangent=still), end=first, tangent=still)
    new, _, node = outcome
    check_arrives(outcome, EventKind.touch, [1.0, 0.0, 0.0])
    assert new.state.phase.tolist() == [Phase.tip]
    np.testing.assert_allclose(node.point.z, first.z, rtol=ROUNDING)
    assert not node.z_before.any()


def test_beyond_the_vertex_the_path_goes_on(march):
    outcome = march.event(VERTEX)
    new, _, node = outcome
    check_arrives(outcome, EventKind.vertex, [0.0, 0.8, 0.0])
    assert new.state.phase.tolist() == [Phase.tip] and new.lead.u == ONWARDS.u
    assert (march.state.before_vertex.tolist(), new.before_vertex.tolist()) == ([1.0], [-1.0])
    np.testing.assert_allclose(node.point.z, HALF_WAY.z, rtol=ROUNDING)


@pytest.mark.parametrize(("goal", "travel"), [(0, 0.0), (1, TRAVEL + 0.6 * STEP / 2)])
def test_travel_counts_from_the_first_stop(march, goal, travel):
    outcome = march.event(AT_STOP, march.state.replace(goal=jnp.asarray(goal)))
    new, _, node = outcome
    check_arrives(outcome, STOP, [0.0, 0.8, 0.0])
    assert new.goal == goal + 1 and not node.whiskers.any()
    np.testing.assert_allclose([new.travel, node.travel], travel, atol=ROUNDING)


MISSED = {
    "not solved": {"converged": False},
    "behind the start of the step": {"distance": -1e-6},
    "far beyond the end of the step": {"distance": 1.6 * STEP},
    "passed from beyond": {"tangent": Point(jnp.array([[0.6, 0.6, 0.0]]), ONWARDS.u)},  # the force grows
}


@pytest.mark.parametrize("reason", MISSED)
def test_an_event_that_is_missed_is_approached_by_a_shorter_step(march, reason):
    check_tries_again(march.event(RELEASE, **MISSED[reason]), SHORTER * STEP)


def test_a_march_is_lost_where_no_shorter_step_leads_to_an_event(march):
    shortest = march.state.replace(step=jnp.asarray(SHORTEST_STEP))
    new, _, _ = march.event(RELEASE, shortest, distance=SHORTEST_STEP, converged=False)
    assert new.task == Task.done and new.status == Status.lost


def test_an_event_before_the_one_that_was_solved_for_comes_first(march):
    new, _, _ = march.event(AT_STOP, distance=STEP, there={PHASE: -3.0})
    assert new.task == Task.event and new.target.number == PHASE and new.target.whiskers.all()
    np.testing.assert_allclose(new.target.distance, STEP / 4, rtol=ROUNDING)


@pytest.fixture(scope="module")
def rough():
    """The same with friction, whose contact sticks."""
    march = March(friction=0.3)
    sticking = Friction(jnp.zeros(1, int), jnp.array([0.6]), jnp.zeros(1))
    march.state = march.state.replace(state=march.state.state._replace(friction=sticking))
    return march


def test_a_stable_path_with_friction_does_not_turn_back(march, rough):
    friction = {"rates": jnp.array([jnp.inf]), "parameters": jnp.array([0.6])}
    assert march.advance(tangent=BACK)[1] and rough.advance(**friction)[1]
    check_tries_again(rough.advance(tangent=BACK, **friction), SHORTER * STEP)


def test_a_small_force_of_a_contact_that_sticks_must_be_near_its_prediction(rough):
    friction = {"rates": jnp.array([jnp.inf]), "parameters": jnp.array([0.6])}
    light = rough.state.replace(point=AT._replace(z=AT.z.at[0, 0].set(1e-3)))
    assert rough.advance(light, miss=(4e-4, 0.0, 0.0), **friction)[1]
    check_tries_again(rough.advance(light, miss=(6e-4, 0.0, 0.0), **friction), SHORTER * STEP, light.point)


@pytest.mark.parametrize(
    ("goal", "direction", "x", "over"),
    [
        (1, -1.0, -2.0, True),  # on the last leg, beyond the object
        (1, -1.0, -0.3, False),  # ... still before it
        (0, -1.0, -2.0, False),  # on the way to the first stop
        (1, 1.0, -2.0, False),  # on the way back, towards the object
    ],
)
def test_a_march_is_over_beyond_the_object(march, goal, direction, x, over):
    free = march.state.state._replace(phase=jnp.array([int(Phase.free)]), side=-jnp.ones(1))
    at = march.state.replace(goal=jnp.asarray(goal), direction=jnp.asarray(direction), state=free)
    trial = march.trial(AT)._replace(stance=march.problem.stance(0.0, jnp.array([[x]])))
    gone = ContinuationInPlane(march.problem).is_over(at, trial, jnp.asarray(1))
    assert bool(gone) == over
