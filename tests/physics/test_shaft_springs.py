"""Springs on the shaft: exact states, limits, laws for random scenes, prestress, derivatives, errors."""

import json
from functools import cache
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from independent_shaft import violations

import jaxwhisker as jw
from random_shafts import CONTROL, drawn, scans
from scenes import all_ok

DATA = json.loads((Path(__file__).parents[1] / "data" / "shaft_spring.json").read_text())
EXACT = 1e-8  # of the peak: the accuracy asked for; the reference has ten digits
SAME = 1e-9  # the same equilibria, computed in another way
SOUND = 1e-7  # largest residual of a law
SCENES = 24
DIFFERENCE = 1e-5  # step of central differences
BY_DIFFERENCES = 1e-6  # their accuracy relative to the largest derivative
SIGNALS = ("base_x", "fx", "fy", "mz", "contact_force", "contact_arc", "contact_slope")


def axial(stiffness, rest_length=0.2, at=0.1, **options):
    return jw.Spring((0, 1), stiffness, rest_length, axis="axial", at=at, **options)


def scene(*springs, distance=0.2, a=1.0, **options):
    return jw.Scene(jw.Whisker(), jw.Parabola(distance, a), jw.Support(springs), **options)


@pytest.mark.parametrize("case", DATA["cases"], ids=lambda case: f"h = {case['h']}")
def test_states_agree_with_exact_ones(case):
    springs, base = [axial(**case["shaft_spring"], at=case["h"])], case["base_spring"]
    springs += [] if base is None else [jw.Spring((0, 1), **base)]
    states = sorted(case["states"], key=lambda state: -state["control"])
    control = np.array([state["control"] for state in states])
    # The march comes from before the first touch.
    result = jw.scan(scene(*springs, **case["parabola"]), np.concatenate([[1.0], control]))
    assert all_ok(result)
    names = {name: name for name in SIGNALS} | {"fx": "fx_guide_and_spring"}
    for name, reference in names.items():
        exact = np.array([state[reference] for state in states])
        atol = EXACT * max(np.abs(exact).max(), 1.0)
        np.testing.assert_allclose(getattr(result, name)[1:, 0], exact, atol=atol, err_msg=name)
    ends = np.array([(state["shaft_x"] - state["control"], state["shaft_y"] - case["h"]) for state in states])
    np.testing.assert_allclose(result.spring_length[1:, 0], np.hypot(*ends.T), atol=EXACT)


def test_a_spring_at_the_base_is_a_base_spring():
    control = np.linspace(0.9, -1.4, 47)
    expected = jw.scan(scene(jw.Spring((0, 1), 70.0, 0.2)), control)
    for axis in ("axial", "x"):
        result = jw.scan(scene(jw.Spring((0, 1), 70.0, 0.2, axis=axis, at=0.0)), control)
        assert all_ok(result)
        for name in SIGNALS:
            np.testing.assert_allclose(getattr(result, name), getattr(expected, name), atol=SAME, err_msg=name)
        np.testing.assert_allclose(result.spring_length, expected.spring_length, atol=SAME)
        kinds = [(event.kind, event.whiskers) for event in result.events]
        assert kinds == [(event.kind, event.whiskers) for event in expected.events]
        controls = [event.control for event in expected.events]
        np.testing.assert_allclose([event.control for event in result.events], controls, atol=SAME)


BASE, COUPLING = jw.Spring((0, 1), 70.0, 0.2), jw.Spring((1, 2), 70.0, 0.2)
WITH = {
    "two whiskers": ((COUPLING,), {}),
    "friction": ((), {"friction": 0.3}),
    "a box": ((), {"profile": jw.Box(0.3, width=0.8, height=0.5)}),
}


