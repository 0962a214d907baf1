"""Whiskers: materials, cones, the whiskers of a rat, functions of arc length, errors."""

# pyright: reportArgumentType=false
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from functions import Linear

EXACT = 1e-12


def test_bending_stiffness_of_a_circular_section():
    whisker = jw.Whisker.from_material(0.05, 3e9, 2e-4)
    assert whisker.uniform
    assert float(whisker.base_stiffness) == pytest.approx(3e9 * np.pi / 64 * 2e-4**4, rel=EXACT)
    # A modulus that increases towards the tip makes the whisker non-uniform.
    stiffer = jw.Whisker.from_material(0.05, lambda s: 3e9 * (1 + 10 * s), 2e-4)
    assert not stiffer.uniform
    assert float(stiffer.stiffness_at(0.05) / whisker.base_stiffness) == pytest.approx(1.5, rel=EXACT)


def test_a_cone_has_a_linear_diameter():
    cone = jw.Whisker.conical(2.0, 64e4 / np.pi, 0.1, 0.05)
    actual = [float(cone.stiffness_at(s)) for s in (0.0, 1.0, 2.0)]
    np.testing.assert_allclose(actual, [1.0, 0.75**4, 0.5**4], rtol=EXACT)


def test_a_rat_has_the_whiskers_of_the_regressions():
    # C2: 43 + 1.8 * 3 - 7.6 * 2 mm long, 0.041 + 0.002 * 33.2 + 0.011 * 3 - 0.0039 * 2 mm thick.
    whisker = jw.Whisker.rat("C", 2)
    assert float(whisker.length) == pytest.approx(33.2e-3, rel=EXACT)
    assert float(whisker.base_stiffness) == pytest.approx(3e9 * np.pi / 64 * 132.6e-6**4, rel=EXACT)
    # The radius decreases by 0.0012 + 0.00017 * 3 - 0.000066 + 0.00011 per length.
    shorter = jw.Whisker.rat("C", 1, length=0.03, youngs_modulus=4e9, intrinsic_curvature=10.0)
    base = 0.041 + 0.002 * 30 + 0.011 * 3 - 0.0039
    tip = base - 2 * 30 * (0.0012 + 0.00017 * 3 - 0.000066 + 0.00011)
    assert float(shorter.stiffness_at(0.03)) == pytest.approx(4e9 * np.pi / 64 * (tip * 1e-3) ** 4, rel=1e-9)
    assert float(shorter.curvature_at(0.01)) == 10.0


def test_masses_follow_from_a_density():
    cone = jw.Whisker.conical(2.0, 64e4 / np.pi, 0.1, 0.05, density=400 / np.pi)
    np.testing.assert_allclose([float(cone.mass_at(s)) for s in (0.0, 1.0, 2.0)], [1.0, 0.75**2, 0.5**2], rtol=EXACT)
    rod = jw.Whisker.from_material(0.05, 3e9, 2e-4, density=1300.0)
    assert float(rod.mass_at(0.02)) == pytest.approx(1300 * np.pi / 4 * 2e-4**2, rel=EXACT)
    denser = jw.Whisker.from_material(0.05, 3e9, 2e-4, density=Linear(1300.0, 1e4))
    assert float(denser.mass_at(0.05) / rod.mass_at(0.05)) == pytest.approx(1800 / 1300, rel=EXACT)
    rat = jw.Whisker.rat("C", 2, density=1300.0)
    assert float(rat.mass_at(0.0)) == pytest.approx(1300 * np.pi / 4 * 132.6e-6**2, rel=EXACT)
    assert jw.Whisker.rat("C", 2).mass_per_length is None


def test_equilibria_do_not_depend_on_masses():
    heavy = jw.Whisker(mass_per_length=Linear(1.0, 1.0), tip_mass=0.1, base_mass=2.0, base_inertia=0.3)
    assert heavy.uniform and heavy.has_masses
    assert jax.tree.structure(heavy.without_masses()) == jax.tree.structure(jw.Whisker())
    scene = jw.Scene((heavy, jw.Whisker()), jw.Parabola(0.2), jw.Support.fbfb(70.0)).in_equilibrium()
    assert scene.whiskers == (jw.Whisker(), jw.Whisker())


