"""Shape functions of a moving whisker: integrals of Legendre polynomials, and quadrature along the whisker.

The curvature is a sum of Legendre polynomials P_k of the arc length, the angle a sum of their integrals from the base.
Cosine and sine of the angle are known at Gauss points; positions are the integrals of their interpolating polynomials.
"""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.quadrature import gauss, legendre
from jaxwhisker._base.types import Scalar

EXTRA_POINTS = 4  # Gauss points in excess of the shape functions: cos and sin of the angle are not polynomials


class Basis(NamedTuple):
    """Matrices for a number of shape functions, on a whisker of length 1; the nodes are base, Gauss points, tip."""

    points: np.ndarray  # (points,), arc lengths of the Gauss points
    weights: np.ndarray  # (points,)
    curvatures: np.ndarray  # (points, n), Legendre polynomials at the Gauss points
    angles: np.ndarray  # (points, n), their integrals from the base
    reach: np.ndarray  # (nodes, points): integrals from the base to the nodes of what is known at the Gauss points
    interpolation: (
        np.ndarray
    )  # (points, points), from values at the Gauss points to coefficients of Legendre polynomials


@lru_cache(maxsize=32)
def basis(n: int) -> Basis:
    """The basis of n shape functions."""
    count = n + EXTRA_POINTS
    points, weights = gauss(count)
    every = np.stack(legendre(points, count + 1), axis=-1)
    values, integrals = every[:, :-1], every @ _integral(count).T
    interpolation = np.linalg.inv(values)
    inner = integrals @ interpolation
    reach = np.concatenate([np.zeros((1, count)), inner, weights[None]])
    return Basis(points, weights, values[:, :n], integrals[:, :n], reach, interpolation)


def weights_at(basis: Basis, s: Scalar) -> Float[Array, "2 points"]:
    """Weights that interpolate values at the Gauss points at the arc length s, and that integrate them up to there."""
    polynomials = _legendre(jnp.asarray(s, dtype=float), basis.points.size)
    return jnp.stack([polynomials[:-1], _integral(basis.points.size) @ polynomials]) @ basis.interpolation


def polynomials_at(s: Scalar, n: int) -> Float[Array, " n"]:
    """The first n Legendre polynomials on [0, 1] at the arc length s."""
    return _legendre(jnp.asarray(s, dtype=float), n - 1)


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def _legendre(s: Scalar, degree: int) -> Array:
    """The Legendre polynomials up to this degree."""
    return jnp.stack(legendre(jnp.asarray(s), degree + 1))


@_legendre.defjvp
def _(degree, primals, tangents):
    (s,), (change,) = primals, tangents
    values = _legendre(s, degree)
    return values, (_derivative(degree) @ values) * change


def sinc(x: Array) -> Array:
    """sin(x) / x; angles change by less than a radian in a step, and jnp.sinc compiles to a polynomial of its own."""
    square = x * x
    small = 1 - square / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72)))
    large = jnp.abs(x) > 0.1
    return jnp.where(large, jnp.sin(x) / jnp.where(large, x, 1.0), small)


def _derivative(degree: int) -> np.ndarray:
    """Derivatives of the polynomials up to this degree, in terms of these polynomials."""
    j, k = np.meshgrid(np.arange(degree + 1), np.arange(degree + 1))
    return np.where((j < k) & ((k - j) % 2 == 1), 2.0 * (2 * j + 1), 0.0)


def _integral(count: int) -> np.ndarray:
    """Integrals from 0 of the first polynomials, in terms of them and the next one."""
    matrix = np.zeros((count, count + 1))
    matrix[0, :2] = 1 / 2
    for k in range(1, count):
        matrix[k, k + 1], matrix[k, k - 1] = 1 / (2 * (2 * k + 1)), -1 / (2 * (2 * k + 1))
    return matrix
