"""Detect contacts that are not modelled: a whisker that meets the object a second time, and whiskers that cross.

The path, which chooses its steps itself, is searched for the first such state, and ends there. What is found therefore
depends on the caller's control no more than stability and snaps do. Later states are unknown even if the shafts come
apart again: the missing force decides what they are.
"""

from collections.abc import Callable
from functools import partial
from itertools import combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import contact, newton
from jaxwhisker._equilibrium.contact import FORCE, of_each
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.crossing import cross
from jaxwhisker._equilibrium.newton import with_dummy_contacts
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.second_contact import dips, may_meet, meets, passes
from jaxwhisker._equilibrium.shaft import Shaft, moved, shaft
from jaxwhisker._model.objects import of_one_kind
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import Path, Status, cut
from jaxwhisker._scan.steps import interpolate

SHARES = 2  # states examined from one node of the path to the next; a contact that lasts less than that is overlooked
BATCH = 256  # states examined at once
CLOSER = 32  # of them at once that need a closer look
REFINEMENTS = 3  # each divides the distance to the first contact on the path by as many


Kinds = tuple[str, ...]  # of contacts that are not modelled: names of statuses


def kinds_of(scene: Scene) -> Kinds:
    """What a scene is to detect, without what cannot happen.

    Without friction, and before a single object, a straight whisker whose bending stiffness EI does not increase
    towards the tip stays on the outer side of the object's tangent at its contact, which a convex object does not
    cross. Let theta be the angle from the tangent to the whisker, theta1 its value at the contact, and M = EI theta',
    M' = f cos theta along the shaft, towards the base. Then M^2 / 2 EI - f (sin theta - sin theta1) is zero at the
    contact, and its derivative is -(M / EI)^2 EI' / 2, not positive, therefore sin theta >= sin theta1 >= 0.
    """
    possible = {
        "second_contact": scene.friction is not None
        or scene.support.on_shafts
        or scene.gravity is not None
        or len(scene.profile.objects) > 1
        or not all(whisker.tapers for whisker in scene.whiskers),
        "crossing": len(scene.whiskers) > 1,
    }
    return tuple(name for name in scene.detects if possible[name])


def detect(problem: Problem, path: Path, kinds: Kinds) -> Path:
    """The path up to the first state in which a contact of these kinds begins; without derivatives."""
    problem, path = jax.lax.stop_gradient((problem, path))
    found = _search(problem, path, kinds)
    return cut(path, found.place, found.status)


def _shafts(problem: Problem, point: Point, state: ContactState, kinds: Kinds) -> Shaft:
    """The shafts of all whiskers, stacked."""
    free = state.free
    z, phase = with_dummy_contacts(problem, point.z, state.phase)
    bodies = problem.bodies(point.u, z, state.piece)
    if problem.attached is None:
        z = z.at[:, FORCE].set(jnp.where(free, 0.0, z[:, FORCE]))
    shafts = of_each(bodies, shaft, z, phase, state.side, state.friction)
    if "crossing" not in kinds or problem.attached is not None:  # no need to know where free whiskers are
        return shafts
    load = newton.load_of(of_each(bodies, contact.in_base_frame, shafts.base), problem.axes)
    load = jnp.where(free[:, None], 0.0, load)
    at = problem.in_scene(point.u, problem.rest(point.u) + problem.displacement(load))
    unloaded = jax.vmap(moved)(shafts, *at)
    shafts = jax.tree.map(
        lambda bent, straight: jnp.where(jnp.reshape(free, (-1,) + (1,) * (bent.ndim - 1)), straight, bent),
        shafts,
        unloaded,
    )
    return shafts._replace(base=shafts.base._replace(x=at.x, y=at.y))


class _Examined(NamedTuple):
    """A state that is examined."""

    shafts: Shaft
    touches: Bool[Array, " whiskers"]
    number: Int[Array, " whiskers"] | None  # of the object that is touched; None with a single object
    changed_sides: Bool[Array, " whiskers"] | None  # whether it has passed right through another object
    cross: Bool[Array, ""] | None  # None unless that is asked


def _examined(problem: Problem, path: Path, kinds: Kinds, place: Scalar) -> _Examined:
    """The state at a place of the path."""
    index, u = _control_at(path, place)
    state = jax.tree.map(lambda leaf: leaf[index], path.nodes.state)
    point = interpolate(path, index, u)
    shafts = _shafts(problem, point, state, kinds)
    cross = _any_cross(problem, point, shafts) if "crossing" in kinds else None
    number, sides = problem.profile.object_of(state.piece), state.sides
    if number is None or sides is None:
        return _Examined(shafts, state.touches, None, None, cross)

    def changed(one: AbstractProfile, k: Int[Array, ""], standing: Array) -> Bool[Array, " whiskers"]:
        return (number != k) & (jax.vmap(partial(passes, one))(shafts) * standing < 0)

    kinds_of_objects = of_one_kind(problem.profile.objects)
    each = [jax.vmap(changed)(some, jnp.array(k), sides[jnp.array(k)]) for k, some in kinds_of_objects]
    return _Examined(shafts, state.touches, number, jnp.any(jnp.concatenate(each), axis=0), cross)


