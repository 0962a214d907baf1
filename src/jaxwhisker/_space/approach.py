"""Approach in space: where a scan begins, and where it ends if nothing happens.

A drive that moves along a line comes from afar. It starts where all whiskers are free, and where planes between them
and the object show that they stay free if it moves back any further. Other motions have a first and a last control.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._path.continuation import Limits
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space.stance import clearance, leaves

REACH = 2.0  # lengths of the longest whisker
HIGHEST_FORCE = 100.0  # EI/L^2 on every base, and the moment in EI/L; forces before a release hardly ever reach it
DISTANCES = tuple(2.0**k for k in range(8))  # lengths


def limits_of(problem: SpaceProblem, first_stop: Scalar) -> Limits:
    """The limits of a scan to a first stop, or right across the object if that is NaN."""
    whole = jnp.isnan(first_stop)
    if problem.ends is not None:
        first, last = problem.ends
        late = problem.onwards * (first_stop - first) > 0
        return Limits(jnp.where(whole | late, first, first_stop), last, last)
    middle = jnp.where(whole, _beside(problem), first_stop)
    ways, reach = problem.onwards * jnp.array([-1, 1]), jnp.stack([jnp.zeros(()), _reach(problem)])
    start, far = jax.vmap(_clear_of, (None, None, 0, 0))(problem, middle, ways, reach)
    return Limits(start, far, far)


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


def _clear_of(problem: SpaceProblem, u: Float[Array, ""], way: Array, least: Array) -> Float[Array, ""]:
    """The first of some controls, ever further in one direction, from which on whiskers are so far away."""
    places = u + way * jnp.array([0.0, *DISTANCES])

    def is_clear(u):
        return (clearance(problem, u) > least) & leaves(problem, u, way)

    clear = jax.vmap(is_clear)(places)
    return jnp.where(jnp.any(clear), places[jnp.argmax(clear)], places[-1])
