"""Fit a sphere or an ellipsoid to points in space and the directions of forces there: the surface and its errors."""

from collections.abc import Sequence
from itertools import permutations, product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.rotation import rotation_matrix
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._inverse.fit_profile import LEAST, OUTLIER, PADDED, SIGNIFICANCE
from jaxwhisker._inverse.points import PointStatus, SpaceReconstruction
from jaxwhisker._inverse.statistics import FitStatus, chi_squared, is_plausible, judged
from jaxwhisker._model.quadrics import Ellipsoid, Sphere
from jaxwhisker._model.surface import AbstractSurface, Point

FAMILIES: dict[type, tuple[str, ...]] = {
    Sphere: ("radius", "x", "y", "z"),
    Ellipsoid: ("a", "b", "c", "x", "y", "z", "rotation_x", "rotation_y", "rotation_z"),
}
GAUSS_NEWTON_STEPS = 50
SMALLEST, LONGEST = 1e-10, 0.5  # of a step: the last one, and the largest change of a log, a length or an angle
FLATTEST = 0.02  # of the mean: least eigenvalue of the matrix of a first ellipsoid
POSITION_AND_FORCE = np.array([0, 1, 2, 4, 5, 6])  # in the covariance of a point

Matrix = Float[Array, "3 3"]


class SurfaceFit(eqx.Module):
    """A surface fitted to points in space.

    Standard errors follow from the covariances of the points, or, without any, from the scatter of the points about the
    surface. They are NaN where the status is not ok: `implausible` if the covariances do not explain the distances of
    the points from the surface, `undetermined` if the points do not determine all parameters, or `not_converged`.
    """

    surface: AbstractSurface  # a Sphere, or an Ellipsoid that is rotated
    # Half axes a, b and c, or the radius; the centre x, y and z; the rotation vector of an ellipsoid, rad.
    estimates: dict[str, float]
    standard_error: dict[str, float]
    covariance: Float[np.ndarray, "p p"]  # of the estimates, in their order
    chi2: float  # sum of squares of the whitened residuals
    degrees_of_freedom: int = eqx.field(static=True)
    status: FitStatus = eqx.field(static=True)

    def band(self, normals: Any) -> tuple[np.ndarray, np.ndarray]:
        """Points of the surface with these outward normals, and their standard errors along the normals.

        Args:
            normals: directions, (n, 3), of any length but zero.

        Returns:
            Points, (n, 3), and errors, (n,), lengths. Errors are NaN where the status is not ok.

        Raises:
            ValueError: if `normals` is not an array of this shape.
        """
        checks.rows("normals", normals, columns=3)
        directions = np.asarray(checks.unmasked(normals), dtype=float)
        kind = Sphere if len(self.estimates) == len(FAMILIES[Sphere]) else Ellipsoid
        estimates = jnp.asarray(list(self.estimates.values()))
        _, by, points = map(np.asarray, _support(kind, estimates, jnp.asarray(directions)))
        variance = np.einsum("ip,pq,iq->i", by, np.nan_to_num(self.covariance), by)
        return points, np.where(np.isfinite(self.covariance).all(), np.sqrt(np.maximum(variance, 0.0)), np.nan)

    def __str__(self) -> str:
        lines = [f"{self.surface}: chi^2 = {self.chi2:.4g} with {self.degrees_of_freedom} degrees of freedom"]
        lines += [f"status: {self.status.name}, standard errors are unknown"] * (self.status != FitStatus.ok)
        width = max(map(len, self.estimates))
        for name, value in self.estimates.items():
            error = self.standard_error[name]
            lines.append(f"  {name:<{width}}  {value:< 14.8g}" + f" +- {error:.2g}" * bool(np.isfinite(error)))
        return "\n".join(lines)

    __repr__ = __str__


