"""Shape functions of moving whiskers against NumPy's Legendre series, and their derivatives against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._dynamics.legendre import EXTRA_POINTS, basis, polynomials_at, sinc, weights_at

N = 6
ROUNDING = 1e-13  # of polynomials of degree N + EXTRA_POINTS, and of the inverse of their matrix
SLOPES = 1e-11  # likewise, of second derivatives, which are about N^4


def series(n):
    return [np.polynomial.Legendre.basis(k, domain=[0, 1]) for k in range(n)]


def polynomial(degree):
    return np.polynomial.Polynomial(np.random.default_rng(degree).normal(size=degree + 1))


@pytest.mark.parametrize("n", [2, N])
def test_a_basis_holds_polynomials_and_their_integrals(n):
    shapes, each = basis(n), series(n)
    assert shapes.points.size == n + EXTRA_POINTS
    at = shapes.points
    np.testing.assert_allclose(shapes.curvatures, np.stack([one(at) for one in each], axis=1), atol=ROUNDING)
    np.testing.assert_allclose(shapes.angles, np.stack([one.integ(lbnd=0)(at) for one in each], axis=1), atol=ROUNDING)


def test_nodes_reach_as_far_as_the_integral_of_the_interpolating_polynomial():
    shapes = basis(N)
    known = polynomial(shapes.points.size - 1)
    expected = known.integ(lbnd=0)(np.concatenate([[0.0], shapes.points, [1.0]]))
    np.testing.assert_allclose(shapes.reach @ known(shapes.points), expected, atol=ROUNDING)
    coefficients = np.asarray(known.convert(kind=np.polynomial.Legendre, domain=[0, 1]).coef, float)
    np.testing.assert_allclose(shapes.interpolation @ known(shapes.points), coefficients, atol=ROUNDING)


def test_weights_interpolate_and_integrate_up_to_any_place():
    shapes, s = basis(N), np.linspace(0.0, 1.0, 7)
    known = polynomial(shapes.points.size - 1)

    @jax.jit
    def at(s):
        value, rate = jax.jvp(lambda s: weights_at(shapes, s), (s,), (jnp.ones(()),))
        return value, rate, jax.jacrev(lambda s: weights_at(shapes, s))(s)

    value, rate, reverse = (np.asarray(each) for each in jax.vmap(at)(jnp.asarray(s)))
    values = known(shapes.points)
    np.testing.assert_allclose(value @ values, np.stack([known(s), known.integ(lbnd=0)(s)], axis=1), atol=ROUNDING)
    np.testing.assert_allclose(rate @ values, np.stack([known.deriv()(s), known(s)], axis=1), atol=SLOPES)
    np.testing.assert_allclose(reverse, rate, atol=SLOPES)


def test_polynomials_have_the_derivatives_of_any_order():
    s = jnp.linspace(0.0, 1.0, 5)

    def at(s):
        return polynomials_at(s, N)

    first = jax.jacfwd(at)
    both = jax.jit(jax.vmap(lambda s: (at(s), first(s), jax.jacfwd(first)(s), jax.jacrev(first)(s))))(s)
    for order, got in zip((0, 1, 2, 2), both, strict=True):
        expected = np.stack([one.deriv(order)(np.asarray(s)) for one in series(N)], axis=1)
        np.testing.assert_allclose(got, expected, atol=SLOPES, err_msg=str(order))
    np.testing.assert_array_equal(at(jnp.asarray(0.3))[:2], [1.0, -0.4])


def test_the_sine_over_its_argument_is_smooth_at_zero_and_where_the_series_ends():
    edge = [0.1, np.nextafter(0.1, 1.0)]
    x = np.array([0.0, 1e-9, 0.05, *edge, 0.3, 2.0, 3.5])
    x = np.concatenate([x, -x])
    with np.errstate(invalid="ignore"):
        slope = np.where(x == 0, 0.0, (x * np.cos(x) - np.sin(x)) / x**2)
    rates = jax.jit(jax.vmap(lambda x: (sinc(x), jax.grad(sinc)(x), jax.hessian(sinc)(x))))(jnp.asarray(x))
    np.testing.assert_allclose(rates[0], np.sinc(x / np.pi), rtol=ROUNDING)
    far = np.abs(x) > 1e-6  # closer to zero, the closed form of the slope loses its digits
    np.testing.assert_allclose(rates[1][far], slope[far], atol=1e-13)
    np.testing.assert_allclose(rates[1][~far], -x[~far] / 3, atol=1e-24)
    assert rates[2][0] == pytest.approx(-1 / 3, abs=1e-15)
    np.testing.assert_allclose(rates[2][3], rates[2][4], rtol=1e-11)
