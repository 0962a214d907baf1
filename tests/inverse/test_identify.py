"""Parameters from signals: they come back, their errors are honest, and what cannot be told is said."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import pyplot

import jaxwhisker as jw
from jaxwhisker._inverse.features import features
from jaxwhisker._inverse.identifiability import identifiability
from jaxwhisker._inverse.measured import Measured
from jaxwhisker._inverse.misfit import WIDE_EVENT

RECOVERED = 1e-6  # relative: least squares stop at 1e-7, signals by the closed form and by integration agree to 1e-9
STEPS = 256  # one block of samples, so that all fits of a scene share a compiled function
NOISE = {"fx": 0.07, "fy": 0.2, "mz": 0.06}  # 1 % of the peaks
LIKELY = 4.0  # standard errors: one in 16,000 estimates is further off
SHARE = 0.02  # relative: a parabola's interval and a profile likelihood's, where the parabola is good
DIFFERENCE = 1e-5  # relative step of central differences, good to 1e-9 of a smooth function
SLOPE = 1e-5  # relative: derivatives against differences of signals that are good to 1e-10


def fb(c, q):
    """One whisker on a spring."""
    return jw.Scene(jw.Whisker(), jw.Parabola(q), jw.Support.fb(c))


def fb_whole(c, q, stiffness, rest, position):
    """Everything about one whisker on a spring."""
    support = jw.Support((jw.Spring((0, 1), c, rest),))
    return jw.Scene(jw.Whisker(1.0, stiffness), jw.Parabola(q, 1.0, position), support)


TRUTH = {"c": 55.0, "q": 0.27}


def exact(scene, steps=STEPS, control=None):
    """Signals by the closed form: fits integrate, so that no errors are shared."""
    scene = jw.Scene(scene.whisker, scene.profile, scene.support, rod=jw.ClosedForm())
    if control is None:
        control = np.linspace(0.75, -1.35, steps)
    result = jw.scan(scene, control)
    return {"control": np.asarray(control)} | {n: np.asarray(getattr(result, n)) for n in NOISE}


def noisy(data, seed):
    """The same with noise."""
    rng = np.random.default_rng(seed)
    return {n: v + NOISE[n] * rng.standard_normal(v.shape) if n in NOISE else v for n, v in data.items()}


@pytest.fixture(scope="module")
def data():
    """Signals without noise."""
    return exact(fb(**TRUTH))


@pytest.mark.parametrize("factors", [(1.0, 1.0), (3.0, 3.0), (1 / 3, 1 / 3), (3.0, 1 / 3)])
def test_parameters_come_back_from_guesses_off_by_three(data, factors):
    guess = {name: value * factor for (name, value), factor in zip(TRUTH.items(), factors, strict=True)}
    fit = jw.identify(fb, guess, data)
    assert fit.status == jw.FitStatus.ok
    assert max(abs(fit.estimates[k] / v - 1) for k, v in TRUTH.items()) < RECOVERED


def test_errors_are_as_large_as_told(data):
    bound = jw.information(fb, TRUTH, sigma=NOISE, control=data["control"]).standard_error
    for seed in range(4):
        fit = jw.identify(fb, {"c": 80.0, "q": 0.3}, noisy(data, seed), sigma=NOISE)
        assert fit.status == jw.FitStatus.ok
        for name, value in TRUTH.items():
            assert abs(fit.estimates[name] - value) < LIKELY * fit.standard_error[name]
            # At the estimate, not at the truth.
            np.testing.assert_allclose(fit.standard_error[name], bound[name], rtol=0.2)
            low, high = fit.interval[name]
            assert low < fit.estimates[name] < high


def test_profile_is_the_interval_where_the_misfit_is_a_parabola(data):
    fit = jw.identify(fb, TRUTH, noisy(data, 1), sigma=NOISE)
    profile = fit.profile("q", points=9)
    np.testing.assert_allclose(profile.interval, fit.interval["q"], rtol=SHARE * fit.standard_error["q"] * 10)
    assert profile.misfit[4] == np.min(profile.misfit)
    assert np.all(np.diff(profile.misfit[:5]) < 0) and np.all(np.diff(profile.misfit[4:]) > 0)


def test_log_density_has_its_maximum_at_the_estimate_and_its_curvature_there(data):
    fit = jw.identify(fb, TRUTH, noisy(data, 1), sigma=NOISE)
    gradient = jax.jit(jax.grad(fit.log_density))(jnp.asarray(fit.variables))
    errors = np.array([fit.standard_error[n] / fit.estimates[n] for n in fit.names])
    # In standard errors: how far a Newton step would lead.
    assert np.max(np.abs(np.asarray(gradient)) * errors) < 1e-2
    found = fit.parameters(fit.variables)
    assert {n: float(v) for n, v in found.items()} == pytest.approx(fit.estimates)


def test_gaps_missing_channels_offsets_and_a_shift(data):
    gaps = {n: v.copy() for n, v in data.items()}
    gaps["mz"][40:60] = np.nan
    gaps["fx"][::3] = np.nan
    del gaps["fy"]
    fit = jw.identify(fb, {"c": 90.0, "q": 0.2}, gaps)
    assert max(abs(fit.estimates[k] / v - 1) for k, v in TRUTH.items()) < RECOVERED
    moved = data | {"control": data["control"] + 0.03, "fx": data["fx"] + 0.5, "mz": data["mz"] - 0.2}
    fit = jw.identify(fb, {"c": 70.0, "q": 0.3}, moved, offsets=True, shift=True)
    assert fit.status == jw.FitStatus.ok
    assert fit.estimates["c"] == pytest.approx(TRUTH["c"], rel=10 * RECOVERED)
    assert fit.estimates["shift"] == pytest.approx(-0.03, abs=RECOVERED)
    assert fit.estimates["offset_fx"] == pytest.approx(0.5, abs=RECOVERED)
    assert fit.estimates["offset_mz"] == pytest.approx(-0.2, abs=RECOVERED)


def test_every_form_of_data_gives_the_same_fit(data, tmp_path):
    import pandas as pd
    import xarray as xr

    frame = pd.DataFrame({n: np.ravel(v) for n, v in data.items()})
    path = tmp_path / "measured.csv"
    path.write_text("# a comment\n" + frame.to_csv(index=False), encoding="utf-8")
    result = jw.scan(fb(**TRUTH), data["control"])
    dims = ("c", "control", "whisker")
    dataset = xr.Dataset({n: (dims, np.asarray(getattr(result, n))[None]) for n in NOISE}, {"control": data["control"]})
    for form in (frame, path, str(path), result, dataset):
        fit = jw.identify(fb, {"c": 60.0, "q": 0.3}, form)
        assert max(abs(fit.estimates[k] / v - 1) for k, v in TRUTH.items()) < RECOVERED
    with pytest.raises(ValueError, match="several along c"):
        jw.identify(fb, TRUTH, xr.concat([dataset, dataset], "c"))


def test_data_recorded_backwards_are_a_scan_from_the_other_side():
    control = np.linspace(-1.35, 0.75, STEPS)
    fit = jw.identify(fb, {"c": 3 * TRUTH["c"], "q": TRUTH["q"] / 2}, exact(fb(**TRUTH), control=control))
    assert fit.starts == 1
    assert max(abs(fit.estimates[k] / v - 1) for k, v in TRUTH.items()) < RECOVERED


def test_reversing_data():
    control = np.concatenate([np.linspace(0.75, -0.6, STEPS // 2), np.linspace(-0.6, 0.75, STEPS // 2)])
    fit = jw.identify(fb, {"c": 3 * TRUTH["c"], "q": TRUTH["q"] / 2}, exact(fb(**TRUTH), control=control))
    assert fit.starts == 1
    assert max(abs(fit.estimates[k] / v - 1) for k, v in TRUTH.items()) < RECOVERED


def test_a_touch_in_noise_lies_where_it_is_told():
    # fx is loudest, but no parabola; mz tells where.
    control, touch, noise = np.linspace(0.0, -1.0, STEPS), 0.3, 0.02
    past = np.maximum(-control - touch, 0.0)
    values = np.stack([0.2 * past + 20 * past**7, np.full(STEPS, np.nan), past + past**2], axis=-1)
    misses = []
    for seed in range(20):
        found = values + noise * np.random.default_rng(seed).standard_normal(values.shape)
        seen = features(Measured(control, found[:, None], np.full(found[:, None].shape, noise)))
        misses.append(abs(seen.touch[0] - touch))
    assert np.median(misses) < WIDE_EVENT / 2


def test_what_is_only_told_together_is_said_and_has_no_error(data):
    guess = {"c": 60.0, "q": 0.25, "stiffness": 1.1, "rest": 0.2, "position": 0.0}
    fit = jw.identify(fb_whole, guess, data, sigma=NOISE)
    # Where the object is and how long the spring rests shift the signals alike.
    assert not fit.identified["rest"] and not fit.identified["position"]
    assert fit.identified["c"] and fit.identified["q"] and fit.identified["stiffness"]
    assert np.isnan(fit.standard_error["rest"]) and np.isnan(fit.interval["position"][0])
    assert any("rest" in words and "position" in words for words in fit.combinations)
    assert "not identified" in str(fit)
    # Without noise, but with the noise that is told: where in its step the snap lies decides the rest.
    assert fit.estimates["stiffness"] == pytest.approx(1.0, abs=fit.standard_error["stiffness"])


def test_a_rigid_clamp_tells_nothing_of_a_spring(data):
    rigid = exact(jw.Scene(jw.Whisker(), jw.Parabola(0.27)), control=data["control"] + 0.2)  # the spring's rest length
    fit = jw.identify(fb, {"c": 1e4, "q": 0.3}, rigid | {"control": data["control"]}, sigma=NOISE)
    assert fit.identified == {"q": True, "c": False}
    assert "c alone" in fit.combinations[0] and np.isnan(fit.standard_error["c"])
    assert fit.estimates["q"] == pytest.approx(0.27, rel=1e-3)  # the spring is not rigid


def test_what_changes_nothing_is_found_and_said():
    rng = np.random.default_rng(0)
    jacobian = 1e3 * rng.standard_normal((50, 3))
    names, log, scale = ("a", "b", "x"), np.array([True, True, False]), np.array([1.0, 1.0, 0.5])
    known = identifiability(jacobian, names, log, scale)
    assert known.rank == 3 and known.identified.all() and not known.combinations
    np.testing.assert_allclose(known.covariance, np.linalg.inv(jacobian.T @ jacobian))
    alone = identifiability(jacobian * [1.0, 0.0, 1.0], names, log, scale)
    assert alone.combinations == ("b alone changes no signal",) and alone.identified.tolist() == [True, False, True]
    together = identifiability(jacobian[:, [0, 0, 1]] * [1.0, -2.0, 1.0], names, log, scale)
    assert together.combinations == ("a +1 % with b +0.5 % changes no signal",)
    assert np.isnan(together.covariance[0]).all() and together.covariance[2, 2] > 0
    weak = identifiability(jacobian * [1e-5, 1.0, 1.0], names, log, scale)
    assert weak.rank == 2 and "a alone is told no better than to a factor of" in weak.combinations[0]
    # Of what may have any sign an error is as large as it is.
    assert identifiability(jacobian * [1.0, 1.0, 1e-5], names, log, scale).identified.all()


def test_a_bad_fit_never_looks_like_a_good_one(data):
    wrong = data | {"mz": -data["mz"]}
    fit = jw.identify(fb, TRUTH, wrong, sigma=NOISE, starts=2)
    assert fit.status == jw.FitStatus.implausible and fit.starts == 3
    assert all(np.isnan(e) for e in fit.standard_error.values())
    assert str(fit).startswith("NOT A GOOD FIT (implausible)") and "identified " not in str(fit)
    fit = jw.identify(fb, TRUTH | {"c": 40.0}, data, sigma=NOISE, bounds={"c": (20.0, 50.0)}, starts=0)
    assert fit.status in (jw.FitStatus.at_bound, jw.FitStatus.implausible)
    assert fit.estimates["c"] <= 50.0 and np.isnan(fit.standard_error["c"])


@pytest.mark.parametrize("bounds", [(30.0, 90.0), (None, 90.0), (30.0, None)])
def test_bounds_that_hold_the_truth_do_not_matter(data, bounds):
    fit = jw.identify(fb, {"c": 40.0, "q": 0.3}, data, bounds={"c": bounds})
    free = jw.identify(fb, {"c": 40.0, "q": 0.3}, data)
    assert fit.estimates["c"] == pytest.approx(TRUTH["c"], rel=RECOVERED)
    assert fit.standard_error["c"] == pytest.approx(free.standard_error["c"], rel=0.1)  # both from tiny residuals


GUESS = {"c": 60.0, "q": 0.3}
TABLE = {"control": np.linspace(0.7, -1.3, 50), "fx": np.ones(50)}


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"measured": TABLE | {"Fz": np.ones(50)}}, "'Fz'"),
        ({"measured": TABLE | {"mz": np.ones(49)}}, "mz"),
        ({"measured": {"fx": np.ones(5)}}, "`control`"),
        ({"measured": {"control": TABLE["control"]}}, "at least one of fx, fy, mz"),
        ({"measured": 3.0}, "`measured`"),
        ({"measured": "no such file.csv"}, "no such file.csv"),
        ({"measured": {"control": np.linspace(0.7, 0.6, 2), "fx": np.array([0.0, 1.0])}}, "more values"),
        ({"measured": TABLE | {"fx": np.zeros(50)}}, "contact"),
        ({"sigma": 0.0}, "`sigma`.*0.0"),
        ({"sigma": {"fx": -1.0}}, "`sigma`.*-1.0"),
        ({"sigma": {"mz": 1.0}}, "`sigma`.*fx"),
        ({"sigma": {"fq": 1.0}}, "`sigma`.*'fq'"),
        ({"sigma": "a"}, "`sigma`.*'a'"),
        ({"sigma": {"fx": 1.0, "fx_3": 1.0}}, "`sigma`.*'fx_3'"),
        ({"measured": {"control": TABLE["control"], "fx_0": np.ones(50)}}, "`measured`.*whisker 0"),
        ({"guess": {"c": 60.0, "q": np.nan}}, "`guess`.*`q`"),
        ({"guess": {"c": 60.0}}, "`guess`.*'q'"),
        ({"guess": {"c": 60.0, "q": 0.3, "k": 1.0}}, "`guess`.*'k'"),
        ({"guess": {}}, "`guess`"),
        ({"bounds": {"c": (70.0, 90.0)}}, "`guess`.*c = 60.0"),
        ({"bounds": {"b": (70.0, 90.0)}}, "`bounds`.*'b'"),
        ({"bounds": {"c": 3.0}}, "`bounds`.*3.0"),
        ({"transform": {"c": "sqrt"}}, "`transform`.*'sqrt'"),
        ({"starts": -1}, "`starts`.*-1"),
        ({"build": lambda c, q: 3.0}, "`build`"),
        ({"build": lambda c, q: fb(50.0, q)}, "depends on c"),
    ],
)
def test_wrong_arguments_are_told_by_name(arguments, words):
    given = {"build": fb, "guess": GUESS, "measured": TABLE} | arguments
    with pytest.raises(ValueError, match=words):
        jw.identify(**given)


def test_values_in_other_units_are_a_warning(data):
    milli = data | {n: 1e-6 * data[n] for n in NOISE}
    with pytest.warns(UserWarning, match="same units"):
        jw.identify(fb, GUESS, milli, starts=0)


@pytest.fixture(scope="module")
def told():
    """What the signals of one whisker know."""
    return jw.information(fb, TRUTH, sigma=NOISE, control=np.linspace(0.75, -1.35, STEPS))


def test_information_is_that_of_differences(told):
    control = told.control
    rates = []
    for name, value in TRUTH.items():
        step = DIFFERENCE * value
        high, low = (exact(fb(**TRUTH | {name: value + s}), control=control) for s in (step, -step))
        rates.append(np.stack([(high[c] - low[c])[:, 0] / (2 * step) / NOISE[c] for c in NOISE], axis=1))
    expected = np.stack(rates, axis=-1)
    some = np.any(told.rates != 0, axis=(1, 2))
    # A step beside a snap is left out; differences there would leave the branch.
    some &= np.max(np.abs(np.gradient(expected[:, 2, 0]))) > 0
    scale = np.max(np.abs(told.rates), axis=(0, 1))
    np.testing.assert_allclose(told.rates[some] / scale, expected[some] / scale, atol=1e2 * SLOPE)
    assert some.sum() > STEPS // 2


def test_information_adds_up(told):
    np.testing.assert_allclose(sum(told.by_channel.values()), told.matrix, rtol=1e-12)
    alone = told.of("mz")
    assert alone.channels == ("mz",) and alone.standard_error["c"] > told.standard_error["c"]
    assert told.known("q").standard_error["c"] <= told.standard_error["c"]
    snaps = told.by_channel["snaps"]
    assert np.linalg.matrix_rank(snaps) == 1  # one snap-off: one combination
    np.testing.assert_allclose(told.density.sum(axis=0) + np.diag(snaps), np.diag(told.matrix), rtol=1e-12)
    assert told.with_events(1e-4).standard_error["c"] < told.standard_error["c"]
    assert {e.kind.name for e in told.events} >= {"touch", "vertex", "snap_off"}
    assert "told most by" in str(told)
    for wrong in (lambda: told.of("fq"), lambda: told.known("x"), lambda: told.known("c", "q")):
        with pytest.raises(ValueError, match="must"):
            wrong()


def test_event_rates_are_those_of_differences(told):
    (snap,) = [e for e in told.events if e.kind == jw.EventKind.snap_off]
    for k, (name, value) in enumerate(TRUTH.items()):
        step = DIFFERENCE * value
        at = [
            jw.scan(fb(**TRUTH | {name: value + s}), told.control).events.of(jw.EventKind.snap_off)[0].control
            for s in (step, -step)
        ]
        assert snap.by_parameter[k] == pytest.approx((at[0] - at[1]) / (2 * step), rel=1e-4)


def test_pictures_of_fits_and_of_information(data, told):
    ax = jw.plot.information(told)
    curves = {line.get_label(): line for line in ax.get_lines() if not line.get_label().startswith("_")}
    assert set(curves) == set(TRUTH)
    for k, name in enumerate(told.names):
        gained = curves[name].get_ydata()
        assert gained[-1] == pytest.approx(1.0) and np.all(np.diff(gained) >= 0)
        np.testing.assert_allclose(np.diff(gained), told.density[1:, k] / told.density[:, k].sum(), atol=1e-12)
    lacking = {name: values for name, values in data.items() if name != "fx"}
    axes = jw.plot.fit(jw.identify(fb, TRUTH, lacking, sigma=NOISE))
    assert [ax.get_ylabel() for ax in axes] == [jw.plot.axis_label(name) for name in ("fy", "mz")]
    dots, line = axes[0].get_lines()
    np.testing.assert_allclose(dots.get_ydata(), data["fy"][:, 0])
    np.testing.assert_allclose(line.get_ydata(), data["fy"][:, 0], atol=NOISE["fy"])
    pyplot.close("all")


def test_design_finds_the_best_spring(told):
    data = jw.design(fb, {"q": 0.27}, sigma=NOISE, control=told.control, c=[40.0, TRUTH["c"], 200.0])
    assert data.standard_error.dims == ("c", "parameter")
    alone = told.known("c").standard_error["q"]
    np.testing.assert_allclose(data.standard_error.sel(c=TRUTH["c"], parameter="q"), alone, rtol=1e-6)
    best = float(data.c[int(np.argmin(data.relative_error.sel(parameter="q").values))])
    assert data.attrs["best"] == f"c = {best:g}"


NO_MAPPING: Any = 3.0


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: jw.information(fb, TRUTH, sigma=-1.0, control=[0.7, 0.1]), "`sigma`"),
        (lambda: jw.information(fb, TRUTH, sigma=1.0, channels=("fz",), control=[0.7, 0.1]), "`channels`.*'fz'"),
        (lambda: jw.information(fb, TRUTH, sigma={"fx": 1.0}, control=[0.7, 0.1]), "`sigma`.*fy, mz"),
        (lambda: jw.information(fb, TRUTH, sigma=1.0, channels=(), control=[0.7, 0.1]), "`channels`.*empty"),
        (lambda: jw.information(fb, {"c": 1.0}, sigma=1.0), "`at` must name the parameters of `build`"),
        (lambda: jw.information(fb, NO_MAPPING, sigma=1.0), "`at`.*3.0"),
        (lambda: jw.design(fb, NO_MAPPING, sigma=1.0, c=[1.0, 2.0]), "`at`.*3.0"),
        (lambda: jw.design(fb, {"q": 0.3}, sigma=1.0, k=[1.0], control=[0.7, 0.1]), "`axes` must name .*'k'"),
        (lambda: jw.design(fb, TRUTH, sigma=1.0), "`axes`"),
        (lambda: jw.design(fb, TRUTH, sigma=1.0, c=[1.0]), "`c`"),
        (lambda: jw.design(fb, {"q": 0.3}, sigma=1.0, c=[50.0, -1.0], control=[0.7, 0.1]), "`stiffness`.*-1.0"),
    ],
)
def test_wrong_arguments_of_information_and_design(call, words):
    with pytest.raises(ValueError, match=words):
        call()
