"""Turning points: steps towards a loss of stability, slips that come to rest, folds within a step."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import begun_march, dimensionless
from exact_contacts import scene
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._equilibrium.solver import Solution
from jaxwhisker._plane.march_state import TrialInPlane
from jaxwhisker._plane.turning_points import SHORTEST_DIP, may_fold_twice, step_to_loss, turning_point

ROUNDING = 1e-12
SCENE = scene(jw.Support.fb(70.0))


@pytest.fixture(scope="module")
def state():
    """A state ahead of the object, whose drive moves towards -x."""
    return begun_march(dimensionless(SCENE), jnp.array([1.0, -1.0]))


def trial(end, tangent, stable=True, rates=()):
    """What these decisions see of a trial: the drive moves towards -x."""
    turns = jnp.array([-tangent.u, *rates])
    solution = Solution(end, None, jnp.asarray(True), jnp.asarray(1))  # pyright: ignore[reportArgumentType]
    parts = solution, tangent, None, jnp.asarray(stable), jnp.asarray(True), None, None, None, jnp.ones(1), turns
    return TrialInPlane(None, *parts)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("unstable_at", [1.0, 1e-3])
def test_a_linear_fold_is_a_secant_away(unstable_at):
    # du/ds falls from 0.3 to -0.1 at the loss: its zero lies three quarters of the way.
    found = step_to_loss(jnp.array([0.3]), jnp.asarray(unstable_at), jnp.array([-0.1]))
    np.testing.assert_allclose(found, 0.75 * unstable_at, rtol=ROUNDING)


def test_a_loss_of_stability_without_a_fold_is_bisected():
    bracket = [0.0, 1.0]
    lost = 1 / np.pi
    for _ in range(30):
        step = float(step_to_loss(jnp.array([0.3]), jnp.asarray(bracket[1] - bracket[0]), jnp.array([0.2])))
        bracket[bracket[0] + step > lost] = bracket[0] + step
    assert bracket[0] <= lost <= bracket[1]
    np.testing.assert_allclose(bracket[1] - bracket[0], 0.5**30, rtol=1e-6)


@pytest.mark.parametrize(("turn", "unstable_turn"), [(1e-15, -1.0), (1.0, -1e-15), (0.0, -1.0), (1.0, -1e9)])
def test_the_next_step_stays_inside_the_bracket(turn, unstable_turn):
    turn, unstable_turn = jnp.array([turn]), jnp.array([unstable_turn])
    step = float(step_to_loss(turn, jnp.asarray(0.5), unstable_turn))
    assert 0 < step < 0.5
    assert np.isinf(step_to_loss(turn, jnp.asarray(jnp.inf), unstable_turn))


def test_each_rate_has_a_secant_of_its_own():
    # The drive turns back half-way. The slip hardly changes: its small rate says nothing about the drive.
    drive, slip = (0.3, -0.3), (1e-10, 1e-10)
    turns, unstable_turns = (jnp.asarray([drive[k], slip[k], jnp.inf]) for k in (0, 1))
    np.testing.assert_allclose(step_to_loss(turns, jnp.asarray(1.0), unstable_turns), 0.5, rtol=ROUNDING)


@pytest.mark.parametrize(
    ("slip", "slip_ahead", "drive_ahead", "rests"),
    [
        (1e-10, -1e-4, 0.5, True),  # nothing else turns back
        (1e-10, -1e-4, -1e-3, True),  # the drive turns back much later
        (1e-10, -1e-4, -1e3, False),  # a fold is as near: whatever the drive moves rests there
        (1e-8, -1e-4, 0.5, False),  # it still slips
        (1e-10, -1e-10, 0.5, False),  # it hardly ever slips
    ],
)
def test_a_slip_comes_to_rest_before_the_drive_or_with_it(state, slip, slip_ahead, drive_ahead, rests):
    ahead = jnp.array([drive_ahead, slip_ahead])
    at = state.replace(step=jnp.asarray(1e-3), unstable_at=jnp.asarray(0.1), unstable_turns=ahead)
    found = turning_point(at, trial(state.point, state.tangent._replace(u=jnp.asarray(-1e-3)), rates=[slip]))
    assert found.holds and found.rests is not None
    assert bool(found.rests[0]) == bool(found.reached) == rests


def folds(state, start, end, mean, step=0.01, stable=True):
    """Whether a step may fold twice, whose du/ds is a parabola with these values at its ends and this mean."""
    at = state.replace(step=jnp.asarray(step), tangent=state.tangent._replace(u=jnp.asarray(-start)))
    arrived = Point(state.point.z, state.point.u - mean * step)
    twice, share = may_fold_twice(at, trial(arrived, state.tangent._replace(u=jnp.asarray(-end)), stable=stable))
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
