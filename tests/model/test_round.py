"""Whiskers with circular cross-sections: materials, cones, the whiskers of a rat, errors."""

# pyright: reportArgumentType=false
import math

import jax
import numpy as np
import pytest

import jaxwhisker as jw
from functions import Linear
from jaxwhisker._model.along import ParabolicShape

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


@pytest.mark.unchecked
def test_cones_may_be_curved_and_errors_name_them_as_users_do():
    cone = jw.Whisker.conical(0.06, 4e10, 4e-4, 2e-4, intrinsic_curvature=5.0)
    assert float(cone.curvature_at(0.03)) == 5.0 and not cone.tapers
    assert jw.Whisker.conical(0.06, 4e10, 4e-4, 2e-4).tapers and not jw.Whisker.conical(0.06, 4e10, 2e-4, 4e-4).tapers
    for call in (jw.Whisker.conical, jw.Whisker.from_material, jw.Whisker.from_points):
        with pytest.raises(TypeError, match=rf"^Whisker\.{call.__name__}\(\) missing"):
            call(1.0)  # pyright: ignore[reportCallIssue]


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


def test_torsion_follows_from_the_poisson_ratio():
    # G = E / (2 (1 + nu)) and J = 2 I of a circle.
    for whisker in (
        jw.Whisker.from_material(0.05, 3e9, 2e-4, poisson_ratio=0.25),
        jw.Whisker.conical(0.05, 3e9, 2e-4, 5e-5, poisson_ratio=0.25),
        jw.Whisker.rat("C", 2, poisson_ratio=0.25),
    ):
        assert whisker.torsion_ratio == pytest.approx(1 / 1.25, rel=EXACT)
    assert jw.Whisker.rat("C", 2).torsion_ratio is None
    slope = jax.grad(lambda nu: jw.Whisker.from_material(0.05, 3e9, 2e-4, poisson_ratio=nu).torsion)(0.25)
    np.testing.assert_allclose(slope, -1 / 1.25**2, rtol=EXACT)


def test_a_rat_whisker_may_be_a_parabola():
    whisker = jw.Whisker.rat("C", 2, parabola=12.0)
    assert whisker.intrinsic_curvature == ParabolicShape(12.0)
    np.testing.assert_allclose(whisker.curvature_at(0.0), 24.0, rtol=EXACT)
    assert jw.Whisker.rat("C", 2).intrinsic_curvature is None


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
        (
            lambda: jw.Whisker.conical(1.0, 1.0, 1.0, -1.0),
            "`tip_diameter` must be a non-negative finite number, got -1",
        ),
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
            lambda: jw.Whisker.from_material(1.0, 1.0, lambda s: math.exp(s)),
            "`diameter` must be a function that JAX can",
        ),
        (
            lambda: jw.Whisker.rat("C", 2, parabola=12.0, intrinsic_curvature=24.0),
            "`parabola` must be None with an `intrinsic_curvature`, got 12",
        ),
        (lambda: jw.Whisker.rat("C", 2, parabola="a"), "`coefficient` must be a finite number, got 'a'"),
        (
            lambda: jw.Whisker.from_material(1.0, 1.0, 0.1, poisson_ratio=-1.0),
            "`poisson_ratio` must be above -1 and at most 0.5, got -1",
        ),
        (lambda: jw.Whisker.rat("C", 2, poisson_ratio=0.6), "`poisson_ratio` must be above -1 and at most 0.5"),
        (lambda: jw.Whisker.rat("C", 2, poisson_ratio="0"), "`poisson_ratio` must be a finite number, got '0'"),
    ],
)
def test_wrong_whiskers(make, message):
    with pytest.raises(ValueError, match=message):
        make()
