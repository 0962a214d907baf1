"""Fit a sphere or an ellipsoid to points in space and the directions of forces there: the surface and its errors."""

from collections.abc import Sequence
from itertools import permutations, product
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.rotation import rotation_matrix
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._inverse.fit_shape import (
    SIGNIFICANCE,
    AbstractShapeFamily,
    AbstractShapeFit,
    Facet,
    ShapePoints,
    fit_shape,
    nearest_quadric,
    supported_points,
)
from jaxwhisker._inverse.points import PointStatus, SpaceReconstruction
from jaxwhisker._model.quadrics import Ellipsoid, Sphere
from jaxwhisker._model.surface import AbstractSurface, Point

FAMILIES: dict[type, tuple[str, ...]] = {
    Sphere: ("radius", "x", "y", "z"),
    Ellipsoid: ("a", "b", "c", "x", "y", "z", "rotation_x", "rotation_y", "rotation_z"),
}
FLATTEST = 0.02  # of the mean: least eigenvalue of the matrix of a first ellipsoid
POSITION_AND_FORCE = np.array([0, 1, 2, 4, 5, 6])  # in the covariance of a point


class SurfaceFit(AbstractShapeFit):
    """A surface fitted to points in space.

    Standard errors and status are those of a `ProfileFit`. The estimates are the half axes a, b and c, or the radius;
    the centre x, y and z; and the rotation vector of an ellipsoid, rad.
    """

    surface: AbstractSurface  # a Sphere, or an Ellipsoid that is rotated

    @property
    def _shape(self) -> AbstractSurface:
        return self.surface

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
        like = _SurfaceFamily(FAMILIES[kind], 1.0, kind, np.zeros(3))
        points, by = supported_points(like, list(self.estimates.values()), directions)
        return points, self._across(by)


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
    observed, middle, unit = _read_points(points, normals)
    names, count = FAMILIES[family], observed.position.shape[0]
    if observed.residuals < len(names):
        raise ValueError(f"`measured` must hold enough points for {len(names)} parameters, got {count}.")
    fields, _ = fit_shape(_SurfaceFamily(names, unit, family, middle), _start(observed, family), observed)
    return SurfaceFit(surface=_surface(family, fields["estimates"].values()), **fields)


def _read_points(points: Any, normals: bool) -> tuple[ShapePoints, np.ndarray, np.ndarray]:
    """Significant points relative to their middle and in units of their size; the middle, and the size."""
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
    noise = by @ noise @ by.transpose(0, 2, 1) if certain.any() else None
    scaled = ShapePoints((position - middle) / size, direction, noise, np.ones(len(force)), normals)
    return scaled, middle, np.asarray(size)


_ALLOWED = "the result of jw.reconstruct in space, or a list of such results"
_JUDGED, _VECTORS = ("status", "significance"), ("point", "force")


def _start(observed: ShapePoints, family: type) -> Float[np.ndarray, " p"]:
    """Values to start from, by linear least squares."""
    normals = np.asarray(observed.direction) if observed.has_direction else None
    bends = () if family is Sphere else _TRACELESS
    matrix, linear, constant = nearest_quadric(np.asarray(observed.position), normals, bends)
    eigenvalues, axes = np.linalg.eigh(matrix)
    eigenvalues = np.maximum(eigenvalues, FLATTEST)
    centre = -axes @ (axes.T @ linear / eigenvalues) / 2
    square = centre @ (axes * eigenvalues) @ axes.T @ centre - constant
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


class _SurfaceFamily(AbstractShapeFamily):
    """Surfaces; fitted are the logs of the half axes, the centre and the rotation vector.

    Lengths are in a unit and relative to the middle of the points, the estimates are not.
    """

    kind: type = eqx.field(static=True)
    middle: Float[np.ndarray, "3"]

    @property
    def _parts(self) -> tuple[slice, slice, slice]:
        """Where the half axes, the centre and the rotation vector are."""
        lengths = self.names.index("x")
        return slice(lengths), slice(lengths, lengths + 3), slice(lengths + 3, None)

    def estimates(self, values):
        half_axes, centre, _ = self._parts
        estimates, rates = values.copy(), np.ones(values.size)
        with np.errstate(over="ignore"):
            estimates[half_axes] = rates[half_axes] = self.unit * np.exp(values[half_axes])
        estimates[centre] = self.middle + self.unit * values[centre]
        rates[centre] = self.unit
        return estimates, rates

    def shape(self, values):
        half_axes, *rest = (values[part] for part in self._parts)
        return _surface(self.kind, jnp.concatenate([jnp.exp(half_axes), *rest]))

    def facet(self, shape, position, covariance):
        foot = _foot(shape, position)
        normal = shape.normal(foot)
        tangents = _tangents(normal)
        bend = tangents @ shape.curvature(foot) @ tangents.T
        turn = -bend @ tangents  # the foot does not move with a point along the normal
        by = jnp.block([[normal[None], jnp.zeros((1, 3))], [turn, tangents]])
        bias = jnp.zeros(())
        if covariance is not None:  # errors along a convex surface lead out of it
            bias = jnp.sum(bend * (tangents @ covariance[:3, :3] @ tangents.T)) / 2
        return Facet(2 / jnp.trace(bend), tangents, by, bias)

    def residuals(self, shape, position, direction):
        foot = _foot(shape, position)
        normal = shape.normal(foot)
        return shape.off(foot) + jnp.sum((position - foot) * normal), direction - normal, normal

    def supported(self, estimates, direction):
        half_axes, centre, rotation = (estimates[part] for part in self._parts)
        normal = direction / jnp.sqrt(jnp.sum(direction**2))
        turn = rotation_matrix(rotation) if self.kind is Ellipsoid else jnp.eye(3)
        inwards = half_axes * (normal @ turn)
        size = jnp.sqrt(jnp.sum(inwards**2))
        return normal @ centre + size, centre + turn @ (half_axes * inwards) / size


def _foot(surface: AbstractSurface, x: Point) -> Point:
    """The point of the surface nearest to x, to second order in the distance."""
    return x - surface.off(x) * surface.normal(x)


def _tangents(normal: Point) -> Float[Array, "2 3"]:
    """Two perpendicular directions along the surface."""
    one = jnp.cross(normal, jnp.eye(3)[jnp.argmin(jnp.abs(normal))])
    one = one / jnp.sqrt(jnp.sum(one**2))
    return jnp.stack([one, jnp.cross(normal, one)])
