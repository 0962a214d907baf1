"""The memory of friction: how the places where contacts stick depend on the numbers of a scene.

A contact that sticks depends on where it began to stick: at a turning point of the drive, at another event, or where
its slip came to rest. That event may itself depend on earlier ones. The march stores the places as values; here they
get their derivatives, from event to event.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.implicit import without_rule
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import SLACK, beyond
from jaxwhisker._equilibrium.contact_state import Places
from jaxwhisker._equilibrium.implicit import Sides, event_points
from jaxwhisker._equilibrium.newton import contact_parameters
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._path.path import STOP, Node, Path, Stops, event_room
from jaxwhisker._scan.signals import event_point

LINKS = 16  # changes of slips and turning points of the drive, besides the events that a scan has room for


class Memory(NamedTuple):
    """What contacts with friction remember at the nodes of a path; fields (nodes, ...)."""

    control: Float[Array, " nodes"]  # dimensionless; that of an event on which later places depend has derivatives
    places: Places  # where contacts stick from the node on
    places_before: Places

    def on(self, path: Path) -> Path:
        """The path that remembers this."""
        nodes = path.nodes
        return path._replace(
            nodes=nodes._replace(
                point=nodes.point._replace(u=self.control),
                state=nodes.state.stuck_at(self.places),
                before=nodes.before.stuck_at(self.places_before),
            )
        )


def memory_of(path: Path) -> Memory | None:
    """What contacts remember, without derivatives; None without friction."""
    nodes = path.nodes
    if nodes.state.places is None or nodes.before.places is None:
        return None
    u: Any = nodes.point.u
    return Memory(u, nodes.state.places, nodes.before.places)


class Link(NamedTuple):
    """What follows from an event: its control, and where contacts stick before and after it."""

    control: Scalar
    places: Places
    places_before: Places


@runtime_checkable
class AfterEvent(Protocol):
    """How a mechanics finds what follows from the event at a node."""

    def __call__(
        self, problem: Any, node: Node, previous: Node, known: Link, linked: Bool[Array, ""], stops: Stops
    ) -> tuple[Scalar, Places]:
        """The control of the event, and where contacts stick from there on.

        Args:
            problem: the problem.
            node: the node of the event.
            previous: the node before.
            known: what followed from the event before.
            linked: whether that was at the node before.
            stops: where the drive starts, turns and ends, in the scene's units.
        """
        ...


@eqx.filter_custom_jvp
def remembered(after: AfterEvent, problem: Any, path: Path, stops: Stops) -> Memory:
    """What contacts remember, with derivatives.

    Args:
        after: how the mechanics finds what follows from an event.
        problem: the problem.
        path: the path, whose own derivatives are ignored.
        stops: where the drive starts, turns and ends, in the scene's units.
    """
    memory = memory_of(path)
    assert memory is not None
    return without_rule(memory, (problem, stops))


@remembered.def_jvp
def _(primals, tangents):
    (after, problem, path, stops), (_, problem_dot, _, stops_dot) = primals, tangents

    def chain(known):
        problem, stops = known
        return chained(after, problem, path, stops)

    dot = eqx.filter_jvp(chain, ((problem, stops),), ((problem_dot, stops_dot),))[1]
    return remembered(after, problem, path, stops), dot


def chained(after: AfterEvent, problem: Any, path: Path, stops: Stops, *, events: bool = False) -> Memory:
    """What contacts remember, differentiable by JAX, from one event to the next.

    Args:
        after: how the mechanics finds what follows from an event.
        problem: the problem.
        path: the path, without derivatives.
        stops: where the drive starts, turns and ends, in the scene's units.
        events: whether controls are those of the events at all nodes, rather than those that contacts remember.
    """
    nodes = path.nodes
    room, corner = nodes.kind.shape[0], nodes.corner
    assert corner is not None
    links = (jnp.arange(room) < path.count) & ((nodes.kind == STOP) | corner | (events & (nodes.kind >= 0)))
    # The first node, where all is free, fills the rest of the room. If there is too little, derivatives are NaN.
    size = min(room, LINKS + event_room(nodes.whiskers.shape[1]))
    index = jnp.nonzero(links, size=size, fill_value=0)[0]
    known = jnp.where(jnp.sum(links) > size, jnp.nan, 1.0)
    controls = jnp.asarray(nodes.point.u)
    none = jax.tree.map(lambda leaf: leaf[0], nodes.state.places)
    start = Link(controls[0], none, none)

    def link(carry, k):
        node, previous = (jax.tree.map(lambda leaf, j=j: leaf[j], nodes) for j in (k, jnp.maximum(k - 1, 0)))
        u, places = after(problem, node, previous, carry, links[jnp.maximum(k - 1, 0)], stops)
        carry = Link(u, places, carry.places)
        return carry, carry

    _, every = jax.lax.scan(link, start, index)
    every = jax.tree.map(lambda leaf: leaf * known, every)
    passed = jnp.cumsum(links)
    controls = jnp.where(links, jnp.asarray(every.control)[jnp.maximum(passed - 1, 0)], controls)
    table = jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), none, every.places)
    now, before = (jax.tree.map(lambda leaf, at=at: leaf[at], table) for at in (passed, passed - links))
    return Memory(controls, now, before)


def after_event(
    problem: Problem, node: Node, previous: Node, known: Link, linked: Bool[Array, ""], stops: Stops
) -> tuple[Scalar, Places]:
    """What follows from an event in the plane; see AfterEvent."""
    places = known.places
    previous = previous._replace(
        point=previous.point._replace(u=jnp.where(linked, known.control, previous.point.u)),
        state=previous.state.stuck_at(places),
        before=previous.before.stuck_at(places),
    )
    at, _ = event_point(problem, node, previous)
    point = event_points(
        Sides(at.point, None), problem, Sides(at.state, None), at.along, at.condition, at.turning
    ).before
    here = contact_parameters(problem, point.z, at.state), beyond(point.z[:, SLACK], at.state.phase)
    new, old = node.state.places, node.before.places
    assert new is not None and old is not None and node.corner is not None and node.stop is not None
    differs = node.corner & ((new[0] != old[0]) | (new[1] != old[1]))

    def moved(value, here, known):
        # In a snap, a contact may also stick later. Its derivatives are then those of where the snap begins.
        return jnp.where(differs, value + here - jax.lax.stop_gradient(here), known)

    stop = stops[node.stop] / jnp.asarray(problem.unit.control)
    u = jnp.where(node.kind == STOP, node.point.u + stop - jax.lax.stop_gradient(stop), point.u)
    return u, jax.tree.map(moved, new, here, places)
