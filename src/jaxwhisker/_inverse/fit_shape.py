"""Fits of shapes to points: the same for profiles in the plane and for surfaces in space.

A family of shapes says how its shapes follow from the values that are fitted, and how a point is compared with one of
them. Weights, the loop, errors and the status of a fit are those of this file.
"""

from abc import abstractmethod
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._inverse.least_squares import Evaluation, minimise
from jaxwhisker._inverse.statistics import FitStatus, chi_squared, is_plausible, judged

REWEIGHTINGS = 20  # fits in a row; weights depend on the shape, so each fit uses those of the previous one
LEAST_DECREASE = 1e-10  # of chi-squared, below which a fit ends: within 1e-5 standard errors of the minimum
EXACT = 1e-10  # of the largest coordinate: points without covariances scatter more than this
LEAST = 1e-12  # least share of a residual's variance that is independent of the residuals before it
SIGNIFICANCE = 40.0  # standard deviations: points with weaker signals are left out
OUTLIER = 3.0  # standard deviations from which a point is weighted less (Huber): a few contacts have the wrong phase
PADDED = 256  # points are padded to a multiple of it, so similar numbers of points share a compilation

Numbers = Array | np.ndarray


class ShapePoints(eqx.Module):
    """Points of an object."""

    position: Float[Numbers, "points dimensions"]
    direction: Float[Numbers, " points"] | Float[Numbers, "points 3"]  # slope angle, or force; any if unknown
    covariance: Float[Numbers, "points measured measured"] | None  # of position and direction
    weight: Float[Numbers, " points"]  # 0 for padding
    has_direction: bool = eqx.field(static=True)

    @property
    def residuals(self) -> int:
        """Number of residuals: distances and, with directions, the differences between these."""
        count, dimensions = self.position.shape
        return count * (dimensions if self.has_direction else 1)

    def padded(self) -> "ShapePoints":
        """As many points as programs are compiled for; those that are added have no weight."""
        room = [(0, -self.weight.size % PADDED)]
        padded = jax.tree.map(lambda v: np.pad(v, room + [(0, 0)] * (v.ndim - 1), mode="edge"), self)
        return eqx.tree_at(lambda points: points.weight, padded, np.pad(self.weight, room))


class Facet(NamedTuple):
    """A shape near a point: what the errors of the point do to its residuals."""

    radius: Scalar  # of curvature, which turns differences of directions into lengths
    along: Float[Array, "compared directed"]  # directions along the shape: components of a difference of directions
    by: Float[Array, "residuals measured"]  # derivatives of distance and components by position and direction
    bias: Scalar  # distance from the shape that follows in the mean from errors along it


class Whitening(NamedTuple):
    """Weights of points: whitened = matrix @ residuals - shift."""

    matrix: Float[Numbers, "points residuals directed+1"]
    shift: Float[Numbers, "points residuals"]


class AbstractShapeFamily(eqx.Module):
    """Shapes as functions of the values to fit."""

    names: tuple[str, ...] = eqx.field(static=True)  # of the estimates
    unit: Scalar | np.ndarray  # a length: the unit of positions

    @abstractmethod
    def shape(self, values: Float[Array, " p"]) -> Any:
        """The shape with these values."""

    @abstractmethod
    def facet(self, shape: Any, position: Any, covariance: Any) -> Facet:
        """The shape near a point."""

    @abstractmethod
    def residuals(self, shape: Any, position: Any, direction: Any) -> tuple[Any, Any, Any]:
        """Distance of a point from the shape, difference of directions, and direction of the shape at its foot."""

    @abstractmethod
    def supported(self, estimates: Float[Array, " p"], direction: Array) -> tuple[Scalar, Array]:
        """Support function, and point of a shape with this direction."""

    @abstractmethod
    def estimates(self, values: Float[np.ndarray, " p"]) -> tuple[np.ndarray, np.ndarray]:
        """Estimates in the units of the user, and their derivatives by the values, (estimates, p)."""