@pytest.mark.parametrize("name", WITH)
def test_springs_on_shafts_go_with_everything_else(name):
    further, options = WITH[name]
    options = {"profile": jw.Parabola(0.2)} | options
    control = np.concatenate([np.linspace(0.9, -0.6, 31), np.linspace(-0.6, 0.2, 9)])
    expected, result = (
        jw.scan(jw.Scene(jw.Whisker(), support=jw.Support((first, *further)), **options), control)
        for first in (BASE, jw.Spring((0, 1), 70.0, 0.2, at=0.0))
    )
    assert all_ok(result)
    for field in SIGNALS:
        np.testing.assert_allclose(getattr(result, field), getattr(expected, field), atol=SAME, err_msg=field)
    assert [event.kind for event in result.events] == [event.kind for event in expected.events]
    controls = [event.control for event in expected.events]
    np.testing.assert_allclose([event.control for event in result.events], controls, atol=SAME)


@cache
def scanned():
    held = drawn(SCENES, np.random.default_rng(5))
    # As numbers, because tests replace some of them.
    return held, jax.tree.map(np.asarray, jax.block_until_ready(scans()(held)))


def residuals(held, result):
    control = np.broadcast_to(CONTROL, result.control.shape)
    return {law: np.max(amount) for law, amount in violations(held, control, result).items()}


def test_random_scenes_satisfy_all_laws():
    held, result = scanned()
    assert np.mean(np.any(result.status != jw.Status.ok, axis=1)) < 0.1
    assert all(np.sum(result.phase == phase) > SCENES for phase in jw.Phase)
    for law, amount in residuals(held, result).items():
        assert amount < SOUND, law
    # Springs that disagree bend whiskers before these touch.
    free = np.all(result.phase[:, 0] == jw.Phase.free, axis=1)
    assert np.sum(free & (np.abs(result.mz[:, 0, 0]) > 0.05)) > SCENES / 4


