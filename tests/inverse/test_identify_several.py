"""Fits and information of whiskers with two contacts: the distance of two pegs, the width and depth of a groove."""

from functools import cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxwhisker as jw

CHANNELS = ("fx", "fy", "mz")
NOISE = 0.01  # of the peaks
FAR = 4.5  # standard errors: 99.999 %
EXACT = 1e-6  # relative: parameters from exact signals
DIFFERENCE = 1e-5  # step of central differences
SLOPE = 2e-6  # of the largest derivative, of signals that are good to 1e-10
TRIALS = 36


class Groove(eqx.Module):
    """A groove in a parabola."""

    distance: float
    depth: float
    width: float

    def __call__(self, x):
        return self.distance + 0.8 * x**2 + self.depth * jnp.exp(-((x / self.width) ** 2))


def groove(depth, width):
    return jw.Scene(jw.Whisker(), jw.Graph(Groove(0.3, depth, width)), contacts=2)


def pegs(apart, x):
    """Two pegs; while the whisker leaves the first one, it touches both."""
    objects = jw.Circle(0.5, 0.15, position=x), jw.Circle(0.25, 0.15, position=x - apart)
    return jw.Scene(jw.Whisker(), objects, contacts=2)


CASES = {
    "pegs": (pegs, {"apart": 0.55, "x": 0.0}, {"apart": 0.5, "x": 0.03}, np.linspace(0.4, -1.5, 191)),
    "groove": (groove, {"depth": 0.15, "width": 0.2}, {"depth": 0.1, "width": 0.25}, np.linspace(0.9, -1.5, 241)),
}


@cache
def recorded(name: str):
    """The exact scan of a case, and the noise of its channels."""
    build, truth, _, control = CASES[name]
    scan = jw.scan(build(**truth), control)
    return scan, {c: NOISE * float(jnp.max(jnp.abs(getattr(scan, c)))) for c in CHANNELS}


def measured(name: str, seed: int | None) -> dict:
    """Signals of a case; None: without noise."""
    scan, sigma = recorded(name)
    rng = np.random.default_rng(seed)
    size = {c: 0.0 if seed is None else s for c, s in sigma.items()}
    return {"control": CASES[name][3]} | {
        c: np.asarray(getattr(scan, c)) + s * rng.standard_normal(scan.fx.shape) for c, s in size.items()
    }


def z_scores(name: str, seed: int) -> list[float]:
    """Errors of a fit to noisy signals, in standard errors."""
    build, truth, guess, _ = CASES[name]
    fit = jw.identify(build, guess, measured(name, seed), sigma=recorded(name)[1])
    assert fit.status == jw.FitStatus.ok
    return [(fit.estimates[k] - truth[k]) / fit.standard_error[k] for k in truth]


def steps_with_two(name: str) -> np.ndarray:
    return np.all(np.asarray(recorded(name)[0].phase[:, 0]) > 0, axis=-1)


@pytest.mark.parametrize("name", CASES)
def test_exact_signals_give_the_parameters(name):
    build, truth, guess, _ = CASES[name]
    fit = jw.identify(build, guess, measured(name, None))
    assert steps_with_two(name).sum() > 10
    for key, value in truth.items():
        assert fit.estimates[key] == pytest.approx(value, abs=EXACT)


@pytest.mark.parametrize("name", CASES)
def test_noisy_signals_give_the_parameters_within_their_errors(name):
    assert np.max(np.abs(z_scores(name, 0))) < FAR


@pytest.mark.parametrize("name", CASES)
def test_errors_of_many_fits_are_as_large_as_their_standard_errors(name):
    scores = np.array([z_scores(name, seed) for seed in range(TRIALS)])
    for own in scores.T:
        low, high = stats.chi2.ppf([1e-4, 1 - 1e-4], TRIALS)
        assert low < np.sum(own**2) < high
        assert abs(np.mean(own)) < FAR / np.sqrt(TRIALS)
    within = np.sum(np.abs(scores) < 1.96)
    assert stats.binom.cdf(within, scores.size, 0.95) > 1e-4


@pytest.mark.parametrize("name", CASES)
def test_information_is_that_of_differences(name):
    build, truth, _, control = CASES[name]
    scan, sigma = recorded(name)
    found = jw.information(build, truth, sigma=sigma, control=control)
    np.testing.assert_array_equal(found.control, control)
    # Beside events, differences leave the piece of the path.
    events = np.array([event.control for event in scan.events])
    near = np.min(np.abs(control[:, None] - events), axis=1) < 1e-3
    both = 0
    for k, (key, value) in enumerate(truth.items()):
        high, low = (jw.scan(build(**truth | {key: value + s}), control) for s in (DIFFERENCE, -DIFFERENCE))
        for c, channel in enumerate(CHANNELS):
            slope = np.asarray(getattr(high, channel) - getattr(low, channel))[:, 0] / (2 * DIFFERENCE) / sigma[channel]
            own = found.rates[:, c, k]
            used = ~near & (own != 0)
            both += np.sum(used & steps_with_two(name))
            assert np.max(np.abs(own - slope)[used]) < SLOPE * np.max(np.abs(slope[used]))
    assert both > 30


def test_the_width_of_a_groove_is_felt_where_both_its_sides_are_touched():
    build, truth, _, control = CASES["groove"]
    found = jw.information(build, truth, sigma=recorded("groove")[1], control=control)
    both = steps_with_two("groove")
    per_step = np.asarray(found.density)[:, list(truth).index("width")]
    assert np.mean(per_step[both]) > np.mean(per_step[~both])
