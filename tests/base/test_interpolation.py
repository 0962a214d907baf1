"""Cubics: exact for polynomials of degree 3, with the smallest value in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.interpolation import Cubic, between

EXACT = 1e-13  # of polynomials, whose coefficients are about 1
T = jnp.linspace(0.0, 1.0, 10_001)
SAMPLED = 1e-7  # distance of the smallest sample from the smallest value: curvature times squared distance of samples


def of(polynomial):
    rate = polynomial.deriv()
    return Cubic(*(jnp.asarray(each(t)) for each in (polynomial, rate) for t in (0.0, 1.0)))


@pytest.mark.parametrize("seed", range(6))
def test_polynomials_of_degree_3_are_reproduced(seed):
    polynomial = np.polynomial.Polynomial(np.random.default_rng(seed).normal(size=4))
    cubic = of(polynomial)
    np.testing.assert_allclose(cubic.value(T), polynomial(T), atol=EXACT)
    np.testing.assert_allclose(cubic.rate(T), polynomial.deriv()(T), atol=10 * EXACT)
    np.testing.assert_allclose(jax.vmap(jax.grad(cubic.value))(T), cubic.rate(T), atol=10 * EXACT)
    assert np.min(polynomial(T)) - SAMPLED < cubic.least() < np.min(polynomial(T)) + EXACT


def test_the_smallest_value_of_lines_and_parabolas():
    for coefficients, least in [((1.0,), 1.0), ((1.0, 2.0), 1.0), ((1.0, -2.0), -1.0), ((1.0, -1.0, 1.0), 0.75)]:
        assert of(np.polynomial.Polynomial(coefficients)).least() == pytest.approx(least, abs=EXACT)


@pytest.mark.parametrize("seed", range(12))
def test_the_minimum_of_a_cubic(seed):
    polynomial = np.polynomial.Polynomial(np.random.default_rng(seed).normal(size=4))
    minima = [t.real for t in polynomial.deriv().roots() if t.imag == 0 and polynomial.deriv(2)(t.real) > 0]
    assert of(polynomial).minimum() == pytest.approx(minima[0] if minima else np.inf, rel=1e3 * EXACT)


def test_the_minimum_of_lines_and_parabolas():
    for coefficients, place in [((1.0,), np.inf), ((1.0, 2.0), np.inf), ((1.0, 0.0, -1.0), np.inf), ((1, -1, 1), 0.5)]:
        assert of(np.polynomial.Polynomial(coefficients)).minimum() == pytest.approx(place, abs=EXACT)


def test_cubics_between_points_have_rates_per_arc_length():
    s = np.array([0.0, 0.3, 1.0])
    cubics = between(jnp.asarray(s**3), jnp.asarray(3 * s**2), jnp.diff(jnp.asarray(s)))
    middle = (s[:-1] + s[1:]) / 2
    np.testing.assert_allclose(cubics.value(jnp.asarray(0.5)), middle**3, atol=EXACT)
    np.testing.assert_allclose(cubics.rate(jnp.asarray(0.5)), 3 * middle**2 * np.diff(s), atol=EXACT)
