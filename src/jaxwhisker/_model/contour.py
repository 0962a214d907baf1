"""A contour of any strictly convex shape: its radius of curvature as a function of the slope angle."""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text, text_unless
from jaxwhisker._base.program import Program
from jaxwhisker._base.quadrature import gauss
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import STEEPEST, AbstractProfile, ContactPoint, FirstTouch, bisect

CELLS = 32  # between two knots; x and y are accurate to 1e-11 of the radius even if that grows by e^2 from knot to knot
GAUSS = 4  # quadrature points per cell


class _AbstractContour(AbstractProfile):
    """A contour by its lowest point and anything that tells its shape."""

    # Its subclasses declare `distance` and `position`, because the order of the fields is that of their arguments.

    def vertex(self: Any):
        return self.position, self.distance

    def _positive(self: Any):
        return [self.distance]


class Contour(_AbstractContour):
    """A strictly convex contour, given by its radius of curvature rho as a function of the slope angle alpha.

        x = position + int_0^alpha rho cos(a) da,  y = distance + int_0^alpha rho sin(a) da.

    log rho is a cubic spline in alpha, constant beyond the outermost knots. Therefore the contour is smooth and
    strictly convex for any values at the knots. Its parameter is the slope angle.

    Args:
        distance: q, height of the lowest point above the bases, a length; positive.
        log_radius: log of the radius of curvature (a length) at the knots, shape (knots,).
        slopes: slope angles of the knots, rad, strictly increasing, each less than a right angle; at least two.
        position: x of the lowest point, a length.

    Raises:
        ValueError: if an argument is not a finite number or array, is outside its domain, or there is not one
            `log_radius` per knot.

    Examples:
        >>> contour = jw.Contour(0.2, log_radius=jnp.log(jnp.array([0.4, 0.5, 0.8])), slopes=(-1.0, 0.0, 1.0))
        >>> print(contour)
        contour q = 0.2, 3 knots
        >>> print(f"{contour.radius(0.0):.3f}")
        0.500
    """

    distance: Scalar
    log_radius: Float[Array, " knots"] = eqx.field(converter=lambda values: _as_array(values))
    slopes: tuple[float, ...] = eqx.field(static=True, converter=lambda values: _as_tuple(values))
    position: Scalar = 0.0

    def __check_init__(self):
        checks.number("distance", self.distance, positive=True)
        checks.number("position", self.position)
        knots = np.asarray(check_slopes("slopes", self.slopes))
        if isinstance(self.log_radius, (np.ndarray, jax.Array)) and jnp.shape(self.log_radius) == ():
            return  # transformations rebuild one of several contours
        checks.vector("log_radius", self.log_radius)
        if self.log_radius.shape != knots.shape:
            got = f"an array of shape {self.log_radius.shape}"
            checks.fail("log_radius", f"one value per knot ({knots.size})", got)

    @classmethod
    def like(cls, profile: AbstractProfile, slopes) -> "Contour":
        """A contour with the vertex of another profile, and with its radii of curvature at the knots.

        Args:
            profile: a profile with a smooth point at each of these slopes.
            slopes: slope angles of the knots, rad, as for a Contour.

        Raises:
            ValueError: as for a Contour.
        """
        x, y = profile.vertex()
        slopes = check_slopes("slopes", slopes)
        return cls(y, _log_radii_now(jax.tree.map(checks.as_float, profile), np.asarray(slopes)), slopes, x)

    def radius(self, slope: Scalar) -> Float[Array, ""]:
        """Radius of curvature at a slope angle (rad), a length."""
        x_rate, y_rate = jax.jvp(lambda a: self.point(a)[:2], (jnp.asarray(slope, dtype=float),), (jnp.ones(()),))[1]
        return x_rate * jnp.cos(slope) + y_rate * jnp.sin(slope)

    def tabulated(self) -> "Tabulated":
        """The same contour as a table of polynomials, which yields points without integration."""
        return tabulate(spline(self.slopes), self.distance, self.position, self.log_radius)

    def point(self, parameter):
        return self.tabulated().point(parameter)

    def first_touch(self, height, side):
        return self.tabulated().first_touch(height, side)

    def in_unit(self, length):
        return self.tabulated().in_unit(length)

    def __str__(self):
        position = text_unless(0.0, ", x = ", self.position)
        return f"contour q = {as_text(self.distance)}, {len(self.slopes)} knots{position}"