def _status(meets: Callable, profile: AbstractProfile, kinds: Kinds, seen: _Examined) -> Int[Array, ""]:
    """Status of a state: what is detected in it, if `meets` tells whether a shaft dips into an object."""
    status = jnp.asarray(int(Status.ok)) if seen.cross is None else jnp.where(seen.cross, Status.crossing, Status.ok)
    if "second_contact" in kinds:
        status = jnp.where(jnp.any(_at_objects(meets, profile, seen)), Status.second_contact, status)
    return status


def _at_objects(meets: Callable, profile: AbstractProfile, seen: _Examined) -> Bool[Array, " whiskers"]:
    """Whether touching whiskers meet their object in a second place, or another object, according to `meets`."""
    shafts, touches, number, changed, _ = seen
    if number is None or changed is None:
        return jax.vmap(lambda own, touches: meets(profile, own, touches, own.parameter))(shafts, touches)

    def at(one: AbstractProfile, k: Int[Array, ""]) -> Bool[Array, " whiskers"]:
        # The parameter of another object's contact may mean nothing on this one.
        own, lowest = number == k, jnp.asarray(one.lowest(), dtype=float)
        return jax.vmap(partial(meets, one))(shafts, touches, jnp.where(own, shafts.parameter, lowest), own)

    each = [jax.vmap(at)(some, jnp.array(k)) for k, some in of_one_kind(profile.objects)]
    return jnp.any(jnp.concatenate(each), axis=0) | (touches & changed)


def _any_cross(problem: Problem, point: Point, shafts: Shaft) -> Bool[Array, ""]:
    """Whether any two whiskers cross, or their bases have changed places."""
    n = problem.length.shape[0]
    rest, found = problem.in_scene(point.u, problem.rest(point.u)), jnp.asarray(False)
    for j, k in combinations(range(n), 2):
        one, other = (jax.tree.map(lambda leaf, i=i: leaf[i], shafts) for i in (j, k))
        x, y = other.base.x - one.base.x, other.base.y - one.base.y
        in_order = x * (rest.x[k] - rest.x[j]) + y * (rest.y[k] - rest.y[j]) > 0
        found |= cross(one, other) | ~in_order
    return found


class _Found(NamedTuple):
    """The search: the last place known to be good, and what was found after it."""

    place: Float[Array, ""]  # on the path, counted in nodes
    stride: Float[Array, ""]  # from one examined place to the next
    end: Float[Array, ""]  # the first bad place so far, or the last one
    status: Int[Array, ""]  # there; of the end of the path if nothing is bad so far


def _search(problem: Problem, path: Path, kinds: Kinds) -> _Found:
    ok = jnp.asarray(int(Status.ok))

    def status_of(meets: Callable, seen: _Examined) -> Int[Array, ""]:
        return _status(meets, problem.profile, kinds, seen)

    def some(seen: _Examined, chosen: Int[Array, "*chosen"]) -> _Examined:
        return jax.tree.map(lambda leaf: leaf[chosen], seen)

    def searching(found: _Found) -> Bool[Array, ""]:
        return (found.place < found.end) & ((found.status == ok) | (found.stride > finest))

    def examine(found: _Found) -> _Found:
        places = jnp.minimum(found.place + found.stride * jnp.arange(1, BATCH + 1), found.end)
        new = jnp.append(True, places[:-1] < found.end)
        seen = jax.vmap(partial(_examined, problem, path, kinds))(places)

        def sift(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            todo, status = carry
            (chosen,) = jnp.nonzero(todo, size=CLOSER, fill_value=BATCH)
            sifted = jax.vmap(partial(status_of, may_meet))(some(seen, chosen))
            return todo.at[chosen].set(False), status.at[chosen].set(sifted)

        def look(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            status, _ = carry
            first = jnp.argmax(status != ok)
            there = status_of(meets, some(seen, first))
            return status.at[first].set(there), there

        status = jnp.where(new, jax.vmap(partial(status_of, dips))(seen), ok)
        _, status = jax.lax.while_loop(lambda carry: jnp.any(carry[0]), sift, (status != ok, status))
        status, first_status = jax.lax.while_loop(
            lambda carry: jnp.any(carry[0] != ok) & (carry[1] == ok), look, (status, ok)
        )
        bad, first = first_status != ok, jnp.argmax(status != ok)
        before = jnp.where(first == 0, found.place, places[first - 1])
        return _Found(
            jnp.where(bad, before, places[-1]),
            jnp.where(bad, found.stride / CLOSER, found.stride),
            jnp.where(bad, places[first], found.end),
            jnp.where(bad, first_status, found.status),
        )

    finest = 1 / SHARES / CLOSER**REFINEMENTS / 2
    # The first place examined is that of the first node.
    return jax.lax.while_loop(
        searching, examine, _Found(jnp.asarray(-1.0 / SHARES), jnp.asarray(1.0 / SHARES), path.count - 1.0, ok)
    )


def _control_at(path: Path, place: Scalar) -> tuple[Int[Array, ""], Scalar]:
    """The node before a place on the path, and the control there."""
    index = jnp.clip(jnp.floor(place).astype(int), 0, path.count - 1)
    controls = jnp.asarray(path.nodes.point.u)
    u, there = controls[index], controls[jnp.minimum(index + 1, path.count - 1)]
    return index, u + (place - index) * (there - u)
