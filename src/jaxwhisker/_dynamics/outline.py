"""The outline of one or several objects, on which closest points are sought: curves with one parameter."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.objects import Objects, numbered
from jaxwhisker._model.profile import AbstractProfile

APART = 10.0  # between the parameters of two objects


class ObjectChain(Objects):
    """Several objects as one curve: their parameters lie one after the other."""

    shift: tuple[Scalar, ...] = ()  # of the parameters of each object

    def point(self, parameter):
        return self._at(lambda one, own: one.point(own), parameter)

    def piece_at(self, parameter):
        # A smooth object is an arc, and has an odd number.
        return self._at(lambda one, own: one.piece_at(own) if one.has_edges else jnp.asarray(1), parameter)

    def _at(self, function: Callable[[AbstractProfile, Scalar], Any], parameter: Scalar) -> Any:
        """A function of the object with this parameter and of its own parameter."""
        at = jnp.asarray(parameter)
        return numbered(number_of(self, at), [function(one, own) for one, own, _ in objects_at(self, at)])

    def ends(self):
        (first, _), (_, last) = self.each[0].span(), self.each[-1].span()
        return first + self.shift[0], last + self.shift[-1]


def outline(profile: AbstractProfile) -> AbstractProfile:
    """The outline of all objects, which are in the unit of the problem."""
    if not isinstance(profile, Objects):
        return profile
    shifts, free = [], jnp.zeros(())
    for one in profile.each:
        first, last = (jax.lax.stop_gradient(jnp.asarray(end, dtype=float)) for end in one.span())
        shifts.append(free - first)
        free = free + last - first + APART
    return ObjectChain(profile.each, profile.placeholder_parameter, tuple(shifts))


def objects_at(
    profile: AbstractProfile, parameter: Float[Array, ""]
) -> list[tuple[AbstractProfile, Float[Array, ""], Bool[Array, ""]]]:
    """Each object, a parameter on it, and whether it is the one that this parameter of the outline belongs to."""
    if not isinstance(profile, ObjectChain):
        return [(profile, parameter, jnp.asarray(True))]
    assert profile.placeholder_parameter is not None
    number, found = number_of(profile, parameter), []
    for k, each in enumerate(zip(profile.each, profile.shift, profile.placeholder_parameter, strict=True)):
        one, shift, placeholder = each
        found.append((one, jnp.where(number == k, parameter - shift, placeholder), number == k))
    return found


def samples(profile: AbstractProfile, count: int) -> Float[Array, " parameters"]:
    """Parameters of `count` points of each object."""
    if not isinstance(profile, ObjectChain):
        return jnp.linspace(*profile.span(), count)
    each = [jnp.linspace(*one.span(), count) + shift for one, shift in zip(profile.each, profile.shift, strict=True)]
    return jnp.concatenate(each)


def number_of(profile: AbstractProfile, parameter: Float[Array, "*batch"]) -> Int[Array, "*batch"]:
    """The object with this parameter, an index into `objects`."""
    parameter = jax.lax.stop_gradient(jnp.asarray(parameter))
    number = jnp.zeros(parameter.shape, int)
    if isinstance(profile, ObjectChain):
        for one, shift in zip(profile.each[1:], profile.shift[1:], strict=True):
            number += jnp.asarray(parameter > one.span()[0] + shift - APART / 2).astype(int)
    return number
