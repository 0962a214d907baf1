"""Second contacts: a shaft dips into the object that it touches, or into another one.

A small object may be passed between two states; the side on which the shaft passes it tells.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.clearance import DEPTH, clear_of_tangent, clear_of_tangents, least_gap
from jaxwhisker._equilibrium.shaft import Shaft, cells_of
from jaxwhisker._model.profile import AbstractProfile

PARTS = 4  # of each cell of a shaft, which are almost straight
Truth = Bool[Array, ""]
CHORD = 0.01  # more than the distance between a shaft and its chords


def meets(
    profile: AbstractProfile, own: Shaft, touches: Truth, parameter: Scalar, here: Truth | None = None
) -> Bool[Array, ""]:
    """Whether a shaft dips into an object by more than `DEPTH`, without derivatives; false unless it `touches` any.

    The shaft touches this object at this parameter; if `here` is false, it touches another one, and this is the
    parameter of the lowest point.
    """
    return touches & (least_gap(profile, _divided(cells_of(own)), parameter, here, enough=-DEPTH) < -DEPTH)


def dips(
    profile: AbstractProfile, own: Shaft, touches: Truth, parameter: Scalar, here: Truth | None = None
) -> Bool[Array, ""]:
    """Whether a shaft crosses the tangent at its contact, which it does if it `meets` the object."""
    crosses = ~jnp.all(clear_of_tangent(profile, cells_of(own), parameter))
    return touches & (crosses if here is None else crosses | ~here)


def may_meet(
    profile: AbstractProfile, own: Shaft, touches: Truth, parameter: Scalar, here: Truth | None = None
) -> Bool[Array, ""]:
    """Whether a shaft crosses tangents near its nearest points, which it does if it `meets` the object."""
    del here
    return touches if profile.faces() is not None else touches & ~clear_of_tangents(profile, cells_of(own), parameter)


def _divided(cells: Cubic) -> Cubic:
    """The parts of cells, as cells."""
    t = jnp.arange(PARTS + 1)[:, None, None] / PARTS
    value, rate = cells.value(t), cells.rate(t) / PARTS
    parts = Cubic(value[:-1], value[1:], rate[:-1], rate[1:])
    return jax.tree.map(lambda leaf: jnp.reshape(jnp.swapaxes(leaf, 0, 1), (-1, 2)), parts)


def passes(profile: AbstractProfile, own: Shaft) -> Float[Array, ""]:
    """The side (+1 right, -1 left) on which a shaft passes the lowest point of an object; 0 if below it or close by."""
    x, y = (jnp.concatenate([getattr(own.to_base, name)[::-1], getattr(own.to_tip, name)]) for name in ("x", "y"))
    lowest_x, lowest_y = profile.vertex()
    crosses = (y[:-1] < lowest_y) & (y[1:] >= lowest_y)
    first = jnp.argmax(crosses)
    rise = jnp.where(crosses[first], y[first + 1] - y[first], 1.0)
    right = x[first] + (lowest_y - y[first]) / rise * (x[first + 1] - x[first]) - lowest_x
    return jnp.where(crosses[first] & (jnp.abs(right) > CHORD), jnp.sign(right), 0.0)