@with_own_settings
def fit_surface(points: Any, family: type[AbstractSurface] | None, normals: bool) -> SurfaceFit:
    """Fit a surface of one family to points in space; see `fit_contour`.

    The residuals of a point are its distance from the surface and, with normals, the two components along the surface
    of the direction of its force. The covariance of position and force whitens them.
    """
    checks.float64_mode()
    if family is None or family not in FAMILIES:
        checks.fail("family", "Sphere or Ellipsoid", repr(family))
    checks.instance("normals", normals, bool, "True or False")
    observed, middle, size = _read_points(points, normals)
    names, count = FAMILIES[family], observed.position.shape[0]
    degrees = count * (3 if normals else 1) - len(names)
    if degrees < 0:
        raise ValueError(f"`measured` must hold enough points for {len(names)} parameters, got {count}.")
    values, residual, gradient = _fitted(family, _start(observed, family), observed.padded())
    chi2 = chi_squared(residual)
    status, covariance = judged(residual, gradient)
    if observed.covariance is None:
        covariance = covariance * (chi2 / degrees if degrees else np.nan)
    elif np.isfinite(chi2) and not is_plausible(chi2, degrees):
        status, covariance = FitStatus.implausible, np.full_like(covariance, np.nan)
    lengths = names.index("x")
    estimates, rates = values.copy(), np.ones(values.size)
    estimates[:lengths] = rates[:lengths] = size * np.exp(values[:lengths])
    estimates[lengths : lengths + 3] = middle + size * values[lengths : lengths + 3]
    rates[lengths : lengths + 3] = size
    covariance = covariance * np.outer(rates, rates)
    return SurfaceFit(
        surface=_surface(family, estimates.tolist()),
        estimates=dict(zip(names, estimates.tolist(), strict=True)),
        standard_error=dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance=covariance,
        chi2=chi2 if observed.covariance is not None else chi2 * size**2,
        degrees_of_freedom=degrees,
        status=status,
    )


