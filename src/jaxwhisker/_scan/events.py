"""The events of a path, from where the drive has reached the first position of the control."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._path.path import EventKind, Path, first_and_last
from jaxwhisker._scan.mechanics import AnyProblem, Mechanics, Memory
from jaxwhisker._scan.steps import kept


def public_nodes(
    nodes: Any, path_count: Int[Array, ""], size: int
) -> tuple[Bool[Array, " nodes"], Int[Array, " events"]]:
    """Which nodes of a path are events of its scan, and the indices of these; 0 without one.

    Of more events than there is room for, the first and the last are kept.
    """
    index = jnp.arange(nodes.kind.shape[0])
    reached = jnp.cumsum((nodes.travel >= 0) & (index < path_count)) > 0
    public = (nodes.kind >= 0) & reached & (index < path_count)
    return public, first_and_last(public, size)


class EventTable(NamedTuple):
    """The events of a scan, as far as inverse problems need them: without the states there, which cost most."""

    kind: Int[Array, " events"]  # EventKind; -1 beyond their number
    whiskers: Bool[Array, "events whiskers"]  # those that the event concerns
    freed: Bool[Array, "events whiskers"]  # whiskers whose contact ends
    control: Float[Array, " events"]  # NaN beyond their number
    travel: Float[Array, " events"]  # no derivatives


def event_table(mechanics: type[Mechanics], problem: AnyProblem, path: Path, memory: Memory = None) -> EventTable:
    """The events of a path. `memory` is what contacts with friction remember, with its derivatives."""
    nodes = mechanics.event_nodes(problem, path)
    public, at = public_nodes(nodes, path.count, mechanics.event_room(nodes.whiskers.shape[1]))
    filled = jnp.arange(at.size) < jnp.sum(public)
    control, lost = mechanics.event_controls(problem, path, memory, at, filled)
    kind = jnp.where(filled, nodes.kind[at], -1)
    unit = problem.unit.control
    return EventTable(
        kind=kind,
        whiskers=nodes.whiskers[at] & filled[:, None],
        freed=lost & (kind >= EventKind.release)[:, None],
        control=jnp.where(filled, control * unit, jnp.nan),
        travel=jnp.where(filled, jax.lax.stop_gradient(nodes.travel[at] * unit), jnp.nan),
    )


def events(
    mechanics: type[Mechanics], problem: AnyProblem, path: Path, memory: Memory = None, room: int | None = None
) -> Any:
    """The events of a path. `memory` is what contacts with friction remember, with its derivatives."""
    nodes = mechanics.event_nodes(problem, path)
    size = mechanics.event_room(nodes.whiskers.shape[1]) if room is None else room
    public, at = public_nodes(nodes, path.count, size)
    count = jnp.sum(public)
    filled = jnp.arange(size) < count
    control, *sides = mechanics.at_events(problem, path, memory, at, filled)
    # With both sides in one batch, the rods are compiled only once.
    both = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *sides)
    states, *_ = jax.vmap(lambda side: mechanics.signals(problem, *side))(both)
    before, after = jax.tree.map(lambda leaf: leaf[:size], states), jax.tree.map(lambda leaf: leaf[size:], states)
    travel = jax.lax.stop_gradient(nodes.travel)[at] * problem.unit.control
    return mechanics.events(
        kind=jnp.where(filled, nodes.kind[at], -1),
        whiskers=nodes.whiskers[at] & filled[:, None],
        control=kept(control * problem.unit.control, filled),
        travel=kept(travel, filled),
        before=kept(before, filled),
        after=kept(after, filled),
        count=count,
    )
