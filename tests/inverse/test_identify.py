"""Identification: parameters come back, their errors are honest, and a bad fit never looks like a good one."""

import numpy as np
import pytest
from matplotlib import pyplot

import jaxwhisker as jw
from recordings import CONTROL, NOISE, STEPS, TRUTH, exact, fb, noisy, reversed_order

RECOVERED = 1e-6  # relative: least squares stop at 1e-7, signals by the closed form and by integration agree to 1e-9
LIKELY = 4.0  # standard errors: one in 16,000 estimates is further off


def fb_whole(c, q, stiffness, rest, position):
    """Everything about one whisker on a spring."""
    support = jw.Support((jw.Spring((0, 1), c, rest),))
    return jw.Scene(jw.Whisker(1.0, stiffness), jw.Parabola(q, 1.0, position), support)


@pytest.fixture(scope="module")
def data():
    """Signals without noise."""
    return exact(fb(**TRUTH))


def off(fit):
    """Largest relative error of the estimates."""
    return max(abs(fit.estimates[name] / value - 1) for name, value in TRUTH.items())


@pytest.mark.parametrize("factors", [(1.0, 1.0), (3.0, 3.0), (1 / 3, 1 / 3), (3.0, 1 / 3)])
def test_parameters_come_back_from_guesses_off_by_three(data, factors):
    guess = {name: value * factor for (name, value), factor in zip(TRUTH.items(), factors, strict=True)}
    fit = jw.identify(fb, guess, data)
    assert fit.status == jw.FitStatus.ok and fit.starts == 1
    assert off(fit) < RECOVERED


def test_errors_have_the_right_size(data):
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


@pytest.mark.parametrize("seed", range(3))
def test_unknown_noise_is_estimated_from_the_residuals(data, seed):
    known = jw.identify(fb, {"c": 80.0, "q": 0.3}, noisy(data, seed), sigma=NOISE)
    fit = jw.identify(fb, {"c": 80.0, "q": 0.3}, noisy(data, seed))
    assert fit.status == jw.FitStatus.ok
    np.testing.assert_allclose(np.nanmax(fit.measured.sigma, axis=(0, 1)), list(NOISE.values()), rtol=0.15)
    for name in TRUTH:
        assert fit.estimates[name] == pytest.approx(known.estimates[name], abs=known.standard_error[name])
        assert fit.standard_error[name] == pytest.approx(known.standard_error[name], rel=0.2)


def test_gaps_missing_channels_offsets_and_a_shift(data):
    gaps = {n: v.copy() for n, v in data.items()}
    gaps["mz"][40:60] = np.nan
    gaps["fx"][::3] = np.nan
    del gaps["fy"]
    fit = jw.identify(fb, {"c": 90.0, "q": 0.2}, gaps)
    assert off(fit) < RECOVERED
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
        assert off(jw.identify(fb, {"c": 60.0, "q": 0.3}, form)) < RECOVERED
    with pytest.raises(ValueError, match="several along c"):
        jw.identify(fb, TRUTH, xr.concat([dataset, dataset], "c"))


