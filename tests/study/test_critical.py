"""The critical stiffness, compared with the closed form and with scans on both sides of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._study.critical import softest, steepest
from scenes import all_ok, model

# Largest dF_x/dx0 before the vertex, and x0 there, by distance (a = 1), from the closed form. The first two are maxima
# in tangential contact, in 40 digits. At the larger distances the tip touches the vertex, where the slope still grows.
EXACT = {
    0.1: (129.7212723891506, -0.0888582778568),
    0.4: (5.823515964515434, -0.3674412508699),
    0.46: (7.209075237763611, -0.7617065743),
    0.8: (5.673606459206943, -0.5326371760),
}
SLOPE = 1e-9  # relative
PLACE = 1e-7  # the position of a maximum is known to the square root of the precision of its value
MARGIN = 1e-3  # relative, on both sides of the critical stiffness


@pytest.mark.parametrize("distance", EXACT)
def test_steepest_slope_agrees_with_the_closed_form(distance):
    found = steepest(jw.Whisker(), jw.Parabola(distance))
    slope, base_x = EXACT[distance]
    assert abs(found.slope / slope - 1) < SLOPE
    assert abs(found.base_x - base_x) < PLACE


def test_steepest_slope_is_in_the_units_of_the_scene():
    length, bending = 37.5, 4.2e4
    found = steepest(jw.Whisker(length, bending), jw.Parabola(0.1 * length, 1 / length, position=5.0))
    slope, base_x = EXACT[0.1]
    assert abs(found.slope * length**3 / bending / slope - 1) < SLOPE
    assert abs((found.base_x - 5.0) / length - base_x) < PLACE


def test_an_object_out_of_reach_has_no_steepest_slope():
    assert np.all(np.isnan(steepest(jw.Whisker(), jw.Parabola(1.2))))


def test_a_scan_snaps_through_only_below_the_steepest_slope():
    slope, _ = EXACT[0.1]
    for stiffness, snaps in ((slope * (1 - MARGIN), 1), (slope * (1 + MARGIN), 0)):
        result = jw.scan(model("FB", stiffness, distance=0.1), np.array([0.9, -0.8]))
        assert len(result.events.of(jw.EventKind.snap_through)) == snaps


@pytest.mark.parametrize("below", [1e-4, 1e-5, 1e-6, 1e-7])
def test_a_scan_just_below_the_critical_stiffness_has_one_small_snap(below):
    # The two folds are at most 1e-3 apart, and in u a millionth of that, which leaves the flow almost no force.
    result = jw.scan(model("FB", EXACT[0.1][0] * (1 - below), distance=0.1), np.linspace(0.9, -0.8, 64))
    assert all_ok(result)
    (snap,) = result.events.of(jw.EventKind.snap_through)
    # The state moves by less than the square root of the deficit in stiffness, and there is no other event.
    moved = abs(float(snap.after.base_x[0] - snap.before.base_x[0]))
    assert 0.03 * np.sqrt(below) < moved < 3 * np.sqrt(below)


def test_compliance_of_the_softest_base():
    softness = {"FB": 1.0, "FBFB": 2.0, "FBFBR": 2 / 3, "FBFBFBR": 5 / 8}
    for name, value in softness.items():
        assert abs(softest(jw.Support.named(name, 10.0)) - value / 10) < 1e-15
    assert softest(jw.Support.clamped()) == 0
    assert softest(jw.Support.follicle(x=20.0, y=1.0, phi=0.1)) == 0.05  # along x only


STEP = 1e-5
SLOPES = 1e-6  # relative, of derivatives: both the differences and the position of the maximum limit it
# Distance, a, length, bending stiffness. The maximum is at the vertex and moves with it.
AT_VERTEX = (0.46, 1.0, 1.0, 1.0)


def critical(distance, a, length, bending_stiffness):
    return jw.critical_stiffness(jw.Whisker(length, bending_stiffness), jw.Parabola(distance, a))


@pytest.mark.parametrize("distance", [0.1, 0.46])
def test_derivatives_agree_with_differences_in_both_modes(distance):
    at = (distance, *AT_VERTEX[1:])
    found = jax.grad(critical, argnums=(0, 1, 2, 3))(*at)
    for k, slope in enumerate(found):
        way = STEP * np.eye(4)[k]
        expected = (critical(*(at + way)) - critical(*(at - way))) / (2 * STEP)
        np.testing.assert_allclose(slope, expected, rtol=SLOPES, atol=SLOPES * float(critical(*at)))
    forwards = jax.jvp(critical, at, (1.0, 2.0, 3.0, 4.0))[1]
    np.testing.assert_allclose(forwards, np.dot(found, [1.0, 2.0, 3.0, 4.0]), rtol=1e-12)
    # It is a stiffness: c L^3 / EI depends on q / L and a L only.
    np.testing.assert_allclose(found[3], critical(*at), rtol=SLOPES)


def test_batches_are_those_of_single_values_and_the_hopeless_lane_has_no_derivative():
    batch, slopes = jax.vmap(jax.value_and_grad(lambda q: critical(q, *AT_VERTEX[1:])))(jnp.array([0.1, 0.46, 1.3]))
    assert np.isnan(batch[2]) and slopes[2] == 0
    for k, q in enumerate((0.1, 0.46)):
        np.testing.assert_allclose(batch[k], critical(q, *AT_VERTEX[1:]), rtol=1e-12)
        np.testing.assert_allclose(slopes[k], jax.grad(critical)(q, *AT_VERTEX[1:]), rtol=1e-12)


def test_it_can_be_compiled():
    assert abs(jax.jit(critical)(*AT_VERTEX) / EXACT[0.46][0] - 1) < SLOPE


def test_of_coupled_whiskers_and_several_objects():
    far, near = jw.Parabola(0.4), jw.Parabola(0.1, position=-5.0)
    assert abs(jw.critical_stiffness(jw.Whisker(), far, "FBFB") / EXACT[0.4][0] / 2 - 1) < SLOPE
    assert abs(jw.critical_stiffness(jw.Whisker(), (far, near)) / EXACT[0.1][0] - 1) < SLOPE


@pytest.mark.unchecked
def test_an_unknown_model_is_rejected():
    with pytest.raises(ValueError, match=r"`model` must be one of clamped, FB, .*, got 'BF'"):
        jw.critical_stiffness(jw.Whisker(), jw.Parabola(0.2), "BF")
