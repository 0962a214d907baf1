"""Scans of whiskers with several contacts against exact ones: signals, contacts and the derivatives of both."""

from functools import cache
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.polygons import corner_signs
from jaxwhisker._equilibrium.friction import Friction
from jaxwhisker._scan.chain import problem_now, signals
from scenes import all_ok
from several_cases import CASES, changed, contacts_of, number_at, scanned, scene_of

SIGNAL = 1e-8  # relative to a signal's peak, which is stored with nine decimals
CONTACT = 1e-8  # positions; forces relative to the largest one
DERIVATIVE = 1e-6  # relative to the largest one of the same quantity and parameter; two step sizes agree to 1e-8
SAME = 1e-11  # of one scan in different programs, relative to the largest value: solved states are accurate to rounding
MODES = 1e-9  # forward against reverse mode, relative to the sum of sizes

FIELDS = "phase", "contact_force", "contact_arc", "contact_x", "contact_y"

by_name = pytest.mark.parametrize("name", CASES)


@by_name
def test_signals_are_exact(name):
    case, result = CASES[name], scanned(name)
    assert all_ok(result)
    for signal in ("base_x", "fx", "fy", "mz"):
        exact = np.array(case[signal])
        error = np.asarray(getattr(result, signal))[1:] - exact
        assert np.max(np.abs(error)) < SIGNAL * np.max(np.abs(exact)), signal


@by_name
def test_contacts_are_exact(name):
    case, result = CASES[name], scanned(name)
    peak = max(contact[3] for step in case["contacts"] for contact in step)
    scale = np.array([1.0, peak, 1.0, 1.0, 1.0])
    most = 0
    for k, step in enumerate(case["contacts"]):
        state = SimpleNamespace(**{field: getattr(result, field)[k + 1] for field in FIELDS})
        for whisker in range(len(case["whiskers"])):
            exact = [contact[2:] for contact in step if contact[0] == whisker + 1]
            found = contacts_of(state, whisker)
            assert len(found) == len(exact), k
            most = max(most, len(exact))
            if exact:
                assert np.max(np.abs(np.array(found) - exact) / scale) < CONTACT, k
    assert most >= min(2, case["contacts_at_once"])


def test_free_places_hold_nothing():
    result = scanned("three_circles")
    free = np.asarray(result.phase) == jw.Phase.free
    assert free.shape == (len(result.control), 1, 3)
    assert np.any(free[..., 0]) and not np.all(free[..., 2])
    for name in FIELDS:
        assert np.all(np.asarray(getattr(result, name))[free] == 0), name
    assert result.contact_object is not None and np.all(np.asarray(result.contact_object)[free] == 0)


def test_objects_are_numbered():
    case, result = CASES["three_circles"], scanned("three_circles")
    assert result.contact_object is not None
    for k, step in enumerate(case["contacts"]):
        numbers = [int(n) for n in result.contact_object[k + 1, 0] if n > 0]
        assert numbers == [contact[1] for contact in step][::-1]


def test_a_tip_in_an_inner_corner_is_two_contacts():
    result = scanned("roof")
    at = np.all(np.asarray(result.phase)[:, 0] == jw.Phase.tip, axis=1)
    assert np.any(at)
    force, slope, x, y = (
        np.asarray(getattr(result, f"contact_{name}"))[at, 0] for name in ("force", "slope", "x", "y")
    )
    np.testing.assert_allclose([x, y], [np.full_like(x, 0.0), np.full_like(y, 0.8)], atol=CONTACT)
    np.testing.assert_allclose(slope, np.tile([np.arctan2(0.3, 0.7), np.arctan2(-0.3, 0.6)], (len(x), 1)))
    assert np.all(force > 0)
    sums = np.sum(force * np.sin(slope), axis=1), np.sum(-force * np.cos(slope), axis=1)
    reactions = np.asarray(result.fx)[at, 0], np.asarray(result.fy)[at, 0]
    np.testing.assert_allclose(sums, np.negative(reactions), atol=SIGNAL * np.max(force))


