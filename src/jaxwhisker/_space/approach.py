"""Approach in space: where a scan begins, and where it ends if nothing happens.

A drive that moves along a line comes from afar. It starts where all whiskers are free, and where planes between them
and the object show that they stay free if it moves back any further. Before objects without such planes, balls show it
as far as the places reach. Whiskers that may be in a hollow start at the first position of the control if they are
clear there. Other motions have a first and a last control.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._path.continuation import Limits
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space.stance import clearance, distance, leaves

REACH = 2.0  # lengths of the longest whisker
HIGHEST_FORCE = 100.0  # EI/L^2 on every base, and the moment in EI/L; forces before a release hardly ever reach it
CLEAR = 1e-9  # lengths: distance of whiskers that are clear of an object
# Distances from the middle of the object, in lengths: with planes, and so dense that balls cover what is between them.
FEW = np.array([0.0, *(2.0**k for k in range(8))])
MANY = np.concatenate([0.05 * np.arange(10), 0.5 * 1.1 ** np.arange(59)])


def limits_of(problem: SpaceProblem, first_stop: Scalar) -> Limits:
    """The limits of a scan to a first stop, or right across the object if that is NaN."""
    whole = jnp.isnan(first_stop)
    if problem.ends is not None:
        first, last = problem.ends
        late = problem.onwards * (first_stop - first) > 0
        return Limits(jnp.where(whole | late, first, first_stop), last, last)
    middle = jnp.where(whole, _beside(problem), first_stop)
    ways, reach = problem.onwards * jnp.array([-1, 1]), jnp.stack([jnp.zeros(()), _reach(problem)])
    (start, far), known = jax.vmap(_clear_of, (None, None, 0, 0))(problem, middle, ways, reach)
    if problem.contacts > 1 or not all(one.is_convex for one in problem.surface.objects):
        start = jnp.where(~whole & (distance(problem, middle) > CLEAR), middle, start)
    return Limits(start, far, far, known[0])


def _reach(problem: SpaceProblem) -> Float[Array, ""]:
    """Distance of unloaded whiskers from the object at which loaded ones have come free, too."""
    lengths = REACH * jnp.max(problem.length)
    if problem.springs is None:
        return lengths
    hardest = jnp.full_like(problem.springs.offset, HIGHEST_FORCE)
    return lengths + jnp.max(jnp.abs(problem.displacement(hardest)[:, :3]))


def _beside(problem: SpaceProblem) -> Float[Array, ""]:
    """The control at which the bases are beside the middle of the object."""

    def position(u):
        return jnp.mean(problem.drive(u).position + problem.mount.position, axis=0)

    zero = jnp.zeros(())
    at, rate = jax.jvp(position, (zero,), (jnp.ones(()),))
    return jnp.sum((problem.surface.interior_point() - at) * rate) / jnp.sum(rate**2)


def _clear_of(
    problem: SpaceProblem, u: Float[Array, ""], way: Array, least: Array
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """The first of some controls, ever further in one direction, from which on whiskers are so far away.

    The last one if there is none, and whether there is one.
    """
    planes = problem.surface.has_planes
    distances = FEW if planes else MANY
    places = u + way * distances
    room = jax.vmap(lambda u: clearance(problem, u))(places)
    if planes:
        stay = jax.vmap(lambda u: leaves(problem, u, way))(places)
    else:  # balls at neighbouring places overlap from here on
        apart = np.diff(distances)
        covered = jnp.append(room[1:] + room[:-1] > apart, 2 * room[-1] > apart[-1])
        stay = jax.lax.cummin(covered.astype(int), reverse=True) > 0
    good = (room > least) & stay
    return jnp.where(jnp.any(good), places[jnp.argmax(good)], places[-1]), jnp.any(good)