class Tabulated(_AbstractContour):
    """A contour as polynomials of degree 5, CELLS of them between two knots."""

    distance: Scalar
    position: Scalar
    knots: Float[Array, " knots"]
    # The last knot may be repeated, so that contours of different numbers of knots share programs.
    cells: Float[Array, "cells 2 6"]  # coefficients of x and of y in powers of the fraction of the cell
    ends_at: Float[Array, "2 3"]  # x, y, radius at the first and at the last knot

    def point(self, parameter):
        cos, sin = jnp.cos(parameter), jnp.sin(parameter)
        knots = jax.lax.stop_gradient(self.knots)
        x, y = _between_knots(self.cells, knots, parameter)
        for beyond, at, (end_x, end_y, radius) in (
            (parameter < knots[0], knots[0], self.ends_at[0]),
            (parameter > knots[-1], knots[-1], self.ends_at[1]),
        ):
            x = jnp.where(beyond, end_x + radius * (sin - jnp.sin(at)), x)
            y = jnp.where(beyond, end_y + radius * (jnp.cos(at) - cos), y)
        return ContactPoint(x, y, cos, sin)

    def first_touch(self, height, side):
        still = jax.lax.stop_gradient(self)
        a = bisect(lambda a: still.point(side * a).y < jax.lax.stop_gradient(height), 0.0, STEEPEST)
        a = jax.lax.stop_gradient(side * a)
        # A last Newton step carries the derivative, unless the shaft of the whisker meets the widest point.
        y, rate = jax.jvp(lambda a: self.point(a).y, (a,), (jnp.ones_like(a),))
        crosses = (rate != 0) & (jnp.abs(a) < STEEPEST * (1 - 1e-12))
        a = a - jnp.where(crosses, (y - height) / jnp.where(crosses, jax.lax.stop_gradient(rate), 1.0), 0.0)
        at = self.point(a)
        return FirstTouch(a, at.x, at.y)

    def in_unit(self, length):
        sizes = self.distance / length, self.position / length
        return Tabulated(*sizes, self.knots, self.cells / length, self.ends_at / length)

    def __str__(self):
        return f"contour q = {as_text(self.distance)}"


def check_slopes(name: str, values) -> tuple[float, ...]:
    """Slope angles of knots as floats, after a check that the errors of `name` describe."""
    checks.vector(name, values)
    knots = np.asarray(values, dtype=float)
    if knots.size < 2 or not (np.diff(knots) > 0).all() or np.abs(knots).max() > STEEPEST:
        checks.fail(name, "at least two strictly increasing slope angles, each less than a right angle", values)
    return tuple(knots.tolist())


def _as_array(values):
    # Transformations of JAX replace leaves by objects that are not arrays; these pass unchanged.
    try:
        return jnp.asarray(checks.unmasked(values), dtype=float)
    except (TypeError, ValueError):
        return values


def _as_tuple(values):
    return tuple(float(value) for value in np.ravel(np.asarray(values, dtype=float)))


def _radius(profile: AbstractProfile, slope: Scalar) -> Float[Array, ""]:
    """Radius of curvature of any profile at a slope angle."""

    def angle(parameter):
        at = profile.point(parameter)
        return jnp.arctan2(at.sin, at.cos)

    def rate(function, parameter):
        return jax.jvp(function, (parameter,), (jnp.ones_like(parameter),))[1]

    parameter = jax.lax.stop_gradient(profile.at_slope(slope))
    parameter = parameter - (angle(parameter) - slope) / rate(angle, parameter)
    x, y = rate(lambda p: jnp.stack(profile.point(p)[:2]), parameter)
    return jnp.hypot(x, y) / rate(angle, parameter)


def _log_radii(profile: AbstractProfile, slopes: Float[Array, " knots"]) -> Float[Array, " knots"]:
    return jnp.log(jax.vmap(lambda slope: _radius(profile, slope))(slopes))


_log_radii_now = Program(_log_radii)


class Spline(NamedTuple):
    """Linear maps from values at the knots to values and derivatives at the nodes, and to values at Gauss points."""

    knots: np.ndarray
    node: np.ndarray
    value: np.ndarray
    rate: np.ndarray
    gauss: np.ndarray  # angles (cells, GAUSS)
    at_gauss: np.ndarray
    width: np.ndarray  # (cells,)
    weight: np.ndarray  # (GAUSS,)


