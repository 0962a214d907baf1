"""Jacobi's functions and their derivatives against mpmath."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from jaxwhisker._rod.jacobi import jacobi

mp.mp.dps = 40
ROUNDING = 1e-14
FIRST = 1e-13  # of derivatives, which are sums of larger terms
SECOND = 1e-12  # of second derivatives


def exact(w, m):
    """sn(u)/u, cn(u), dn(u), eps(u)/u at w = u^2 of either sign."""
    w, m = mp.mpf(w), mp.mpf(m)
    u = mp.sqrt(w)
    sn, cn, dn = (mp.ellipfun(name, u, m=m) for name in ("sn", "cn", "dn"))
    epsilon = mp.quad(lambda t: mp.ellipfun("dn", t * u, m=m) ** 2, mp.linspace(0, 1, 5))
    return [mp.re(v) for v in (sn / u, cn, dn, epsilon)]


ARGUMENTS = [(1e-12, 0.5), (1e-3, 0.3), (0.7, 0.0), (1.9, 0.5), (6.8, 0.5), (6.8, 0.05), (16.0, 0.4), (100.0, 0.5)]


@pytest.mark.parametrize(("w", "m"), [*ARGUMENTS, (-1e-6, 0.5), (-0.5, 0.2)])
def test_values(w, m):
    np.testing.assert_allclose(jacobi(w, m), np.array(exact(w, m), float), atol=ROUNDING)


def test_the_limit_of_a_vanishing_argument():
    np.testing.assert_array_equal(jacobi(0.0, 0.3), np.ones(4))
    by_w = np.array(jax.jacfwd(jacobi)(jnp.asarray(0.0), 0.3))
    # sn(u)/u = 1 - (1 + m) w/6, cn = 1 - w/2, dn = 1 - m w/2, eps(u)/u = 1 - m w/3.
    np.testing.assert_allclose(by_w, [-1.3 / 6, -0.5, -0.15, -0.1], atol=ROUNDING)


@pytest.mark.parametrize(("w", "m"), [(0.01, 0.4), (1.9, 0.5), (6.8, 0.2)])
def test_derivatives(w, m):
    at = jnp.asarray(w), jnp.asarray(m)
    h = mp.mpf(10) ** -12
    first, second = (jax.jit(f)(*at) for f in (jax.jacrev(jacobi, (0, 1)), jax.hessian(jacobi, (0, 1))))

    def difference(k, at):
        step = [h * (i == k) for i in (0, 1)]
        ahead, behind = (exact(at[0] + s * step[0], at[1] + s * step[1]) for s in (1, -1))
        return [(x - y) / (2 * h) for x, y in zip(ahead, behind, strict=True)]

    at = mp.mpf(w), mp.mpf(m)
    for k in (0, 1):
        np.testing.assert_allclose([f[k] for f in first], np.array(difference(k, at), float), atol=FIRST)
        ahead, behind = (difference(0, [v + s * h * (i == k) for i, v in enumerate(at)]) for s in (1, -1))
        curved = np.array([(x - y) / (2 * h) for x, y in zip(ahead, behind, strict=True)], float)
        np.testing.assert_allclose([f[0][k] for f in second], curved, atol=SECOND)
