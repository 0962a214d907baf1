"""Whiskers whose bending stiffness changes along them: limits, energy, shapes; see test_curvature.py, too."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from scenes import all_ok

EXACT = 1e-7  # of signals relative to their size: the rods' steps, whose error grows with the taper
SAME = 1e-9  # of signals relative to their size: the same rod, computed in another way
LIMIT = 1e-8  # relative: of an extrapolation to no load

CONTROL = np.linspace(0.85, -1.5, 95)
SIGNALS = ("base_x", "fx", "fy", "mz")


def cone(ratio=5.0, length=1.0, stiffness=1.0):
    """A cone of that stiffness at its base, `ratio` times thicker there than at its tip."""
    return jw.Whisker(length, Power(stiffness, 1 / ratio, length))


class Power(eqx.Module):
    """EI of a cone, by the ratio of tip to base diameter."""

    stiffness: float
    ratio: float
    length: float

    def __call__(self, s):
        return self.stiffness * (1 + (self.ratio - 1) * s / self.length) ** 4


def scene(whisker, stiffness=70.0, distance=0.2, rest_length=0.2):
    return jw.Scene(whisker, jw.Parabola(distance), jw.Support.fb(stiffness, rest_length))


@cache
def scanned(ratio=5.0):
    return jw.scan(scene(cone(ratio)), CONTROL)


def relative(found, wanted):
    return np.max(np.abs(np.asarray(found) - np.asarray(wanted))) / np.max(np.abs(np.asarray(wanted)))


def test_a_clamped_cone_is_lost_in_tangential_contact():
    # A uniform whisker lets go with its tip; this one folds with a third of its length beyond the contact. Upright it
    # would stand in the object there, so that it lands on the far side.
    result = jw.scan(jw.Scene(cone(), jw.Parabola(0.2)))
    assert all_ok(result)
    (lost,) = result.events.of(jw.EventKind.snap_through)
    assert lost.before.phase[0] == jw.Phase.tangential
    assert lost.control == pytest.approx(-0.735, abs=5e-4)  # the last digit of what is known
    assert lost.before.contact_arc[0] == pytest.approx(0.67, abs=5e-3)
    assert lost.after.mz[0] < 0
    (released,) = result.events.of(jw.EventKind.release)
    assert released.control == pytest.approx(-np.sqrt(0.8), abs=SAME)


def test_no_taper_is_a_uniform_whisker():
    uniform, constant = (jw.scan(scene(whisker), CONTROL) for whisker in (jw.Whisker(), cone(1.0)))
    for name in SIGNALS:
        assert relative(getattr(constant, name), getattr(uniform, name)) < SAME
    np.testing.assert_allclose([e.control for e in constant.events], [e.control for e in uniform.events], atol=SAME)


def test_whiskers_of_different_kinds_share_a_scene():
    support = jw.Support.fbfb(80.0, 0.2)
    whiskers = cone(5.0), cone(3.0, 0.9)
    plain = jw.Whisker(0.9, lambda s: (1 + (1 / 3 - 1) * s / 0.9) ** 4)
    alike, mixed = (
        jw.scan(jw.Scene(pair, jw.Parabola(0.2), support), CONTROL) for pair in (whiskers, (whiskers[0], plain))
    )
    assert all_ok(alike)
    assert len(alike.events) > 4
    for name in SIGNALS:
        assert relative(getattr(mixed, name), getattr(alike, name)) < SAME


def test_a_cone_beside_a_uniform_whisker():
    # Rigid springs: neither knows of the other.
    rigid = jw.Support.fbfb(jnp.inf, 0.2)
    both = jw.scan(jw.Scene((cone(), jw.Whisker()), jw.Parabola(0.2), rigid), CONTROL)
    for k, whisker in enumerate((cone(), jw.Whisker())):
        alone = jw.scan(jw.Scene(whisker, jw.Parabola(0.2), jw.Support.fb(jnp.inf, 0.2 * (k + 1))), CONTROL)
        for name in SIGNALS:
            assert relative(getattr(both, name)[:, k], getattr(alone, name)[:, 0]) < SAME


def test_units_do_not_matter():
    length, modulus, thick, thin = 0.05, 3.0e9, 2e-4, 5e-5
    whisker = jw.Whisker.conical(length, modulus, thick, thin)
    force = modulus * np.pi / 64 * thick**4 / length**2
    physical = jw.Scene(
        whisker, jw.Parabola(0.2 * length, 1 / length), jw.Support.fb(70 * force / length, 0.2 * length)
    )
    found = jw.scan(physical, CONTROL * length)
    wanted = jw.scan(scene(cone(4.0)), CONTROL)
    assert relative(found.fx, force * np.asarray(wanted.fx)) < SAME
    assert relative(found.mz, force * length * np.asarray(wanted.mz)) < SAME


def test_small_loads_bend_a_cone_as_beam_theory_says():
    # F L^3 / (3 E I_base) * (d_base / d_tip); the next term is of second order in the load.
    def slope(force):
        d = jw.deflect(cone(5.0), jw.PointForce(force))
        return -float(d.x[-1]) / force

    first, second = slope(2e-3), slope(1e-3)
    assert (4 * second - first) / 3 == pytest.approx(5.0 / 3.0, rel=LIMIT)


def test_a_pointed_cone_has_no_nan():
    # The tip of a point carries no load: beyond the last one the whisker is straight.
    point = jw.Whisker.conical(1.0, 64 / np.pi, 1.0, 0.0)
    d = jw.deflect(point, jw.PointForce(0.5, position=0.8))
    assert d.status == jw.Status.ok
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in (d.x, d.y, d.angle, d.curvature))
    assert float(d.mz) == pytest.approx(-0.5 * float(jnp.interp(0.8, d.s, d.y)), rel=1e-6)


def test_energy_is_what_the_drive_puts_in():
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


def test_shapes_end_where_the_contact_is():
    result = scanned()
    k = int(np.argmax(np.asarray(result.mz)[:, 0]))
    lines = jw.shapes(result, CONTROL[k : k + 1])
    assert float(lines.x[0, 0, -2]) == pytest.approx(float(result.contact_x[k, 0]), abs=EXACT)
    assert float(lines.y[0, 0, -2]) == pytest.approx(float(result.contact_y[k, 0]), abs=EXACT)


def test_a_function_that_is_no_stiffness_is_refused():
    with pytest.raises(
        ValueError, match=r"`bending_stiffness` must be positive and finite .* but is -0.0156\d* at 0.406"
    ):
        jw.Whisker(1.0, lambda s: 1.0 - 2.5 * s)
    with pytest.raises(ValueError, match="`tip_diameter` must be at least 0, but is -1"):
        jw.Whisker.conical(1.0, 1.0, 1.0, -1.0)
    with pytest.raises(ValueError, match=r"`rod` must be Shooting\(\) for whiskers that are curved or not uniform"):
        jw.Scene(cone(), jw.Parabola(0.2), rod=jw.ClosedForm())


def test_a_lane_without_stiffness_is_invalid_and_its_neighbour_never_notices():
    def mz(tip):
        return (result := jw.scan(scene(cone(1 / tip)), CONTROL[::12])).mz, result.status

    (good, bad), status = jax.jit(jax.vmap(mz))(jnp.array([0.2, -1.0]))
    assert np.all(status[1] == jw.Status.invalid) and np.all(np.isnan(bad))
    np.testing.assert_allclose(good, np.asarray(scanned().mz)[::12], atol=EXACT)


def test_a_rat_has_the_whiskers_of_the_regressions():
    # C2: 43 + 1.8 * 3 - 7.6 * 2 mm long, 0.041 + 0.002 * 33.2 + 0.011 * 3 - 0.0039 * 2 mm thick.
    whisker = jw.Whisker.rat("C", 2)
    assert float(whisker.length) == pytest.approx(33.2e-3, rel=1e-12)
    assert float(whisker.base_stiffness) == pytest.approx(3e9 * np.pi / 64 * 132.6e-6**4, rel=1e-12)
    # The radius falls by 0.0012 + 0.00017 * 3 - 0.000066 + 0.00011 per length.
    shorter = jw.Whisker.rat("C", 1, length=0.03, youngs_modulus=4e9, intrinsic_curvature=10.0)
    base = 0.041 + 0.002 * 30 + 0.011 * 3 - 0.0039
    tip = base - 2 * 30 * (0.0012 + 0.00017 * 3 - 0.000066 + 0.00011)
    assert float(shorter.stiffness_at(0.03)) == pytest.approx(4e9 * np.pi / 64 * (tip * 1e-3) ** 4, rel=1e-9)
    assert float(shorter.curvature_at(0.01)) == 10.0
    with pytest.raises(ValueError, match="`row` must be one of A, B, C, D, E, but is 'F'"):
        jw.Whisker.rat("F", 1)
    with pytest.raises(ValueError, match="`column` must be an int from 0 to 4 in row B, but is 5"):
        jw.Whisker.rat("B", 5)


def test_a_pointed_whisker_scans():
    cone = jw.Whisker(1.0, lambda s: (1 - s) ** 4)
    result = jw.scan(jw.Scene(cone, jw.Parabola(0.2), jw.Support.fb(70.0, 0.2)), np.linspace(0.65, -1.0, 64))
    blunt = jw.Whisker(1.0, lambda s: (1 - 0.9999 * s) ** 4)
    near = jw.scan(jw.Scene(blunt, jw.Parabola(0.2), jw.Support.fb(70.0, 0.2)), np.linspace(0.65, -1.0, 64))
    assert np.all(np.asarray(result.status) == jw.Status.ok)
    assert np.max(np.abs(result.mz - near.mz)) < 1e-3
