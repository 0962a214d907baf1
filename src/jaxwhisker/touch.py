"""First touch: where an unloaded whisker that comes from one side meets the object."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker import contact, rod
from jaxwhisker._types import Scalar
from jaxwhisker.contact import Body, Phase
from jaxwhisker.profile import AbstractProfile, ContactPoint
from jaxwhisker.whisker import Section

SHAFT_FIRST = 1e-12  # share of the length that must stand above the first contact to call it tangential
POINTS = 65  # of a curved whisker at which the first touch is looked for
SAME_HEIGHT = 1e-6  # by which whisker and object may miss each other there
NEWTON_STEPS = 8


class Touch(NamedTuple):
    """A contact that is about to begin; each (whiskers,) in a problem."""

    parameter: Float[Array, "*batch"]  # of the profile
    x: Float[Array, "*batch"]  # position of the base
    slack: Float[Array, "*batch"]  # as of any contact: see contact.py


def _angle(cos: rod.Along, sin: rod.Along, at: ContactPoint, side: Scalar) -> rod.Along:
    """Angle between a whisker of that direction and the object, as seen from the side that the whisker comes from."""
    return jnp.arctan2(sin * at.cos - cos * at.sin, side * (cos * at.cos + sin * at.sin))


def of_straight(profile: AbstractProfile, length: Scalar, side: Scalar) -> Touch:
    """The first touch of a straight whisker, which stands upright."""
    touch = profile.first_touch(length, side)
    at = profile.point(touch.parameter)
    beyond = length - touch.y
    # Upright, it never points below the tangent of an object that ends in a wall.
    angle = jnp.arctan2(jnp.abs(at.cos), side * at.sin)
    return Touch(touch.parameter, touch.x, jnp.where(beyond > SHAFT_FIRST * length, beyond, -angle))


def _unloaded(body: Body):
    """States of the unloaded whisker at points from the base, at the origin, to the tip."""
    assert isinstance(body.section, Section)
    zero = jnp.zeros_like(body.length)
    upright, nothing = (zero, zero, zero, zero + 1.0), rod.Load(None, zero, None)
    return rod.points(upright, -body.length, nothing, body.section, count=POINTS, from_base=zero)


def height(body: Body) -> Float[Array, ""]:
    """Height of the unloaded whisker's tip."""
    return _unloaded(body)[1][-1]


def of_curved(body: Body, side: Scalar) -> Touch:
    """The first touch of a curved whisker: with its tip, or where along its shaft it stands out most.

    Looked for at points of the whisker, then solved for with the equations of a contact without force.
    """
    x, y, cos, sin = _unloaded(body)
    touch = jax.vmap(lambda height: body.profile.first_touch(height, side))(y)
    at = jax.vmap(body.profile.point)(touch.parameter)
    meets = (y > body.profile.vertex()[1]) & (jnp.abs(touch.y - y) < SAME_HEIGHT)
    ahead = jnp.where(meets, side * (touch.x - x), -jnp.inf)
    k = jnp.argmax(ahead)
    angle = _angle(cos, sin, at, side)
    tip = (k == POINTS - 1) & (angle[-1] > 0)
    beyond = body.length * (1 - jnp.minimum(k, POINTS - 1.5) / (POINTS - 1))
    found = jnp.stack([touch.parameter[k], jnp.where(tip, -angle[-1], beyond)])
    found = jnp.where(jnp.any(meets), found, jnp.stack([touch.parameter[-1], -jnp.ones(())]))
    phase = jnp.where(tip, Phase.tip, Phase.tangential)

    def newton(_, found):
        value, gradient = contact.linearise(body, jnp.append(0.0, found), phase, side, rates=body.rod)
        (a, b), (c, d) = gradient.y[1:], gradient.cos[1:]
        step = jnp.stack([d * value.y - b * value.cos, a * value.cos - c * value.y]) / (a * d - b * c)
        return found - jnp.where(jnp.isfinite(step), step, 0.0)

    found = jax.lax.stop_gradient(jax.lax.fori_loop(0, NEWTON_STEPS, newton, found))
    # Each further step carries the derivatives of one more order.
    found = newton(0, newton(0, found))
    return Touch(found[0], contact.equations(body, jnp.append(0.0, found), phase, side).x, found[1])
