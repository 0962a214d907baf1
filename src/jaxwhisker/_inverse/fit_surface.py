"""Fit a surface to points in space and the directions of forces there: the surface and its errors."""

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
from jaxwhisker._model.quadrics import Cylinder, Ellipsoid, Plane, Sphere
from jaxwhisker._model.surface import AbstractSurface, Point

FAMILIES: dict[type, tuple[str, ...]] = {
    Sphere: ("radius", "x", "y", "z"),
    Ellipsoid: ("a", "b", "c", "x", "y", "z", "rotation_x", "rotation_y", "rotation_z"),
    Cylinder: ("radius", "x", "y", "z", "axis_x", "axis_y", "axis_z"),
    Plane: ("x", "y", "z", "outward_x", "outward_y", "outward_z"),
}
FREE = {Sphere: 4, Ellipsoid: 9, Cylinder: 5, Plane: 3}  # numbers that are fitted
FLAT = 1e-9  # curvature, in units of the size of the points, below which it turns no lengths into angles
FLATTEST = 0.02  # of the mean: least eigenvalue of the matrix of a first ellipsoid
POSITION_AND_FORCE = np.array([0, 1, 2, 4, 5, 6])  # in the covariance of a point


class SurfaceFit(AbstractShapeFit):
    """A surface fitted to points in space.

    Standard errors and status are those of a `ProfileFit`. The estimates of a sphere are its radius and its centre x, y
    and z; those of an ellipsoid its half axes a, b and c, its centre, and its rotation vector, rad. Those of a cylinder
    are its radius, the point of its axis nearest to the middle of the points, and the direction of the axis, a unit
    vector; those of a plane the point nearest to this middle, and its outward normal.
    """

    surface: AbstractSurface  # an ellipsoid is rotated

    @property
    def _shape(self) -> AbstractSurface:
        return self.surface

    def band(self, normals: Any) -> tuple[np.ndarray, np.ndarray]:
        """Points of the surface with these outward normals, and their standard errors along the normals.

        Args:
            normals: directions, (n, 3), of any length but zero. Of a cylinder, their part across the axis counts; the
                points are those around the estimated point of the axis. A plane has one normal and one such point.

        Returns:
            Points, (n, 3), and errors, (n,), lengths. Errors are NaN where the status is not ok.

        Raises:
            ValueError: if `normals` is not an array of this shape.
        """
        checks.rows("normals", normals, columns=3)
        directions = np.asarray(checks.unmasked(normals), dtype=float)
        (kind,) = (kind for kind, names in FAMILIES.items() if names == tuple(self.estimates))
        like = _family_of(kind, 1.0, np.zeros(3), np.eye(3))
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
        checks.fail("family", "Sphere, Ellipsoid, Cylinder or Plane", repr(family))
    checks.instance("normals", normals, bool, "True or False")
    observed, middle, unit = _read_points(points, normals)
    if observed.residuals < FREE[family]:
        count = observed.position.shape[0]
        raise ValueError(f"`measured` must hold enough points for {FREE[family]} parameters, got {count}.")
    if family in (Sphere, Ellipsoid):
        frame, start = np.eye(3), _start(observed, family)
    else:
        frame, start = _start_along_axis(observed, family)
    fields, _ = fit_shape(_family_of(family, unit, middle, frame), start, observed)
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


def _start_along_axis(observed: ShapePoints, family: type) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " p"]]:
    """A frame whose last axis is that of the first cylinder, or the normal of the first plane, and values there."""
    x, normals = np.asarray(observed.position), np.asarray(observed.direction)
    if family is Plane:
        outward = normals.mean(axis=0)
        frame = _frame(outward / np.linalg.norm(outward))
        return frame, np.r_[np.mean(x @ frame[2]), 0.0, 0.0]
    # The axis is perpendicular to all normals.
    frame = _frame(np.linalg.eigh(normals.T @ normals)[1][:, 0])
    across, flat = x @ frame[:2].T, normals @ frame[:2].T
    size = np.linalg.norm(flat, axis=1)
    _, linear, constant = nearest_quadric(across, flat / np.maximum(size, FLATTEST)[:, None])
    centre = -linear / 2
    return frame, np.r_[np.log(max(centre @ centre - constant, FLATTEST**2)) / 2, centre, 0.0, 0.0]