def test_traced_masses_out_of_their_domain_are_invalid():
    @jax.jit
    def valid(mass, growth, tip, base):
        return jw.Whisker(2.0, mass_per_length=Linear(mass, growth), tip_mass=tip, base_mass=base).valid_masses()

    assert valid(1.0, -0.5, 0.0, 0.0)  # the mass per length vanishes at the tip only
    for bad in [(1.0, -0.6, 0.0, 0.0), (1.0, 0.0, -1.0, 0.0), (1.0, 0.0, 0.0, jnp.nan), (jnp.inf, 0.0, 0.0, 0.0)]:
        assert not valid(*bad), bad


def test_the_stiffness_may_vanish_at_the_tip():
    assert jw.Whisker(1.0, lambda s: 1.0 - s).stiffness_at(1.0) == 0


def test_breaks_belong_to_functions():
    stepped = jw.Whisker(2.0, Linear(1.0, -0.1), mass_per_length=Linear(1.0, 0.0), breaks=[0.5, 1.0])
    np.testing.assert_array_equal(stepped.without_masses().breaks, [0.5, 1.0])
    assert "2 breaks" in str(jw.Scene(stepped, jw.Parabola(0.2)))
    # Those of a uniform whisker are those of its mass.
    assert jw.Whisker(2.0, mass_per_length=Linear(1.0, 0.0), breaks=(0.5,)).without_masses() == jw.Whisker(2.0)
    assert jw.Whisker(breaks=()).breaks is None


def test_traced_breaks_outside_the_whisker_are_invalid():
    @jax.jit
    def valid(first, second):
        return jw.Whisker(2.0, Linear(1.0, -0.1), breaks=(first, second)).valid()

    assert valid(0.5, 1.0) and valid(0.5, 0.5)
    for bad in [(0.0, 1.0), (1.0, 0.5), (0.5, 2.0), (jnp.nan, 1.0)]:
        assert not valid(*bad), bad


def test_parameters_of_a_module_are_differentiable():
    def middle(start, growth):
        return jw.Whisker(2.0, Linear(start, growth)).stiffness_at(1.0)

    np.testing.assert_allclose(jax.grad(middle, argnums=(0, 1))(1.0, 0.5), (1.0, 1.0), atol=EXACT)