REVERSING = np.concatenate([np.linspace(0.75, -0.6, STEPS // 2), np.linspace(-0.6, 0.75, STEPS // 2)])


@pytest.mark.parametrize("control", [CONTROL[::-1], REVERSING], ids=["from the other side", "reversing"])
def test_other_ways_of_the_drive(control):
    fit = jw.identify(fb, {"c": 3 * TRUTH["c"], "q": TRUTH["q"] / 2}, exact(fb(**TRUTH), control))
    assert fit.starts == 1 and fit.status == jw.FitStatus.ok
    assert off(fit) < RECOVERED


def test_parameters_that_are_not_identifiable_have_no_error(data):
    guess = {"c": 60.0, "q": 0.25, "stiffness": 1.1, "rest": 0.2, "position": 0.0}
    fit = jw.identify(fb_whole, guess, data, sigma=NOISE)
    # The position of the object and the rest length of the spring shift the signals alike.
    assert not fit.identified["rest"] and not fit.identified["position"]
    assert fit.identified["c"] and fit.identified["q"] and fit.identified["stiffness"]
    assert np.isnan(fit.standard_error["rest"]) and np.isnan(fit.interval["position"][0])
    assert any("rest" in words and "position" in words for words in fit.combinations)
    assert "not identified" in str(fit) and "not identifiable: " in str(fit)
    # Exact signals, but with finite `sigma`: where in its step the snap lies determines the rest.
    assert fit.estimates["stiffness"] == pytest.approx(1.0, abs=fit.standard_error["stiffness"])


def test_a_rigid_clamp_does_not_identify_a_spring(data):
    # The spring's rest length is 0.2.
    rigid = exact(jw.Scene(jw.Whisker(), jw.Parabola(0.27)), control=data["control"] + 0.2)
    fit = jw.identify(fb, {"c": 1e4, "q": 0.3}, rigid | {"control": data["control"]}, sigma=NOISE)
    assert fit.identified == {"q": True, "c": False}
    assert "c alone" in fit.combinations[0] and np.isnan(fit.standard_error["c"])
    assert fit.estimates["q"] == pytest.approx(0.27, rel=1e-3)  # the spring is not rigid


def test_a_bad_fit_never_looks_like_a_good_one(data):
    # With fx, the wrong sign of mz would be recognised.
    wrong = {"control": data["control"], "fy": data["fy"], "mz": -data["mz"]}
    fit = jw.identify(fb, TRUTH, wrong, sigma=NOISE, starts=2)
    assert fit.status == jw.FitStatus.implausible and fit.starts == 3
    assert all(np.isnan(e) for e in fit.standard_error.values())
    assert str(fit).startswith("NOT A GOOD FIT (implausible)") and "identified " not in str(fit)
    fit = jw.identify(fb, TRUTH | {"c": 40.0}, data, sigma=NOISE, bounds={"c": (20.0, 50.0)}, starts=0)
    assert fit.status in (jw.FitStatus.at_bound, jw.FitStatus.implausible)
    assert fit.estimates["c"] <= 50.0 and np.isnan(fit.standard_error["c"])


def test_a_fit_that_leaves_most_samples_out_is_implausible():
    # Without fx, nothing but the fit itself shows that the order is reversed: it ends where nothing is touched.
    data = reversed_order(exact(fb(60.0, 0.25)))
    fit = jw.identify(fb, {"c": 100.0, "q": 0.3}, {n: v for n, v in data.items() if n != "fx"}, starts=0)
    assert fit.status == jw.FitStatus.implausible and fit.chi2 > 1e3 * fit.degrees
    assert np.isnan(list(fit.standard_error.values())).all() and np.all(fit.signals == 0)
    # The same misfit with hardly any samples left, as if the snap were far from the observed one.
    solution = fit._solution
    (compared,) = solution.compared
    few = compared._replace(left_out=np.arange(compared.left_out.size) > 9)
    status, reason = fit._problem.status(solution._replace(compared=(few,)))
    assert status == jw.FitStatus.implausible and "only 20 of 512 values lie on the same side of a snap" in reason


@pytest.mark.parametrize("seed", [None, 0])
def test_unknown_noise_does_not_explain_a_wrong_scene(data, seed):
    # Another rest length by 0.02: residuals of 3 % of the peaks, which would pass for noise by their size.
    moved = data | {"control": data["control"] + 0.02}
    fit = jw.identify(fb, {"c": 80.0, "q": 0.3}, moved if seed is None else noisy(moved, seed), starts=0)
    assert fit.status == jw.FitStatus.implausible
    assert "neighbouring samples" in fit.reason and "`sigma`" in fit.reason


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
        ({"measured": TABLE | {"mz": np.ones(49)}}, "mz"),
        ({"measured": {"fx": np.ones(5)}}, "`control`"),
        ({"measured": {"control": TABLE["control"]}}, "at least one of fx, fy, mz"),
        ({"measured": 3.0}, "`measured`"),
        ({"measured": "no such file.csv"}, "no such file.csv"),
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
        ({"gains": 3}, "`gains` must be True, False, a 3 x 3 matrix, .*, got 3"),
        ({"gains": ["fx"]}, r"`gains` must be True, False, a 3 x 3 matrix, .*, got \['fx'\]"),
        ({"offsets": 0.0}, "`offsets` must be True or False, got 0.0"),
        ({"offsets": None}, "`offsets` must be True or False, got None"),
        ({"shift": "no"}, "`shift` must be True or False, got 'no'"),
        ({"snaps": 1}, "`snaps` must be True or False, got 1"),
        ({"near": 1}, "`near` must be True or False, got 1"),
        ({"build": lambda c, q: 3.0}, "`build`"),
        ({"build": lambda c, q: fb(50.0, q)}, "depends on c"),
    ],
)
def test_wrong_arguments_are_named(arguments, words):
    given = {"build": fb, "guess": GUESS, "measured": TABLE} | arguments
    with pytest.raises(ValueError, match=words):
        jw.identify(**given)


def no_compilation(*_, **__):
    """In place of the program: a check came too late."""
    raise AssertionError("a program was compiled")


@pytest.mark.parametrize("name", ["reversed", "constant", "not traceable"])
def test_hopeless_fits_are_refused_before_compiling(name, monkeypatch):
    arguments, words = {
        "reversed": (
            {"measured": reversed_order(exact(fb(60.0, 0.25), np.linspace(0.75, -1.35, 200)))},
            "`measured`.*order",
        ),
        "constant": ({"measured": TABLE}, "`measured`.*contact"),
        "not traceable": ({"build": lambda c, q: fb(float(c), q)}, "`build`.*JAX can trace"),
    }[name]
    monkeypatch.setattr("jaxwhisker._inverse.linearised.problem_and_slopes_now", no_compilation)
    with pytest.raises(ValueError, match=words):
        jw.identify(**{"build": fb, "guess": {"c": 100.0, "q": 0.3}, "measured": TABLE, "starts": 0} | arguments)


def test_pictures_of_fits(data):
    lacking = {name: values for name, values in data.items() if name != "fx"}
    axes = jw.plot.fit(jw.identify(fb, TRUTH, lacking, sigma=NOISE))
    assert [ax.get_ylabel() for ax in axes[::2]] == [jw.plot.axis_label(name) for name in ("fy", "mz")]
    dots, line = axes[0].get_lines()
    np.testing.assert_allclose(dots.get_ydata(), data["fy"][:, 0])
    np.testing.assert_allclose(line.get_ydata(), data["fy"][:, 0], atol=NOISE["fy"])
    pyplot.close("all")
