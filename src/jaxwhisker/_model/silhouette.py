"""Silhouette of an object: points of its contour for figures, films and the explorer."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._base import checks
from jaxwhisker._base.jit import jit
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, bisect

FAR = 3.0  # lengths to either side of the lowest point at which an unbounded object is cut off
POINTS = 481


def silhouette(
    profile: AbstractProfile, length: Scalar, *, whole: bool = True, points: int = POINTS
) -> Float[jax.Array, "points 2"]:
    """Points of an object's contour along its lower side from left to right, in the unit of the profile.

    Args:
        profile: the object.
        length: of the whiskers; an unbounded object is cut off at a multiple of it.
        whole: follow a closed contour all around.
        points: number of points.

    Returns:
        x and y of each point; NaN beyond the ends of the object.
    """
    around = profile.around() if whole else None
    low, high = _near(profile, FAR * length) if around is None else around
    # Start beside the top: at the top itself, heights above the lowest point are 0/0.
    beside = 0.0 if around is None else 0.5 / (points - 1)
    at = jax.vmap(profile.point)(low + (high - low) * (jnp.linspace(0.0, 1.0, points) + beside))
    return jnp.stack([at.x, at.y], axis=-1)


def silhouette_of(
    profile: AbstractProfile, length: float, *, whole: bool = True
) -> tuple[Float[np.ndarray, " known"], Float[np.ndarray, " known"]]:
    """x and y of an object's contour, without NaN; compiled once for all objects of one kind."""
    points = _compiled(jax.tree.map(checks.as_float, profile), jnp.asarray(length, dtype=float), whole)
    x, y = np.asarray(points).T
    known = np.isfinite(x) & np.isfinite(y)
    return x[known], y[known]


def _near(profile: AbstractProfile, reach: Scalar) -> tuple[Scalar, Scalar]:
    """Parameters between which the object stays within a horizontal distance of its lowest point."""
    lowest, ends = profile.lowest(), profile.ends()
    vertex = profile.point(lowest)

    def end(last: Scalar) -> Scalar:
        def within(share):
            at = profile.point(lowest + share * (last - lowest))
            return jnp.isfinite(at.y) & (jnp.abs(at.x - vertex.x) < reach)

        return lowest + bisect(within, 0.0, 1.0) * (last - lowest)

    return end(ends[0]), end(ends[1])


_compiled = jit(lambda profile, length, whole: silhouette(profile, length, whole=whole))
