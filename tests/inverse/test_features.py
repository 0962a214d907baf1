"""Features of signals: touches in noise, jumps and steep signals before them, and the noise of neighbouring samples."""

import numpy as np
import pytest

from jaxwhisker._inverse.features import features, neighbour_scatter, noise_of
from jaxwhisker._inverse.observations import Observations
from jaxwhisker._inverse.residuals import OVERLAID_EVENT
from recordings import STEPS

CONTROL = np.linspace(0.0, -1.0, STEPS)
SCATTER = 0.25  # relative error of the noise estimated from 256 samples: three standard errors of a median


def observations(values, noise=np.nan, control=CONTROL):
    """One whisker with values (steps, 3)."""
    return Observations(control, values[:, None], np.full(values[:, None].shape, noise))


def test_a_touch_in_noise_is_located():
    # fx is loudest, but not a parabola; mz is one.
    touch, noise = 0.3, 0.02
    past = np.maximum(-CONTROL - touch, 0.0)
    values = np.stack([0.2 * past + 20 * past**7, np.full(STEPS, np.nan), past + past**2], axis=-1)
    errors = []
    for seed in range(20):
        random = np.random.default_rng(seed).standard_normal(values.shape)
        errors.append(abs(features(observations(values + noise * random, noise)).touch[0] - touch))
    assert np.median(errors) < OVERLAID_EVENT / 2


def test_a_snap_is_found_and_the_steep_signal_before_it_is_not():
    # A square root before a fold, as a signal has it, then zero.
    fold = 0.6
    values = np.where(fold > -CONTROL, 2.0 + np.sqrt(np.maximum(fold + CONTROL, 0.0)), 0.0)
    values = np.where(-CONTROL < 0.2, 0.0, values * np.minimum(1.0, 10 * (-CONTROL - 0.2)))
    seen = features(observations(np.stack([values] * 3, axis=-1)))
    jumps = np.isfinite(seen.low)
    assert jumps.sum() == 1
    assert seen.low[0] < fold <= seen.high[0] and seen.high[0] - seen.low[0] == pytest.approx(1 / (STEPS - 1))
    assert seen.release[0] == pytest.approx(seen.high[0])


@pytest.mark.parametrize("noise", [1e-6, 0.01])
def test_noise_alternates_and_smooth_signals_do_not(noise):
    values = smooth(CONTROL)
    values[:50] = 0.0  # free
    assert noise_of(observations(values)) is None
    scattered = values + noise * np.random.default_rng(0).standard_normal(values.shape)
    np.testing.assert_allclose(np.asarray(noise_of(observations(scattered)), dtype=float), noise, rtol=SCATTER)
    assert noise_of(observations(values[:3], control=CONTROL[:3])) is None


def smooth(control):
    return np.stack([np.sin(3 * control), 5 * control**2, np.exp(control)], axis=-1)


@pytest.mark.parametrize("scale", [1e-3, 0.1])
@pytest.mark.parametrize("kind", ["equal steps", "unequal steps", "gaps", "a jump", "free half of the time"])
def test_scatter_of_neighbours_is_the_noise(kind, scale):
    rng = np.random.default_rng(1)
    control = np.linspace(0.0, -1.0, 4 * STEPS)
    if kind == "unequal steps":
        control = -np.sort(rng.uniform(0.0, 1.0, control.size))
    values = smooth(control)
    if kind == "a jump":
        values[control < -0.5] += 10.0
    if kind == "free half of the time":
        values[control < -0.5] = 0.0
    values = values + scale * rng.standard_normal(values.shape) * [1.0, 2.0, 3.0]
    if kind == "gaps":
        values[::3, 0] = np.nan
        values[100:200] = np.nan
    scatter = neighbour_scatter(observations(values, control=control))
    np.testing.assert_allclose(scatter.sigma, scale * np.array([1.0, 2.0, 3.0]), rtol=0.12)
    assert scatter.count > STEPS