class AbstractShapeFit(eqx.Module):
    """Estimates of a shape's parameters, and their uncertainty."""

    estimates: dict[str, float]
    standard_error: dict[str, float]
    covariance: Float[np.ndarray, "p p"]  # of the estimates, in their order
    chi2: float  # sum of squares of the whitened residuals
    degrees_of_freedom: int = eqx.field(static=True)
    status: FitStatus = eqx.field(static=True)

    @property
    @abstractmethod
    def _shape(self) -> Any:
        """The shape."""

    def _across(self, by: Float[np.ndarray, "n p"]) -> Float[np.ndarray, " n"]:
        """First-order standard errors of positions along the normal, from their derivatives by the estimates."""
        variance = np.einsum("ip,pq,iq->i", by, np.nan_to_num(self.covariance), by)
        return np.where(np.isfinite(self.covariance).all(), np.sqrt(np.maximum(variance, 0.0)), np.nan)

    def __str__(self) -> str:
        lines = [f"{self._shape}: chi^2 = {self.chi2:.4g} with {self.degrees_of_freedom} degrees of freedom"]
        lines += [f"status: {self.status.name}, standard errors are unknown"] * (self.status != FitStatus.ok)
        width = max(map(len, self.estimates))
        for name, value in self.estimates.items():
            error = self.standard_error[name]
            lines.append(f"  {name:<{width}}  {value:< 14.8g}" + f" +- {error:.2g}" * bool(np.isfinite(error)))
        return "\n".join(lines)

    __repr__ = __str__


