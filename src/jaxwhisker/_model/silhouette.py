"""The silhouette of an object: what pictures, films and pages draw of it."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._base import checks
from jaxwhisker._base.jit import COMPILER_OPTIONS
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, bisect

FAR = 3.0  # lengths beside the lowest point to where an object without an end is cut off
POINTS = 481


def silhouette(
    profile: AbstractProfile, length: Scalar, *, whole: bool = True, points: int = POINTS
) -> Float[jax.Array, "points 2"]:
    """Points of an object's contour from left to right below it, in the unit of the profile; NaN where it ends.

    Args:
        profile: the object.
        length: of the whiskers that touch it.
        whole: go all around what is closed.
        points: how many.
    """
    around = profile.around() if whole else None
    low, high = _near(profile, FAR * length) if around is None else around
    # Once around from beside the top: at the very top heights above the lowest point are 0/0.
    beside = 0.0 if around is None else 0.5 / (points - 1)
    at = jax.vmap(profile.point)(low + (high - low) * (jnp.linspace(0.0, 1.0, points) + beside))
    return jnp.stack([at.x, at.y], axis=-1)


def silhouette_of(
    profile: AbstractProfile, length: float, *, whole: bool = True
) -> tuple[Float[np.ndarray, " known"], Float[np.ndarray, " known"]]:
    """x and y of an object's contour as far as it is known; compiled once for all objects of one kind."""
    found = _compiled(jax.tree.map(checks.as_float, profile), jnp.asarray(length, dtype=float), whole)
    x, y = np.asarray(found).T
    known = np.isfinite(x) & np.isfinite(y)
    return x[known], y[known]


def _near(profile: AbstractProfile, reach: Scalar) -> tuple[Scalar, Scalar]:
    """Parameters between which the object is no farther to either side of its lowest point."""
    lowest, ends = profile.lowest(), profile.ends()
    vertex = profile.point(lowest)

    def end(last: Scalar) -> Scalar:
        def within(share):
            at = profile.point(lowest + share * (last - lowest))
            return jnp.isfinite(at.y) & (jnp.abs(at.x - vertex.x) < reach)

        return lowest + bisect(within, 0.0, 1.0) * (last - lowest)

    return end(ends[0]), end(ends[1])


_OPTIONS: Any = {"compiler_options": COMPILER_OPTIONS}
_compiled = eqx.filter_jit(lambda profile, length, whole: silhouette(profile, length, whole=whole), **_OPTIONS)
