"""The march: following the path of equilibria through events, folds and snaps.

This is pseudo-arclength continuation. Each iteration makes one Newton solve, whatever its task, because all elements of
a batch pay for the most expensive branch that any of them takes. The tasks are:

    advance   take a step along the path; its length follows the prediction error
    event     solve for the point within the last step where a margin vanishes
    arrive    solve for the same point in the state that holds from here on, and determine in which direction to leave
    done      do nothing: the march has ended
    flow      take a step of what follows from a loss of stability, at fixed drive
    kick      in the plane: take the first step away from an equilibrium that lost its stability

Stability is checked at every node; a failure of the solver does not count as a loss of stability. If the end of a step
is unstable, stability was lost within the step, and steps are shortened until the loss is located. There the path turns
back in u (a fold) or, at a corner, leaves in the wrong direction.

What the march asks of whiskers in the plane and in space is listed in continuation.py.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._path.continuation import Continuation, Limits
from jaxwhisker._path.march_state import MarchState, Task
from jaxwhisker._path.path import Last, Path, ScanPath, Status, select
from jaxwhisker._path.transitions import after_advance, after_arrive, after_event

STOPS = 8  # stops of a route with turns: so many, or twice as many, or four times ... after padding
TRACED_STOPS = 16 * STOPS  # of a traced control: turns are cheap, nodes are not
TRACED_SWEEPS = 2 * STOPS  # so many stops of a traced control have room for the nodes of a sweep past the object
CHUNK = 16  # iterations between two checks of whether the whole batch is done


def sweeps_of(last: Any) -> tuple[int, ...]:
    """The number of stops that a path has room for if the drive passes the object before each, if it is not all."""
    return (TRACED_SWEEPS,) if checks.is_traced(last) else ()


def _iterate(mechanics: Continuation, stops: Float[Array, " stops"], last: Int[Array, ""], now: MarchState):
    """Predict, solve, decide. Return the new state, and the index (-1 for none) and value of the node to write."""
    trial = mechanics.trial(now, stops, last)
    new, write, node = jax.lax.switch(
        jnp.minimum(now.task, Task.flow),
        [
            lambda: after_advance(mechanics, now, trial),
            lambda: after_event(mechanics, now, trial),
            lambda: after_arrive(mechanics, now, trial, stops, last),
            lambda: (now, jnp.asarray(False), now.pending),
            lambda: mechanics.after_flow(now, trial),
        ],
    )
    return new.replace(count=new.count + write), (jnp.where(write, now.count, -1), node)


@jax.custom_batching.custom_vmap
def any_lane(holds: Bool[Array, ""]) -> Bool[Array, ""]:
    """Whether a condition holds, or under `vmap` whether it holds in any lane.

    With a condition of its own for each lane, a loop copies all of its values again and again, and of two branches both
    are computed in every lane.
    """
    return holds


@any_lane.def_vmap
def _(size, batched, holds):
    del size, batched
    return any_lane(jnp.any(holds)), False


def follow(mechanics: Continuation, stops: Float[Array, " stops"], last: Last, sweeps: int | None) -> ScanPath:
    """March to all stops, given in the scene's units; right across the object if the first one is NaN.

    There is room for the nodes of so many `sweeps` past the object; by default, of one for each stop.
    """
    unit, whole = mechanics.problem.unit.control, jnp.isnan(stops[0])
    stops = stops / unit
    limits = mechanics.limits(stops[0])
    stops = jnp.where(whole, jnp.full_like(stops, limits.far).at[0].set(limits.start), stops)
    capacity = mechanics.capacity(min(sweeps or stops.size, stops.size))
    path = march(mechanics, limits, stops, jnp.asarray(last), capacity=capacity)
    path, start, stop = mechanics.crop(path, whole, limits)
    return ScanPath(mechanics.checked(path), jnp.asarray(start * unit), jnp.asarray(stop * unit))


def march(
    mechanics: Continuation, limits: Limits, stops: Float[Array, " stops"], last: Int[Array, ""], *, capacity: int
) -> Path:
    """Follow the path from where all whiskers are free to stops[0], stops[1], ..., stops[last].

    The march ends with status `ok` at the last stop or as soon as all whiskers have passed the object for good. If the
    path cannot be followed any further, the march ends there, and the status of the path says why.
    """
    now = mechanics.start(stops, limits)
    # A node is written as one row of a table: one write per field would be slow to compile.
    blank, unpacked = ravel_pytree(now.pending)
    empty = jnp.zeros((capacity, blank.size)), jnp.asarray(0)
    # In a batch, all values of the loop have lanes from the start: JAX traces the loop again for those that get them.
    start = jax.tree.map(
        lambda own, invalid: jax.lax.select(mechanics.problem.valid, own, invalid),
        (now, *empty),
        (now.stopped(Status.invalid), *empty),
    )
    room = mechanics.room(capacity, last)
    most = mechanics.iterations(room) // CHUNK

    def running(carry):
        # The second condition is never the first to fail. Without it, XLA takes the task for a counter and analyses the
        # body again and again to count the iterations, which makes compilation 40 % longer.
        now, _, used = carry
        # All marches of a batch iterate as long as one does; one that is done writes nothing.
        return any_lane((now.task != Task.done) & (used <= most))

    def chunk(carry):
        now, table, used = carry

        def iteration(now, _):
            now, (index, node) = _iterate(mechanics, stops, last, now)
            return now, (index, ravel_pytree(node)[0])

        now, (index, rows) = jax.lax.scan(iteration, now, None, length=CHUNK)
        table = table.at[jnp.where(index < 0, capacity, index)].set(rows, mode="drop")
        ends = (now.count > room) | ((now.task != Task.done) & ((now.count == room) | (used >= most)))
        return select(ends, now.stopped(Status.too_long), now), table, used + 1

    now, table, _ = jax.lax.while_loop(running, chunk, start)
    end = mechanics.last_node(now)
    if end is not None:
        write, node = end
        table = table.at[jnp.where(write, now.count, capacity)].set(ravel_pytree(node)[0], mode="drop")
        now = now.replace(count=now.count + write)
    return Path(jax.vmap(unpacked)(table), jnp.minimum(now.count, capacity).astype(int), now.status.astype(int))
