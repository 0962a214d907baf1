"""Gain matrices: sensors with crosstalk, known or fitted, and what one sweep or two determine."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportOptionalSubscript=false

import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.channels import Channels
from jaxwhisker._inverse.gains import gains_from
from jaxwhisker._scan.quantities import REACTIONS_IN_SPACE as NAMES
from recordings import TRUTH as PLANE
from recordings import exact, fb

RECOVERED = 1e-6  # least squares stop at 1e-7
ROUNDED = 1e-12
NOISE = 1e-3
FITS = 25
PULLS = 0.28  # 4 standard errors of the root mean square of 4 x 25 numbers
LIKELY = 4.5  # standard deviations: one of 100,000 numbers is further off
TRUTH = {"offset": 0.2, "distance": 0.3}
GUESS = {"offset": 0.17, "distance": 0.33}
CONTROL = np.linspace(-0.9, 0.6, 100)
MATRIX = np.eye(6) + 0.1 * np.random.default_rng(0).standard_normal((6, 6))
SPACE = Channels(NAMES, in_space=True)


def past(flatness):
    """Scenes of a curved whisker, which is turned about its base, past an ellipsoid, or a ball if that is not flat."""

    def build(offset, distance, stiffness=1.0):
        hair = jw.Whisker(intrinsic_curvature=0.4, torsion_ratio=0.7, bending_stiffness=stiffness)
        axes = (1.0, 1.0 - flatness / 2, 1.0 - flatness)
        body = jw.Ellipsoid(axes, (0.0, distance + 1.0, 0.0)).rotated((0.3, 0.2, -0.4))
        drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, offset))
        return jw.SpaceScene(hair, body, jw.Support(mount=jw.Mount(roll=0.5)), motion=drive)

    return build


glued, flat = past(0.0), past(0.3)


def six(build=glued, **parameters):
    """The six reactions of a sweep, (steps, 6)."""
    result = jw.scan(build(**TRUTH | parameters), CONTROL)
    return np.concatenate([result.force[:, 0], result.moment[:, 0]], axis=1)


@pytest.fixture(scope="module")
def reactions():
    return six()


def recording(reactions, matrix=MATRIX, offset=0.0, noise=0.0, seed=0):
    """What a sensor with this gain matrix measures."""
    values = reactions @ np.transpose(matrix) + offset
    values = values + noise * np.random.default_rng(seed).standard_normal(values.shape)
    return {"control": CONTROL} | dict(zip(NAMES, values.T, strict=False))


def named(k, c):
    return f"gain_{NAMES[k]}" if k == c else f"gain_{NAMES[k]}_{NAMES[c]}"


def agree(fit, truth):
    assert fit.status == jw.FitStatus.ok, str(fit)
    for name, value in truth.items():
        assert abs(fit.estimates[name] - value) < RECOVERED * max(1.0, abs(value)), f"{name}\n{fit}"


def test_a_matrix_is_applied_to_signals_and_derivatives():
    rng = np.random.default_rng(1)
    matrix, signals = rng.standard_normal((2, 6, 6)), rng.standard_normal((4, 2, 6, 3))
    partly = matrix.copy()
    partly[0, 1, 2] = partly[1, 5, 5] = np.nan
    gains = gains_from(partly, SPACE, 2)
    assert gains.unknown == ((0, 1, 2), (1, 5, 5)) and [gains.name(e) for e in gains.unknown] == ["fy_fz", "mz"]
    unknown = [matrix[e] for e in gains.unknown]
    np.testing.assert_array_equal(gains.filled(unknown), matrix)
    expected = np.einsum("wrc,swcd->swrd", matrix, signals)
    np.testing.assert_allclose(gains.applied(signals, unknown), expected, rtol=ROUNDED, atol=ROUNDED)
    # One matrix for all whiskers, each with its own unknowns.
    assert gains_from(partly[0], SPACE, 2).unknown == ((0, 1, 2), (1, 1, 2))
    assert gains.of_measured([(0, 1)]).unknown == ((0, 1, 2),)
    assert gains_from(True, SPACE, 1).unknown == tuple((0, k, k) for k in range(6))
    assert gains_from(False, SPACE, 1).applied(signals, []) is signals


def test_signals_that_are_not_used_may_be_nan():
    gains = gains_from({"a": [2.0, 0, 0, 0, 0, 0], "b": [0, 3.0, 0, 0, 0, 0]}, SPACE, 1)
    signals = np.array([1.0, np.nan, 1.0, 1.0, 1.0, 1.0])[None, None]
    np.testing.assert_array_equal(gains.applied(signals, []), [[[2.0, np.nan]]])


def test_a_start_has_no_crosstalk_and_rounding_has_no_size():
    gains = gains_from(np.full((6, 6), np.nan), SPACE, 1)
    signals = np.array([[2.0, 4.0, 1.0, 5.0, 1e-16, 8.0]])[:, None]
    sizes, start = gains.sizes(np.full(6, 8.0), signals)
    np.testing.assert_array_equal(np.reshape(sizes, (6, 6))[0], [4.0, 2.0, 8.0, 1.6, 1.0, 1.0])
    np.testing.assert_array_equal(np.reshape(start, (6, 6)), np.diag([4.0, 2.0, 8.0, 1.6, 1.0, 1.0]))


def test_crosstalk_is_what_a_channel_has_besides_its_own_signal():
    known = np.eye(6)
    known[0, 1] = known[0, 0] = known[1, 1] = known[2, 3] = np.nan
    known[2, 2] = 0.0  # without a gain of its own, the other one is all there is
    gains = gains_from(known, SPACE, 1)
    assert [gains.name(e) for e in gains.unknown] == ["fx", "fx_fy", "fy", "fz_mx"]
    np.testing.assert_array_equal(gains.crosstalk, [False, True, False, False])
    assert not gains_from({"u": np.full(6, np.nan)}, SPACE, 1).crosstalk.any()
    assert not gains_from(True, SPACE, 1).crosstalk.any() and not gains_from(False, SPACE, 1).crosstalk.any()


@pytest.mark.parametrize(
    "wrong",
    [
        3.0,
        1j * np.eye(6),
        np.ones(6),
        np.eye(3),
        np.full((6, 6), np.inf),
        "all",
        {},
        {"a": [1.0, 2.0]},
        2.0 * np.eye(7),
    ],
)
def test_wrong_gains_are_named(wrong):
    with pytest.raises(ValueError, match="`gains` must be"):
        gains_from(wrong, SPACE, 1)
    with pytest.raises(ValueError, match="`gains` must be a matrix for scenes of several whiskers"):
        gains_from({"a": np.ones(6)}, SPACE, 2)


def test_a_known_matrix_gives_the_parameters(reactions):
    agree(jw.identify(glued, GUESS, recording(reactions), sigma=NOISE, gains=MATRIX, starts=0), TRUTH)
    # Four channels of other names, one of them with a gain that is not known.
    names = ("u1", "u2", "u3", "u4")
    values = dict(zip(names, (reactions @ MATRIX[:4].T).T, strict=True))
    rows = dict(zip(names, MATRIX[:4].copy(), strict=True))
    rows["u2"][5] = np.nan
    fit = jw.identify(glued, GUESS, {"control": CONTROL} | values, sigma=NOISE, gains=rows, starts=0)
    agree(fit, TRUTH | {"gain_u2_mz": MATRIX[1, 5]})
    assert fit.measured.names == list(names) and fit.signals.shape == (CONTROL.size, 1, 4)
    assert np.isnan(fit.force_moment).all()  # four channels do not determine six reactions


def test_a_sweep_past_an_ellipsoid_determines_the_whole_matrix_and_one_past_a_ball_does_not(reactions):
    offset = np.arange(1.0, 7.0)
    unknown, options = np.full((6, 6), np.nan), {"sigma": NOISE, "offsets": True, "starts": 0}
    # The force points to the centre of the ball, whose height and side do not change in a sweep along x:
    # mx = -(y fz - z fy), so that no signal distinguishes gains of fy, fz and mx.
    ball = jw.identify(glued, GUESS, recording(reactions, offset=offset), gains=unknown, **options)
    lost = {named(k, NAMES.index(signal)) for k in range(6) for signal in ("fy", "fz", "mx")}
    truth = TRUTH | {named(k, c): MATRIX[k, c] for k in range(6) for c in range(6)}
    truth |= {f"offset_{name}": value for name, value in zip(NAMES, offset, strict=True)}
    agree(ball, {name: value for name, value in truth.items() if name not in lost})
    assert {name for name, identified in ball.identified.items() if not identified} == lost
    assert all(np.isnan(ball.standard_error[name]) for name in lost)
    past_ellipsoid = recording(six(flat), offset=offset)
    fit = jw.identify(flat, GUESS, past_ellipsoid, gains=unknown, **options)
    agree(fit, truth)
    assert all(fit.identified.values())
    assert np.max(np.abs(fit.force_moment)) < RECOVERED  # after the gains are removed


def test_the_scale_of_all_gains_is_that_of_the_stiffness():
    measured, guess = recording(six(flat)), GUESS | {"stiffness": 1.3}
    unknown, options = np.full((6, 6), np.nan), {"sigma": NOISE, "starts": 0}
    fit = jw.identify(flat, guess, measured, gains=unknown, **options)
    agree(fit, TRUTH)
    np.testing.assert_array_equal(np.isfinite(list(fit.standard_error.values())), [name in TRUTH for name in fit.names])
    (words,) = fit.combinations
    assert "stiffness" in words and "gain_" in words
    # With one known entry, all is known.
    unknown[0, 0] = MATRIX[0, 0]
    fit = jw.identify(flat, guess, measured, gains=unknown, **options)
    agree(fit, {"stiffness": 1.0, "gain_mx_my": MATRIX[3, 4]})
    assert all(fit.identified.values())


def test_errors_of_gains_are_those_of_the_noise(reactions):
    partly, truth = MATRIX.copy(), TRUTH | {"gain_fx_my": MATRIX[0, 4], "gain_mz": MATRIX[5, 5]}
    partly[0, 4] = partly[5, 5] = np.nan
    pulls = []
    for seed in range(FITS):
        measured = recording(reactions, noise=NOISE, seed=seed)
        # Steep signals with noise sometimes look like snaps; these sweeps have none.
        fit = jw.identify(glued, GUESS, measured, sigma=NOISE, gains=partly, near=True, snaps=False)
        assert fit.status == jw.FitStatus.ok
        pulls.append([(fit.estimates[name] - value) / fit.standard_error[name] for name, value in truth.items()])
    assert abs(np.sqrt(np.mean(np.square(pulls))) - 1) < PULLS
    assert np.max(np.abs(pulls)) < LIKELY
    # The information at the truth promises the same errors.
    bound = jw.information(glued, truth, sigma=NOISE, control=CONTROL, gains=partly).standard_error
    for name in truth:
        np.testing.assert_allclose(fit.standard_error[name], bound[name], rtol=0.05)  # they differ with the estimates


def test_information_about_gains_and_offsets_is_that_of_differences(reactions):
    partly, at = MATRIX.copy(), TRUTH | {"gain_fx_my": MATRIX[0, 4]}
    partly[0, 4] = partly[2, 2] = np.nan
    matrix = MATRIX.copy()
    matrix[2, 2] = 1.0  # the default of information
    found = jw.information(glued, at, sigma=NOISE, control=CONTROL, gains=partly, offsets=True)
    moved = tuple(f"offset_{name}" for name in NAMES)
    assert found.names == (*at, *moved, "gain_fz") and found.channels == NAMES
    compared = np.any(found.rates[..., 0] != 0, axis=1)  # a step before a snap is left out
    assert compared.sum() > 0.9 * CONTROL.size
    step, change = 1e-4, {}
    for name in TRUTH:
        ends = [six(**{name: TRUTH[name] + s}) @ matrix.T for s in (step, -step)]
        change[name] = (ends[0] - ends[1]) / (2 * step)
    change |= {"gain_fx_my": reactions[:, [4]] * np.eye(6)[0], "gain_fz": reactions[:, [2]] * np.eye(6)[2]}
    change |= {name: np.tile(row, (CONTROL.size, 1)) for name, row in zip(moved, np.eye(6), strict=True)}
    for k, name in enumerate(found.names):
        off = found.rates[..., k] * NOISE - change[name]
        assert np.max(np.abs(off[compared])) < RECOVERED * np.max(np.abs(change[name])), name
    with pytest.raises(ValueError, match=r"`at` must name unknowns .*got gain_mx_my"):
        jw.information(glued, at | {"gain_mx_my": 0.1}, sigma=NOISE, control=CONTROL, gains=partly)


def test_designs_compare_sensors_with_gains():
    options = {"sigma": NOISE, "control": CONTROL, "gains": MATRIX, "offsets": True}
    data = jw.design(glued, {"offset": 0.2}, **options, distance=[0.3])
    alone = jw.information(glued, TRUTH, **options).known("distance")
    np.testing.assert_allclose(data.standard_error[0], list(alone.standard_error.values()), rtol=1e-9)


def test_a_whole_matrix_with_parameters_of_each_recording_does_not_end_in_a_wrong_minimum():
    """From this guess, gains explain the signals of wrong scenes; without crosstalk at first, they do not."""

    def sprung(c, distance, position):
        return jw.Scene(jw.Whisker(), jw.Circle(distance, 0.4, position), jw.Support.fb(c))

    names, control, rng = ("fx", "fy", "mz"), np.linspace(1.0, -0.2, 120), np.random.default_rng(4)
    truth = {"c": (40.0, 60.0, 80.0), "distance": (0.3, 0.5, 0.4), "position": (0.0, 0.1, -0.1)}
    matrix = np.eye(3) + 0.3 * rng.standard_normal((3, 3))
    scans = [jw.scan(sprung(*values), control) for values in zip(*truth.values(), strict=True)]
    signals = [np.concatenate([getattr(scan, name) for name in names], axis=1) @ matrix.T for scan in scans]
    sigma = 2e-3 * np.max(np.abs(signals), axis=(0, 1))
    noisy = [values + sigma * rng.standard_normal(values.shape) for values in signals]
    measured = [{"control": control} | dict(zip(names, values.T, strict=True)) for values in noisy]
    fit = jw.identify(
        sprung,
        {"c": 48.8, "distance": 0.234, "position": 0.098},
        measured,
        sigma=dict(zip(names, sigma, strict=True)),
        gains=np.full((3, 3), np.nan),
        offsets=True,
        individual=list(truth),
        snaps=False,
        starts=1,
    )
    assert fit.status == jw.FitStatus.ok and (fit.agreeing, fit.starts) == (1, 2), str(fit)
    for name, values in truth.items():
        for k, value in enumerate(values, start=1):
            error = fit.estimates[f"{name}[{k}]"] - value
            assert abs(error) < LIKELY * fit.standard_error[f"{name}[{k}]"], f"{name}[{k}]\n{fit}"


def test_matrices_mix_signals_in_the_plane():
    matrix = np.array([[1.0, 0.1, 0.0], [-0.2, 0.9, 0.3], [0.0, 0.05, 2.0]])
    plain = exact(fb(**PLANE))
    values = np.concatenate([plain[name] for name in ("fx", "fy", "mz")], axis=1) @ matrix.T
    measured = {"control": plain["control"]} | dict(zip(("fx", "fy", "mz"), values.T, strict=True))
    partly = matrix.copy()
    partly[1, 2] = np.nan
    fit = jw.identify(fb, {"c": 80.0, "q": 0.3}, measured, gains=partly, starts=0)
    agree(fit, PLANE | {"gain_fy_mz": 0.3})
    assert fit.force_moment is None and "force . moment" not in str(fit)
    known = jw.identify(fb, {"c": 80.0, "q": 0.3}, measured, sigma=0.01, gains=partly, starts=0)
    y = known.variables + 0.01
    residual = known._problem.solve.evaluate(y, known._problem.samples(), known.variables).residual
    np.testing.assert_allclose(known.log_density(y), -0.5 * np.sum(residual**2), rtol=RECOVERED)
