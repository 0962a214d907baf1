"""Identification and information in space: parameters from the signals of an independent reference."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportOptionalSubscript=false

import json
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

REFERENCE = 1e-6  # the reference gives ten digits
SLOPES = 1e-6  # relative to the largest; central differences with a step of 1e-4
NAMES = ("fx", "fy", "fz", "mx", "my", "mz")
CASES = json.loads((Path(__file__).parents[1] / "data" / "space_points.json").read_text("utf-8"))["cases"]


def reference(name):
    """The signals of a case of the reference, in the order of a scan."""
    (row,) = [row for row in CASES if row["name"] == name]
    states = row["states"]
    reactions = np.concatenate([states["force"], states["moment"]], axis=1)
    return {"control": np.array(states["u"])} | dict(zip(NAMES, reactions.T, strict=True))


def clamped(offset, distance):
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, offset))
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, distance + 1.0, 0.0)), motion=drive)


def sprung(offset, stiffness):
    springs = [jw.Spring((0, 1), c, axis=axis) for axis, c in zip("xyz", (stiffness, 300.0, 8.0), strict=True)]
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, offset))
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.0)), jw.Support(tuple(springs)), motion=drive)


def bent(curvature, roll):
    mount = jw.Mount(roll=roll)
    hair = jw.Whisker(intrinsic_curvature=curvature, torsion_ratio=2 / 3)
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, 0.1))
    return jw.SpaceScene(hair, jw.Sphere(1.0, (0.0, 1.3, 0.0)), jw.Support(mount=mount), motion=drive)


@pytest.mark.parametrize(
    ("name", "build", "truth", "guess"),
    [
        ("S1 sphere offset 0.2", clamped, {"offset": 0.2, "distance": 0.3}, {"offset": 0.15, "distance": 0.35}),
        (
            "S2 sphere offset 0.2 springs (30, 300, 8)",
            sprung,
            {"offset": 0.2, "stiffness": 30.0},
            {"offset": 0.25, "stiffness": 40.0},
        ),
        (
            "S4 arc kappa 0.8 roll 60 C/B 0.667 offset 0.1",
            bent,
            {"curvature": 0.8, "roll": np.pi / 3},
            {"curvature": 0.6, "roll": 0.9},
        ),
    ],
)
def test_parameters_follow_from_the_signals_of_the_reference(name, build, truth, guess):
    fit = jw.identify(build, guess, reference(name), sigma=1e-6)
    assert fit.status == jw.FitStatus.ok, str(fit)
    for key, value in truth.items():
        assert abs(fit.estimates[key] - value) < REFERENCE * max(1.0, value), str(fit)


TRUTH = {"offset": 0.2, "distance": 0.3}
CONTROL = np.linspace(-1.0, 1.0, 60)


@pytest.fixture(scope="module")
def scanned():
    return jw.scan(clamped(**TRUTH), CONTROL)


def test_results_tables_and_parts_of_the_channels_may_be_measured(scanned, tmp_path):
    table = {"control": CONTROL} | {name: np.asarray(getattr(scanned, name))[:, 0] for name in ("fx", "fz", "mx")}
    file = tmp_path / "measured.csv"
    np.savetxt(file, np.column_stack(list(table.values())), "%.17g", ",", header=",".join(table), comments="")
    for measured in (scanned, file):
        fit = jw.identify(clamped, {"offset": 0.18, "distance": 0.32}, measured, near=True)
        assert fit.status == jw.FitStatus.ok, str(fit)
        np.testing.assert_allclose(list(fit.estimates.values()), list(TRUTH.values()), atol=REFERENCE)


def test_gains_offsets_and_a_shift_of_the_control_are_found(scanned):
    gains, shift = {"fx": 200.0, "fy": -3.0, "fz": 0.5}, 0.01
    table = {name: 7.0 + gain * np.asarray(getattr(scanned, name))[:, 0] for name, gain in gains.items()}
    measured = {"control": CONTROL - shift} | table
    guess = {"offset": 0.18, "distance": 0.32}
    fit = jw.identify(clamped, guess, measured, sigma=1e-4, gains=True, offsets=True, shift=True, near=True)
    assert fit.status == jw.FitStatus.ok, str(fit)
    truth = TRUTH | {"shift": shift} | {f"gain_{name}": gain for name, gain in gains.items()}
    for name, value in truth.items():
        assert abs(fit.estimates[name] - value) < REFERENCE * max(1.0, abs(value)), str(fit)


def test_information_holds_the_derivatives_of_scans(scanned):
    sigma = 0.01
    found = jw.information(clamped, TRUTH, sigma=sigma, control=CONTROL)
    assert found.channels == NAMES
    for k, name in enumerate(TRUTH):
        ends = [jw.scan(clamped(**TRUTH | {name: TRUTH[name] + step}), CONTROL) for step in (1e-4, -1e-4)]
        one, other = (np.concatenate([end.force[:, 0], end.moment[:, 0]], axis=1) for end in ends)
        expected = (one - other) / 2e-4
        # Not where contact begins or ends between the two.
        steady = np.all([np.asarray(end.phase)[:, 0] == np.asarray(scanned.phase)[:, 0] for end in ends], axis=0)
        assert steady.sum() > 50
        off = found.rates[steady, :, k] * sigma - expected[steady]
        assert np.max(np.abs(off)) < SLOPES * np.max(np.abs(expected))
    alone = found.of("fz").known("distance")
    rates = found.rates[:, NAMES.index("fz"), 0]
    np.testing.assert_allclose(alone.standard_error["offset"], 1 / np.linalg.norm(rates), rtol=1e-12)


def test_information_of_independent_scans_adds_up(scanned):
    first = jw.information(clamped, TRUTH, sigma=0.01, control=CONTROL)
    second = jw.information(clamped, TRUTH, sigma=0.02, control=CONTROL[:50])
    both = first + second
    np.testing.assert_allclose(both.matrix, first.matrix + second.matrix, rtol=1e-12)
    assert both.control.size == 110 and both.density.shape == (110, 2)
    with pytest.raises(ValueError, match="`other` must be information at"):
        _ = first + replace(second, at=dict.fromkeys(second.at, 7.0))
    with pytest.raises(ValueError, match="`other` must have the channels"):
        _ = first + second.of("fx")


def own(result, mix):
    """Signals along the directors of the base, one of them mixed with the length of a spring."""
    (first, *_), (*_, last) = result.own_force[:, 0].T, result.own_moment[:, 0].T
    return {"f1": first + mix * result.spring_length[:, 0], "m3": last, "height": result.base_y}


def test_channels_are_functions_of_results_in_space():
    at = {"offset": 0.2, "stiffness": 30.0, "mix": 0.5}

    def signals(offset, stiffness, mix):
        found = own(jw.scan(sprung(offset, stiffness), CONTROL), mix)
        return np.stack([np.ravel(found[name]) for name in ("f1", "m3", "height")], axis=1)

    found = jw.information(sprung, at, sigma=1.0, control=CONTROL, channels=own)
    assert found.channels == ("f1", "m3", "height") and found.names == tuple(at)
    exact = signals(**at)
    for k, (name, value) in enumerate(at.items()):
        step = 1e-4 * value
        expected = (signals(**at | {name: value + step}) - signals(**at | {name: value - step})) / (2 * step)
        steady = np.any(found.rates != 0, axis=(1, 2)) & np.all(np.abs(expected) < 1e3, axis=1)
        assert steady.sum() > 40
        off = np.abs(found.rates[:, :, k] - expected)[steady]
        assert np.max(off) < 10 * SLOPES * np.max(np.abs(expected[steady])), name
    measured = {"control": CONTROL} | dict(zip(("f1", "m3", "height"), exact.T, strict=True))
    guess = {"offset": 0.18, "stiffness": 35.0, "mix": 0.0}
    fit = jw.identify(sprung, guess, measured, sigma=1e-4, channels=own, near=True, starts=0)
    assert fit.status == jw.FitStatus.ok, str(fit)
    for name, value in at.items():
        assert abs(fit.estimates[name] - value) < REFERENCE * max(1.0, value), str(fit)


def test_fits_report_force_and_moment_as_reconstructions_do(scanned):
    scene, sigma = clamped(**TRUTH), 0.01
    rng = np.random.default_rng(0)
    six = np.concatenate([scanned.force[:, 0], scanned.moment[:, 0]], axis=1)
    noisy = six + sigma * rng.standard_normal(six.shape)
    crosstalk = np.eye(6) + 0.05 * rng.standard_normal((6, 6))
    options = {"sigma": sigma, "near": True, "starts": 0}

    def measured(values):
        return {"control": CONTROL} | dict(zip(NAMES, values.T, strict=True))

    plain = jw.identify(clamped, TRUTH, measured(noisy), **options)
    points = jw.reconstruct(measured(noisy), scene, sigma=sigma)
    np.testing.assert_allclose(plain.force_moment, points.force_moment, rtol=REFERENCE)
    np.testing.assert_allclose(plain.force_moment_score, points.force_moment_score, rtol=REFERENCE)
    touching = np.asarray(scanned.phase)[:, 0] > 0
    # The score has mean 0 and variance 1: that of the mean square of n numbers is 2 / n.
    assert abs(np.mean(plain.force_moment_score[touching] ** 2) - 1) < 4 * np.sqrt(2 / touching.sum())
    assert "force . moment: " in str(plain)
    # Crosstalk and a constant that the fit knows are removed; those that it does not know show.
    mixed = noisy @ crosstalk.T + 0.3
    fit = jw.identify(clamped, TRUTH, measured(mixed), gains=crosstalk, offsets=True, **options)
    exact = jw.identify(clamped, TRUTH, measured(six @ crosstalk.T + 0.3), gains=crosstalk, offsets=True, **options)
    assert np.nanmax(np.abs(exact.force_moment[touching])) < REFERENCE
    assert np.mean(fit.force_moment_score[touching] ** 2) < 2
    wrong = jw.identify(clamped, TRUTH, measured(mixed - 0.3), **options)
    assert wrong.status == jw.FitStatus.implausible and np.mean(wrong.force_moment_score[touching] ** 2) > 9
    partial = {name: values for name, values in measured(noisy).items() if name != "my"}
    assert np.isnan(jw.identify(clamped, TRUTH, partial, **options).force_moment).all()


def test_designs_in_space_are_compared_by_the_information():
    options = {"sigma": 0.01, "control": CONTROL}
    data = jw.design(clamped, {"offset": 0.2}, **options, distance=[0.3, 0.35])
    for k, distance in enumerate((0.3, 0.35)):
        alone = jw.information(clamped, {"offset": 0.2, "distance": distance}, **options).known("distance")
        np.testing.assert_allclose(data.standard_error[k, 0], alone.standard_error["offset"], rtol=1e-9)


def rubbing(distance, friction):
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(0.3, (0.0, distance, 0.1)), friction=friction)


THERE = np.linspace(0.6, -0.05, 60)
THERE_AND_BACK = np.concatenate([THERE, THERE[::-1]])
RUBBED = {"distance": 0.9, "friction": 0.3}


def test_friction_in_space_is_found_from_a_scan_there_and_back():
    result = jw.scan(rubbing(**RUBBED), THERE_AND_BACK)
    assert np.all(result.status == 0) and np.any(np.asarray(result.phase)[90:] > 0)
    signals = {name: np.asarray(getattr(result, name)) for name in ("fx", "fy", "fz", "mx", "my", "mz")}
    rng = np.random.default_rng(0)
    noisy = {name: values + 0.01 * rng.normal(size=values.shape) for name, values in signals.items()}
    fit = jw.identify(rubbing, {"distance": 0.93, "friction": 0.2}, {"control": THERE_AND_BACK, **noisy}, sigma=0.01)
    assert fit.status == jw.FitStatus.ok, str(fit)
    for name, true in RUBBED.items():
        assert abs(fit.estimates[name] - true) < 4 * fit.standard_error[name]
    data = jw.information(rubbing, RUBBED, sigma=0.01, control=THERE_AND_BACK)
    for name in RUBBED:
        np.testing.assert_allclose(fit.standard_error[name], data.standard_error[name], rtol=0.2)
    one = jw.information(rubbing, RUBBED, sigma=0.01, control=THERE)
    assert one.standard_error["friction"] > data.standard_error["friction"]


def test_information_with_friction_in_space_holds_the_derivatives_of_scans():
    def signals(x):
        result = jw.scan(rubbing(*x), THERE_AND_BACK)
        return jnp.ravel(jnp.stack([getattr(result, name) for name in ("fx", "fy", "fz", "mx", "my", "mz")]))

    slopes = np.asarray(jax.jacfwd(signals)(jnp.array(list(RUBBED.values())))) / 0.01
    data = jw.information(rubbing, RUBBED, sigma=0.01, control=THERE_AND_BACK)
    expected = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    np.testing.assert_allclose([data.standard_error[name] for name in RUBBED], expected, rtol=1e-6)


def test_what_is_not_supported_in_space_raises_errors(scanned):
    with pytest.raises(ValueError, match="`channels` must be among fx, fy, fz, mx, my, mz"):
        jw.information(clamped, TRUTH, sigma=0.1, control=CONTROL, channels=("height",))
    fit = jw.identify(clamped, TRUTH, scanned, near=True)
    with pytest.raises(ValueError, match="`log_density` must be asked of a fit in the plane"):
        fit.log_density(fit.variables)