def test_traced_parameters_out_of_their_domain_are_invalid():
    @jax.jit
    def valid(length, stiffness, curvature):
        return jw.Whisker(length, Linear(stiffness, -0.5), Linear(curvature, 0.0)).valid()

    assert valid(1.0, 1.0, 0.3)
    assert valid(1.0, 0.5, 0.3)  # the stiffness vanishes at the tip only
    for bad in [(-1.0, 1.0, 0.3), (1.0, 0.4, 0.3), (1.0, 1.0, 1.6), (jnp.inf, 1.0, 0.3), (1.0, jnp.nan, 0.3)]:
        assert not valid(*bad), bad


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.Whisker.rat("", 2), "`row` must be one of A, B, C, D, E, got ''"),
        (lambda: jw.Whisker.rat("AB", 2), "`row` must be one of A, B, C, D, E, got 'AB'"),
        (lambda: jw.Whisker.rat(3, 2), "`row` must be one of A, B, C, D, E, got 3"),
        (lambda: jw.Whisker.rat(["A"], 2), "`row` must be one of"),
        (lambda: jw.Whisker.rat("B", 5), "`column` must be an int from 0 to 4 in row B, got 5"),
        (lambda: jw.Whisker.rat("B", True), "`column` must be an int from 0 to 4 in row B, got True"),
        (lambda: jw.Whisker(1.0, lambda s: 0.99 - s), r"`bending_stiffness` must be positive .*, got -0.01\d* at 1 of"),
        (
            lambda: jw.Whisker(1.0, lambda s: 1.0 - 2.5 * s),
            r"`bending_stiffness` must be positive and finite .*, got -0.0156\d* at 0.406",
        ),
        (
            lambda: jw.Whisker.conical(1.0, 1.0, 1.0, -1.0),
            "`tip_diameter` must be a non-negative finite number, got -1",
        ),
        (lambda: jw.Whisker(breaks=(0.5,)), r"`breaks` must be absent unless .* is a function, got \(0.5\)"),
        (
            lambda: jw.Whisker(2.0, Linear(1.0, 0.0), breaks=(0.5, 2.0)),
            r"`breaks` must be in ascending order inside \(0, 2\), got \(0.5, 2\)",
        ),
        (lambda: jw.Whisker(2.0, Linear(1.0, 0.0), breaks=(1.0, 0.5)), "`breaks` must be in ascending order"),
        (lambda: jw.Whisker(2.0, Linear(1.0, 0.0), breaks=0.5), "`breaks` must be a non-empty one-dimensional array"),
        (lambda: jw.Whisker(mass_per_length=0.0), "`mass_per_length` must be a positive finite number, got 0"),
        (
            lambda: jw.Whisker(mass_per_length=lambda s: 1.0 - 2.5 * s),
            r"`mass_per_length` must be positive and finite .*, got -0.0156\d* at 0.406",
        ),
        (lambda: jw.Whisker(tip_mass=-1.0), "`tip_mass` must be a non-negative finite number, got -1"),
        (lambda: jw.Whisker(base_mass=math.inf), "`base_mass` must be a non-negative finite number, got inf"),
        (lambda: jw.Whisker(base_inertia="1"), "`base_inertia` must be a non-negative finite number, got '1'"),
        (lambda: jw.Whisker.rat("C", 2, density=-1.0), "`density` must be a positive finite number, got -1"),
        (lambda: jw.Whisker.from_material(1.0, -1.0, 1.0), "`youngs_modulus` must be a positive finite number, got -1"),
        (
            lambda: jw.Whisker.from_material(0.06, 210e9, 0.3),
            r"`diameter` must be at most 1/5 of the length 0.06, in the same unit: .*; got 0.3\.",
        ),
        (lambda: jw.Whisker.from_material(0.06, 210e9, lambda s: 1e-3 + s), "`diameter` must be at most .*; got 0.061"),
        (lambda: jw.Whisker.conical(0.06, 3e9, 0.2, 0.0), "`base_diameter` must be at most 1/5 .*; got 0.2"),
        (lambda: jw.Whisker.conical(0.06, 3e9, 2e-4, 0.1), "`tip_diameter` must be at most 1/5 .*; got 0.1"),
        (
            lambda: jw.Whisker(intrinsic_curvature=1.6),
            r"`intrinsic_curvature` must turn .* less than a right angle, got a turn of 91\.67 degrees",
        ),
        (
            lambda: jw.Whisker(1.0, lambda s: 1.0 if s < 0.5 else 0.5),
            "`bending_stiffness` .* jnp.where instead of `if`",
        ),
        (
            lambda: jw.Whisker(intrinsic_curvature=math.sin),
            "`intrinsic_curvature` must be a function that JAX can trace",
        ),
        (
            lambda: jw.Whisker.from_material(1.0, 1.0, lambda s: math.exp(s)),
            "`diameter` must be a function that JAX can",
        ),
        (lambda: jw.Whisker(1.0, lambda s, t: s + t), r"`bending_stiffness` .* one number, got <lambda>\(s, t\)"),
        (
            lambda: jw.Whisker(1.0, lambda s: jnp.ones(3)),
            r"`bending_stiffness` .* which returns an array of shape \(3,\)",
        ),
    ],
)
def test_wrong_whiskers(make, message):
    with pytest.raises(ValueError, match=message):
        make()
