"""Deflection under given loads: the thesis's tables, balance, moments, several loads."""

import jax
import numpy as np
import pytest

import jaxwhisker as jw

PRINTED = 5.1e-5  # the tables have four decimals
EXACT = 1e-9

TIP_FOLLOWER = {  # A.1
    1: (0.8795, 0.4758, 0.9755),
    3: (0.5139, 2.9557, 2.4313),
    5: (-2.5163, 4.3207, 2.9396),
    7: (-5.9366, 3.7091, 2.7236),
    10: (-9.8894, 1.4833, 1.7224),
}
FOLLOWER_ALONG = {0.3: (0.9990, 0.0450, 0.2999), 0.5: (0.9922, 0.1246, 0.4992), 0.7: (0.9703, 0.2421, 0.6958)}  # A.2
TIP_DEAD = {1: 0.943567, 3: 2.2367, 5: 3.0619, 7: 3.6895, 10: 4.4500}  # A.3, whose 0.9437 is a misprint
DEAD_ALONG = {0.3: 0.2998, 0.5: 0.4979, 0.7: 0.6893}  # A.4


@pytest.mark.parametrize("force", TIP_FOLLOWER)
def test_table_a1(force):
    d = jw.deflect(jw.Whisker(), jw.PointForce(force, position=1.0, follower=True))
    np.testing.assert_allclose([d.fx, d.fy, -d.mz], TIP_FOLLOWER[force], atol=PRINTED)


@pytest.mark.parametrize("position", FOLLOWER_ALONG)
def test_table_a2(position):
    d = jw.deflect(jw.Whisker(), jw.PointForce(1.0, position=position, follower=True))
    np.testing.assert_allclose([d.fx, d.fy, -d.mz], FOLLOWER_ALONG[position], atol=PRINTED)


@pytest.mark.parametrize("force", TIP_DEAD)
def test_table_a3(force):
    d = jw.deflect(jw.Whisker(), jw.PointForce(force))
    np.testing.assert_allclose([d.fx, d.fy, -d.mz], [force, 0.0, TIP_DEAD[force]], atol=PRINTED)


@pytest.mark.parametrize("position", DEAD_ALONG)
def test_table_a4(position):
    d = jw.deflect(jw.Whisker(), jw.PointForce(1.0, position=position))
    np.testing.assert_allclose([d.fx, d.fy, -d.mz], [1.0, 0.0, DEAD_ALONG[position]], atol=PRINTED)


def test_the_misprint_of_table_a3():
    d = jw.deflect(jw.Whisker(), jw.PointForce(1.0))
    assert abs(-d.mz - 0.943567) < 5.1e-7


def test_a_tip_moment_bends_an_arc():
    d = jw.deflect(jw.Whisker(), jw.PointMoment(0.8))
    np.testing.assert_allclose(d.curvature[:-1], 0.8, atol=EXACT)
    np.testing.assert_allclose(d.x, (np.cos(0.8 * d.s) - 1) / 0.8, atol=EXACT)
    np.testing.assert_allclose(d.y, np.sin(0.8 * d.s) / 0.8, atol=EXACT)
    np.testing.assert_allclose(d.angle, np.pi / 2 + 0.8 * d.s, atol=EXACT)
    assert abs(d.mz + 0.8) < EXACT
    assert abs(d.fx) < EXACT


def test_several_loads_balance():
    whisker = jw.Whisker(length=2.0, bending_stiffness=3.0)
    d = jw.deflect(whisker, jw.PointForce(1.0, 1.5, direction=2.5), jw.PointMoment(0.3, 1.0), jw.PointForce(2.0, 0.7))
    order_does_not_matter = jw.deflect(
        whisker, jw.PointForce(2.0, 0.7), jw.PointForce(1.0, 1.5, direction=2.5), jw.PointMoment(0.3, 1.0)
    )
    at = {s: (np.interp(s, d.s, d.x), np.interp(s, d.s, d.y)) for s in (0.7, 1.5)}
    forces = {0.7: (-2.0, 0.0), 1.5: (np.cos(2.5), np.sin(2.5))}
    moment = 0.3 + sum(at[s][0] * forces[s][1] - at[s][1] * forces[s][0] for s in at)
    assert abs(d.fx + sum(f[0] for f in forces.values())) < EXACT
    assert abs(d.fy + sum(f[1] for f in forces.values())) < EXACT
    assert abs(d.mz + moment) < EXACT
    assert abs(d.mz - order_does_not_matter.mz) < EXACT


def test_a_follower_turns_with_the_whisker_and_a_dead_load_does_not():
    follower = jw.deflect(jw.Whisker(), jw.PointForce(2.0, follower=True))
    tip = float(follower.angle[-1])
    np.testing.assert_allclose([-follower.fx, -follower.fy], 2 * np.array([-np.sin(tip), np.cos(tip)]), atol=EXACT)
    dead = jw.deflect(jw.Whisker(), jw.PointForce(2.0))
    np.testing.assert_allclose([dead.fx, dead.fy], [2.0, 0.0], atol=EXACT)


def test_units_are_carried():
    one = jw.deflect(jw.Whisker(), jw.PointForce(5.0))
    length, stiffness = 0.02, 3e-7
    si = jw.deflect(jw.Whisker(length, stiffness), jw.PointForce(5.0 * stiffness / length**2))
    assert abs(si.mz / (stiffness / length) - one.mz) < 1e-12
    np.testing.assert_allclose(si.x / length, one.x, atol=1e-12)


def test_a_load_too_large_for_the_steps_says_so():
    d = jw.deflect(jw.Whisker(), jw.PointForce(1e4))
    assert d.status == jw.Status.inexact
    assert np.isnan(d.mz) and np.all(np.isnan(d.x))


def test_derivatives_of_dead_and_follower_loads():
    for follower in (False, True):

        def moment(force, position, stiffness, *, follower=follower):
            return jw.deflect(jw.Whisker(1.0, stiffness), jw.PointForce(force, position, follower=follower)).mz

        at = (3.0, 0.8, 1.2)
        forward = np.array(jax.jacfwd(moment, argnums=(0, 1, 2))(*at))
        reverse = np.array(jax.jacrev(moment, argnums=(0, 1, 2))(*at))
        np.testing.assert_allclose(forward, reverse, rtol=1e-10)
        for i in range(3):
            near = [list(at), list(at)]
            near[0][i] -= 1e-4
            near[1][i] += 1e-4
            difference = (moment(*near[1]) - moment(*near[0])) / 2e-4
            assert abs(forward[i] - difference) < 1e-6


def test_vmap_is_a_loop():
    forces = np.array([1.0, 5.0, 10.0])
    batch = jax.vmap(lambda f: jw.deflect(jw.Whisker(), jw.PointForce(f)).mz)(forces)
    loop = [jw.deflect(jw.Whisker(), jw.PointForce(f)).mz for f in forces]
    np.testing.assert_allclose(batch, loop, rtol=1e-13)
