"""Polygons as chains of corners and faces: their geometry."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, ContactPoint, FirstTouch

FLATTEST = 1e-9  # rad: smallest angle by which the outline must turn at a corner
SAME_PLACE = 1e-12  # dimensionless: corners this close in x are touched at the same time by an upright whisker

Corners = Float[Array, "corners 2"]
Count = Int[Array, ""] | Int[np.ndarray, ""]  # of corners that are not repetitions of the last one


class PolygonChain(AbstractProfile):
    """The corners and faces of a polygon in order, from the left end of its top to the right end.

    Corner k is piece 2k, the face to the next corner is piece 2k + 1. Of fewer corners than there is room for, the last
    one is repeated, and its repetitions begin at infinite parameters.
    """

    xy: Corners
    slopes: Float[Array, " slopes"]  # before and after each corner, rad; increasing by a full turn in all
    start: Float[Array, " pieces"]  # parameter at which each piece begins
    count: Int[Array, ""]  # of corners
    concave: bool = eqx.field(static=True, default=False)  # whether slopes may fall at some corners

    @property
    def is_concave(self):
        return self.concave

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
        turn = way
        if self.concave:
            turn = jnp.where(self.slopes[corner + 1] < self.slopes[corner], -way, way)
        turned = slope + jnp.where(is_face, 0.0, turn)
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
        return chain(self.xy / length, self.count, concave=self.concave)

    def _positive(self):
        return positive(self.xy, self.count, concave=self.concave)

    def __str__(self):
        return f"polygon of {self.count} corners"


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


def _signed(turns: Float[Array, " corners"]) -> Float[Array, " corners"]:
    """Angles by which the outline turns at each corner, negative at inner corners."""
    return jnp.where(turns > 2 * checks.RIGHT_ANGLE, turns - 4 * checks.RIGHT_ANGLE, turns)


def positive(corners: Corners, count: Count | None = None, *, concave: bool = False) -> list[Scalar]:
    """Values that are positive for a convex polygon above the bases, or for a concave one that turns once in all."""
    count = np.asarray(corners.shape[0]) if count is None else count
    turns = _turns(_sides(corners, count), count)
    if concave:
        turns = _signed(turns)
        least = jnp.min(jnp.where(np.arange(turns.size) < count, jnp.abs(turns), jnp.inf))
        once = FLATTEST * turns.size - jnp.abs(jnp.sum(turns) - 4 * checks.RIGHT_ANGLE)
        return [jnp.min(corners[:, 1]), least - FLATTEST, once]
    half, once = 2 * checks.RIGHT_ANGLE + FLATTEST, 4 * checks.RIGHT_ANGLE + FLATTEST
    least = jnp.min(jnp.where(np.arange(turns.size) < count, turns, jnp.inf))
    return [jnp.min(corners[:, 1]), least - FLATTEST, half - jnp.max(turns), once - jnp.sum(turns)]


def is_convex(corners: Corners, count: Count | None = None) -> Bool[Array, ""]:
    return jnp.all(jnp.stack(positive(corners, count)[1:]) > 0)


def is_simple(corners: np.ndarray) -> bool:
    """Whether a polygon turns once in all, counter-clockwise, and does not cross itself."""
    if not all(bool(value > 0) for value in positive(jnp.asarray(corners), concave=True)[1:]):
        return False
    ahead = np.roll(corners, -1, axis=0)

    def left(a, b, p):
        return np.sign((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]))

    for j, k in itertools.combinations(range(len(corners)), 2):
        if (j + 1) % len(corners) == k or (k + 1) % len(corners) == j:
            continue
        (a, b), (c, d) = (corners[j], ahead[j]), (corners[k], ahead[k])
        if left(a, b, c) != left(a, b, d) and left(c, d, a) != left(c, d, b):
            return False
    return True


def chain(corners: Corners, count: Count, *, concave: bool = False) -> PolygonChain:
    """The chain of a polygon of `count` corners; further ones repeat the last one."""
    corners, count = jnp.asarray(corners, dtype=float), jnp.asarray(count)
    k = np.arange(corners.shape[0])
    last = jnp.minimum(k, count - 1)
    # Placeholder for an invalid polygon, whose derivatives must be finite (see `safe_placeholder`).
    around = 4 * checks.RIGHT_ANGLE * last / count
    regular = jnp.stack([jnp.cos(around), jnp.sin(around) + 2], axis=1)
    still = jax.lax.stop_gradient(corners)
    known = jnp.all(jnp.stack(positive(still, count, concave=True)[1:]) > 0) if concave else is_convex(still, count)
    corners = jnp.where(known, corners, regular)
    sides = jax.lax.stop_gradient(_sides(corners, count))
    up = jnp.where(k < count, -sides[:, 0] / _lengths(sides, count), -jnp.inf)
    # The last side is the top.
    corners = corners[jnp.mod(last + 1 + jnp.argmax(up), count)]
    sides = _sides(corners, count)
    turns, (top_x, top_y) = _turns(sides, count), sides[count - 1]
    turns = _signed(turns) if concave else turns
    top = jnp.mod(jnp.arctan2(top_y, top_x), 4 * checks.RIGHT_ANGLE) - 4 * checks.RIGHT_ANGLE
    slopes = top + jnp.concatenate([jnp.zeros(1), jnp.cumsum(turns)])
    angles = jnp.abs(turns) if concave else turns
    extents = jnp.reshape(jnp.stack([angles, _lengths(sides, count)], axis=1), -1)[:-1]
    start = jnp.concatenate([jnp.zeros(1), jnp.cumsum(extents)[:-1]])
    start = jnp.where(np.arange(start.size) < 2 * count - 1, start, jnp.inf)
    return PolygonChain(corners, slopes, start, count, concave)
