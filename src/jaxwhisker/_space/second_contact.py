"""Whether whiskers meet an object in a second place, or another object, which is not modelled: a scan ends there.

Without friction, a straight round whisker bends in a plane, away from the object, and touches a strictly convex object
once. One that is curved, or held by friction, may touch it twice. Among several objects, whiskers may also touch
another one, or slide onto it. What they meet on the way of a jump, jumps.py tells.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.interpolation import between
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._path.path import Path, Status, cut
from jaxwhisker._space.contact import POINT
from jaxwhisker._space.free import CentreLine
from jaxwhisker._space.jumps import DEPTH, distances
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import Contacts, SpaceProblem, of_each
from jaxwhisker._space.shape import shape

BATCH = 32  # nodes of a path searched at once
JUST_BEFORE = 1e-9  # of the way from a node to the next one
PARTS = 16  # of each interval of a whisker: between its points, an edge of radius r is deeper by 1e-6 / r at most


def depth(surface: AbstractSurface, line: CentreLine) -> Float[Array, ""]:
    """How deep a whisker is inside an object, at many points along it; negative outside."""
    cubics = between(line.position, line.tangent, line.spacing[:, None])
    inside = cubics.value(jnp.arange(PARTS)[:, None, None] / PARTS)
    points = jnp.concatenate([inside.reshape(-1, 3), line.position[-1:]])
    return jnp.max(-jax.vmap(surface.off)(points))


def touches_twice(problem: SpaceProblem, z: Contacts, phase: Phases) -> Bool[Array, ""]:
    """Whether any whisker in contact is inside its object elsewhere, or inside another object."""
    if not problem.may_touch_twice:
        return jnp.asarray(False)
    surface = problem.surface

    def meets(body, z, phase):
        line = shape(problem, body, z, phase)
        own = surface.of_each(lambda one: depth(one, line))
        if len(surface.objects) == 1:
            return own[0] > DEPTH
        touched = surface.object_of(z[POINT]) == jnp.arange(own.size)
        return jnp.any(jnp.where(touched, own, -distances(surface, line)) > DEPTH)

    return jnp.any(of_each(problem, meets, z, phase) & (phase != Phase.free))


def until_second_contact(problem: SpaceProblem, path: Path) -> Path:
    """The path to the last node before a whisker meets an object in a second place, or another object."""
    if not problem.may_touch_twice:
        return path
    nodes = path.nodes
    number = jnp.arange(nodes.kind.size)
    exists = number < path.count
    phase = jnp.where(exists[:, None], nodes.state.phase, int(Phase.free))

    def touch_twice(some):
        z, phase = some
        search = jax.vmap(lambda z, phase: touches_twice(problem, z, phase))
        found = jnp.zeros(BATCH, dtype=bool)
        return jax.lax.cond(jnp.any(phase != Phase.free), lambda: search(z, phase), lambda: found)

    batches = (leaf.reshape(-1, BATCH, *leaf.shape[1:]) for leaf in (nodes.point.z, phase))
    bad = jnp.ravel(jax.lax.map(touch_twice, tuple(batches)))
    place = jnp.argmax(bad) - JUST_BEFORE
    if len(problem.surface.objects) > 1:
        slides_over = exists & _changes_object(problem, path)
        bad |= slides_over
        first = jnp.argmax(bad)
        # States on the way to the other object are not told apart.
        place = jnp.where(slides_over[first], first - 1.0, first - JUST_BEFORE)
    return cut(path, place, jnp.where(jnp.any(bad), int(Status.second_contact), int(Status.ok)))


def _changes_object(problem: SpaceProblem, path: Path) -> Bool[Array, " nodes"]:
    """Whether contacts have slid from one object to another one since the node before."""
    nodes = path.nodes
    touched, touches = nodes.state.phase[:-1] != Phase.free, nodes.before.phase[1:] != Phase.free
    start, end = (jax.vmap(jax.vmap(problem.surface.object_of))(z[..., POINT]) for z in (nodes.point.z, nodes.z_before))
    return jnp.append(False, jnp.any(touched & touches & (start[:-1] != end[1:]), axis=1))