def _fitted(family: type, values: np.ndarray, observed: "_SurfacePoints") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values at the minimum, residuals and their derivatives: Gauss-Newton steps, with new weights at each of them."""
    for _ in range(GAUSS_NEWTON_STEPS):
        residual, gradient = map(np.asarray, _linearised(family, jnp.asarray(values), observed))
        residual, gradient = residual.ravel(), gradient.reshape(-1, values.size)
        if not (np.isfinite(residual).all() and np.isfinite(gradient).all()):
            break
        step, *_ = np.linalg.lstsq(gradient, -residual, rcond=None)
        if np.max(np.abs(step)) < SMALLEST:
            break
        values = values + step * min(1.0, LONGEST / np.max(np.abs(step)))
    return values, residual, gradient


class _SurfacePoints(eqx.Module):
    """Points of an object relative to their middle, in units of their size."""

    position: Float[Array, "points 3"] | Float[np.ndarray, "points 3"]
    direction: Float[Array, "points 3"] | Float[np.ndarray, "points 3"]  # of the forces
    covariance: Float[Array, "points 6 6"] | Float[np.ndarray, "points 6 6"] | None  # of position and direction
    weight: Float[Array, " points"] | Float[np.ndarray, " points"]  # 0 for padding
    has_normals: bool = eqx.field(static=True)

    def padded(self) -> "_SurfacePoints":
        room = [(0, -self.weight.size % PADDED)]
        padded = jax.tree.map(lambda v: np.pad(v, room + [(0, 0)] * (v.ndim - 1), mode="edge"), self)
        return eqx.tree_at(lambda points: points.weight, padded, np.pad(self.weight, room))


def _read_points(points: Any, normals: bool) -> tuple[_SurfacePoints, np.ndarray, float]:
    """Significant points, their middle and their size."""
    every = list(points) if isinstance(points, Sequence) else [points]
    if not every:
        checks.fail("measured", _ALLOWED, "an empty list")
    for one in every:
        if not isinstance(one, SpaceReconstruction):
            checks.fail("measured", _ALLOWED, f"a {type(one).__name__}")
    status, significance = (np.concatenate([np.ravel(getattr(one, n)) for one in every]) for n in _JUDGED)
    position, force = (np.concatenate([np.reshape(getattr(one, n), (-1, 3)) for one in every]) for n in _VECTORS)
    noise = np.concatenate([np.reshape(one.covariance, (-1, 7, 7)) for one in every])
    noise = noise[:, POSITION_AND_FORCE[:, None], POSITION_AND_FORCE]
    known = (status == PointStatus.ok) & ~(significance < SIGNIFICANCE)
    certain = known & np.isfinite(noise).all(axis=(1, 2))
    known = certain if certain.any() else known
    if not known.any():
        raise ValueError("`measured` must hold significant points, got none.")
    position, force, noise = position[known], force[known], noise[known]
    middle = position.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum((position - middle) ** 2, axis=1)))) or 1.0
    strength = np.linalg.norm(force, axis=1)
    direction = force / strength[:, None]
    by = np.zeros((len(force), 6, 6))  # of scaled position and direction with respect to position and force
    by[:, :3, :3] = np.eye(3) / size
    by[:, 3:, 3:] = (np.eye(3) - direction[:, :, None] * direction[:, None, :]) / strength[:, None, None]
    scaled = by @ noise @ by.transpose(0, 2, 1) if certain.any() else None
    return _SurfacePoints((position - middle) / size, direction, scaled, np.ones(len(force)), normals), middle, size


_ALLOWED = "the result of jw.reconstruct in space, or a list of such results"
_JUDGED, _VECTORS = ("status", "significance"), ("point", "force")


def _start(observed: _SurfacePoints, family: type) -> Float[np.ndarray, " p"]:
    """Values to start from: x.A x + b.x + c = 0 and tangents.(2 A x + b) = 0 by linear least squares, trace A = 3."""
    x, n = np.asarray(observed.position), np.asarray(observed.direction)
    one, zero = np.ones((len(x), 1)), np.zeros((len(x), 3, 1))
    bends = np.zeros((0, 3, 3)) if family is Sphere else np.array(_TRACELESS)
    turned = np.einsum("mij,pj->pim", bends, x)  # M x of each matrix M
    rows = [np.concatenate([np.einsum("pi,pim->pm", x, turned), x, one], axis=1)]
    right = [-np.sum(x**2, axis=1)]
    if observed.has_normals:
        across = np.eye(3) - n[:, :, None] * n[:, None, :]
        gradient = np.concatenate([2 * turned, np.broadcast_to(np.eye(3), (len(x), 3, 3)), zero], axis=2)
        rows.append((across @ gradient).reshape(-1, gradient.shape[2]))
        right.append(-2 * (across @ x[:, :, None]).ravel())
    found, *_ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)
    matrix = np.eye(3) + np.einsum("m,mij->ij", found[:-4], bends)
    eigenvalues, axes = np.linalg.eigh(matrix)
    eigenvalues = np.maximum(eigenvalues, FLATTEST)
    centre = -axes @ (axes.T @ found[-4:-1] / eigenvalues) / 2
    square = centre @ (axes * eigenvalues) @ axes.T @ centre - found[-1]
    half_axes = np.sqrt(max(square, FLATTEST) / eigenvalues)
    if family is Sphere:
        return np.r_[np.log(half_axes[:1]), centre]
    order, signs = max(
        product(permutations(range(3)), product((1, -1), repeat=3)), key=lambda one: _nearness(axes, *one)
    )
    return np.r_[np.log(half_axes[list(order)]), centre, _rotation_vector(axes[:, order] * signs)]


_TRACELESS = (
    [[1, 0, 0], [0, -1, 0], [0, 0, 0]],
    [[0, 0, 0], [0, 1, 0], [0, 0, -1]],
    [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
    [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
    [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
)


def _nearness(axes: np.ndarray, order: Sequence[int], signs: Sequence[int]) -> float:
    """How close a choice of axes is to those of the scene; reflections are excluded."""
    chosen = axes[:, order] * signs
    return float(np.trace(chosen)) if np.linalg.det(chosen) > 0 else -np.inf


def _rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle of a rotation by less than two right angles."""
    sine = (
        np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
        / 2
    )
    size = float(np.linalg.norm(sine))
    return sine * (np.arctan2(size, (np.trace(rotation) - 1) / 2) / size if size > 0 else 1.0)


def _surface(family: type, numbers: Any) -> AbstractSurface:
    """The surface with these half axes or radius, centre and rotation."""
    if family is Sphere:
        radius, *centre = numbers
        return Sphere(radius, tuple(centre))
    a, b, c, x, y, z, *rotation = numbers
    return Ellipsoid((a, b, c), (x, y, z)).rotated(tuple(rotation))


def _of_values(family: type, values: Float[Array, " p"]) -> AbstractSurface:
    lengths = FAMILIES[family].index("x")
    return _surface(family, [*jnp.exp(values[:lengths]), *values[lengths:]])


def _foot(surface: AbstractSurface, x: Point) -> Point:
    """The point of the surface nearest to x, to second order in the distance."""
    return x - surface.off(x) * surface.normal(x)


def _tangents(normal: Point) -> Float[Array, "2 3"]:
    """Two perpendicular directions along the surface."""
    one = jnp.cross(normal, jnp.eye(3)[jnp.argmin(jnp.abs(normal))])
    one = one / jnp.sqrt(jnp.sum(one**2))
    return jnp.stack([one, jnp.cross(normal, one)])