@lru_cache(maxsize=64)
def spline(slopes: tuple[float, ...]) -> Spline:
    """The maps of the cubic spline through values at these slopes."""
    from scipy.interpolate import CubicSpline  # scipy is loaded with the first contour

    knots = np.asarray(slopes)
    fraction = np.arange(CELLS) / CELLS
    node = np.append((knots[:-1, None] + fraction * np.diff(knots)[:, None]).ravel(), knots[-1])
    cubic = CubicSpline(knots, np.eye(knots.size))
    at, weight = gauss(GAUSS)
    width = np.diff(node)
    at_gauss = node[:-1, None] + width[:, None] * at
    return Spline(knots, node, cubic(node), cubic(node, 1), at_gauss, cubic(at_gauss), width, weight)


# From value, rate and second rate at the end of a cell to coefficients 3, 4 and 5 of the quintic Hermite interpolant.
_HERMITE = np.linalg.inv(np.array([[1.0, 1.0, 1.0], [3.0, 4.0, 5.0], [6.0, 12.0, 20.0]]))


def tabulate(spline: Spline, distance: Scalar, position: Scalar, log_radius: Float[Array, " knots"]) -> Tabulated:
    """The contour with this vertex and these radii of curvature."""
    values, width = jnp.asarray(log_radius, dtype=float), spline.width
    radius = jnp.exp(jnp.sum(spline.value * values, axis=-1))
    radius_rate = radius * jnp.sum(spline.rate * values, axis=-1)
    radius_at_gauss = jnp.exp(jnp.sum(spline.at_gauss * values, axis=-1))
    # x and y, along the first axis, are the integrals of radius times cosine and radius times sine.
    cos, sin = jnp.cos(spline.node), jnp.sin(spline.node)
    direction, direction_rate = jnp.stack([cos, sin]), jnp.stack([-sin, cos])
    at_gauss = jnp.stack([jnp.cos(spline.gauss), jnp.sin(spline.gauss)])
    rises = width * jnp.sum(spline.weight * radius_at_gauss * at_gauss, axis=-1)
    start = jnp.cumsum(jnp.pad(rises, ((0, 0), (1, 0))), axis=-1)
    rate, bend = radius * direction, radius_rate * direction + radius * direction_rate
    a0, a1, a2 = start[:, :-1], rate[:, :-1] * width, bend[:, :-1] * width**2 / 2
    misses = jnp.stack([rises - a1 - a2, rate[:, 1:] * width - a1 - 2 * a2, bend[:, 1:] * width**2 - 2 * a2])
    higher = (jnp.sum(row[:, None, None] * misses, axis=0) for row in _HERMITE)
    cells = jnp.swapaxes(jnp.stack([a0, a1, a2, *higher], axis=-1), 0, 1)
    ends = jnp.stack([jnp.append(start[:, k], radius[k]) for k in (0, -1)])
    # The integrals start at the first knot; shift the curve to its vertex.
    distance, position = jnp.asarray(distance, dtype=float), jnp.asarray(position, dtype=float)
    more = _as_many(spline.knots.size) - spline.knots.size
    knots = jnp.pad(jnp.asarray(spline.knots), (0, more), mode="edge")
    cells = jnp.pad(cells, ((0, more * CELLS), (0, 0), (0, 0)))
    table = Tabulated(distance, position, knots, cells, ends)
    lowest = table.point(jnp.zeros(()))
    shift = jnp.stack([position - lowest.x, distance - lowest.y])
    return Tabulated(distance, position, table.knots, cells.at[:, :, 0].add(shift), ends + jnp.append(shift, 0.0))


def _as_many(knots: int) -> int:
    """Number of knots of a table for this many: 4, 16, 64, ..."""
    return 4 ** math.ceil(math.log(max(knots, 4), 4) - 1e-9)


def _between_knots(
    cells: Float[Array, "cells 2 6"], knots: Float[Array, " knots"], slope: Scalar
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """x and y of the polynomials at a slope angle, which is clipped to the outermost knots."""
    inside = jnp.clip(slope, knots[0], knots[-1])
    still = jax.lax.stop_gradient(inside)
    interval = jnp.sum((still >= knots[1:-1]) & (knots[1:-1] < knots[-1]))
    way = (inside - knots[interval]) / (knots[interval + 1] - knots[interval]) * CELLS
    cell = jnp.clip(jnp.floor(jax.lax.stop_gradient(way)).astype(int), 0, CELLS - 1)
    t, c = way - cell, cells[interval * CELLS + cell].T
    x, y = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
    return x, y