def fit_shape(
    family: AbstractShapeFamily, values: Float[np.ndarray, " p"], points: ShapePoints
) -> tuple[dict[str, Any], Float[np.ndarray, " points *direction"]]:
    """Fit a shape of a family to points, starting from these values.

    Without covariances, the scatter of the points about the shape is their noise.

    Returns:
        The fields of an AbstractShapeFit by name, and the directions of the shape at the points.
    """
    padded, known = points.padded(), points.covariance is not None
    degrees = points.residuals - values.size
    least = EXACT * (np.max(np.abs(points.position)) * family.unit or 1.0)

    def linearised(values: np.ndarray, whitening: Whitening | None, noise: float = 1.0) -> Evaluation:
        """Residuals for given weights, or for those that follow from the shape."""
        given = _no_whitening(padded) if whitening is None else whitening
        residual, jacobian, *others = _linearised(family, values, padded, given, np.asarray(whitening is None))
        residual, jacobian = np.asarray(residual).ravel(), np.asarray(jacobian).reshape(-1, values.size)
        return Evaluation(residual / noise, jacobian / noise, tuple(others))

    at = linearised(values, None)
    for _ in range(REWEIGHTINGS):
        noise = 1.0 if known else max(np.sqrt(chi_squared(at.residual) / max(degrees, 1)), least)
        whitening = at.compared[0]
        solution = minimise(partial(linearised, whitening=whitening, noise=noise), values, LEAST_DECREASE)
        if solution.steps == 1:  # this shape is a minimum with the weights that follow from it
            break
        values = solution.y
        at = linearised(values, None)
    chi2 = chi_squared(at.residual)
    status, covariance = judged(at.residual, at.jacobian)
    if not known:
        covariance = covariance * (chi2 / degrees if degrees else np.nan)
    elif np.isfinite(chi2) and not is_plausible(chi2, degrees):
        status, covariance = FitStatus.implausible, np.full_like(covariance, np.nan)
    estimates, rates = family.estimates(values)
    covariance = _carried_over(covariance, rates)
    fields = {
        "estimates": dict(zip(family.names, estimates.tolist(), strict=True)),
        "standard_error": dict(zip(family.names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        "covariance": covariance,
        "chi2": chi2,
        "degrees_of_freedom": degrees,
        "status": status,
    }
    return fields, np.asarray(at.compared[1])


def _carried_over(covariance: Float[np.ndarray, "p p"], rates: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n n"]:
    """The covariance of what depends on values at these rates; NaN only where it depends on unknown ones."""
    depends, unknown = (rates != 0).astype(int), (~np.isfinite(covariance)).astype(int)
    known = rates @ np.where(unknown, 0.0, covariance) @ rates.T
    return np.where(depends @ unknown @ depends.T, np.nan, known)


def supported_points(
    family: AbstractShapeFamily, estimates: Any, directions: Any
) -> tuple[Float[np.ndarray, "n dimensions"], Float[np.ndarray, "n p"]]:
    """Points of a shape with these directions, and the derivatives of their positions along the outward normal."""
    points, by = _supported(family, np.asarray(estimates, dtype=float), np.asarray(directions, dtype=float))
    return np.asarray(points), np.asarray(by)


def nearest_quadric(
    x: Float[np.ndarray, "points d"],
    normals: Float[np.ndarray, "points d"] | None = None,
    bends: Any = (),
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit a quadric by linear least squares: x.A x + b.x + c = 0 and tangents.(2 A x + b) = 0.

    Args:
        x: points.
        normals: at the points, unit vectors; optional.
        bends: matrices (d, d), of which A - 1 is a linear combination. Default: none, for circles and spheres.

    Returns:
        A, b and c.
    """
    count, d = x.shape
    matrices = np.reshape(bends, (-1, d, d))
    turned = np.einsum("mij,pj->pim", matrices, x)  # M x of each matrix M
    rows = [np.concatenate([np.einsum("pi,pim->pm", x, turned), x, np.ones((count, 1))], axis=1)]
    right = [-np.sum(x**2, axis=1)]
    if normals is not None:
        across = np.eye(d) - normals[:, :, None] * normals[:, None, :]
        unit, zero = np.broadcast_to(np.eye(d), (count, d, d)), np.zeros((count, d, 1))
        gradient = np.concatenate([2 * turned, unit, zero], axis=2)
        rows.append((across @ gradient).reshape(-1, gradient.shape[2]))
        right.append(-2 * (across @ x[:, :, None]).ravel())
    solution, *_ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)
    shares, linear, constant = solution[: len(matrices)], solution[-d - 1 : -1], float(solution[-1])
    return np.eye(d) + np.einsum("m,mij->ij", shares, matrices), linear, constant


def _inverse_root(covariance: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The inverse of the Cholesky factor, row by row; parts that others determine keep a small variance."""
    rows: list[Float[Array, " n"]] = []
    for k in range(covariance.shape[0]):
        row = jnp.eye(covariance.shape[0])[k]
        for other in rows:  # which have unit variance and are uncorrelated
            row = row - jnp.sum(covariance[k] * other) * other
        variance = row @ covariance @ row
        rows.append(row / jnp.sqrt(jnp.maximum(variance, LEAST * covariance[k, k] + 1e-300)))
    return jnp.stack(rows)


def _no_whitening(points: ShapePoints) -> Whitening:
    """Weights that are replaced."""
    count, dimensions = points.position.shape
    matrix = np.zeros((count, dimensions, 1 + np.size(points.direction) // count))
    return Whitening(matrix, np.zeros((count, dimensions)))


def _residuals(family: AbstractShapeFamily, values, points: ShapePoints) -> tuple[Array, Array]:
    """Residuals of every point, (points, 1 + directed), and the directions of the shape."""
    off, turned, facing = jax.vmap(partial(family.residuals, family.shape(values)))(points.position, points.direction)
    return jnp.concatenate([off[:, None], turned.reshape(off.size, -1)], axis=1), facing


def _whitened(residuals: Array, whitening: Whitening) -> Float[Array, "points residuals"]:
    return jnp.sum(whitening.matrix * residuals[:, None, :], axis=-1) - whitening.shift


def _whitening(family: AbstractShapeFamily, values, points: ShapePoints) -> Whitening:
    """Weights from the covariances of the points, smaller for outliers (Huber)."""

    def one(position, covariance):
        facet = family.facet(family.shape(values), position, covariance)
        compared, directed = facet.along.shape
        if covariance is None:
            root = jnp.multiply(family.unit, jnp.diag(jnp.append(1.0, jnp.full(compared, facet.radius))))
        else:
            root = _inverse_root(facet.by @ covariance @ facet.by.T)
        root = root if points.has_direction else root.at[1:].set(0.0)
        off, rest = jnp.zeros((1, directed)), jnp.zeros((compared, 1))
        return Whitening(root @ jnp.block([[jnp.ones((1, 1)), off], [rest, facet.along]]), root[:, 0] * facet.bias)

    whitening = jax.vmap(one)(points.position, points.covariance)
    share = points.weight
    if points.covariance is not None:
        residuals, _ = _residuals(family, values, points)
        size = jnp.sqrt(jnp.sum(_whitened(residuals, whitening) ** 2, axis=-1))
        share = share * jnp.sqrt(jnp.minimum(1.0, OUTLIER / jnp.maximum(size, OUTLIER)))
    return Whitening(whitening.matrix * share[:, None, None], whitening.shift * share[:, None])


@Program
def _linearised(family: AbstractShapeFamily, values, points: ShapePoints, given: Whitening, renewed: Array):
    """Whitened residuals, their derivatives, the weights (given, or new), and the directions of the shape."""
    new = _whitening(family, values, points)
    whitening = jax.tree.map(lambda new, old: jnp.where(renewed, new, old), new, given)

    def whitened(values):
        residuals, facing = _residuals(family, values, points)
        residuals = _whitened(residuals, whitening)
        return residuals, (residuals, facing)

    jacobian, (residual, facing) = jax.jacfwd(whitened, has_aux=True)(values)
    return residual, jacobian, whitening, facing


@Program
def _supported(family: AbstractShapeFamily, estimates, directions: Float[Array, "n *direction"]):
    by, points = jax.jacfwd(lambda e: jax.vmap(partial(family.supported, e))(directions), has_aux=True)(estimates)
    return points, by