def test_smooth_signals_scatter_hardly_and_constant_ones_not_at_all():
    scatter = neighbour_scatter(observations(smooth(CONTROL)))
    assert np.all(scatter.sigma < 1e-6) and scatter.count > STEPS / 2
    assert np.all(neighbour_scatter(observations(np.ones((STEPS, 3)))).sigma == 0)
    standing = np.repeat(CONTROL, 2)  # the drive stops at every position
    assert np.isfinite(neighbour_scatter(observations(smooth(standing), control=standing)).sigma).all()


# fx, fy and mz of a follicle before a sphere at 18 positions: exact, but curved between neighbours.
FEW = np.array(
    [
        (-0.242162, 0.078823, 0.247654),
        (-0.469675, 0.160982, 0.488013),
        (-0.702462, 0.277726, 0.726869),
        (-0.994337, 0.522208, 0.988348),
        (-1.299144, 0.869609, 1.258464),
        (-1.582319, 1.325862, 1.518163),
        (-1.785052, 1.884103, 1.727351),
        (-1.780485, 2.516553, 1.772272),
        (-1.099455, 3.135961, 1.144508),
        (1.099455, 3.135961, -1.144508),
        (1.780485, 2.516553, -1.772272),
        (1.785052, 1.884103, -1.727351),
        (1.582319, 1.325862, -1.518163),
        (1.299144, 0.869609, -1.258464),
        (0.994337, 0.522208, -0.988348),
        (0.702462, 0.277726, -0.726869),
        (0.469675, 0.160982, -0.488013),
        (0.242162, 0.078823, -0.247654),
    ]
)


def test_the_curvature_of_signals_between_few_positions_is_no_noise():
    exact = Observations(np.linspace(-0.842907, 0.842907, len(FEW)), FEW[:, None], np.full((len(FEW), 1, 3), np.nan))
    assert noise_of(exact) is None
    noisy = FEW + 0.2 * np.random.default_rng(0).standard_normal(FEW.shape)
    assert noise_of(Observations(exact.control, noisy[:, None], exact.sigma)) is not None


def test_signals_of_a_scan_have_no_noise():
    values = smooth(CONTROL) + 0.01 * np.random.default_rng(0).standard_normal((STEPS, 3))
    measured = observations(values)
    exact = Observations(CONTROL, measured.values, measured.sigma, exact=True)
    assert noise_of(measured) is not None and noise_of(exact) is None
    assert neighbour_scatter(exact).count == 0 and np.all(neighbour_scatter(exact).sigma == 0)
    assert exact.at(slice(9)).exact and not exact.with_sigma(0.1).exact


def test_noise_on_a_slope_is_no_jump():
    slope = np.clip(-CONTROL - 0.2, 0.0, 0.5)
    found = 0
    for seed in range(100):
        noise = 0.3 / STEPS * np.random.default_rng(seed).standard_normal((STEPS, 3))
        seen = features(observations(0.05 * np.sin(40 * CONTROL)[:, None] + slope[:, None] + noise, 0.3 / STEPS))
        found += int(np.isfinite(seen.low).sum())
    assert found == 0


def test_with_friction_a_jump_at_a_turn_of_the_drive_is_no_snap():
    # The signal rises, drops where the contact sticks behind the turn, and falls; and it jumps elsewhere.
    out = np.linspace(0.0, 1.0, STEPS)
    control = np.concatenate([out, out[::-1]])
    signal = np.concatenate([out, out[:0:-1], out[:1]]) - 0.3 * (np.arange(2 * STEPS) > STEPS + 1)
    signal += 0.5 * (np.arange(2 * STEPS) > 1.5 * STEPS)
    seen = Observations(control, np.tile(signal[:, None, None], (1, 1, 3)), np.full((2 * STEPS, 1, 3), 1e-4))
    jumps = [features(seen, friction=friction) for friction in (False, True)]
    counts = [int(np.isfinite(one.low).sum()) for one in jumps]
    assert counts == [2, 1]
    np.testing.assert_allclose(jumps[1].low[np.isfinite(jumps[1].low)], 1.5, atol=2 / STEPS)
