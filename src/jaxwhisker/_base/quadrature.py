"""Gauss points and Legendre polynomials on the interval from 0 to 1."""

import numpy as np
from jaxtyping import Array, Float


def gauss(count: int) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """Points and weights (Golub and Welsch 1969). numpy.polynomial would have to be loaded with the package."""
    k = np.arange(1, count)
    at, vectors = np.linalg.eigh(np.diag(k / np.sqrt(4.0 * k**2 - 1), -1))
    return (at + 1) / 2, vectors[0] ** 2


def legendre(s: Array | np.ndarray, count: int) -> list:
    """The first Legendre polynomials at s, each with the values -1 or 1 at 0 and 1 at 1."""
    x = 2 * s - 1
    values = [1.0 + 0.0 * x, x]
    for n in range(1, count - 1):
        values.append(((2 * n + 1) * x * values[n] - n * values[n - 1]) / (n + 1))
    return values[:count]


def legendre_integrals(s: Array | np.ndarray, count: int) -> list:
    """Integrals from 0 to s of the first Legendre polynomials."""
    values = legendre(s, count + 1)
    return [s, *((values[n + 1] - values[n - 1]) / (4 * n + 2) for n in range(1, count))]
