"""Springs between the shafts of two whiskers: limits, laws of statics, derivatives, energy, errors."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from independent_shaft import along

import jaxwhisker as jw
from scenes import all_ok

SAME = 1e-9  # the same equilibria, computed in another way
SOUND = 1e-8  # largest residual of a law, integrated by the classical Runge-Kutta method with 128 steps
DIFFERENCE = 1e-5  # step of central differences
BY_DIFFERENCES = 1e-6  # their accuracy relative to the largest derivative
WORK = 1e-6  # accuracy of the work of the drive by Simpson's rule, relative to it
SIGNALS = ("base_x", "fx", "fy", "mz", "contact_force", "contact_arc", "contact_slope")
EVENTS = 10  # that happen in these scenes within this control
CONTROL = np.linspace(0.8, -1.5, 24)
BASES = jw.Spring((0, 1), 70.0, 0.2), jw.Spring((1, 2), 70.0, 0.2)
NUMBERS = {"stiffness": 30.0, "rest_length": 0.15, "first": 0.1, "second": 0.25}


def scene(*springs, **options):
    return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support((*BASES, *springs), **options))


def coupled(stiffness, rest_length, first, second):
    return scene(jw.Spring((1, 2), stiffness, rest_length, axis="axial", at=(first, second)))


@cache
def coupled_scan():
    return jw.scan(coupled(**NUMBERS), CONTROL)


def test_a_spring_between_the_bases_is_a_base_spring():
    springs = jw.Spring((0, 1), 70.0, 0.2), jw.Spring((1, 2), 50.0, 0.2)
    between = jw.Spring((1, 2), 50.0, 0.2, at=(0.0, 0.0))
    expected, result = (
        jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support(own)), CONTROL)
        for own in (springs, (springs[0], between))
    )
    assert all_ok(result)
    for name in SIGNALS:
        np.testing.assert_allclose(getattr(result, name), getattr(expected, name), atol=SAME, err_msg=name)
    np.testing.assert_allclose(result.spring_length, expected.spring_length, atol=SAME)
    controls = [event.control for event in expected.events]
    np.testing.assert_allclose([event.control for event in result.events], controls, atol=SAME)


def test_whiskers_are_in_equilibrium():
    result = coupled_scan()
    assert all_ok(result)
    r = {name: np.asarray(getattr(result, name)) for name in (*SIGNALS, "base_y", "base_angle", "phase")}
    contact = np.stack([np.asarray(result.contact_x), np.asarray(result.contact_y)])
    states, loads = [], []
    for k, at in enumerate((NUMBERS["first"], NUMBERS["second"])):
        x, y, fx, fy, mz = (r[name][:, k] for name in ("base_x", "base_y", "fx", "fy", "mz"))
        loads.append(np.stack([-fx, -fy, -mz - x * fy + y * fx]))
        states.append(along(np.stack([x, y, np.pi / 2 + r["base_angle"][:, k]]), loads[k], at))
    way = states[1][:2] - states[0][:2]
    length = np.hypot(*way)
    np.testing.assert_allclose(result.spring_length[:, 2], length, atol=SOUND)
    force = -NUMBERS["stiffness"] * (length - NUMBERS["rest_length"]) / length * way  # on the second whisker
    for k, (at, sign) in enumerate(((NUMBERS["first"], -1.0), (NUMBERS["second"], 1.0))):
        (x, y, _), (fx, fy) = states[k], sign * force
        load = loads[k] - np.stack([fx, fy, x * fy - y * fx])
        touches = r["phase"][:, k] != jw.Phase.free
        end = along(states[k], load, np.where(touches, r["contact_arc"][:, k], 1.0) - at)
        moment = load[2] - end[0] * load[1] + end[1] * load[0]
        np.testing.assert_allclose(moment, 0.0, atol=SOUND)
        slope, pressed = r["contact_slope"][:, k], r["contact_force"][:, k]
        np.testing.assert_allclose(load[0], pressed * np.sin(slope), atol=SOUND * 20)
        np.testing.assert_allclose(load[1], -pressed * np.cos(slope), atol=SOUND * 20)
        np.testing.assert_allclose(np.where(touches, end[:2] - contact[:, :, k], 0.0), 0.0, atol=SOUND)
    # The drive carries what the first whisker does not get from the second base and the spring between the shafts.
    fx, base = r["fx"], r["base_x"]
    np.testing.assert_allclose(fx[:, 1], -70.0 * (base[:, 1] - base[:, 0] - 0.2), atol=SOUND * 20)
    np.testing.assert_allclose(fx[:, 0] + fx[:, 1], -70.0 * (base[:, 0] - CONTROL - 0.2), atol=SOUND * 20)


def test_derivatives_agree_with_differences():
    def function(numbers):
        result = jw.scan(coupled(**numbers), CONTROL)
        events, lengths = result.events.control[:EVENTS], result.spring_length
        return {name: getattr(result, name) for name in ("fx", "fy", "mz")} | {"length": lengths, "events": events}

    forwards = jax.jacfwd(function)(NUMBERS)
    for name in NUMBERS:
        up, down = (function(NUMBERS | {name: NUMBERS[name] + step}) for step in (DIFFERENCE, -DIFFERENCE))
        assert np.all(np.isfinite(up["events"]))
        for signal in up:
            by_differences = (up[signal] - down[signal]) / (2 * DIFFERENCE)
            own = forwards[signal][name]
            size = np.abs(own).max()
            assert size > 0
            np.testing.assert_allclose(
                own, by_differences, atol=BY_DIFFERENCES * max(size, 1.0), err_msg=f"{signal} {name}"
            )
    weights = np.random.default_rng(0).normal(size=(CONTROL.size, 2))
    backwards = jax.grad(lambda numbers: jnp.sum(weights * function(numbers)["mz"]))(NUMBERS)
    for name in NUMBERS:
        np.testing.assert_allclose(backwards[name], jnp.sum(weights * forwards["mz"][name]), rtol=SAME)


def test_the_drive_does_the_work_that_is_stored():
    result = jw.scan(coupled(**NUMBERS), np.linspace(0.0, -0.4, 81))  # between two events
    energy = jw.stored_energy(result.scene, result)
    power = -np.sum(np.asarray(result.fx), axis=1)
    step = 0.4 / 80
    work = step / 3 * np.sum(power * np.array([1, *[4, 2] * 39, 4, 1]))
    np.testing.assert_allclose(energy[-1] - energy[0], work, rtol=WORK)


def test_a_batch_has_the_results_of_single_scans():
    ats = jnp.array([0.05, 1.5, 0.25])  # the second one is beyond the tip

    def signals(at):
        result = jw.scan(coupled(**NUMBERS | {"second": at}), CONTROL)
        return result.mz, result.status

    mz, status = jax.vmap(signals)(ats)
    assert np.all(status[1] == jw.Status.invalid) and np.all(np.isnan(mz[1]))
    np.testing.assert_allclose(mz[2], coupled_scan().mz, atol=SAME)
    assert np.all(status[0] == jw.Status.ok)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.Spring((1, 2), 1.0, at=0.1), "`at` must be a pair of numbers, got 0.1"),
        (
            lambda: jw.Spring((1, 2), 1.0, at=(0.1, 0.1), anchor=(0.0, 0.0)),
            "`anchor` must be None for a spring between",
        ),
        (lambda: jw.Spring((1, 2), np.inf, at=(0.1, 0.1)), "`stiffness` must be finite for a spring on a shaft"),
        (lambda: jw.Support((jw.Spring((1, 2), 1.0, at=(0.1, 0.1)),)), "must connect every base from 1 to 2"),
        (lambda: coupled(30.0, 0.2, 0.1, 1.1), "`at`"),
    ],
)
def test_wrong_arguments(make, message):
    with pytest.raises(ValueError, match=message):
        make()
