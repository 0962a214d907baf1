"""Curvature of the object at a contact."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile, bisect


class Bend(NamedTuple):
    """How far the profile leads and how much it turns per parameter; the radius of curvature is their ratio.

    An edge turns without leading anywhere, and a straight face does not turn.
    """

    speed: Float[Array, ""]
    turn: Float[Array, ""]


def bend_of_each(profile: AbstractProfile, number: Int[Array, ""], contact: tuple[Scalar, Scalar, Scalar]) -> Bend:
    """The bend of the object with this number at a contact (x, y, slope angle); of any object if the number is 0."""
    found = []
    for k, one in enumerate(profile.objects, 1):
        # Objects that are not touched have a contact at their lowest point.
        at = (jnp.where(number == k, value, low) for value, low in zip(contact, (*one.vertex(), 0.0), strict=True))
        found.append(bend_at(one, *at))
    chosen = jnp.maximum(number - 1, 0)
    return jax.tree.map(lambda *values: jnp.stack(values)[chosen], *found)


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
    rate = jax.lax.stop_gradient(jax.grad(ahead)(parameter))
    for _ in range(2):  # steps from the solution, even with a constant rate, carry the first and second derivatives
        parameter = parameter - ahead(parameter) / rate

    at, rate = jax.jvp(profile.point, (parameter,), (jnp.ones_like(parameter),))
    return Bend(rate.x * at.cos + rate.y * at.sin, rate.sin * at.cos - rate.cos * at.sin)
