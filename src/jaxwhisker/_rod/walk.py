"""Walks along a rod past the places where forces, moments and springs act on it.

A rod is integrated from place to place. What acts at a place may depend on where the rod is, which is known when the
walk gets there. Beyond the place, the load on the rod is another one. Rods in the plane and in space, walks towards the
base and away from it, differ in two functions: how the rod is integrated, and how a place changes the load.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.rod import Along, Load

Tree = TypeVar("Tree")
State = TypeVar("State")
Loading = TypeVar("Loading")
Place = TypeVar("Place")
Part = Scalar | Float[Array, "*forces"]


class Order(NamedTuple):
    """Places of several kinds along a rod, in the order in which a walk passes them."""

    at: Float[Array, " places"]  # arc lengths from the base
    ranks: tuple[Int[Array, "..."], ...]  # of the places of each kind

    def spread(self, kind: int, tree: Tree) -> Tree:
        """Fields of the places of one kind as fields of all places, which are zero at the others."""
        rank = self.ranks[kind]
        return jax.tree.map(
            lambda leaf: jnp.zeros_like(leaf, shape=(self.at.size, *leaf.shape[1:])).at[rank].set(leaf), tree
        )


def in_order(*kinds: Array, outwards: bool = False) -> Order:
    """Places of several kinds from the tip to the base, or outwards.

    Of places that coincide, those of the first kind come first, and those of the same kind stay in their order.
    """
    at = jnp.concatenate(kinds)
    key = jax.lax.stop_gradient(at)
    order = jnp.argsort(key if outwards else -key, stable=True)
    ranks = jnp.split(jnp.argsort(order), np.cumsum([kind.size for kind in kinds])[:-1])
    return Order(at[order], tuple(ranks))


NO_POINTS = np.zeros(0)  # on stretches


class Stretches(NamedTuple):
    """Loads from the top of a whisker to its base, and points on the stretches between them."""

    at: Float[Array, " places"]  # arc lengths of all, from the top to the base
    loads: Int[np.ndarray, " loads"]  # indices of the loads
    points: Int[np.ndarray, " points"]  # indices of the points
    lengths: Float[Array, " stretches"]


def stretches(position: Float[Array, " loads"], share: Float[np.ndarray, " share"], *, beyond: bool) -> Stretches:
    """Points on the stretches from load to load, and from the last load to the base.

    Args:
        position: arc lengths of loads, from the tip to the base.
        share: points as fractions of each stretch, increasing from 0 to 1; each load lies between the last point of the
            stretch before it and the first one of the stretch behind it.
        beyond: whether there is a stretch beyond the outermost load too: the top is the tip of a whisker of length 1.
    """
    starts = jnp.concatenate([jnp.ones(1 if beyond else 0), position])
    ends = jnp.append(starts[1:], 0.0)
    # Rounding must not exchange points and loads, also on a stretch without length.
    inside = jnp.where(share == 1, ends[:, None], starts[:, None] + (ends - starts)[:, None] * share)
    at = jnp.ravel(jnp.concatenate([starts[:, None], inside], axis=1))
    at = at if np.any(share == 1) else jnp.append(at, 0.0)
    first = np.arange(starts.size) * (1 + share.size)  # of each stretch
    points = (first[:, None] + 1 + np.arange(share.size)).ravel()
    return Stretches(at, first[1:] if beyond else first, points, starts - ends)


class Walk(NamedTuple):  # not generic: types of its fields could not be checked then
    """The end of a walk, and the rod just before each place to which there is a way."""

    end: Any  # state where the walk ends
    load: Any  # there
    passed: Any  # states at the places
    loads: Any  # in front of the places
    ways: Any  # what is kept of the way to each place


def walk(
    onwards: Callable[[State, Loading, Scalar, Scalar], tuple[State, Loading, Any]],
    past: Callable[[Loading, State, Place], Loading],
    start: State,
    load: Loading,
    stops: Along,
    places: Place,
    *,
    s: Scalar | None = None,
) -> Walk:
    """Follow a rod past places.

    Args:
        onwards: state of the rod and load on it at the next place, and what is kept of the way there, from state and
            load behind a place and the arc lengths of both.
        past: load on the rod behind a place, from the load in front of it and the state there.
        start: state of the rod where the walk begins.
        load: on the rod there.
        stops: arc lengths of the places from the base, in the order in which they are passed.
        places: what acts there; stacked.
        s: arc length where the walk begins. Default: at the first place; there is no way to it.
    """

    def piece(carry, each):
        (state, load, s), (stop, place) = carry, each
        state, load, way = onwards(state, load, s, stop)
        state, load = jax.tree.map(jnp.asarray, (state, load))
        return (state, past(load, state, place), stop), (state, load, way)

    start, load = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float), (start, load))
    if s is None:
        s, stops = stops[0], stops[1:]
        load = past(load, start, jax.tree.map(lambda leaf: leaf[0], places))
        places = jax.tree.map(lambda leaf: leaf[1:], places)
    carry = start, load, jnp.asarray(s, dtype=float)
    (end, load, _), (passed, loads, ways) = jax.lax.scan(piece, carry, (stops, places))
    return Walk(end, load, passed, loads, ways)


def pressed(point: tuple[Part, Part], force_x: Part, force_y: Part, turn: Part | None = None) -> Load:
    """The load of a force that acts at a point in the plane, and of a moment; or of each of several forces."""
    x, y = point
    about_origin = x * force_y - y * force_x
    return Load(force_x, force_y, about_origin if turn is None else about_origin + turn)
