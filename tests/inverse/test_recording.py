"""Recordings that cannot be fitted are refused, and no others."""

import dataclasses
from functools import cache

import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.observations import Observations, read_observations
from jaxwhisker._inverse.recording import check_recording, check_signs, check_units_of_guess, without_jitter
from jaxwhisker._scan.route import turns_of
from recordings import CONTROL, NOISE, STEPS, TRUTH, exact, fb, noisy, reversed_order

TABLE = np.linspace(0.7, -1.3, 300)


def check(data, sigma=None, unknowns=2, scene=None):
    check_recording(read_observations(data, sigma), fb(**TRUTH) if scene is None else scene, unknowns)


@pytest.fixture(scope="module")
def data():
    return exact(fb(**TRUTH))


ROUND_TRIP = np.concatenate([np.linspace(0.75, -0.6, STEPS // 2), np.linspace(-0.6, 0.75, STEPS // 2)])


@pytest.mark.parametrize(
    "control", [CONTROL, CONTROL[::-1], ROUND_TRIP], ids=["scan", "from the other side", "reversing"]
)
@pytest.mark.parametrize("seed", [None, 0])
def test_scans_pass(control, seed):
    scan = exact(fb(**TRUTH), control)
    check(scan if seed is None else noisy(scan, seed))
    check(scan if seed is None else noisy(scan, seed), NOISE)
    check({n: v[np.sum(control > 0.2) :] for n, v in scan.items()})  # begins in contact


@pytest.mark.parametrize("c", [10.0, 60.0, 1000.0])
@pytest.mark.parametrize("seed", [None, 0])
def test_reversed_order_is_refused(c, seed):
    # Every fourth sample is enough; c = 10 snaps to the far side, and is released there.
    scan = exact(fb(c, 0.25), np.linspace(0.75, -1.6, STEPS))
    data = reversed_order(scan if seed is None else noisy(scan, seed))
    for part in (data, {n: v[::4] for n, v in data.items()}):
        with pytest.raises(ValueError, match=r"`measured` must be in the order .*sign of fx"):
            check(part)
    with pytest.raises(ValueError, match=r"`measured` must be in the order .*sign of fx"):
        check(scan | {"fx": -scan["fx"]})


@pytest.mark.parametrize(
    ("names", "hint"),
    [
        (["mz"], "lean ahead .*the tables of the thesis negate mz"),
        (["fy"], "pulls"),
        (["fx"], "reverse the order of all arrays"),
        (["fx", "mz"], "reverse the order of all arrays"),
        (["fx", "fy", "mz"], "whiskers do|pulls"),
    ],
)
@pytest.mark.parametrize("c", [10.0, 60.0])
@pytest.mark.parametrize("towards", [-1, 1])
def test_negated_signals_are_named(names, hint, c, towards):
    scan = exact(fb(c, 0.25), towards * np.linspace(-1.5, 1.6, STEPS))
    for recording in (scan, noisy(scan, 0)):
        check(recording)
        with pytest.raises(ValueError, match=rf"`measured` must be .*{hint}.*") as error:
            check(recording | {name: -recording[name] for name in names})
        assert f"check the sign of {', '.join(names)}" in str(error.value)


def test_signs_that_the_sensor_may_reverse_pass(data):
    """Springs on a shaft share the load; a whisker that leans may bend either way."""
    signals = read_observations(data | {"mz": -data["mz"]}, NOISE)
    with pytest.raises(ValueError, match="sign of mz"):
        check_signs(signals, fb(**TRUTH))
    leaning = jw.Support.clamped().springs, jw.Mount(0.0, 0.0, 0.3)
    check_signs(signals, jw.Sensor(jw.Whisker(), jw.Support(*leaning)))
    check_signs(signals, jw.Sensor(jw.Whisker(intrinsic_curvature=0.2)))
    held = jw.Support((jw.Spring((0, 1), 70.0, at=0.1), jw.Spring((0, 1), 9.0, axis="phi")))
    negated = read_observations(data | {name: -data[name] for name in ("fy", "mz")}, NOISE)
    check_signs(negated, jw.Sensor(jw.Whisker(), held))


def test_reversed_order_needs_fx_of_all_whiskers_and_a_free_start(data):
    back = reversed_order(data)
    check({n: v for n, v in back.items() if n != "fx"})
    check({n: v[np.argmax(np.abs(back["fx"][:, 0]) > 1) :] for n, v in back.items()})


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.full(300, np.nan), "more values .*got 0"),
        (np.where(np.arange(300) < 4, 1.0, np.nan), "5 or more drive positions for 2 unknowns, got 4"),
        (np.zeros(300), "contact"),
        (np.ones(300), "contact"),
        (np.random.default_rng(0).standard_normal(300), "contact"),
        (3.0 + np.random.default_rng(1).standard_normal(300), "contact"),
    ],
)
def test_recordings_without_information_are_refused(values, words):
    with pytest.raises(ValueError, match=f"`measured` must .*{words}"):
        check({"control": TABLE, "fx": values})


