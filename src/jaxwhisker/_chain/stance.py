"""Stance: which contacts may begin, and whether those that exist are as the equations assume."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState, Segments, chain_of, objects_of_body
from jaxwhisker._chain.gaps import Candidate, Gaps, gaps_of
from jaxwhisker._chain.march_state import ChainStance
from jaxwhisker._chain.newton import of_whiskers
from jaxwhisker._chain.problem import BasePoses, ChainProblem
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._chain.shaft import BaseAt, WholeShaft, shaft_of
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject, of_each

FLAT = 1e-8  # difference of curvatures that may be rounding


def bases_of(problem: ChainProblem, u: Scalar, pose: BasePoses) -> BaseAt:
    """Where bases with these coordinates are; fields (whiskers,)."""
    at = problem.in_scene(u, pose)
    return BaseAt(at.x, at.y, -jnp.sin(at.angle), jnp.cos(at.angle))


def shafts_of(problem: ChainProblem, u: Scalar, pose: BasePoses, z: RowsOfContacts, state: ChainState) -> WholeShaft:
    """The shafts of all whiskers; fields (whiskers, ...)."""
    own = of_whiskers(problem, (z, state))

    def one(body: WhiskerAtObject, z, state, base) -> WholeShaft:
        return shaft_of(body, chain_of(body, z, state), state, base)

    return of_each(problem.bodies(u), one, *own, bases_of(problem, u, pose))


def stance_of(
    problem: ChainProblem, u: Scalar, pose: BasePoses, z: RowsOfContacts, state: ChainState
) -> tuple[ChainStance, Candidate]:
    """The stance at a point of the path, and the contacts that may begin."""
    bodies = problem.bodies(u)

    def one(body: WhiskerAtObject, z, state, base) -> tuple[Gaps, Bool[Array, ""], Array]:
        chain = chain_of(body, z, state)
        shaft = shaft_of(body, chain, state, base)
        return gaps_of(objects_of_body(body), shaft, body.length), opens(body, chain, state, shaft), chain.parameter

    gaps, open_, parameter = of_each(bodies, one, *of_whiskers(problem, (z, state)), bases_of(problem, u, pose))

    def places(u):
        at = problem.in_scene(u, problem.rest)
        tip = problem.length
        return jnp.stack([at.x, at.y, at.x - tip * jnp.sin(at.angle), at.y + tip * jnp.cos(at.angle)])

    rates = jax.jvp(places, (u,), (jnp.ones_like(u),))[1]
    speed = jnp.sqrt(jnp.max(jnp.maximum(rates[0] ** 2 + rates[1] ** 2, rates[2] ** 2 + rates[3] ** 2)))
    outside = jnp.all(gaps.base > 0)
    gap, parameter = gaps.candidates.gap, jnp.where(state.touches, jnp.ravel(parameter), 0.0)
    return ChainStance(gap, gaps.distance, outside, jnp.all(open_), speed, parameter), gaps.candidates


def opens(body: WhiskerAtObject, chain: Segments, state: ChainState, shaft: WholeShaft) -> Bool[Array, ""]:
    """Whether object and shaft part on both sides of every contact on the shaft."""
    at, piece = chain.contact, jnp.where(state.touches, state.piece, 0)

    def bend(piece, p):
        rate = jax.jvp(lambda p: body.profile.point_on(piece, p), (p,), (jnp.ones_like(p),))[1]
        return rate

    rate = jax.vmap(bend)(piece, chain.parameter)
    speed, turn = rate.x * at.cos + rate.y * at.sin, rate.sin * at.cos - rate.cos * at.sin
    # Towards the object, the normal of the whisker's direction is on its left if it runs along the object's tangent.
    kappa = shaft.curvature[1:, 0] * state.side
    # The object leaves its tangent by curvature / 2 upwards; the shaft must leave it less, or downwards.
    # A straight shaft may lie on a face.
    return jnp.all((state.phase != Phase.tangential) | (turn - kappa * speed > -FLAT))
