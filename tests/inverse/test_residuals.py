"""Residuals: weights of both stages, snaps and their price, overlaid scans, and derivatives."""

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.features import JUMPS, features
from jaxwhisker._inverse.observations import read_observations
from jaxwhisker._inverse.residuals import (
    BLOCK,
    MISSING_EVENT,
    OVERLAID_SIGMA,
    _at_snaps,
    _ContactEnds,
    _overlay,
    _residuals_of_snaps,
    _Snaps,
    samples_of,
)
from jaxwhisker._scan.route import route_of
from recordings import NOISE, STEPS, TRUTH, exact, fb, noisy

DIFFERENCE = 1e-6  # of the fit's variables
SLOPE = 1e-5  # relative: derivatives against differences


@pytest.fixture(scope="module")
def data():
    return exact(fb(**TRUTH))


def samples(data, overlaid):
    observed = read_observations(data, NOISE)
    route = route_of(observed.control)
    return samples_of(observed, features(observed), route, overlaid=overlaid, length=1.0)


def test_samples_are_padded_without_weight(data):
    gaps = data | {"mz": np.where(np.arange(STEPS)[:, None] < 9, np.nan, data["mz"])}
    padded = samples(gaps, overlaid=False)
    assert padded.control.shape == (BLOCK,) and padded.values.shape == (BLOCK, 1, 3)
    assert np.all(padded.weight[STEPS:] == 0) and np.all(padded.weight[:9, 0, 2] == 0)
    np.testing.assert_allclose(padded.weight[9:STEPS, 0], np.tile([1 / s for s in NOISE.values()], (STEPS - 9, 1)))
    assert padded.direction == -1.0 and np.all(padded.values[:9, 0, 2] == 0)


def test_overlaid_signals_weigh_as_one_value(data):
    padded = samples(data, overlaid=True)
    peaks = [np.abs(data[name]).max() for name in NOISE]
    # The weighted mean square of signals that are off by their peaks.
    total = np.sum((padded.weight[:STEPS, 0] * peaks) ** 2)
    assert total == pytest.approx(1 / OVERLAID_SIGMA**2)
    assert np.all(np.isinf(padded.jump_width))


@pytest.mark.parametrize("friction", [False, True])
@pytest.mark.parametrize("overlaid", [False, True])
def test_with_friction_a_jump_need_not_be_a_snap_except_for_overlaid_scans(data, friction, overlaid):
    observed = read_observations(data, NOISE)
    route = route_of(observed.control)
    padded = samples_of(observed, features(observed), route, overlaid=overlaid, length=1.0, friction=friction)
    assert padded.missing == (0.0 if friction and not overlaid else MISSING_EVENT)


def snaps_at(snap):
    """One jump between travel 1.0 and 1.1."""

    def row(value):
        return jnp.zeros(JUMPS).at[0].set(value)

    one = jnp.arange(JUMPS) == 0
    return _Snaps(row(1.0), row(1.1), row(snap), one, one)


@pytest.mark.unchecked
def test_a_snap_within_its_gap_costs_little_and_far_outside_much():
    gap = 0.1
    weights: Any = SimpleNamespace(
        jump_width=2.0 * gap * jnp.ones(JUMPS), jump_weight=12**0.5 / gap * jnp.ones(JUMPS), missing=MISSING_EVENT
    )

    def cost(snap):
        return float(_residuals_of_snaps(snaps_at(snap), weights)[0])

    assert cost(1.05) == 0.0
    assert cost(1.1) == pytest.approx(3**0.5, rel=0.05)  # the end of a uniform distribution
    assert cost(1.55) > 8 * 5 * 12**0.5 > 5 * 12**0.5
    lost = snaps_at(1.05)._replace(paired=jnp.zeros(JUMPS, bool))
    assert float(_residuals_of_snaps(lost, weights)[0]) > MISSING_EVENT * 12**0.5 / gap


@pytest.mark.parametrize(
    ("snap", "wrong", "out"),
    [(1.05, [], [1.0]), (0.75, [0.8, 0.9, 1.0], [0.8, 0.9, 1.0]), (1.25, [1.1, 1.2], [1.0, 1.1, 1.2])],
)
def test_samples_between_both_snaps_are_left_out(snap, wrong, out):
    travel = np.round(np.arange(0.5, 1.5, 0.1), 10)
    left_out, wrong_side = _at_snaps(snaps_at(snap), jnp.asarray(travel))
    assert travel[np.asarray(wrong_side)].tolist() == wrong
    assert travel[np.asarray(left_out)].tolist() == out


@pytest.mark.unchecked
def test_overlay_takes_touch_to_touch_and_release_to_release():
    def ends(touch, release):
        return _ContactEnds(jnp.array([[touch], [release]]), jnp.array([[True], [True]]))

    landmarks = SimpleNamespace(touch=jnp.array([0.2]), release=jnp.array([1.2]), travel=jnp.array([0.0, 2.0]))
    observed: Any = SimpleNamespace(landmarks=landmarks, overlaid=jnp.asarray(True))
    overlay = _overlay(observed, ends(0.1, 2.1))
    np.testing.assert_allclose(overlay(jnp.array([0.2, 0.7, 1.2])), [0.1, 1.1, 2.1])
    landmarks.release = jnp.array([jnp.nan])  # the recording ends in contact: no stretch but that of the touch
    np.testing.assert_allclose(_overlay(observed, ends(0.1, 2.1))(jnp.array([0.2, 2.0])), [0.1, 1.9])
    observed.overlaid = jnp.asarray(False)
    np.testing.assert_allclose(_overlay(observed, ends(0.1, 2.1))(jnp.array([0.2])), [0.2])


def test_derivatives_are_those_of_differences(data):
    fit = jw.identify(fb, TRUTH, noisy(data, 0), sigma=NOISE)
    solve, solution = fit._problem.solve, fit._solution
    padded = fit._problem.samples()

    def residual(y):
        return solve.evaluate(y, padded, y).residual[: -y.size]  # without the prior

    np.testing.assert_allclose(residual(solution.y), solution.observed[0])
    for k, step in enumerate(DIFFERENCE * np.eye(solution.y.size)):
        difference = (residual(solution.y + step) - residual(solution.y - step)) / (2 * DIFFERENCE)
        expected = solution.observed[1][:, k]
        np.testing.assert_allclose(difference, expected, rtol=0, atol=SLOPE * np.abs(expected).max())