def test_a_tip_in_an_inner_corner_does_not_slip():
    roof = jw.Polygon([(-0.5, 0.9), (-0.4, 0.4), (0.0, 0.6), (0.4, 0.4), (0.5, 0.9)])
    scene = jw.Scene(jw.Whisker(), roof, contacts=2, friction=0.4)
    problem = problem_now(jax.tree.map(checks.as_float, scene))
    inner = 4
    assert float(corner_signs(problem.profile)[inner]) < 0
    low, high = problem.profile.ends_on(jnp.array([inner]))
    z = jnp.array([[2.0, (low[0] + high[0]) / 2, -0.3], [0.0, 0.0, 0.0]])
    slipping = Friction(jnp.array([-1, 1]), jnp.zeros(2), jnp.zeros(2))
    state = ChainState(jnp.array([1, 0]), jnp.ones(2), jnp.array([inner, 0]), slipping)
    values, _, _ = Program(signals)(problem, z, jnp.asarray(0.0), state)
    # It slipped to the corner, which pushes back with any force between the normals of its sides.
    assert values.slip.tolist() == [[0, 0]]
    np.testing.assert_allclose(values.normal_force, [[2.0, 0.0]], atol=SIGNAL)
    np.testing.assert_allclose(values.friction_force, 0.0, atol=SIGNAL)


WAVY = np.array([CASES["wavy"]["start"], 0.5, 0.1, -0.1, -0.7])
DISTANCES = jnp.array([0.4, jnp.nan, 0.38])


def at_distance(distance) -> tuple:
    """Signals, contacts and status of a scan of `wavy` at another distance."""
    result = jw.scan(scene_of(changed(CASES["wavy"], [["objects", 0, "distance"]], [distance])), WAVY)
    return result.fx, result.contact_force, result.contact_arc, result.phase, result.status


@cache
def in_a_batch() -> tuple:
    """Scans at several distances, of which one is not a number."""
    return jax.vmap(at_distance)(DISTANCES)


def same(one, other):
    """Compare signals, contacts and status."""
    assert np.all(np.asarray(one[-1]) == jw.Status.ok) and np.max(np.abs(one[0])) > 1
    for own, value in zip(one[:3], other[:3], strict=True):
        np.testing.assert_allclose(value, own, atol=SAME * np.max(np.abs(own)))
    for own, value in zip(one[3:], other[3:], strict=True):
        np.testing.assert_array_equal(value, own)


@pytest.mark.parametrize("k", [0, 2])
def test_a_scan_alone_and_in_a_batch_is_the_same(k):
    same(at_distance(float(DISTANCES[k])), [leaf[k] for leaf in in_a_batch()])


def test_a_compiled_scan_is_the_same():
    same(at_distance(float(DISTANCES[0])), jax.jit(at_distance)(DISTANCES[0]))


def test_rejected_steps_are_nan():
    fx, force, arc, phase, status = (leaf[1] for leaf in in_a_batch())
    assert np.all(np.asarray(status) == jw.Status.invalid)
    for values in (fx, force, arc):
        assert np.all(np.isnan(values))
    assert np.all(np.asarray(phase) == jw.Phase.free)


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case["derivatives"]])
def test_derivatives_of_signals(name):
    case = CASES[name]
    rows = [row for row in case["derivatives"] if "d_fx" in row]
    controls = sorted({row["control"] for row in rows}, reverse=True)
    paths = list({str(row["parameter"]): row["parameter"] for row in rows}.values())
    control = jnp.array([case["start"], *controls])

    def signals(values):
        result = jw.scan(scene_of(changed(case, paths, values)), control)
        return jnp.stack([result.fx[1:], result.fy[1:], result.mz[1:]])

    p = jnp.array([number_at(case, path) for path in paths])
    value, along = jax.linearize(signals, p)
    each = np.stack([np.asarray(along(unit)) for unit in jnp.eye(p.size)])
    peak = {}
    for row in rows:
        k, at = paths.index(row["parameter"]), controls.index(row["control"])
        exact = np.array([row["d_fx"], row["d_fy"], row["d_mz"]])
        key = str(row["parameter"])
        peak[key] = max(peak.get(key, 1.0), np.max(np.abs(exact)))
        assert np.max(np.abs(each[k, :, at] - exact)) < DERIVATIVE * max(1.0, np.max(np.abs(exact))), row
    assert min(peak.values()) > 0
    weights = jnp.asarray(np.random.default_rng(3).normal(size=value.shape))
    (pulled,) = jax.linear_transpose(along, p)(weights)
    pushed = np.sum(each * np.asarray(weights), axis=(1, 2, 3))
    sizes = np.sum(np.abs(each * np.asarray(weights)), axis=(1, 2, 3))
    assert np.all(np.abs(pulled - pushed) < MODES * np.maximum(sizes, 1.0))