def test_more_unknowns_than_positions_and_noise_that_hides_the_contact(data):
    few = {n: v[:: STEPS // 8] for n, v in data.items()}
    check(few)
    with pytest.raises(ValueError, match="12 or more drive positions for 11 unknowns, got 8"):
        check(few, unknowns=11)
    with pytest.raises(ValueError, match="`measured` must show a contact"):
        check(data, sigma=10.0)
    still = data | {"control": np.zeros(STEPS)}
    with pytest.raises(ValueError, match="got 1"):
        check(still)


@pytest.mark.parametrize(
    ("factors", "name"),
    [
        ({"control": 1e3}, "range of control"),
        ({"control": 1e-3}, "range of control"),
        ({"fx": 1e-6}, "fx"),
        ({"mz": 1e6}, "mz"),
    ],
)
def test_other_units_are_refused(data, factors, name):
    with pytest.raises(ValueError, match=f"`measured` must be in the same units as the scene, got .*{name}"):
        check({n: v * factors.get(n, 1.0) for n, v in data.items()})


def test_units_of_the_scene_count(data):
    length, stiffness = 0.05, 2.4e-5
    force = stiffness / length**2
    sizes = {"control": length, "fx": force, "fy": force, "mz": force * length}
    scene = jw.Scene(jw.Whisker(length, stiffness), jw.Parabola(0.27 * length), jw.Support.fb(55.0 * force / length))
    check({n: v * sizes[n] for n, v in data.items()}, scene=scene)


@cache
def scanned():
    return jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.25), jw.Support.fb(70.0, 0.2)), np.linspace(1.0, -1.5, 121))


def test_jitter_of_the_control_is_no_turn():
    drive, random = np.linspace(1.0, -1.0, 201), np.random.default_rng(0)
    for samples in (1, 5, 20):
        wait = 1.0 + 1e-4 * random.integers(-1, 2, samples)
        clean = without_jitter(np.concatenate([wait, drive]))
        assert turns_of(clean).size == 0 and np.max(np.abs(clean[samples:] - drive)) < 2e-4
    there_and_back = np.concatenate([drive, drive[::-1]])
    noisy = there_and_back + random.normal(0.0, 0.004, there_and_back.size)
    clean = without_jitter(noisy)
    assert turns_of(noisy).size > 20 and turns_of(clean).size == 1
    assert np.max(np.abs(clean - there_and_back)) < 0.02
    assert np.std(clean - there_and_back) < np.std(noisy - there_and_back)


def test_turns_that_are_meant_are_kept():
    for control in (np.array([0.0, 1.0, 0.0, 1.0, 0.0]), np.linspace(0.0, 1.0, 9), np.array([0.5])):
        assert without_jitter(control) is control
    saw = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(1.0, 0.995, 8), np.linspace(0.995, 2.0, 50)])
    assert without_jitter(saw) is saw


@pytest.mark.parametrize("samples", [1, 4, 16])
def test_a_wait_before_the_sweep_does_not_matter(samples):
    # The drive flickers in its last digit while the signals are noise.
    random = np.random.default_rng(samples)
    result = scanned()
    rows = np.stack([np.asarray(getattr(result, name))[:, 0] for name in ("fx", "fy", "mz")], axis=1)
    for _ in range(10):
        wait = result.control[0] + 1e-4 * random.integers(-1, 2, samples)
        control = np.concatenate([wait, result.control])
        values = np.concatenate([np.zeros((samples, 3)), rows]) + random.normal(0.0, 0.01, (control.size, 3))
        observed = Observations(control, values[:, None], np.full((control.size, 1, 3), 0.01))
        check_signs(observed, result.scene)
        opposite = dataclasses.replace(observed, values=-observed.values)
        with pytest.raises(ValueError, match=r"whiskers lean ahead of the drive|the object pulls whiskers"):
            check_signs(opposite, result.scene)


FACTORS = {
    "mm, mN and N mm": ((557.0, 1040.0, 530.0), "near 1000"),
    "in m instead of mm": ((1e-3, 1.0, 1e-3), "near 0.001"),
    "inches": ((25.4, 1.0, 25.4), "near 25.4"),
    "millinewtons": ((1.0, 1e3, 1e3), "near 1000"),
}


@pytest.mark.parametrize("kind", FACTORS)
def test_factors_between_units_are_noticed(kind):
    (length, force, moment), words = FACTORS[kind]
    result = scanned()
    signals = np.stack([np.asarray(getattr(result, name)) for name in ("fx", "fy", "mz")], axis=-1)
    observed = Observations(
        length * np.asarray(result.control), signals * [force, force, moment], np.full(signals.shape, np.nan)
    )
    with pytest.raises(ValueError, match=f"`measured` must be in the same units as the scene, .*{words}"):
        check_units_of_guess(observed, jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(60.0, 0.2)))


def test_other_sizes_are_those_of_a_guess():
    result = scanned()
    signals = np.stack([np.asarray(getattr(result, name)) for name in ("fx", "fy", "mz")], axis=-1)
    for factor in (1.0, 10.0, 30.0, 0.1):
        observed = Observations(np.asarray(result.control), factor * signals, np.full(signals.shape, np.nan))
        check_units_of_guess(observed, jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(60.0, 0.2)))
