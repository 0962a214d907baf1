"""Gauss points and Legendre polynomials on the interval from 0 to 1, against NumPy."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.quadrature import gauss, legendre, legendre_integrals

ROUNDING = 3e-15  # of eigenvalues, and of polynomials of degree 20


@pytest.mark.parametrize("count", [1, 2, 3, 16, 24])
def test_points_and_weights(count):
    points, weights = gauss(count)
    expected = np.polynomial.legendre.leggauss(count)
    np.testing.assert_allclose(points, (expected[0] + 1) / 2, atol=ROUNDING)
    np.testing.assert_allclose(weights, expected[1] / 2, atol=ROUNDING)
    # Polynomials of a degree below twice the number of points are integrated exactly.
    np.testing.assert_allclose(weights @ points ** (2 * count - 1), 1 / (2 * count), atol=ROUNDING)


@pytest.mark.parametrize("count", [1, 2, 3, 20])
def test_polynomials_and_their_integrals(count):
    s = np.linspace(0.0, 1.0, 11)
    series = [np.polynomial.Legendre.basis(n, domain=[0, 1]) for n in range(count)]
    for at in (s, jnp.asarray(s)):
        np.testing.assert_allclose(np.stack(legendre(at, count)), [each(s) for each in series], atol=ROUNDING)
        integrals = [each.integ(lbnd=0)(s) for each in series]
        np.testing.assert_allclose(np.stack(legendre_integrals(at, count)), integrals, atol=ROUNDING)
