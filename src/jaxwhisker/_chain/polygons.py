"""Polygons: which of their features is nearest to a point or to a shaft."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.objects import Objects
from jaxwhisker._model.polygon_chain import PolygonChain

IN_CONE = 1e-9  # rad: a shaft this close to the tangents at a corner touches it
PROBE = 1e-9  # lengths
SHALLOW = 0.05  # lengths: shafts deeper behind a face or a corner are on another side of the object


class PolygonFaces(NamedTuple):
    """The sides of a polygon, also its top, which is the last real one; fields (corners,)."""

    x: Float[Array, " corners"]
    y: Float[Array, " corners"]
    end_y: Float[Array, " corners"]
    cos: Float[Array, " corners"]
    sin: Float[Array, " corners"]
    length: Float[Array, " corners"]
    real: Bool[Array, " corners"]
    touchable: Bool[Array, " corners"]  # not the top


def faces_of(one: PolygonChain) -> PolygonFaces:
    """The sides of a polygon."""
    k = np.arange(one.xy.shape[0])
    following = jnp.where(k + 1 < one.count, np.minimum(k + 1, k[-1]), 0)
    (x, y), (to_x, to_y) = one.xy.T, one.xy[following].T
    slopes, real = one.slopes[1:], jnp.asarray(k < one.count)
    touchable = jnp.asarray(k < one.count - 1)
    length = jnp.where(real, jnp.hypot(to_x - x, to_y - y), 1.0)
    return PolygonFaces(x, y, to_y, jnp.cos(slopes), jnp.sin(slopes), length, real, touchable)


class AtFace(NamedTuple):
    """The side that is nearest to a point."""

    distance: Scalar  # negative inside
    number: Int[Array, ""]
    along: Scalar  # from its first corner


def nearest_face(faces: PolygonFaces, x: Scalar, y: Scalar) -> AtFace:
    """The side of a polygon that is nearest to a point."""
    right, up = x - faces.x, y - faces.y
    along = jnp.clip(right * faces.cos + up * faces.sin, 0.0, faces.length)
    apart = (right - along * faces.cos) ** 2 + (up - along * faces.sin) ** 2
    number = jnp.argmin(jnp.where(faces.real, apart, jnp.inf))
    # Both sides at a corner must compare with the same height.
    crosses = faces.real & ((y >= faces.y) != (y >= faces.end_y))
    left = right < up * faces.cos / jnp.where(faces.sin == 0, 1.0, faces.sin)
    inside = jnp.sum(crosses & left) % 2 == 1
    distance = jnp.sqrt(apart[number])
    return AtFace(jnp.where(inside, -distance, distance), number, along[number])


class AtCorner(NamedTuple):
    """How a shaft that runs past a corner would touch it; fields like those of the shaft's direction."""

    gap: Scalar  # negative if the corner is beyond the shaft
    side: Scalar
    parameter: Scalar
    meets: Bool[Array, ""]  # whether the shaft's direction lies between those of the sides, and it passes close by


def at_corner(
    one: PolygonChain, faces: PolygonFaces, k: Int[Array, ""], x: Scalar, y: Scalar, cos: Scalar, sin: Scalar
) -> AtCorner:
    """How the point of a shaft that is nearest to a corner would touch it; the direction is from base to tip."""
    before, after = one.slopes[k], one.slopes[k + 1]
    half, middle = (after - before) / 2, (before + after) / 2
    out_x, out_y = jnp.sin(middle), -jnp.cos(middle)
    side = jnp.where(sin * out_x - cos * out_y > 0, 1.0, -1.0)
    normal_x, normal_y = side * sin, -side * cos
    off = jnp.arctan2(out_x * normal_y - out_y * normal_x, out_x * normal_x + out_y * normal_y)
    gap = (x - one.xy[k, 0]) * normal_x + (y - one.xy[k, 1]) * normal_y
    fits = (jnp.abs(off) <= half + IN_CONE) & (k < one.count)
    # A shaft beyond the corner may be on another side of the object. One that meets the corner there is inside, if only
    # just, or it cuts off an acute corner.
    inside = nearest_face(faces, x - PROBE * out_x, y - PROBE * out_y).distance < 0
    depth = jnp.abs(gap) / jnp.maximum(out_x * normal_x + out_y * normal_y, 1e-3)
    cut = nearest_face(faces, one.xy[k, 0] - depth * out_x, one.xy[k, 1] - depth * out_y).distance < 0
    meets = fits & ((gap > 0) | inside | (cut & (gap > -SHALLOW)))
    return AtCorner(gap, side, one.start[2 * k] + off + half, meets)


def corner_signs(profile: Objects) -> Int[Array, " pieces"]:
    """For each piece of all objects, 1 if it is a corner, -1 if it is an inner corner, and 0 otherwise."""
    signs = []
    for one in profile.objects:
        if not isinstance(one, PolygonChain):
            signs.append(jnp.zeros(1, int))
            continue
        turns = jnp.sign(jnp.diff(one.slopes)).astype(int)
        signs.append(jnp.ravel(jnp.stack([turns, jnp.zeros_like(turns)], axis=1))[:-1])
    return jnp.concatenate(signs)


def of_corners(one: PolygonChain, function) -> tuple:
    """A function of the number of a corner, for all corners."""
    return jax.vmap(function)(jnp.arange(one.xy.shape[0]))
