"""Polygons: objects with straight faces and corners, at which whiskers touch edges."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text, text_unless
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, ContactPoint, FirstTouch

FLATTEST = 1e-9  # rad: smallest angle by which the outline must turn at a corner
SAME_PLACE = 1e-12  # dimensionless: corners this close in x are touched at the same time by an upright whisker

Corners = Float[Array, "corners 2"]
Count = Int[Array, ""] | Int[np.ndarray, ""]  # of corners that are not repetitions of the last one


class _AbstractPolygon(AbstractProfile):
    """A polygon by its corners, with the geometry of its chain."""

    # Subclasses declare their fields, because the order of the fields is that of their arguments.

    @property
    def has_edges(self):
        return True

    @abc.abstractmethod
    def corners(self) -> Corners:
        """Corners of the polygon, counter-clockwise."""

    def chain(self) -> "Chain":
        """The polygon as a chain of corners and faces."""
        corners = self.corners()
        return chain(corners, np.asarray(corners.shape[0]))

    def point(self, parameter):
        return self.chain().point(parameter)

    def point_on(self, piece, parameter):
        return self.chain().point_on(piece, parameter)

    def breaks(self):
        return self.chain().breaks()

    def ends(self):
        return self.chain().ends()

    def faces(self):
        return self.chain().faces()

    def at_slope(self, slope):
        return self.chain().at_slope(slope)

    def first_touch(self, height, side):
        return self.chain().first_touch(height, side)

    def above_widest(self, height, side):
        return self.chain().above_widest(height, side)

    def vertex(self):
        return self.chain().vertex()

    def in_unit(self, length):
        return _filled(self.corners()).in_unit(length)

    def _positive(self):
        return _positive(self.corners())


class Polygon(_AbstractPolygon):
    """Convex polygon with straight faces and sharp corners.

    Its parameter is the sum of the lengths of faces and of the angles by which the outline turns at corners (rad),
    starting from the top.

    Args:
        vertices: corners (x, y), shape (corners, 2), lengths: counter-clockwise, which is from left to right along the
            lower side; at least two. Two corners make a thin plate. The side that faces up most, back from the last
            corner of the lower side to the first, is the top, which whiskers cannot touch.

    Raises:
        ValueError: if `vertices` is not such an array of finite numbers, the corners are not those of a convex polygon
            in this order, or three of them are in line.

    Examples:
        >>> wedge = jw.Polygon([(-0.4, 0.6), (0.1, 0.2), (0.5, 0.6)])
        >>> print(wedge)
        polygon of 3 corners
        >>> x, y = wedge.vertex()
        >>> print(f"x = {x:.1f}, y = {y:.1f}")
        x = 0.1, y = 0.2
    """

    vertices: Corners = eqx.field(converter=lambda values: _as_rows(values))

    def __check_init__(self):
        checks.rows("vertices", self.vertices, columns=2, least=2)
        if not checks.is_traced(self.vertices) and not bool(_is_convex_now(np.asarray(self.vertices))):
            allowed = "the corners of a convex polygon, counter-clockwise, no three of them in line"
            checks.fail("vertices", allowed, np.asarray(self.vertices).tolist())

    def corners(self):
        return self.vertices

    def canonical(self):
        if checks.is_traced(self.vertices):
            return _filled(self.vertices)
        filled = _filled(np.asarray(self.vertices))  # compiles nothing
        return eqx.tree_at(lambda own: own.vertices, filled, jax.device_put(filled.vertices))

    def __str__(self):
        return f"polygon of {len(self.vertices)} corners"


class _Filled(_AbstractPolygon):
    """A polygon whose last corner may be repeated, so that polygons of different numbers of corners share programs."""

    vertices: Corners | Float[np.ndarray, "corners 2"]
    count: Count

    def corners(self):
        return jnp.asarray(self.vertices)

    def chain(self):
        return chain(self.corners(), self.count)

    def in_unit(self, length):
        return chain(self.corners() / length, self.count)

    def _positive(self):
        return _positive(self.corners(), self.count)

    def __str__(self):
        return f"polygon of {self.count} corners"


class Box(_AbstractPolygon):
    """Box with a horizontal bottom, vertical flanks and sharp corners.

    An upright whisker touches it at a lower corner, if it reaches that high.

    Args:
        distance: q, height of the bottom above the bases, a length; positive.
        width: along x, a length; positive.
        height: from the bottom to the top, a length; positive.
        position: x of the centre, a length.

    Raises:
        ValueError: if a value is not a finite number, or not positive where it must be.

    Examples:
        >>> print(jw.Box(distance=0.3, width=0.8, height=0.5))
        box q = 0.3, width 0.8, height 0.5
    """

    distance: Scalar
    width: Scalar
    height: Scalar
    position: Scalar = 0.0

    def __check_init__(self):
        for name in self.__dataclass_fields__:
            checks.number(name, getattr(self, name), positive=name != "position")

    def corners(self):
        left, right = self.position - self.width / 2, self.position + self.width / 2
        low, high = self.distance, self.distance + self.height
        values = left, high, left, low, right, low, right, high
        return jnp.reshape(jnp.stack([jnp.asarray(value, dtype=float) for value in values]), (4, 2))

    def _positive(self):
        return [self.distance, self.width, self.height]

    def __str__(self):
        size = f"width {as_text(self.width)}, height {as_text(self.height)}"
        return f"box q = {as_text(self.distance)}, {size}{text_unless(0.0, ', x = ', self.position)}"


class Chain(AbstractProfile):
    """The corners and faces of a convex polygon in order, from the left end of its top to the right end.

    Corner k is piece 2k, the face to the next corner is piece 2k + 1. Of fewer corners than there is room for, the last
    one is repeated, and its repetitions begin at infinite parameters.
    """

    xy: Corners
    slopes: Float[Array, " slopes"]  # before and after each corner, rad; increasing by a full turn
    start: Float[Array, " pieces"]  # parameter at which each piece begins
    count: Int[Array, ""]  # of corners

    @property
    def has_edges(self):
        return True

    def breaks(self):
        return self.start[1:]

    def ends(self):
        last = self.count - 1
        return self.start[0], self.start[2 * last] + self.slopes[last + 1] - self.slopes[last]

    def faces(self):
        (x, y), slopes = self.xy.T, self.slopes[1:]  # after each corner; the last one is that of the top
        return ContactPoint(x, y, jnp.cos(slopes), jnp.sin(slopes))

    def point(self, parameter):
        return self.point_on(self.piece_at(parameter), parameter)

    def point_on(self, piece, parameter):
        assert piece is not None
        piece = jnp.minimum(piece, 2 * self.count - 2)
        corner, is_face = piece // 2, piece % 2
        (x, y), slope, way = self.xy[corner], self.slopes[corner + is_face], parameter - self.start[piece]
        turned = slope + jnp.where(is_face, 0.0, way)
        cos, sin, along = jnp.cos(turned), jnp.sin(turned), jnp.where(is_face, way, 0.0)
        return ContactPoint(x + along * cos, y + along * sin, cos, sin)

    def at_slope(self, slope):
        corner = jnp.clip(jnp.sum(slope > self.slopes) - 1, 0, self.count - 1)
        return jax.lax.stop_gradient(self.start[2 * corner] + slope - self.slopes[corner])

    def first_touch(self, height, side):
        x, y = self.xy.T
        height = jnp.maximum(height, jnp.min(y))
        # The whisker meets corners below its tip and faces that cross the height of its tip.
        rise = jnp.where(y[1:] == y[:-1], 1.0, y[1:] - y[:-1])
        share = (height - y[:-1]) / rise
        crosses = (share >= 0) & (share < 1) & (y[1:] != y[:-1])
        at = jnp.concatenate([x, x[:-1] + share * (x[1:] - x[:-1])])
        ahead = jnp.where(jnp.concatenate([y <= height, crosses]), side * at, -jnp.inf)
        heights = jnp.concatenate([y, jnp.broadcast_to(height, share.shape)])
        # Of several places with the same x, as on a vertical flank, it is the lowest one.
        first = ahead > jnp.max(ahead) - SAME_PLACE
        k = jnp.argmin(jnp.where(first, heights, jnp.inf))
        n = x.size
        # An upright whisker touches a corner with its shaft.
        upright = jnp.clip(side * checks.RIGHT_ANGLE, self.slopes[:-1], self.slopes[1:]) - self.slopes[:-1]
        parameters = jnp.concatenate([
            self.start[::2] + upright,
            self.start[1::2] + share * jnp.hypot(x[1:] - x[:-1], y[1:] - y[:-1]),
        ])  # fmt: skip
        piece = jnp.where(k < n, 2 * k, 2 * (k - n) + 1)
        return FirstTouch(parameters[k], at[k], heights[k], piece)

    def above_widest(self, height, side):
        here, there = self.xy, jnp.roll(self.xy, -1, axis=0)
        (x, y), (across, rise) = here.T, (there - here).T
        share = (height - y) / jnp.where(rise == 0, 1.0, rise)
        crosses = (share >= 0) & (share <= 1) & (rise != 0)
        at = x + share * across
        k = jnp.argmax(jnp.where(crosses, side * at, -jnp.inf))
        # The top is no piece: it counts as an end of its corners.
        is_face, (first, last) = k < self.count - 1, self.ends()
        on_face = self.start[jnp.minimum(2 * k + 1, self.start.size - 1)] + share[k] * jnp.hypot(across[k], rise[k])
        parameter = jnp.where(is_face, on_face, jnp.where(side > 0, last, first))
        piece = jnp.where(is_face, 2 * k + 1, jnp.where(side > 0, 2 * self.count - 2, 0))
        return FirstTouch(parameter, at[k], jnp.where(crosses[k], height, jnp.min(y)), piece)

    def vertex(self):
        x, y = self.xy[jnp.argmin(self.xy[:, 1])]
        return x, y

    def in_unit(self, length):
        return chain(self.xy / length, self.count)

    def _positive(self):
        return _positive(self.xy, self.count)

    def __str__(self):
        return f"polygon of {self.count} corners"


def _filled(corners: Any) -> _Filled:
    """A polygon of 8, 16, 32, ... corners, of which the last one is repeated."""
    count = corners.shape[0]
    last = np.minimum(np.arange(max(8, 1 << (count - 1).bit_length())), count - 1)
    return _Filled(corners[last], np.asarray(count))


def _sides(corners: Corners, count: Count) -> Corners:
    """Vectors from each corner to the next one, from the last one to the first, and zero for its repetitions."""
    k = np.arange(corners.shape[0])
    following = jnp.where(k + 1 < count, np.minimum(k + 1, k[-1]), 0)
    return jnp.where((k < count)[:, None], corners[following] - corners, 0.0)


def _turns(sides: Corners, count: Count) -> Float[Array, " corners"]:
    """Angles by which the outline turns at each corner, from 0 to a full turn; 0 for repetitions of the last one."""
    k = np.arange(sides.shape[0])
    (x, y), (next_x, next_y) = sides[jnp.where(k > 0, np.maximum(k - 1, 0), count - 1)].T, sides.T
    real = k < count
    along = jnp.where(real, x * next_x + y * next_y, 1.0)
    turns = jnp.mod(jnp.arctan2(x * next_y - y * next_x, along), 4 * checks.RIGHT_ANGLE)
    return jnp.where(real, turns, 0.0)


def _lengths(sides: Corners, count: Count) -> Float[Array, " corners"]:
    """Lengths of the sides; 1 for those of repetitions, which have none."""
    real = jnp.arange(sides.shape[0]) < count
    return jnp.hypot(*jnp.where(real[:, None], sides, np.array([1.0, 0.0])).T)


def _positive(corners: Corners, count: Count | None = None) -> list[Scalar]:
    """Values that are positive for a convex polygon above the bases."""
    count = np.asarray(corners.shape[0]) if count is None else count
    turns = _turns(_sides(corners, count), count)
    half, once = 2 * checks.RIGHT_ANGLE + FLATTEST, 4 * checks.RIGHT_ANGLE + FLATTEST
    least = jnp.min(jnp.where(np.arange(turns.size) < count, turns, jnp.inf))
    return [jnp.min(corners[:, 1]), least - FLATTEST, half - jnp.max(turns), once - jnp.sum(turns)]


def _is_convex(corners: Corners, count: Count | None = None) -> Bool[Array, ""]:
    return jnp.all(jnp.stack(_positive(corners, count)[1:]) > 0)


_is_convex_now = Program(_is_convex)


def chain(corners: Corners, count: Count) -> Chain:
    """The chain of a polygon of `count` corners; further ones repeat the last one."""
    corners, count = jnp.asarray(corners, dtype=float), jnp.asarray(count)
    k = np.arange(corners.shape[0])
    last = jnp.minimum(k, count - 1)
    # Placeholder for an invalid polygon, whose derivatives must be finite (see `safe_placeholder`).
    angles = 4 * checks.RIGHT_ANGLE * last / count
    regular = jnp.stack([jnp.cos(angles), jnp.sin(angles) + 2], axis=1)
    corners = jnp.where(_is_convex(jax.lax.stop_gradient(corners), count), corners, regular)
    sides = jax.lax.stop_gradient(_sides(corners, count))
    up = jnp.where(k < count, -sides[:, 0] / _lengths(sides, count), -jnp.inf)
    # The last side is the top.
    corners = corners[jnp.mod(last + 1 + jnp.argmax(up), count)]
    sides = _sides(corners, count)
    turns, (top_x, top_y) = _turns(sides, count), sides[count - 1]
    top = jnp.mod(jnp.arctan2(top_y, top_x), 4 * checks.RIGHT_ANGLE) - 4 * checks.RIGHT_ANGLE
    slopes = top + jnp.concatenate([jnp.zeros(1), jnp.cumsum(turns)])
    extents = jnp.reshape(jnp.stack([turns, _lengths(sides, count)], axis=1), -1)[:-1]
    start = jnp.concatenate([jnp.zeros(1), jnp.cumsum(extents)[:-1]])
    start = jnp.where(np.arange(start.size) < 2 * count - 1, start, jnp.inf)
    return Chain(corners, slopes, start, count)


def _as_rows(values):
    try:
        return jnp.asarray(checks.unmasked(values), dtype=float)
    except (TypeError, ValueError):
        return values  # the constructor rejects it