WRONG = {
    "fx": "springs at and below the base",
    "fy": "force at the end, y",
    "mz": "no moment at the end",
    "base_x": "contact point, x",
    "contact_arc": "contact point, y",
    "contact_slope": "slope of the object",
    "spring_length": "spring lengths",
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_values_violate_a_law(name):
    held, result = scanned()
    wrong = eqx.tree_at(lambda r: getattr(r, name), result, getattr(result, name) * (1 + 1e-5))
    assert residuals(held, wrong)[WRONG[name]] > SOUND


def test_springs_that_disagree_bend_a_whisker_before_it_touches():
    result = jw.scan(scene(axial(70.0), jw.Spring((0, 1), 40.0, 0.3)), np.array([1.1, 1.0]))
    assert np.all(result.phase == jw.Phase.free) and np.all(np.abs(result.mz) > 0.05)


PARAMETERS = {"stiffness": 70.0, "rest": 0.2, "at": 0.1, "anchor_x": 0.02, "anchor_y": 0.07, "base": 40.0}
STEPS = np.array([0.6, 0.2, -0.3, -0.6, -1.0, -1.2])


def given(numbers):
    c, rest, at, x, y, base = numbers
    return scene(axial(c, rest, at, anchor=(x, y)), jw.Spring((0, 1), base, 0.23))


def signals(numbers):
    result = jw.scan(given(numbers), STEPS)
    return jnp.stack([getattr(result, name)[:, 0] for name in ("fx", "fy", "mz", "base_x", "spring_length")])


def events(numbers):
    return jw.scan(given(numbers), STEPS).events.control[:3]


@pytest.mark.parametrize("function", [signals, events])
def test_derivatives_agree_with_differences_in_both_modes(function):
    at = jnp.array(list(PARAMETERS.values()))
    forwards = jax.jacfwd(function)(at)
    for k, name in enumerate(PARAMETERS):
        step = DIFFERENCE * jnp.eye(at.size)[k]
        difference = (function(at + step) - function(at - step)) / (2 * DIFFERENCE)
        atol = BY_DIFFERENCES * max(1.0, float(jnp.max(jnp.abs(forwards[..., k]))))
        np.testing.assert_allclose(forwards[..., k], difference, atol=atol, err_msg=name)
        assert np.max(np.abs(forwards[..., k])) > 1e-4, name
    np.testing.assert_allclose(jax.jacrev(function)(at), forwards, atol=SAME * np.max(np.abs(forwards)))


def test_an_invalid_lane_leaves_its_neighbours_alone():
    at = jnp.array(list(PARAMETERS.values()))
    both = jnp.stack([at, at.at[0].set(-1.0), at.at[2].set(1.5)])
    result = jax.jit(jax.vmap(lambda numbers: jw.scan(given(numbers), STEPS)))(both)
    assert np.all(result.status[0] == jw.Status.ok) and np.all(result.status[1:] == jw.Status.invalid)
    assert np.all(np.isnan(result.mz[1:]))
    np.testing.assert_allclose(result.mz[0], jw.scan(given(at), STEPS).mz, atol=SAME)


def test_a_mirrored_scene_gives_mirrored_signals():
    result = jw.scan(given(PARAMETERS.values()), STEPS)
    springs = axial(70.0, -0.2, 0.1, anchor=(-0.02, 0.07)), jw.Spring((0, 1), 40.0, -0.23)
    mirrored = jw.scan(scene(*springs, motion=jw.Translation(direction=1)), -STEPS)
    assert all_ok(result) and all_ok(mirrored)
    for name, sign in {"fx": -1, "fy": 1, "mz": -1, "base_x": -1, "contact_slope": -1}.items():
        np.testing.assert_allclose(getattr(mirrored, name), sign * getattr(result, name), atol=SAME, err_msg=name)


def test_the_work_of_the_contact_force_is_the_change_of_the_stored_energy():
    one = given(PARAMETERS.values())

    def energy(control):
        result = jw.scan(one, control)
        return np.asarray(jw.stored_energy(one, result)), result

    _, result = energy(STEPS)
    slope = (energy(STEPS + 1e-4)[0] - energy(STEPS - 1e-4)[0]) / 2e-4
    force = -np.asarray(result.contact_force * jnp.sin(result.contact_slope))[:, 0]
    np.testing.assert_allclose(slope, force, atol=1e-6 * np.abs(force).max())  # of the difference
    with pytest.raises(ValueError, match="`control`"):
        jw.stored_energy(one, result.events[0].before)


def test_a_contact_that_reaches_a_spring_ends_the_scan():
    result = jw.scan(scene(axial(70.0, 0.2, 0.5)), np.linspace(0.9, -0.3, 25))
    first = int(np.argmax(result.status != jw.Status.ok))
    assert np.all(result.status[first:] == jw.Status.at_spring)
    assert 0.5 < result.contact_arc[first - 1, 0] < 0.6


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: jw.Spring((1, 0), 70.0, at=(0.1, 0.0)), "between"),
        (lambda: axial(jnp.inf), "stiffness"),
        (lambda: jw.Spring((0, 1), compliance=0.0, at=0.1), "compliance"),
        (lambda: jw.Spring((0, 1), 70.0, anchor=0.1), "anchor"),  # pyright: ignore[reportArgumentType]
        (lambda: jw.Spring((0, 1), 70.0, one_sided="pull"), "one_sided"),
        (lambda: jw.Spring((0, 1), 70.0, axis="w"), "axis"),
        (lambda: jw.Spring((0, 1), 70.0, axis="z", at=0.1), "axis"),
        (lambda: jw.Spring((0, 1), lambda: 1.0), "stiffness"),
        (lambda: jw.Support(free=("x",)), "free"),
        (lambda: scene(axial(70.0, at=1.0)), "at"),
        (lambda: jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support(foundation=jw.Foundation(0.0, 1.5, 9.0))), "stop"),
        (lambda: jw.Support.simony(angle=2.0), "angle"),
        (lambda: jw.Support.hill(pad=1e-3), "pad"),
        (lambda: jw.Support((axial(70.0),), free=("z",)), "free"),
        (lambda: scene(axial(70.0), rod=jw.ClosedForm()), "rod"),
    ],
)
def test_wrong_arguments_are_named(call, words):
    with pytest.raises(ValueError, match=f"`{words}`"):
        call()
