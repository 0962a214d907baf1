"""Whiskers whose bending stiffness changes along them: limits, energy, shapes (see also test_curved_whiskers.py)."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from scenes import all_ok, cone

EXACT = 1e-7  # of signals relative to their size: error of the rods' steps, which grows with the taper
SAME = 1e-9  # of signals relative to their size: the same rod, computed in another way
LIMIT = 1e-8  # relative, of an extrapolation to zero load

CONTROL = np.linspace(0.85, -1.5, 95)
SIGNALS = ("base_x", "fx", "fy", "mz")


def scene(whisker, stiffness=70.0, distance=0.2, rest_length=0.2):
    return jw.Scene(whisker, jw.Parabola(distance), jw.Support.fb(stiffness, rest_length))


@cache
def scanned():
    return jw.scan(scene(cone(0.2)), CONTROL)


def relative(actual, expected):
    return np.max(np.abs(np.asarray(actual) - np.asarray(expected))) / np.max(np.abs(np.asarray(expected)))


def test_a_clamped_cone_is_lost_in_tangential_contact():
    # A uniform whisker snaps off in tip contact; this one folds with a third of its length beyond the contact. There an
    # upright whisker would penetrate the object, and therefore it lands on the far side.
    # A rigid spring is a clamp.
    result = jw.scan(scene(cone(0.2), np.inf, rest_length=0.0))
    assert all_ok(result)
    (lost,) = result.events.of(jw.EventKind.snap_through)
    assert lost.before.phase[0] == jw.Phase.tangential
    assert lost.control == pytest.approx(-0.735, abs=5e-4)  # the reference has three digits
    assert lost.before.contact_arc[0] == pytest.approx(0.67, abs=5e-3)
    assert lost.after.mz[0] < 0
    (released,) = result.events.of(jw.EventKind.release)
    assert released.control == pytest.approx(-np.sqrt(0.8), abs=SAME)


def test_a_cone_without_taper_is_a_uniform_whisker():
    uniform, constant = (jw.scan(scene(whisker), CONTROL) for whisker in (jw.Whisker(), cone(1.0)))
    for name in SIGNALS:
        assert relative(getattr(constant, name), getattr(uniform, name)) < SAME
    np.testing.assert_allclose([e.control for e in constant.events], [e.control for e in uniform.events], atol=SAME)


def test_whiskers_of_different_kinds_share_a_scene():
    support = jw.Support.fbfb(80.0, 0.2)
    whiskers = cone(0.2), cone(1 / 3, length=0.9)
    plain = jw.Whisker(0.9, lambda s: (1 + (1 / 3 - 1) * s / 0.9) ** 4)
    alike, mixed = (
        jw.scan(jw.Scene(pair, jw.Parabola(0.2), support), CONTROL) for pair in (whiskers, (whiskers[0], plain))
    )
    assert all_ok(alike)
    assert len(alike.events) > 4
    for name in SIGNALS:
        assert relative(getattr(mixed, name), getattr(alike, name)) < SAME


def test_a_cone_beside_a_uniform_whisker():
    # Rigid springs decouple the whiskers.
    rigid = jw.Support.fbfb(jnp.inf, 0.2)
    both = jw.scan(jw.Scene((cone(0.2), jw.Whisker()), jw.Parabola(0.2), rigid), CONTROL)
    for k, whisker in enumerate((cone(0.2), jw.Whisker())):
        alone = jw.scan(scene(whisker, np.inf, rest_length=0.2 * (k + 1)), CONTROL)
        for name in SIGNALS:
            assert relative(getattr(both, name)[:, k], getattr(alone, name)[:, 0]) < SAME


def test_units_do_not_matter():
    length, modulus, thick, thin = 0.05, 3.0e9, 2e-4, 5e-5
    whisker = jw.Whisker.conical(length, modulus, thick, thin)
    force = modulus * np.pi / 64 * thick**4 / length**2
    physical = jw.Scene(
        whisker, jw.Parabola(0.2 * length, 1 / length), jw.Support.fb(70 * force / length, 0.2 * length)
    )
    actual = jw.scan(physical, CONTROL * length)
    expected = jw.scan(scene(cone(0.25)), CONTROL)
    assert relative(actual.fx, force * np.asarray(expected.fx)) < SAME
    assert relative(actual.mz, force * length * np.asarray(expected.mz)) < SAME


def test_small_loads_on_a_cone_agree_with_beam_theory():
    # F L^3 / (3 E I_base) * (d_base / d_tip); the next term is of second order in the load.
    def slope(force):
        d = jw.deflect(cone(0.2), jw.PointForce(force))
        return -float(d.x[-1]) / force

    first, second = slope(2e-3), slope(1e-3)
    assert (4 * second - first) / 3 == pytest.approx(5.0 / 3.0, rel=LIMIT)


def test_a_pointed_cone_has_no_nan():
    # A pointed tip carries no load: beyond the last load the whisker is straight.
    point = jw.Whisker.conical(1.0, 64e4 / np.pi, 0.1, 0.0)
    d = jw.deflect(point, jw.PointForce(0.5, position=0.8))
    assert d.status == jw.Status.ok
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in (d.x, d.y, d.angle, d.curvature))
    assert float(d.mz) == pytest.approx(-0.5 * float(jnp.interp(0.8, d.s, d.y)), rel=1e-6)


def test_energy_is_the_work_of_the_drive():
    # dE = sum(fx) du between two events.
    result = scanned()
    energy = np.asarray(jw.stored_energy(result.scene, result))
    first = result.events.of(jw.EventKind.tip_to_tangential)[0].control
    inside = np.flatnonzero(
        (first - 0.05 > CONTROL) & (result.events.of(jw.EventKind.snap_through)[0].control + 0.3 < CONTROL)
    )
    nodes, weights = np.polynomial.legendre.leggauss(64)
    low, high = CONTROL[inside[0]], CONTROL[inside[-1]]
    between = (low + high) / 2 + (high - low) / 2 * nodes
    fx = np.asarray(jw.scan(result.scene, between).fx)[:, 0]
    work = (high - low) / 2 * np.sum(weights * fx)
    assert energy[inside[-1]] - energy[inside[0]] == pytest.approx(work, rel=1e-7)


def test_shapes_pass_through_the_contact():
    result = scanned()
    k = int(np.argmax(np.asarray(result.mz)[:, 0]))
    lines = jw.shapes(result, CONTROL[k : k + 1])
    assert float(lines.x[0, 0, -2]) == pytest.approx(float(result.contact_x[k, 0]), abs=EXACT)
    assert float(lines.y[0, 0, -2]) == pytest.approx(float(result.contact_y[k, 0]), abs=EXACT)


def test_an_invalid_batch_element_does_not_affect_its_neighbour():
    def mz(tip):
        return (result := jw.scan(scene(cone(tip)), CONTROL[::12])).mz, result.status

    (good, bad), status = jax.vmap(mz)(jnp.array([0.2, -1.0]))
    assert np.all(status[1] == jw.Status.invalid) and np.all(np.isnan(bad))
    np.testing.assert_allclose(good, np.asarray(scanned().mz)[::12], atol=EXACT)


def test_a_pointed_whisker_scans():
    result, near = (jw.scan(scene(cone(tip)), np.linspace(0.65, -1.0, 64)) for tip in (0.0, 1e-4))
    assert np.all(np.asarray(result.status) == jw.Status.ok)
    assert np.max(np.abs(result.mz - near.mz)) < 1e-3