def _frame(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Three perpendicular unit vectors, as rows, of which this is the last one."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis])


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
    """The surface with these estimates."""
    if family is Cylinder:
        radius, x, y, z, *axis = numbers
        return Cylinder(radius, (x, y, z), tuple(axis))
    if family is Plane:
        x, y, z, *outward = numbers
        return Plane((x, y, z), tuple(outward))
    if family is Sphere:
        radius, *centre = numbers
        return Sphere(radius, tuple(centre))
    a, b, c, x, y, z, *rotation = numbers
    return Ellipsoid((a, b, c), (x, y, z)).rotated(tuple(rotation))


class _SurfaceFamily(AbstractShapeFamily):
    """Surfaces. Values to fit are in a unit and relative to the middle of the points; estimates are not."""

    kind: type = eqx.field(static=True)
    middle: Float[np.ndarray, "3"]

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
        curved = jnp.trace(bend) / 2
        # Flat surfaces have no radius; the size of the points will do.
        return Facet(jnp.where(curved > FLAT, 1 / jnp.where(curved > FLAT, curved, 1.0), 1.0), tangents, by, bias)

    def residuals(self, shape, position, direction):
        foot = _foot(shape, position)
        normal = shape.normal(foot)
        return shape.off(foot) + jnp.sum((position - foot) * normal), direction - normal, normal


class _EllipsoidFamily(_SurfaceFamily):
    """Spheres and ellipsoids; fitted are the logs of the half axes, the centre and the rotation vector."""

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
        return estimates, np.diag(rates)

    def shape(self, values):
        half_axes, *rest = (values[part] for part in self._parts)
        return _surface(self.kind, jnp.concatenate([jnp.exp(half_axes), *rest]))

    def supported(self, estimates, direction):
        half_axes, centre, rotation = (estimates[part] for part in self._parts)
        normal = direction / jnp.sqrt(jnp.sum(direction**2))
        turn = rotation_matrix(rotation) if self.kind is Ellipsoid else jnp.eye(3)
        inwards = half_axes * (normal @ turn)
        size = jnp.sqrt(jnp.sum(inwards**2))
        return normal @ centre + size, centre + turn @ (half_axes * inwards) / size


class _AxisFamily(_SurfaceFamily):
    """Cylinders and planes; fitted are the log of the radius, shifts, and tilts of the axis or the normal.

    A cylinder shifts and tilts along the first two axes of a frame; a plane shifts along the last one.
    """

    frame: Float[np.ndarray, "3 3"]  # rows

    def _numbers(self, values: Any) -> tuple[Any, Any, Any]:
        """Radius, which planes lack, place relative to the middle, and axis."""
        *sizes, one, other = values
        axis = self.frame[2] + one * self.frame[0] + other * self.frame[1]
        axis = axis / jnp.sqrt(jnp.sum(axis**2))
        if self.kind is Plane:
            (shift,) = sizes
            return None, shift * jnp.sum(self.frame[2] * axis) * axis, axis
        radius, first, second = sizes
        place = first * self.frame[0] + second * self.frame[1]
        return jnp.exp(radius), place - jnp.sum(place * axis) * axis, axis

    def estimated(self, values: Float[Array, " p"]) -> Float[Array, " estimates"]:
        """The estimates."""
        radius, place, axis = self._numbers(values)
        radii = [] if radius is None else [self.unit * radius]
        return jnp.concatenate([jnp.asarray(radii, dtype=float), self.middle + self.unit * place, axis])

    def estimates(self, values):
        estimates, rates = _estimated(self, values)
        return np.asarray(estimates), np.asarray(rates)

    def shape(self, values):
        radius, place, axis = self._numbers(values)
        return _surface(self.kind, [*([] if radius is None else [radius]), *place, *axis])

    def supported(self, estimates, direction):
        *radii, x, y, z, first, second, third = estimates
        place, axis = jnp.stack([x, y, z]), jnp.stack([first, second, third])
        if not radii:
            return jnp.sum(jax.lax.stop_gradient(axis) * place), place
        across = direction - jnp.sum(direction * axis) * axis
        # The axis tilts about this place, which does not move the surface there.
        normal = jax.lax.stop_gradient(across / jnp.sqrt(jnp.sum(across**2)))
        return jnp.sum(normal * place) + radii[0], place + radii[0] * normal


def _family_of(kind: type, unit: Any, middle: np.ndarray, frame: np.ndarray) -> _SurfaceFamily:
    names = FAMILIES[kind]
    if kind in (Sphere, Ellipsoid):
        return _EllipsoidFamily(names, unit, kind, middle)
    return _AxisFamily(names, unit, kind, middle, frame)


@Program
def _estimated(family: _AxisFamily, values: Float[Array, " p"]) -> tuple[Array, Array]:
    """Estimates, and their derivatives by the values."""
    return family.estimated(values), jax.jacfwd(family.estimated)(values)


def _foot(surface: AbstractSurface, x: Point) -> Point:
    """The point of the surface nearest to x, to second order in the distance."""
    return x - surface.off(x) * surface.normal(x)


def _tangents(normal: Point) -> Float[Array, "2 3"]:
    """Two perpendicular directions along the surface."""
    one = jnp.cross(normal, jnp.eye(3)[jnp.argmin(jnp.abs(normal))])
    one = one / jnp.sqrt(jnp.sum(one**2))
    return jnp.stack([one, jnp.cross(normal, one)])
