"""Decisions of the march: lengths of steps, kinds of events, folds within a step, its end."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from exact_contacts import scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._equilibrium.solver import Solution
from jaxwhisker._path.leaving import _is_over
from jaxwhisker._path.march import _start
from jaxwhisker._path.march_state import Target, Trial
from jaxwhisker._path.path import AT_STOP, PHASE, RELEASE, STOP, TOUCH, VERTEX, EventKind
from jaxwhisker._path.transitions import SHORTEST_DIP, _event_kind, _may_fold_twice, _step_to_fold

ROUNDING = 1e-12
SCENE = scene(jw.Support.fb(70.0))


@pytest.fixture(scope="module")
def problem():
    return Program(problem_of)(SCENE)


@pytest.fixture(scope="module")
def state(problem):
    """A state ahead of the object, whose drive moves towards -x."""
    return Program(_start)(problem, jnp.array([1.0, -1.0]))


def trial(end=None, tangent=None, stance=None, stable=True):
    """What these decisions see of a trial."""
    solution = Solution(end, None, jnp.asarray(True), jnp.asarray(1))  # pyright: ignore[reportArgumentType]
    yes = jnp.asarray(True)
    parts = solution, tangent, None, jnp.asarray(stable), yes, None, None, stance, jnp.ones(1)
    return Trial(*parts)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("unstable_at", [1.0, 1e-3])
def test_a_linear_fold_is_a_secant_away(unstable_at):
    # du/ds falls from 0.3 to -0.1 at the loss: its zero lies three quarters of the way.
    found = _step_to_fold(jnp.asarray(0.3), jnp.asarray(unstable_at), jnp.asarray(-0.1), jnp.inf)
    np.testing.assert_allclose(found, 0.75 * unstable_at, rtol=ROUNDING)


def test_a_loss_of_stability_without_a_fold_is_bisected():
    bracket = [0.0, 1.0]
    lost = 1 / np.pi
    for _ in range(30):
        step = float(_step_to_fold(jnp.asarray(0.3), jnp.asarray(bracket[1] - bracket[0]), jnp.asarray(0.2), jnp.inf))
        bracket[bracket[0] + step > lost] = bracket[0] + step
    assert bracket[0] <= lost <= bracket[1]
    np.testing.assert_allclose(bracket[1] - bracket[0], 0.5**30, rtol=1e-6)


@pytest.mark.parametrize(("turn", "unstable_turn"), [(1e-15, -1.0), (1.0, -1e-15), (0.0, -1.0), (1.0, -1e9)])
def test_the_next_step_stays_inside_the_bracket(turn, unstable_turn):
    turn, unstable_turn = jnp.asarray(turn), jnp.asarray(unstable_turn)
    step = float(_step_to_fold(turn, jnp.asarray(0.5), unstable_turn, jnp.inf))
    assert 0 < step < 0.5
    assert float(_step_to_fold(turn, jnp.asarray(0.5), unstable_turn, 1e-6)) == 1e-6
    assert float(_step_to_fold(turn, jnp.asarray(jnp.inf), unstable_turn, 0.1)) == 0.1


def test_each_rate_has_a_secant_of_its_own():
    # The drive turns back half-way. The slip hardly changes: its small rate says nothing about the drive.
    drive, slip = (0.3, -0.3), (1e-10, 1e-10)
    turns, unstable_turns = (jnp.asarray([drive[k], slip[k], jnp.inf]) for k in (0, 1))
    np.testing.assert_allclose(_step_to_fold(turns, jnp.asarray(1.0), unstable_turns, jnp.inf), 0.5, rtol=ROUNDING)


@pytest.mark.parametrize(
    ("kind", "phase", "expected"),
    [
        (TOUCH, Phase.free, EventKind.touch),
        (RELEASE, Phase.tip, EventKind.release),
        (RELEASE, Phase.tangential, EventKind.release),
        (PHASE, Phase.tip, EventKind.tip_to_tangential),
        (PHASE, Phase.tangential, EventKind.tangential_to_tip),
        (VERTEX, Phase.tip, EventKind.vertex),
        (AT_STOP, Phase.tip, STOP),
    ],
)
def test_kinds_of_events(kind, phase, expected):
    # The other whisker, in the other phase, has no say.
    other = Phase.tangential if phase == Phase.tip else Phase.tip
    phases = jnp.array([int(other), int(phase)])
    whisker = jnp.array([False, kind != AT_STOP])
    none = jnp.zeros((2, 3))
    target = Target(jnp.asarray(kind), whisker, jnp.asarray(0.0), none, phases, jnp.ones(2))
    assert _event_kind(target, phases) == expected


def folds(state, start, end, mean, step=0.01, stable=True):
    """Whether a step may fold twice, whose du/ds is a parabola with these values at its ends and this mean."""
    at = state._replace(step=jnp.asarray(step), tangent=state.tangent._replace(u=jnp.asarray(-start)))
    arrived = Point(state.point.z, state.point.u - mean * step)
    twice, share = _may_fold_twice(at, trial(arrived, state.tangent._replace(u=jnp.asarray(-end)), stable=stable))
    return bool(twice), float(share)


def test_a_dip_of_the_turn_below_zero_is_a_pair_of_folds(state):
    # du/ds = 1 - 5 t + 5 t^2 is lowest, -1/4, half-way; its mean is 1/6.
    twice, share = folds(state, 1.0, 1.0, 1 / 6)
    assert twice
    np.testing.assert_allclose(share, 0.5, rtol=1e-9)
    # 1 - 4 t + 3.6 t^2 is lowest at 5/9, with a margin for a slope that is not quite known; its mean is 1/5.
    twice, share = folds(state, 1.0, 0.6, 0.2)
    assert twice
    np.testing.assert_allclose(share, 5 / 9, atol=0.02)
    # du/ds = 1 - 2 t + 2 t^2 stays above 1/2; its mean is 2/3.
    assert not folds(state, 1.0, 1.0, 2 / 3)[0]
    # A long step does not resolve the parabola: half of its lowest end is too near to zero.
    assert folds(state, 1.0, 1.0, 0.45, step=0.03)[0]
    assert not folds(state, 1.0, 1.0, 0.45, step=0.01)[0]


def test_a_dip_beside_the_end_of_a_step_counts(state):
    # du/ds falls from 1 to 0.001 and turns up at the very end, if its slope there is wrong by a little.
    assert folds(state, 1.0, 0.001, 0.33)[0]
    assert not folds(state, 1.0, 0.5, 0.75)[0]


def test_no_pair_of_folds(state):
    dipping = 1.0, 1.0, 1 / 6
    assert folds(state, *dipping)[0]
    assert not folds(state, *dipping, stable=False)[0]  # located as a loss of stability
    assert not folds(state, *dipping, step=SHORTEST_DIP / 2)[0]
    assert not folds(state, 1.0, -0.1, 0.2)[0]  # a single fold lies at its end
    assert not folds(state, 1.0, 1.0, 1.2)[0]  # a hump


@pytest.mark.parametrize(
    ("goal", "direction", "x", "at_stop", "over"),
    [
        (1, -1.0, -2.0, False, True),  # on the last leg, beyond the object
        (1, -1.0, -0.3, False, False),  # ... still before it
        (0, -1.0, -2.0, False, False),  # on the way to the first stop
        (1, 1.0, -2.0, False, False),  # on the way back, towards the object
        (2, -1.0, -0.3, True, True),  # at the last stop
        (1, -1.0, -0.3, True, False),  # at an earlier stop
    ],
)
def test_the_end_of_a_march(problem, state, goal, direction, x, at_stop, over):
    mode = state.mode._replace(side=-jnp.ones(1))
    at = state._replace(goal=jnp.asarray(goal), direction=jnp.asarray(direction), mode=mode)
    stance = problem.stance(0.0, jnp.array([[x]]))
    assert bool(_is_over(problem, at, trial(stance=stance), jnp.asarray(1), jnp.asarray(at_stop))) == over