def _residuals(family: type, values, observed: _SurfacePoints, weights) -> Float[Array, "points 3"]:
    """Residuals of every point, whitened: its distance from the surface, and the direction of its force."""
    surface = _of_values(family, values)

    def one(x, direction, noise, weights):
        foot = _foot(surface, x)
        normal = surface.normal(foot)
        off = surface.off(foot) + jnp.sum((x - foot) * normal)
        if noise is not None:
            # Errors along a convex surface lead out of it: their mean is subtracted.
            tangents = _tangents(normal)
            bend = tangents @ surface.curvature(foot) @ tangents.T
            off = off - jax.lax.stop_gradient(jnp.sum(bend * (tangents @ noise[:3, :3] @ tangents.T)) / 2)
        along = _tangents(jax.lax.stop_gradient(normal)) @ (direction - normal)
        return weights @ jnp.concatenate([off[None], along])

    residuals = jax.vmap(one)(observed.position, observed.direction, observed.covariance, weights)
    return residuals * observed.weight[:, None]


def _weights(family: type, values, observed: _SurfacePoints) -> Float[Array, "points 3 3"]:
    """Lower triangular matrices that whiten the residuals, smaller for outliers (Huber)."""
    surface = _of_values(family, values)
    used = jnp.array([1.0, *[float(observed.has_normals)] * 2])

    def one(x, noise):
        foot = _foot(surface, x)
        normal, bend = surface.normal(foot), surface.curvature(foot)
        tangents = _tangents(normal)
        if noise is None:
            radius = 2 / jnp.sum(tangents * (tangents @ bend))
            return jnp.diag(jnp.stack([jnp.ones(()), radius, radius]))
        off = jnp.concatenate([normal, jnp.zeros(3)])[None]
        turn = -tangents @ bend @ tangents.T @ tangents  # the foot does not move with a point along the normal
        by = jnp.concatenate([off, jnp.concatenate([turn, tangents], axis=1)])
        return _whitening(by @ noise @ by.T)

    weights = jax.vmap(one)(observed.position, observed.covariance) * used[:, None]
    if observed.covariance is None:
        return weights
    size = jnp.sqrt(jnp.sum(_residuals(family, values, observed, weights) ** 2, axis=-1))
    share = jnp.sqrt(jnp.minimum(1.0, OUTLIER / jnp.maximum(size, OUTLIER)))
    return weights * share[:, None, None]


def _whitening(covariance: Matrix) -> Matrix:
    """The inverse of the Cholesky factor, row by row; parts that others determine keep a small variance."""
    rows: list[Float[Array, 3]] = []
    for k in range(3):
        row = jnp.eye(3)[k]
        for other in rows:  # which have unit variance and are uncorrelated
            row = row - jnp.sum(covariance[k] * other) * other
        variance = row @ covariance @ row
        rows.append(row / jnp.sqrt(jnp.maximum(variance, LEAST * covariance[k, k] + 1e-300)))
    return jnp.stack(rows)


@Program
def _linearised(family: type, values, observed: _SurfacePoints):
    """Whitened residuals, and their derivatives with respect to the values at constant weights."""
    weights = _weights(family, values, observed)

    def residuals(values):
        return _residuals(family, values, observed, weights)

    return residuals(values), jax.jacfwd(residuals)(values)


@Program
def _support(family: type, estimates, directions: Float[Array, "n 3"]):
    """The support function of a surface, its derivatives with respect to the estimates, and the points it supports."""

    def support(estimates, direction):
        normal = direction / jnp.sqrt(jnp.sum(direction**2))
        lengths = FAMILIES[family].index("x")
        half_axes, centre = estimates[:lengths], estimates[lengths : lengths + 3]
        turn = rotation_matrix(estimates[lengths + 3 :]) if family is Ellipsoid else jnp.eye(3)
        inwards = half_axes * (normal @ turn)
        size = jnp.sqrt(jnp.sum(inwards**2))
        return normal @ centre + size, centre + turn @ (half_axes * inwards) / size

    def at(direction):
        by, _ = jax.jacfwd(support, has_aux=True)(estimates, direction)
        return *support(estimates, direction)[:1], by, support(estimates, direction)[1]

    return jax.vmap(at)(directions)
