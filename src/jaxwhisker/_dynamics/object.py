"""Curvature of the object at a contact."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, bisect


class Bend(NamedTuple):
    """How far the profile leads and how much it turns per parameter; the radius of curvature is their ratio.

    An edge turns without leading anywhere, and a straight face does not turn.
    """

    speed: Float[Array, ""]
    turn: Float[Array, ""]


def bend_at(profile: AbstractProfile, x: Scalar, y: Scalar, slope: Scalar) -> Bend:
    """The bend of the profile at a contact point with this slope angle."""
    cos, sin, lowest = jnp.cos(slope), jnp.sin(slope), profile.lowest()

    def ahead(parameter):
        # Along the profile, either the slope or the position along the tangent grows.
        at = profile.point(parameter)
        turned = jnp.arctan2(at.sin * cos - at.cos * sin, at.cos * cos + at.sin * sin)
        return turned + (at.x - x) * cos + (at.y - y) * sin

    def before(parameter):
        here = ahead(parameter)
        return jnp.where(jnp.isfinite(here), here < 0, parameter < lowest)

    parameter = jax.lax.stop_gradient(bisect(before, *profile.ends()))
    for _ in range(2):  # Newton steps from the solution carry the first and second derivatives
        parameter = parameter - ahead(parameter) / jax.grad(ahead)(parameter)

    at, rate = jax.jvp(profile.point, (parameter,), (jnp.ones_like(parameter),))
    return Bend(rate.x * at.cos + rate.y * at.sin, rate.sin * at.cos - rate.cos * at.sin)
