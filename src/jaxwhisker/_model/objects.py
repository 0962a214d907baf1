"""Several objects in one scene."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile


class Objects(AbstractProfile):
    """Several objects as one profile: `Scene` makes it of a tuple of profiles.

    The pieces of all objects are numbered one after the other, and a smooth object is one piece. The piece of a contact
    therefore tells which object it is on. Each piece keeps the parameter of its own object.
    """

    each: tuple[AbstractProfile, ...]
    # A parameter of each object, at which it is evaluated for contacts on another; None in the scene's own units.
    placeholder_parameter: tuple[Scalar, ...] | None = None

    def canonical(self):
        return Objects(tuple(one.canonical() for one in self.each), self.placeholder_parameter)

    @property
    def objects(self):
        return self.each

    @property
    def has_edges(self):
        return any(one.has_edges for one in self.each)

    @property
    def is_concave(self):
        return any(one.is_concave for one in self.each)

    @property
    def has_pieces(self):
        return True

    def first_pieces(self) -> tuple[int, ...]:
        """Number of the first piece of each object."""
        return tuple(int(first) for first in np.cumsum([0, *map(_pieces, self.each)])[:-1])

    def object_of(self, piece):
        if piece is None:
            return None
        owners = np.repeat(np.arange(len(self.each)), [_pieces(one) for one in self.each])
        return jnp.asarray(owners)[piece]

    def on(self, piece):
        return self if piece is None else OneOf(self.each, self.placeholder_parameter, piece)

    def ends_on(self, piece):
        far = jnp.full(1, jnp.inf)
        breaks = [one.breaks() for one in self.each]
        low = jnp.concatenate([part for own in breaks for part in (-far, own)])
        high = jnp.concatenate([part for own in breaks for part in (own, far)])
        return low[piece], high[piece]

    def point_on(self, piece, parameter):
        return self._own(lambda one, piece, parameter: one.point_on(piece, parameter), piece, parameter)

    def convex_on(self, piece, parameter):
        return self._own(lambda one, piece, parameter: one.convex_on(piece, parameter), piece, parameter)

    def _own(self, function, piece: Int[Array, ""] | None, parameter: Scalar):
        """A function of the object, the piece of this object, and its parameter, at a contact.

        Objects that differ in numbers only are one object whose numbers are chosen, which compiles faster.
        """
        number, firsts, values = self.object_of(piece), self.first_pieces(), []
        assert piece is not None and number is not None and self.placeholder_parameter is not None
        kinds = [own for own, _ in of_one_kind(self.each)]
        for own in kinds:
            index = jnp.asarray([own.index(k) if k in own else 0 for k in range(len(firsts))])[number]
            mine = [(self.each[k], firsts[k], self.placeholder_parameter[k]) for k in own]
            one, first, placeholder = mine[0] if len(own) == 1 else numbered(index, mine)
            among = jnp.clip(piece - first, 0, _pieces(one) - 1) if one.has_pieces else None
            is_one = jnp.asarray(np.isin(np.arange(len(firsts)), own))[number]
            values.append(function(one, among, jnp.where(is_one, parameter, placeholder)))
        kind = jnp.asarray([[k in own for own in kinds].index(True) for k in range(len(firsts))])[number]
        return numbered(kind, values)

    def vertex(self):
        x, y = (jnp.stack([jnp.asarray(v, dtype=float) for v in vs]) for vs in zip(*self._vertices(), strict=True))
        lowest = jnp.argmin(y)
        return x[lowest], y[lowest]

    def _vertices(self):
        return [one.vertex() for one in self.each]

    def in_unit(self, length):
        each = tuple(one.in_unit(length) for one in self.each)
        return Objects(each, tuple(jax.lax.stop_gradient(jnp.asarray(one.lowest(), dtype=float)) for one in each))

    def valid(self):
        return jnp.all(jnp.stack([one.valid() for one in self.each]))

    def _positive(self):
        return [value for one in self.each for value in one._positive()]

    # Contacts are on one object, which is asked for its own curve.

    def point(self, parameter):
        raise NotImplementedError

    def first_touch(self, height, side):
        raise NotImplementedError

    def __str__(self):
        return "; ".join(map(str, self.each))


def of_one_kind(objects: Sequence[Any]) -> list[tuple[list[int], Any]]:
    """Objects that differ in numbers only: their indices, and all of them as one object with a leading axis."""
    kinds: dict[Any, list[int]] = {}
    for k, one in enumerate(objects):
        leaves, structure = jax.tree.flatten(one)
        kinds.setdefault((structure, tuple(map(jnp.shape, leaves))), []).append(k)

    def stacked(*leaves):
        return jnp.stack(jnp.broadcast_arrays(*leaves))

    return [(own, jax.tree.map(stacked, *(objects[k] for k in own))) for own in kinds.values()]


def of_each_object(profile: Objects, function: Callable[[Any, Int[Array, ""]], Any]) -> list[Any]:
    """A function of each object and the number of its first piece.

    Objects that differ in numbers only are computed together, which compiles faster.
    """
    firsts, each = profile.first_pieces(), {}
    for numbers, stacked in of_one_kind(profile.objects):
        if len(numbers) == 1:
            each[numbers[0]] = function(profile.objects[numbers[0]], jnp.asarray(firsts[numbers[0]]))
            continue
        found = jax.vmap(function)(stacked, jnp.asarray([firsts[k] for k in numbers]))
        each |= {k: jax.tree.map(lambda leaf, j=j: leaf[j], found) for j, k in enumerate(numbers)}
    return [each[k] for k in range(len(firsts))]


class OneOf(Objects):
    """The object with a piece, of several smooth ones."""

    piece: Int[Array, ""] | None = None

    def point(self, parameter):
        return self.point_on(self.piece, parameter)


def numbered(number: Int[Array, ""], values: list[Any]) -> Any:
    """The one with this number of the trees `values`."""
    chosen = values[0]
    for k, value in enumerate(values[1:], 1):
        is_it = number == k
        chosen = jax.tree.map(lambda a, b, is_it=is_it: jnp.where(is_it, b, a), chosen, value)
    return chosen


def _pieces(profile: AbstractProfile) -> int:
    return 1 + jax.eval_shape(profile.breaks).shape[0]


def as_one(profile: Any) -> Any:
    """A tuple of profiles as one profile; anything else stays as it is."""
    if not isinstance(profile, tuple) or not all(isinstance(one, AbstractProfile) for one in profile):
        return profile
    each = tuple(one for some in profile for one in some.objects)
    return Objects(each) if len(each) > 1 else each[0] if each else profile
