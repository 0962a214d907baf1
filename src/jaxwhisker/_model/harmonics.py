"""Smooth surfaces through points: measured ones, or those of a mesh.

The distance of the surface from a point inside is a sum of spherical harmonics of the direction. It is evaluated as a
sum of zonal ones, polynomials of the cosine of the angle from fixed directions, because their derivatives are simple.
"""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import legendre
from scipy.linalg import lstsq

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar, Triple, Vector
from jaxwhisker._model.along import as_vector
from jaxwhisker._model.surface import AbstractDescribed, AbstractSurface, Point, as_point, triple_text

SMOOTHING = 1e-10  # of squared second derivatives on the sphere: decides where there are no points, and nowhere else
MOST_DEGREE = 16  # the polynomials lose four digits there
DIRECTIONS = 2000  # at which a fitted surface is checked
ROUNDING = 1e-9  # of curvature, over the size of the object
LATTICE = 3  # points on a face between two zeros of a harmonic


class SphericalHarmonics(AbstractDescribed):
    """Surface r = sum of coefficients times spherical harmonics of the direction, of a strictly convex object.

    The harmonics are real and have a mean square of 1 over all directions: the first coefficient is the mean distance.
    They are ordered by degree, and within a degree l from m = -l (sines) to l (cosines of m times the angle about z).

    Args:
        coefficients: (degree + 1)^2 lengths.
        inside: (x, y, z) of the point from which distances are measured, lengths.
        error: root mean square distance of the points to which the surface was fitted, a length. Default: unknown.
        largest_error: the largest of these distances.

    Raises:
        ValueError: if the number of coefficients is not a square, at most 289, or a value is not a finite number.

    Examples:
        >>> ball = jw.SphericalHarmonics([0.5, 0.0, 0.0, 0.0], inside=(0.0, 1.0, 0.0))
        >>> print(f"{ball.off(jnp.array([0.0, 0.4, 0.0])):.3f}")
        0.100

    Source: geodesy's full normalisation and recursions, Holmes and Featherstone (2002), Journal of Geodesy 76, 279.
    """

    coefficients: Float[Array, " n"] = eqx.field(converter=lambda values: as_vector("coefficients", values))
    inside: Triple = eqx.field(converter=checks.as_tuple)
    error: Scalar | None = None
    largest_error: Scalar | None = None

    def __check_init__(self):
        checks.triple("inside", self.inside)
        count = np.size(self.coefficients)
        if (self.degree + 1) ** 2 != count or self.degree > MOST_DEGREE:
            checks.fail("coefficients", f"(degree + 1)^2 numbers, of a degree up to {MOST_DEGREE}", f"{count} of them")
        if not checks.is_traced(self.coefficients) and not self.coefficients[0] > 0:
            checks.fail("coefficients", "positive at first, which is the mean distance", f"{self.coefficients[0]:g}")

    @property
    def degree(self) -> int:
        """The largest degree l of a harmonic."""
        return round(np.sqrt(np.size(self.coefficients))) - 1

    @classmethod
    def from_points(cls, points: Any, degree: int = 8, inside: Vector | None = None) -> "SphericalHarmonics":
        """The surface through points on an object, in the sense of least squares.

        Noise and details smaller than about pi / degree of the size are smoothed. `error` and `largest_error` tell how
        far the points are from the surface.

        Args:
            points: (n, 3), lengths, on all sides of the object; at least (degree + 1)^2 of them.
            degree: largest degree of a harmonic, from 2 to 16. A sphere needs 0, an ellipsoid of axes 2 : 1 a degree of
                10 for 1e-3 of its size.
            inside: (x, y, z) of a point inside. Default: the mean of the points.

        Raises:
            ValueError: if an argument is not of this kind, or the fitted surface is not strictly convex. Then a lower
                degree may be, or the object is not, and a whisker would touch it in two places.

        Examples:
            >>> directions = np.random.default_rng(0).normal(size=(400, 3))
            >>> ball = np.array([0.0, 1.2, 0.0]) + 0.5 * directions / np.linalg.norm(directions, axis=1)[:, None]
            >>> stone = jw.SphericalHarmonics.from_points(ball, degree=4)
            >>> print(stone.error < 1e-9)
            True
        """
        points = np.asarray(points, dtype=float)
        if not isinstance(degree, int) or not 2 <= degree <= MOST_DEGREE:
            checks.fail("degree", f"an int from 2 to {MOST_DEGREE}", degree)
        if points.ndim != 2 or points.shape[1] != 3 or not np.all(np.isfinite(points)):
            checks.fail("points", "finite numbers of shape (n, 3)", f"an array of shape {points.shape}")
        if len(points) < (degree + 1) ** 2:
            checks.fail("points", f"at least {(degree + 1) ** 2} for a degree of {degree}", f"{len(points)} of them")
        centre = points.mean(axis=0) if inside is None else np.asarray(inside, dtype=float)
        checks.triple("inside", tuple(centre))
        away = points - centre
        size = np.linalg.norm(away, axis=1)
        if np.min(size) == 0:
            checks.fail("inside", "none of the points", triple_text(checks.as_tuple(centre)))
        rows = _harmonics(degree, away / size[:, None])
        bend = np.repeat(np.arange(degree + 1) * np.arange(1, degree + 2), 2 * np.arange(degree + 1) + 1)
        smooth = np.sqrt(SMOOTHING * len(points)) * np.diag(bend)
        coefficients: Any = lstsq(np.vstack([rows, smooth]), np.append(size, np.zeros(bend.size)))
        coefficients = coefficients[0]
        found = cls(coefficients, tuple(map(float, centre)))
        form = found.form()
        off = np.asarray(_off(form, jnp.asarray(points)))
        bent = float(_least_curvature(form))
        if not bent * coefficients[0] > ROUNDING:
            raise ValueError(
                f"`points` must lie on a strictly convex object: fitted with a degree of {degree}, the least curvature "
                f"is {bent:.3g}, and the points are {np.sqrt(np.mean(off**2)):.3g} off in the root mean square. A "
                "lower degree is smoother."
            )
        return cls(coefficients, found.inside, float(np.sqrt(np.mean(off**2))), float(np.max(np.abs(off))))

    @classmethod
    def from_mesh(cls, vertices: Any, faces: Any, degree: int = 8) -> "SphericalHarmonics":
        """The surface through a closed mesh of triangles, as other libraries read it from a CAD file.

        Vertices are points of the surface, and so are points on large faces. Edges are rounded.

        Args:
            vertices: (n, 3), lengths.
            faces: (m, 3), the numbers of the vertices of each triangle, counter-clockwise seen from outside.
            degree: as for `from_points`.

        Raises:
            ValueError: as `from_points`, or if the mesh encloses no volume.
        """
        vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.all(np.isfinite(vertices)):
            checks.fail("vertices", "finite numbers of shape (n, 3)", f"an array of shape {vertices.shape}")
        whole = np.issubdtype(faces.dtype, np.integer) and faces.ndim == 2 and faces.shape[1] == 3
        if not whole or not np.all((faces >= 0) & (faces < len(vertices))):
            checks.fail("faces", f"integers from 0 to {len(vertices) - 1} of shape (m, 3)", f"shape {faces.shape}")
        corners = vertices[faces]
        start = vertices.mean(axis=0)
        volumes = np.linalg.det(corners - start) / 6
        if not np.sum(volumes) > 0:
            checks.fail(
                "faces", "counter-clockwise from outside, around a volume", f"a volume of {np.sum(volumes):.3g}"
            )
        inside = start + volumes @ (corners - start).sum(axis=1) / 4 / np.sum(volumes)
        spacing = np.pi * np.cbrt(np.sum(volumes)) / (LATTICE * degree)
        longest = np.max(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
        points = [vertices[np.unique(faces)]]
        for corner, parts in zip(corners, np.ceil(longest / spacing).astype(int), strict=True):
            i, j = np.meshgrid(np.arange(parts + 1), np.arange(parts + 1))
            shares = np.stack([i, j, parts - i - j], axis=-1).reshape(-1, 3)
            inner = np.all(shares >= 0, axis=1) & np.all(shares < parts, axis=1)
            points.append(shares[inner] / parts @ corner)
        return cls.from_points(np.concatenate(points), degree, inside)

    def form(self):
        to_weights = jnp.asarray(_to_weights(self.degree))
        weights = jnp.sum(to_weights * jnp.asarray(self.coefficients, dtype=float), axis=1)
        return Zonal(weights, as_point(self.inside), self.degree)

    def _positive(self):
        return [self.thickness()]

    def __str__(self):
        return f"surface of spherical harmonics up to degree {self.degree} about {triple_text(self.inside)}"


class Zonal(AbstractSurface):
    """The surface whose distance from a point inside is a sum of zonal harmonics."""

    weights: Float[Array, " directions"]  # lengths
    inside: Point
    degree: int = eqx.field(static=True)

    def _around(self, direction: Point) -> tuple[Float[Array, ""], Point, Float[Array, "3 3"]]:
        """The sum in the direction of a unit vector, with its first and second derivatives by the vector."""
        at, kernel = jnp.asarray(_directions(_nodes(self.degree))), _kernel(self.degree)
        cosine = jnp.sum(at * direction, axis=1)
        first, second = kernel.deriv(), kernel.deriv(2)
        value, slope, bend = (
            self.weights * jnp.polyval(jnp.asarray(p.coef[::-1]), cosine) for p in (kernel, first, second)
        )
        return jnp.sum(value), jnp.sum(slope[:, None] * at, axis=0), at.T @ (bend[:, None] * at)

    def _seen(self, x: Point) -> tuple[Float[Array, ""], Point]:
        """Distance of a point from the one inside, and its direction."""
        away = x - self.inside
        away = jnp.where(jnp.all(away == 0), jnp.array([1e-9, 0.0, 0.0]), away)
        size = jnp.sqrt(jnp.sum(away**2))
        return size, away / size

    def distance(self, direction: Point) -> Float[Array, ""]:
        """Distance of the surface from the point inside, in the direction of a unit vector."""
        return self._around(direction)[0]

    def level(self, x):
        size, out = self._seen(x)
        return size - self.distance(out)

    def gradient(self, x):
        size, out = self._seen(x)
        _, slope, _ = self._around(out)
        return out - (slope - jnp.sum(out * slope) * out) / size

    def hessian(self, x):
        size, out = self._seen(x)
        _, slope, bend = self._around(out)
        across = jnp.eye(3) - out[:, None] * out
        beside = jnp.sum(across * slope, axis=1)
        mixed = out[:, None] * beside
        turned = across @ bend @ across - jnp.sum(out * slope) * across - mixed - mixed.T
        return across / size - turned / size**2

    def plane_before(self, x):
        # The level is no convex function: the tangent plane in the direction of the point serves.
        _, out = self._seen(x)
        foot = self.inside + self.distance(out) * out
        normal = self.normal(foot)
        return jnp.sum(normal * (x - foot)), normal

    def in_unit(self, length):
        return Zonal(self.weights / length, self.inside / length, self.degree)

    def absorbed(self, turn, before, after):
        del turn, before, after
        return None

    def interior_point(self):
        return self.inside

    def thickness(self):
        return jnp.min(jax.vmap(self.distance)(jnp.asarray(_directions(_nodes(self.degree)))))

    def _positive(self):
        return [self.thickness()]

    def __str__(self):
        return "zonal harmonics"


def _nodes(degree: int) -> int:
    """Number of directions of zonal harmonics: more than enough for all harmonics up to a degree."""
    return 2 * (degree + 1) ** 2


@functools.cache
def _kernel(degree: int) -> np.polynomial.Polynomial:
    """The sum of (2 l + 1) P_l of the cosine between two directions: that of products of harmonics in both."""
    return np.polynomial.Polynomial(legendre.leg2poly(2 * np.arange(degree + 1) + 1.0))


@functools.cache
def _to_weights(degree: int) -> np.ndarray:
    """The matrix from coefficients of harmonics to weights of zonal ones, with the same sum."""
    return np.linalg.pinv(_harmonics(degree, _directions(_nodes(degree)))).T


def _harmonics(degree: int, directions: np.ndarray) -> np.ndarray:
    """All real spherical harmonics up to a degree, with a mean square of 1, in directions (n, 3), unit vectors."""
    x, y, z = directions.T
    about = (x + 1j * y)[:, None] ** np.arange(degree + 1)
    # Of the functions of z, those with m = l are constant, and others follow from the two degrees before.
    by_z: dict[tuple[int, int], Any] = {(0, 0): np.ones_like(z)}
    zero = np.zeros_like(z)
    for l in range(1, degree + 1):  # noqa: E741
        for m in range(l):
            a = np.sqrt((2 * l - 1) * (2 * l + 1) / ((l - m) * (l + m)))
            b = np.sqrt((2 * l + 1) * (l + m - 1) * (l - m - 1) / (max(2 * l - 3, 1) * (l - m) * (l + m)))
            by_z[l, m] = a * z * by_z[l - 1, m] - b * by_z.get((l - 2, m), zero)
        by_z[l, l] = np.sqrt((2 * l + 1) / (2 * l) * (2 if l == 1 else 1)) * by_z[l - 1, l - 1]
    turned = {m: about[:, m].real if m >= 0 else about[:, -m].imag for m in range(-degree, degree + 1)}
    order = [(n, m) for n in range(degree + 1) for m in range(-n, n + 1)]
    return np.stack([by_z[n, abs(m)] * turned[m] for n, m in order], axis=1)


@eqx.filter_jit
def _off(surface: AbstractSurface, points: Float[Array, "n 3"]) -> Float[Array, " n"]:
    return jax.vmap(surface.off)(points)


@eqx.filter_jit
def _least_curvature(surface: Zonal) -> Float[Array, ""]:
    """The least normal curvature of a surface, 1/length, in many directions."""

    def least(out):
        x = surface.inside + surface.distance(out) * out
        normal = surface.normal(x)
        flat = jnp.eye(3) - normal[:, None] * normal
        along = flat @ surface.curvature(x) @ flat
        # Two of three eigenvalues are curvatures, from their sum and product.
        mean, product = jnp.trace(along) / 2, (jnp.trace(along) ** 2 - jnp.trace(along @ along)) / 2
        return mean - jnp.sqrt(jnp.maximum(mean**2 - product, 0.0))

    return jnp.min(jax.vmap(least)(jnp.asarray(_directions(DIRECTIONS))))


@functools.cache
def _directions(count: int) -> np.ndarray:
    """Directions that are spread evenly, on a Fibonacci spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
