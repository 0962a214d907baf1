"""Jumps among objects that are not one convex body: which one a whisker meets on its way, and where it lands there.

The way of a jump is not known. Shapes between those before and after stand for it: their tangents turn evenly.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._space.contact import FORCE, POINT, Contact
from jaxwhisker._space.free import INTERVALS, TIP, CentreLine, contact_at, in_scene, nearest_place
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import Contacts, SpaceProblem, of_each
from jaxwhisker._space.residuals import residuals
from jaxwhisker._space.shape import shape
from jaxwhisker._space.stance import base_placement

DEPTH = 1e-6  # lengths: shafts that are deeper inside an object touch it
LANDING = 1e-3  # lengths: shapes on the way to where whiskers land are not deeper inside that object
STRIDE, SECTIONS = 1 / 64, 8  # of the way, by which a tip moves by less than 0.03 lengths; strides are divided by 8
FINEST = STRIDE / SECTIONS**4 / 2  # of the way
Side = tuple[Contacts, Phases]  # the contacts before or after a jump


class _Way(NamedTuple):
    """The way of one whisker."""

    before: CentreLine
    after: CentreLine
    side: Float[Array, "points 3"]  # first directors of the unloaded whisker
    touched: Bool[Array, " objects"]  # before
    lands: Bool[Array, " objects"]  # whether it touches the object afterwards

    def at(self, share: Scalar) -> CentreLine:
        """A shape on the way."""
        spacing = self.before.spacing

        def integrated(tangent: Float[Array, "points 3"]) -> Float[Array, "points 3"]:
            steps = spacing * (tangent[:-1] + tangent[1:]) / 2
            return jnp.concatenate([jnp.zeros((1, 3)), jnp.cumsum(steps, axis=0)])

        def blend(one: Array, other: Array) -> Array:
            return one + share * (other - one)

        tangent = blend(self.before.tangent, self.after.tangent)
        tangent = tangent / jnp.sqrt(jnp.sum(tangent**2, axis=1, keepdims=True))
        # What the sums miss is little, and vanishes at both ends of the way.
        missed = blend(*(line.position - integrated(line.tangent) for line in (self.before, self.after)))
        return CentreLine(integrated(tangent) + missed, tangent, spacing)


def distances(surface: AbstractSurface, line: CentreLine) -> Float[Array, " objects"]:
    """Distances of a whisker from every object."""

    def distance(one: AbstractSurface) -> Scalar:
        cubic, t = line.interval(nearest_place(one, line))
        return one.ball_before(cubic.value(t))[0]

    return surface.of_each(distance)


class Met(NamedTuple):
    """The first object that whiskers meet on their way; fields (whiskers, ...)."""

    some: Bool[Array, " whiskers"]  # whether there is one
    contact: Contacts  # that begins there


def met_on_the_way(problem: SpaceProblem, u: Scalar, before: Side, after: Side, jumps: Bool[Array, ""]) -> Met:
    """What whiskers meet on their way that they do not touch before; nothing unless there is a jump.

    An object that they touch afterwards counts if they have passed through it, to its far side. One that is not convex
    counts as soon as they have left it, although they touch it before.
    """
    surface = problem.surface
    may_return = np.array([not own.is_convex for own in surface.objects])

    def one(way: _Way, z: Contact) -> Met:
        allowed = jnp.where(way.lands, LANDING, DEPTH)

        def depths(share: Scalar) -> Float[Array, " objects"]:
            return -distances(surface, way.at(share)) - allowed

        def searching(state: _OnTheWay) -> Bool[Array, ""]:
            return jumps & (state.start < 1.0) & (state.stride > FINEST)

        def search(state: _OnTheWay) -> _OnTheWay:
            places = state.start + state.stride * np.arange(1, SECTIONS + 1)
            each, counts, after = jax.vmap(depths)(places), state.counts, state.counts
            if may_return.any():
                left = may_return & ~way.lands & (jax.lax.cummin(each, axis=0) <= 0.0)
                after = counts | jnp.concatenate([jnp.zeros_like(left[:1]), left])
                counts = after[:-1]
            deep = ~(jnp.max(jnp.where(counts, each, -jnp.inf), axis=1) <= 0.0)
            some, first = jnp.any(deep), jnp.argmax(deep)
            return _OnTheWay(
                jnp.where(some, state.start + state.stride * first, places[-1]),
                jnp.where(some, state.stride / SECTIONS, state.stride),
                state.found | some,
                after[jnp.where(some, first, -1)] if may_return.any() else after,
            )

        # A loop that does nothing without a jump, also among other scans.
        start = _OnTheWay(jnp.zeros(()), jnp.asarray(STRIDE), jnp.asarray(False), ~way.touched)
        found = jax.lax.while_loop(searching, search, start)
        share = jnp.minimum(found.start + SECTIONS * found.stride, 1.0)
        line = way.at(share)

        def contact(one: AbstractSurface) -> Contact:
            place = nearest_place(one, line)
            cubic, t = line.interval(place)
            distance, out = one.ball_before(cubic.value(t))
            tangent = cubic.rate(t) / jnp.sqrt(jnp.sum(cubic.rate(t) ** 2))
            side = way.side[jnp.round(place).astype(int)] if problem.rolls else None
            beyond = jnp.where(place >= INTERVALS - TIP, 0.0, (INTERVALS - place) * line.spacing)
            begins = contact_at(cubic.value(t) - distance * out, out, tangent, side, beyond)
            # It is as if the load had fallen as far as the whisker has come.
            return begins.at[FORCE].set((1 - share) * z[FORCE])

        deepest = jnp.argmax(jnp.where(found.counts, depths(share), -jnp.inf))
        return Met(found.found, surface.of_each(contact)[deepest])

    return jax.vmap(one)(_ways(problem, u, before, after), before[0])


class _OnTheWay(NamedTuple):
    """The search for the first meeting on the way."""

    start: Float[Array, ""]  # up to here, nothing is met
    stride: Float[Array, ""]  # from one examined place to the next
    found: Bool[Array, ""]
    counts: Bool[Array, " objects"]  # whether whiskers meet an object if they are inside it


def _ways(problem: SpaceProblem, u: Scalar, before: Side, after: Side) -> _Way:
    """The ways of all whiskers, fields (whiskers, ...)."""
    numbers = jnp.arange(len(problem.surface.objects))

    def of_side(side: Side) -> tuple[CentreLine, Array, Bool[Array, "whiskers objects"]]:
        z, phase = side
        own = jax.vmap(problem.surface.object_of)(z[:, POINT])
        return *_lines(problem, z, u, phase), (numbers == own[:, None]) & (phase != Phase.free)[:, None]

    lines, sides, touched = jax.vmap(of_side)(jax.tree.map(lambda *leaves: jnp.stack(leaves), before, after))
    first, last = (jax.tree.map(lambda leaf, k=k: leaf[k], lines) for k in (0, 1))
    return _Way(first, last, sides[1], touched[0], touched[1])


def _lines(problem: SpaceProblem, z: Contacts, u: Scalar, phase: Phases) -> tuple[CentreLine, Array]:
    """All whiskers in the scene at equidistant points, and the first directors of unloaded ones; (whiskers, ...)."""
    drive, pose = problem.drive(u), jnp.zeros((phase.size, 6))
    if problem.springs is not None:  # by which the loads of others move a base
        _, pose, _ = residuals(problem, z, u, phase, z)

    def of_whisker(body, z, phase, pose, outline):
        placed = in_scene(outline, base_placement(problem, drive, body.mount, pose))
        bent = shape(problem, body, z, phase)
        ends = jnp.append(0.0, jnp.cumsum(bent.spacing))
        arcs = jnp.linspace(0.0, body.length, INTERVALS + 1)
        k = jnp.clip(jnp.searchsorted(ends, arcs, side="right") - 1, 0, bent.spacing.size - 1)
        long = bent.spacing[k] > 0  # nothing is beyond a tip that touches
        spacing = jnp.where(long, bent.spacing[k], 1.0)

        def at(place):
            cubic, t = bent.interval(place)
            return cubic.value(t), cubic.rate(t)

        position, rate = jax.vmap(at)(k + jnp.clip((arcs - ends[k]) / spacing, 0.0, 1.0))
        tangent = jnp.where(long[:, None], rate / spacing[:, None], bent.tangent[k])
        free = phase == Phase.free
        position = jnp.where(free, placed.position, position)
        tangent = jnp.where(free, placed.rotation[..., 2], tangent)
        return CentreLine(position, tangent, jnp.asarray(body.length) / INTERVALS), placed.rotation[..., 0]

    return of_each(problem, of_whisker, z, phase, pose, problem.outline)
