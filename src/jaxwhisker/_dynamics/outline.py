"""The outline of one or several objects, on which closest points are sought: curves with one parameter."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile

APART = 10.0  # between the parameters of two objects


class ObjectChain(AbstractProfile):
    """Several objects, whose parameters lie one after the other."""

    each: tuple[AbstractProfile, ...]
    shift: tuple[Scalar, ...]  # of the parameters of each object

    @property
    def has_edges(self):
        return any(one.has_edges for one in self.each)

    @property
    def objects(self):
        return self.each

    def point(self, parameter):
        return self._own(lambda one, own: one.point(own), parameter)

    def piece_at(self, parameter):
        # A smooth object is an arc, and has an odd number.
        return self._own(lambda one, own: one.piece_at(own) if one.has_edges else jnp.asarray(1), parameter)

    def _own(self, function: Callable[[AbstractProfile, Scalar], Any], parameter: Scalar) -> Any:
        """A function of the object with this parameter and of its own parameter."""
        number = number_of(self, jax.lax.stop_gradient(jnp.asarray(parameter)))
        values = []
        for k, (one, shift) in enumerate(zip(self.each, self.shift, strict=True)):
            # Other objects are evaluated at their lowest points.
            values.append(function(one, jnp.where(number == k, parameter - shift, jax.lax.stop_gradient(one.lowest()))))
        chosen = values[0]
        for k, value in enumerate(values[1:], 1):
            chosen = jax.tree.map(lambda a, b, k=k: jnp.where(number == k, b, a), chosen, value)
        return chosen

    def ends(self):
        (first, _), (_, last) = self.each[0].span(), self.each[-1].span()
        return first + self.shift[0], last + self.shift[-1]

    # Nothing else is asked of the outline: it is made in the unit of the problem, after all checks.

    def first_touch(self, height, side):
        raise NotImplementedError

    def vertex(self):
        raise NotImplementedError

    def in_unit(self, length):
        raise NotImplementedError

    def _positive(self):
        raise NotImplementedError

    def __str__(self):
        return "; ".join(map(str, self.each))


def outline(profile: AbstractProfile) -> AbstractProfile:
    """The outline of all objects."""
    if len(profile.objects) == 1:
        return profile
    shifts, free = [], jnp.zeros(())
    for one in profile.objects:
        first, last = (jax.lax.stop_gradient(jnp.asarray(end, dtype=float)) for end in one.span())
        shifts.append(free - first)
        free = free + last - first + APART
    return ObjectChain(profile.objects, tuple(shifts))


def objects_at(
    profile: AbstractProfile, parameter: Float[Array, ""]
) -> list[tuple[AbstractProfile, Float[Array, ""], Bool[Array, ""]]]:
    """Each object, a parameter on it, and whether it is the one that this parameter of the outline belongs to."""
    if not isinstance(profile, ObjectChain):
        return [(profile, parameter, jnp.asarray(True))]
    number, found = number_of(profile, parameter), []
    for k, (one, shift) in enumerate(zip(profile.each, profile.shift, strict=True)):
        found.append((one, jnp.where(number == k, parameter - shift, one.lowest()), number == k))
    return found


def samples(profile: AbstractProfile, count: int) -> Float[Array, " parameters"]:
    """Parameters of `count` points of each object."""
    if not isinstance(profile, ObjectChain):
        return jnp.linspace(*profile.span(), count)
    each = [jnp.linspace(*one.span(), count) + shift for one, shift in zip(profile.each, profile.shift, strict=True)]
    return jnp.concatenate(each)


def number_of(profile: AbstractProfile, parameter: Float[Array, "*batch"]) -> Int[Array, "*batch"]:
    """The object with this parameter, an index into `objects`."""
    number = jnp.zeros(jnp.shape(parameter), int)
    if isinstance(profile, ObjectChain):
        for one, shift in zip(profile.each[1:], profile.shift[1:], strict=True):
            number += jnp.asarray(parameter > one.span()[0] + shift - APART / 2).astype(int)
    return number
