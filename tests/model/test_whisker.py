"""Whiskers: functions of arc length, masses, curvatures in space, errors."""

# pyright: reportArgumentType=false
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from functions import Linear
from jaxwhisker._model.whisker import with_equal_breaks

EXACT = 1e-12


def test_equilibria_do_not_depend_on_masses():
    heavy = jw.Whisker(mass_per_length=Linear(1.0, 1.0), tip_mass=0.1, base_mass=2.0, base_inertia=0.3)
    assert heavy.uniform and heavy.has_masses
    assert jax.tree.structure(heavy.without_masses()) == jax.tree.structure(jw.Whisker())


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


CURVED = {"lateral_curvature": Linear(0.3, 0.1), "twist": 2.0, "torsion_ratio": 0.7}


def test_a_plane_whisker_has_nothing_of_space():
    whisker = jw.Whisker(intrinsic_curvature=0.3)
    assert not whisker.needs_space
    assert len(jax.tree.leaves(whisker)) == 3
    assert whisker.torsion == 1 / 1.3
    np.testing.assert_array_equal(whisker.curvature_in_space(0.5), [0.0, -0.3, 0.0])


def test_curvatures_in_space():
    whisker = jw.Whisker(2.0, intrinsic_curvature=0.2, **CURVED)
    assert whisker.needs_space and not whisker.uniform
    assert whisker.torsion == 0.7
    np.testing.assert_allclose(whisker.curvature_in_space(1.0), [0.4, -0.2, 2.0], atol=EXACT)
    for name in ("lateral_curvature", "twist"):
        assert jw.Whisker(**{name: 0.1}).needs_space and not jw.Whisker(**{name: 0.1}).uniform
    assert jw.Whisker(torsion_ratio=0.7).uniform


def test_copies_of_whiskers_keep_what_they_have_in_space():
    whisker = jw.Whisker(2.0, mass_per_length=1.0, tip_mass=0.1, breaks=(0.5,), **CURVED)
    assert whisker.without_masses() == jw.Whisker(2.0, breaks=(0.5,), **CURVED)
    other = jw.Whisker(2.0, Linear(1.0, 0.1), breaks=(0.5, 1.0))
    padded, _ = with_equal_breaks((whisker, other))
    np.testing.assert_array_equal(padded.breaks, [0.0, 0.5])
    assert (padded.lateral_curvature, padded.twist, padded.torsion_ratio) == tuple(CURVED.values())


def test_a_twisted_whisker_may_be_long_as_it_does_not_curl_up():
    # A constant twist makes a helix: the tangent goes around an axis, from which it is arctan(k1 / k3) away.
    length = 2 * np.pi / np.hypot(1.0, 2.0)  # once around
    whisker = jw.Whisker(length, lateral_curvature=1.0, twist=2.0)
    assert float(whisker._largest_turn()) == pytest.approx(2 * np.arctan2(1.0, 2.0), abs=EXACT)
    with pytest.raises(ValueError, match="must turn"):
        jw.Whisker(length, lateral_curvature=1.0)


def test_curvatures_in_two_directions_turn_by_their_sum_of_squares():
    whisker = jw.Whisker(2.0, intrinsic_curvature=0.3, lateral_curvature=0.4)
    assert float(whisker._largest_turn()) == pytest.approx(1.0, abs=EXACT)


def test_traced_values_in_space_out_of_their_domain_are_invalid():
    @jax.jit
    def valid(ratio, lateral, twist):
        return jw.Whisker(2.0, torsion_ratio=ratio, lateral_curvature=lateral, twist=twist).valid()

    assert valid(0.7, 0.5, -3.0)
    for bad in [(0.0, 0.5, 0.0), (jnp.inf, 0.5, 0.0), (0.7, 0.8, 0.0), (0.7, jnp.nan, 0.0), (0.7, 0.1, jnp.nan)]:
        assert not valid(*bad), bad


@pytest.mark.parametrize(
    "make",
    [
        lambda whisker: jw.Scene(whisker, jw.Parabola(0.2)),
        jw.Sensor,
        lambda whisker: jw.Sensor((jw.Whisker(), whisker), jw.Support.fbfb(1.0)),
        lambda whisker: jw.modes(jw.Whisker(mass_per_length=1.0, twist=whisker.twist, lateral_curvature=0.1)),
        lambda whisker: jw.critical_stiffness(whisker, jw.Parabola(0.2)),
    ],
)
def test_the_plane_has_no_room_for_curvatures_in_space(make):
    with pytest.raises(
        ValueError, match=r"`lateral_curvature` must be None in the plane: others need an object in space, got 0\.1"
    ):
        make(jw.Whisker(lateral_curvature=0.1))
    with pytest.raises(ValueError, match=r"`(twist|lateral_curvature)` must be None in the plane"):
        make(jw.Whisker(twist=Linear(0.1, 0.0)))


def test_torsion_does_no_harm_in_the_plane():
    assert jw.Sensor(jw.Whisker(torsion_ratio=0.7)).whiskers[0].torsion_ratio == 0.7


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.Whisker(1.0, lambda s: 0.99 - s), r"`bending_stiffness` must be positive .*, got -0.01\d* at 1 of"),
        (
            lambda: jw.Whisker(1.0, lambda s: 1.0 - 2.5 * s),
            r"`bending_stiffness` must be positive and finite .*, got -0.0156\d* at 0.406",
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
        (
            lambda: jw.Whisker(intrinsic_curvature=1.6),
            r"`intrinsic_curvature` must turn .* less than a right angle, got a turn of 91\.67 degrees",
        ),
        (
            lambda: jw.Whisker(intrinsic_curvature=1.2, lateral_curvature=1.2),
            "`intrinsic_curvature` and `lateral_curvature` must turn .* got a turn of 97.23 degrees",
        ),
        (lambda: jw.Whisker(torsion_ratio=0.0), "`torsion_ratio` must be a positive finite number, got 0"),
        (lambda: jw.Whisker(lateral_curvature="1"), "`lateral_curvature` must be a finite number, got '1'"),
        (lambda: jw.Whisker(twist=math.inf), "`twist` must be a finite number, got inf"),
        (lambda: jw.Whisker(twist=math.sin), "`twist` must be a function that JAX can trace"),
        (
            lambda: jw.Whisker(1.0, lambda s: 1.0 if s < 0.5 else 0.5),
            "`bending_stiffness` .* jnp.where instead of `if`",
        ),
        (
            lambda: jw.Whisker(intrinsic_curvature=math.sin),
            "`intrinsic_curvature` must be a function that JAX can trace",
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
