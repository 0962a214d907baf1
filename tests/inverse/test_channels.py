"""Channels: signals of any sensor, in any unit, from several recordings, are fitted like reactions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.channels import channels_from
from recordings import CONTROL, TRUTH, exact, fb

RECOVERED = 1e-6  # relative: least squares stop at 1e-7
LIKELY = 4.0  # standard errors: one in 16,000 estimates is further off
DIFFERENCE = 1e-5  # error of central differences, relative to the largest derivative
GAIN, OFFSET, MIX = -40.0, 7.0, 0.3
COUNTS = 1.0  # noise of the signals in counts


def hall(result, mix):
    """Two signals of a magnetic sensor: one mixes moment and force, the other follows the spring."""
    return {"bend": result.mz + mix * result.fx, "way": 10.0 * result.spring_length}


def counts(scene, seed=None, mix=MIX):
    """Raw counts of such a sensor; exact without a seed."""
    result = jw.scan(scene, CONTROL)
    rng = np.random.default_rng(seed)
    noise = 0.0 if seed is None else COUNTS
    signals = {name: np.asarray(signal)[:, 0] for name, signal in hall(result, mix).items()}
    return {"control": CONTROL} | {
        name: GAIN * signal + OFFSET + noise * rng.standard_normal(CONTROL.size) for name, signal in signals.items()
    }


def test_raw_counts_give_parameters_gains_and_offsets():
    guess = {"c": 90.0, "q": 0.25, "mix": 0.0}
    fit = jw.identify(fb, guess, counts(fb(**TRUTH)), channels=hall, gains=True, offsets=True)
    assert fit.status == jw.FitStatus.ok
    truth = TRUTH | {"mix": MIX, "offset_bend": OFFSET, "offset_way": OFFSET, "gain_bend": GAIN, "gain_way": GAIN}
    assert set(fit.names) == set(truth)
    for name, value in truth.items():
        assert fit.estimates[name] == pytest.approx(value, rel=RECOVERED), name
    assert fit.signals.shape == (CONTROL.size, 1, 2) and fit.measured.names == ["bend", "way"]


def test_several_recordings_share_what_they_have_in_common():
    distances = (TRUTH["q"], TRUTH["q"] + 0.05)
    measured = [counts(fb(TRUTH["c"], q), seed) for seed, q in enumerate((*distances, distances[0]))]
    fit = jw.identify(
        fb,
        {"c": 90.0, "q": 0.28, "mix": 0.0},
        measured,
        sigma=COUNTS,
        channels=hall,
        gains=True,
        offsets=True,
        individual={"q": ["near", "far", "near"]},
    )
    assert fit.status == jw.FitStatus.ok
    truth = {"c": TRUTH["c"], "q[near]": distances[0], "q[far]": distances[1], "mix": MIX, "gain_bend": GAIN}
    for name, value in truth.items():
        assert abs(fit.estimates[name] - value) < LIKELY * fit.standard_error[name], name
    near, far, _ = fit.recordings
    assert near.parameters["q"] == fit.estimates["q[near]"] and far.parameters["q"] == fit.estimates["q[far]"]
    assert far.scene.profile.vertex()[1] == far.parameters["q"]  # pyright: ignore[reportAttributeAccessIssue]
    compared = np.isfinite(near.residuals)
    np.testing.assert_allclose((near.measured.values - near.signals)[compared], near.residuals[compared])
    assert np.nanstd(far.residuals) == pytest.approx(COUNTS, rel=0.2)
    with pytest.raises(ValueError, match="recordings"):
        _ = fit.residuals
    # Together they determine more than one of them alone.
    alone = jw.identify(
        fb, {"c": 90.0, "q": 0.25, "mix": 0.0}, measured[0], sigma=COUNTS, channels=hall, gains=True, offsets=True
    )
    assert fit.standard_error["c"] < alone.standard_error["c"]


def test_the_likelihood_of_several_recordings_has_its_maximum_at_the_fit():
    measured = [counts(fb(TRUTH["c"], TRUTH["q"]), 0), counts(fb(TRUTH["c"], TRUTH["q"] + 0.05), 1)]
    options = {"sigma": COUNTS, "channels": hall, "gains": True, "individual": ["q"], "offsets": True}
    fit = jw.identify(fb, {"c": 90.0, "q": 0.28, "mix": 0.0}, measured, **options)
    density = jax.jit(jax.value_and_grad(fit.log_density))
    value, slope = density(jnp.asarray(fit.variables))
    assert -2 * value == pytest.approx(fit.chi2, rel=1e-3)
    # One standard error in the steepest direction changes the logarithm by a half.
    assert np.max(np.abs(slope) * np.sqrt(np.diag(fit.covariance))[0] / fit.estimates["c"]) < 0.1
    step = 1e-5 * np.eye(len(fit.variables))[1]
    difference = (density(fit.variables + step)[0] - density(fit.variables - step)[0]) / 2e-5
    assert difference == pytest.approx(float(slope[1]), abs=1e-2 * fit.chi2)


def test_information_of_a_function():
    at = TRUTH | {"mix": MIX}
    known = jw.information(fb, at, sigma={"bend": 0.1, "way": 0.2}, control=CONTROL, channels=hall)
    assert known.channels == ("bend", "way") and known.names == tuple(at)

    def signals(c, q, mix):
        result = jw.scan(fb(c, q), CONTROL)
        return np.concatenate([np.asarray(signal)[:, 0] for signal in hall(result, mix).values()])

    for k, name in enumerate(at):
        step = 1e-5 * max(1.0, at[name])
        more, less = signals(**at | {name: at[name] + step}), signals(**at | {name: at[name] - step})
        difference = (more - less).reshape(2, -1).T / (2 * step) / [0.1, 0.2]
        counted = known.rates[:, :, k] != 0
        off = np.abs(known.rates[:, :, k] - difference)[counted]
        assert np.max(off) < DIFFERENCE * np.max(np.abs(difference[counted])) * 100, name


def test_a_result_is_read_through_the_function():
    scene = fb(**TRUTH)
    fit = jw.identify(
        fb, {"c": 90.0, "q": 0.25}, jw.scan(scene, CONTROL), channels=lambda result: {"way": result.base_x}
    )
    assert fit.estimates["q"] == pytest.approx(TRUTH["q"], rel=RECOVERED)
    assert exact(scene)["control"].shape == fit.measured.control.shape


@pytest.mark.parametrize(
    ("channels", "named"),
    [
        (3.0, "3.0"),
        (lambda: {"a": 1.0}, "function of the result"),
        (lambda result: result.fx, "mapping"),
        (lambda result: {"a": result.fx[0, 0]}, r"\(\) for a"),
        (lambda result: {"a": result.events.control}, "events"),
        (lambda result: {"a": result.fx if result.fx[0, 0] > 0 else result.fy}, "trace"),
    ],
)
def test_wrong_functions_are_named(channels, named):
    with pytest.raises(ValueError, match=f"`channels`.*{named}"):
        jw.identify(fb, {"c": 90.0, "q": 0.25}, {"control": CONTROL, "a": CONTROL}, channels=channels)


def test_arguments_of_the_function_need_a_guess():
    with pytest.raises(ValueError, match=r"`guess`.*mix"):
        channels_from(hall, fb(**TRUTH), TRUTH)
    with pytest.raises(ValueError, match=r"`measured`.*mix"):
        jw.identify(fb, TRUTH | {"mix": 0.0}, jw.scan(fb(**TRUTH), CONTROL), channels=hall)
