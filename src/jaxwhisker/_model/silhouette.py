"""The silhouette of an object, as figures, films and pages draw it."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, bisect

CUT_OFF = 3.0  # whisker lengths to either side of the lowest point at which an open object is cut off
CONTOUR_POINTS = 481
ROUNDING = 1e-9  # of the length of a contour


def silhouette(
    profile: AbstractProfile, length: Scalar, *, whole: bool = True, points: int = CONTOUR_POINTS
) -> Float[jax.Array, "points 2"]:
    """Points of an object's contour, from left to right along its lower side; NaN beyond its ends.

    Args:
        profile: the object.
        length: length of the whiskers that touch it.
        whole: whether a closed object is drawn all around.
        points: number of points.
    """
    around = whole and bool(profile.closed)
    low, high = profile.span() if around else _near(profile, CUT_OFF * length)
    # A closed curve starts beside the top: at the very top, heights above the lowest point are 0/0.
    beside = 0.5 / (points - 1) if around else 0.0
    at = jax.vmap(profile.point)(low + (high - low) * (jnp.linspace(0.0, 1.0, points) + beside))
    return jnp.stack([at.x, at.y], axis=-1)


_silhouette = Program(silhouette)


def silhouette_of(
    profile: AbstractProfile, length: float, *, whole: bool = True
) -> tuple[Float[np.ndarray, " known"], Float[np.ndarray, " known"]]:
    """x and y of the finite points of an object's contour; compiled once for all objects of one kind."""
    line = _silhouette(jax.tree.map(checks.as_float, profile), jnp.asarray(length, dtype=float), whole=whole)
    x, y = np.asarray(line).T
    known = np.isfinite(x) & np.isfinite(y)
    return x[known], y[known]


def behind(x: np.ndarray, y: np.ndarray) -> Float[np.ndarray, "points 2"]:
    """Points that close an open contour, from its last point back to its first one; none if a straight line does.

    That line would cross a contour that is not convex. The points therefore lie behind it, at the height above the line
    that the contour reaches.
    """
    way = np.array([x[-1] - x[0], y[-1] - y[0]])
    length = np.hypot(*way)
    if not length > 0:
        return np.empty((0, 2))
    inwards = np.array([-way[1], way[0]]) / length
    height = np.max((x - x[0]) * inwards[0] + (y - y[0]) * inwards[1])
    if height <= ROUNDING * length:
        return np.empty((0, 2))
    return np.array([(x[-1], y[-1]), (x[0], y[0])]) + height * inwards


def _near(profile: AbstractProfile, reach: Scalar) -> tuple[Scalar, Scalar]:
    """Parameters between which the object is within reach of its lowest point, to either side."""
    lowest, ends = profile.lowest(), profile.ends()
    vertex = profile.point(lowest)

    def end(last: Scalar) -> Scalar:
        def within(share):
            at = profile.point(lowest + share * (last - lowest))
            return jnp.isfinite(at.y) & (jnp.abs(at.x - vertex.x) < reach)

        return lowest + bisect(within, 0.0, 1.0) * (last - lowest)

    return end(ends[0]), end(ends[1])
