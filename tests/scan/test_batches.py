"""Batches: vmap equals a loop, jit equals eager execution, and lanes do not affect each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from scenes import event_list, model

LOOP = 1e-11  # a batch is compiled differently from a single scene: rounding errors, amplified near a fold
CONTROL = jnp.linspace(0.8, -1.6, 160)
SIGNALS = ("fx", "fy", "mz", "base_x", "contact_arc")


def build(stiffness, distance):
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fb(stiffness, 0.2))


@jax.jit
@jax.vmap
def scanned(scene):
    return jw.scan(scene, CONTROL)


def batch_of(stiffness, distance):
    return jax.vmap(build)(jnp.asarray(stiffness, float), jnp.asarray(distance, float))


@pytest.fixture(scope="module")
def good():
    rng = np.random.default_rng(3)
    return rng.uniform(8, 200, 8), rng.uniform(0.1, 0.5, 8)


@pytest.fixture(scope="module")
def batch(good):
    return scanned(batch_of(*good))


def test_vmap_equals_a_loop(good, batch):
    for k in range(8):
        one = jw.scan(build(float(good[0][k]), float(good[1][k])), CONTROL)
        for name in SIGNALS:
            np.testing.assert_allclose(getattr(batch, name)[k], getattr(one, name), atol=LOOP * 100, rtol=LOOP)
        lane = jax.tree.map(lambda leaf, k=k: leaf[k], batch)
        assert [e[:2] for e in event_list(lane)] == [e[:2] for e in event_list(one)]
        np.testing.assert_allclose([e[2] for e in event_list(lane)], [e[2] for e in event_list(one)], atol=1e-10)
    kinds = {e[0] for k in range(8) for e in event_list(jax.tree.map(lambda leaf, k=k: leaf[k], batch))}
    assert {"snap_off", "snap_through"} <= kinds  # the lanes have different events


def test_invalid_lanes_leave_their_neighbours_bit_identical(good, batch):
    # Two lanes are replaced: one parameter is NaN, another is outside its domain.
    stiffness, distance = np.array(good[0]), np.array(good[1])
    stiffness[2], distance[5] = np.nan, -0.3
    mixed = scanned(batch_of(stiffness, distance))
    for k in range(8):
        if k in (2, 5):
            assert np.all(np.asarray(mixed.status[k]) == jw.Status.invalid)
            assert np.all(np.isnan(mixed.fx[k]))
            assert mixed.events.count[k] == 0
        else:
            for name in (*SIGNALS, "status", "phase"):
                assert np.array_equal(getattr(mixed, name)[k], getattr(batch, name)[k]), name
            assert np.array_equal(mixed.events.control[k], batch.events.control[k], equal_nan=True)


def test_a_hopeless_lane_leaves_its_neighbours_bit_identical(good, batch):
    # An object 1e-12 above the bases needs forces of 1e24. The path may be lost there; other lanes are not affected.
    stiffness, distance = np.array(good[0]), np.array(good[1])
    distance[0], stiffness[7] = 1e-12, 1e-9
    mixed = scanned(batch_of(stiffness, distance))
    for k in range(1, 7):
        for name in (*SIGNALS, "status"):
            assert np.array_equal(getattr(mixed, name)[k], getattr(batch, name)[k]), name
    ok = np.asarray(mixed.status) == jw.Status.ok
    assert np.array_equal(np.isfinite(mixed.fx[:, :, 0]), ok)


def test_jit_equals_eager_execution():
    scene = model("FBFBR")
    eager = jw.scan(scene, CONTROL)
    jitted = jax.jit(jw.scan)(scene, CONTROL)
    for name in SIGNALS:
        np.testing.assert_allclose(getattr(eager, name), getattr(jitted, name), atol=LOOP * 100)
    assert int(jitted.events.count) == len(eager.events)
    np.testing.assert_allclose([e[2] for e in event_list(jitted)], [e[2] for e in event_list(eager)], atol=1e-10)


def test_results_do_not_depend_on_the_size_of_the_batch(good):
    # Many scans run in blocks, few run one by one.
    many, one = (
        jax.vmap(lambda scene: jw.scan(scene, CONTROL))(batch_of(*parameters))
        for parameters in ((np.repeat(good[0], 8), np.repeat(good[1], 8)), (good[0][:1], good[1][:1]))
    )
    for name in SIGNALS:
        np.testing.assert_allclose(getattr(many, name)[0], getattr(one, name)[0], atol=LOOP * 100)
        assert np.array_equal(getattr(many, name)[0], getattr(many, name)[7])


def test_vmap_accepts_the_default_control_and_a_traced_one():
    scenes = batch_of([40.0, 70.0], [0.2, 0.3])
    default = jax.vmap(jw.scan)(scenes)
    assert np.all(np.asarray(default.status) == jw.Status.ok)
    assert default.control.shape == default.fx.shape[:2]
    alone = jw.scan(build(70.0, 0.3))
    assert [e[0] for e in event_list(jax.tree.map(lambda leaf: leaf[1], default))] == [e[0] for e in event_list(alone)]
    assert abs(default.control[1, 0] - alone.control[0]) < 1e-12
    out = np.linspace(0.8, -1.0, 40)
    there_and_back = jnp.asarray(np.concatenate([out, out[::-1]]))
    traced = jax.vmap(jw.scan)(scenes, jnp.stack([there_and_back, there_and_back]))
    np.testing.assert_allclose(traced.fx[1], jw.scan(build(70.0, 0.3), there_and_back).fx, atol=LOOP * 100)


def test_a_traced_control_with_many_turns_is_followed_and_one_with_too_many_is_too_long():
    zigzag = np.tile([0.5, 0.4], 60)
    scans = jax.jit(jax.vmap(lambda control: jw.scan(build(70.0, 0.2), control)))
    rests = np.append(zigzag, np.full(120, zigzag[-1]))
    result = scans(jnp.asarray([rests, np.tile(zigzag, 2), np.linspace(0.5, 0.4, 240)]))
    assert np.all(np.asarray(result.status)[[0, 2]] == jw.Status.ok)
    assert np.all(np.asarray(result.status[1]) == jw.Status.too_long)
    eager = jw.scan(build(70.0, 0.2), zigzag)
    assert np.all(np.asarray(eager.status) == jw.Status.ok)
    np.testing.assert_allclose(result.fx[0, :120], eager.fx, atol=LOOP * 100)


def test_iterating_over_the_events_of_a_batch_is_rejected(batch):
    with pytest.raises(TypeError, match=r"events are those of a batch of shape \(8,\)"):
        next(iter(batch.events))


def test_events_are_ordered_and_unused_entries_are_marked(batch):
    counts = np.asarray(batch.events.count)
    for k, count in enumerate(counts):
        assert np.all(np.asarray(batch.events.kind[k][:count]) >= 0)
        assert np.all(np.asarray(batch.events.kind[k][count:]) == -1)
        assert np.all(np.isnan(batch.events.control[k][count:]))
        assert np.all(np.diff(batch.events.control[k][:count]) <= 0)
