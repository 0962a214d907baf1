"""Shape functions of a moving whisker: integrals of Legendre polynomials, and quadrature along the whisker.

The curvature is a sum of Legendre polynomials P_k of the arc length, the angle a sum of their integrals from the base.
Cosine and sine of the angle are known at Gauss points; positions are the integrals of their interpolating polynomials.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar

EXTRA_POINTS = 4  # Gauss points in excess of the shape functions: cos and sin of the angle are not polynomials


class Basis(NamedTuple):
    """Matrices for a number of shape functions, on a whisker of length 1; the nodes are base, Gauss points, tip."""

    points: np.ndarray  # (points,), arc lengths of the Gauss points
    weights: np.ndarray  # (points,)
    curvatures: np.ndarray  # (points, n), Legendre polynomials at the Gauss points
    angles: np.ndarray  # (points, n), their integrals from the base
    reach: np.ndarray  # (nodes, points): integrals from the base to the nodes of what is known at the Gauss points
    interpolation: np.ndarray  # (points, points), from values at the Gauss points to coefficients of Legendre polynomials


def basis(n: int) -> Basis:
    """The basis of n shape functions."""
    count = n + EXTRA_POINTS
    points, weights = np.polynomial.legendre.leggauss(count)
    points, weights = (points + 1) / 2, weights / 2
    values, integrals = (np.stack(each, axis=-1) for each in _polynomials(points, count))
    interpolation = np.linalg.inv(values)
    inner = integrals @ interpolation
    reach = np.concatenate([np.zeros((1, count)), inner, weights[None]])
    return Basis(points, weights, values[:, :n], integrals[:, :n], reach, interpolation)


def weights_at(basis: Basis, s: Scalar) -> tuple[Float[Array, " points"], Float[Array, " points"]]:
    """Weights that interpolate values at the Gauss points at the arc length s, and that integrate them up to there."""
    values, integrals = (jnp.stack(each) for each in _polynomials(s, basis.points.size))
    return values @ basis.interpolation, integrals @ basis.interpolation


def polynomials_at(s: Scalar, n: int) -> Float[Array, " n"]:
    """The first n Legendre polynomials at the arc length s."""
    return jnp.stack(_polynomials(s, n)[0])


def _polynomials(s, count: int) -> tuple[list, list]:
    """The first Legendre polynomials on [0, 1], and their integrals from 0."""
    x = 2 * s - 1
    values = [x * 0 + 1, x]
    for k in range(1, count):
        values.append(((2 * k + 1) * x * values[k] - k * values[k - 1]) / (k + 1))
    integrals = [s, *((values[k + 1] - values[k - 1]) / (2 * (2 * k + 1)) for k in range(1, count))]
    return values[:count], integrals[:count]
