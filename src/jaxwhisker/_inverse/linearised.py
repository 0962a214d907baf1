"""Scans with derivatives with respect to the parameters of a user's `build`, outside of any jit.

Only `build` itself is compiled for each `build`. Path and solutions come from the programs of a plain scan. The other
programs compute values together with derivatives in a few directions, those of the parameters, and therefore cost less
than all derivatives of a scan.
"""

import abc
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.aside import Compilers
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._inverse.channels import Channels, channels_and_slopes_now
from jaxwhisker._inverse.parameters import hashable
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._path.path import EventKind, Path
from jaxwhisker._scan.detect import kinds_of
from jaxwhisker._scan.memory import Places, chained
from jaxwhisker._scan.scan import BLOCK, detect_now, follow_path_now, path_through, solved_states_now
from jaxwhisker._scan.signals import control_at_event, event_nodes
from jaxwhisker._scan.steps import Solutions, states, with_places

REACTION_CHANNELS = Channels()
LEAST_STEPS = 64  # for which a function of the result is compiled
WIDTH = 4  # directions are padded to a multiple of this, so that different numbers of parameters share programs


class EventTable(NamedTuple):
    """The events of a scan, as far as inverse problems need them."""

    kind: Int[Array, " events"]  # EventKind; -1 beyond their number
    whiskers: Bool[Array, "events whiskers"]  # those that the event concerns
    freed: Bool[Array, "events whiskers"]  # whiskers whose contact ends
    control: Float[Array, " events"]  # NaN beyond their number
    travel: Float[Array, " events"]  # no derivatives


def event_table(problem: Problem, path: Path) -> EventTable:
    """The events of a scan without the states before and after them, which cost most."""
    node, previous, filled, *_ = event_nodes(path)
    control, state = jax.vmap(partial(control_at_event, problem))(node, previous)
    lost = state.touches & node.state.free
    return EventTable(
        kind=jnp.where(filled, node.kind, -1),
        whiskers=node.whiskers & filled[:, None],
        freed=lost & (filled & (node.kind >= EventKind.release))[:, None],
        control=jnp.where(filled, control * problem.unit.control, jnp.nan),
        travel=jnp.where(filled, jax.lax.stop_gradient(node.travel * problem.unit.control), jnp.nan),
    )


def _scene_and_slopes(
    build: Callable[..., AbstractScene],
    names: tuple[str, ...],
    width: int,
    x: Float[Array, " parameters"],
    known: dict[str, Scalar],
) -> tuple[AbstractScene, Any]:
    """The scene, and derivatives of its numbers with respect to the parameters along a last axis of this width."""

    def scene(x):
        return jax.tree.map(checks.as_float, build(**dict(zip(names, x, strict=True)), **known))

    numbers, push = jax.linearize(lambda x: eqx.filter(scene(x), eqx.is_array), x)
    return eqx.combine(numbers, scene(x)), jax.vmap(push, out_axes=-1)(jnp.eye(width, x.size))


def _problem_and_slopes(scene: Any, slopes: Any) -> tuple[Problem, Float[Array, "numbers directions"]]:
    """The problem, and derivatives of its numbers."""
    arrays, static = eqx.partition(scene, eqx.is_array)

    def numbers(arrays):
        return ravel_pytree(problem_of(eqx.combine(arrays, static)).numbers())[0]

    along = jax.vmap(lambda dots: jax.jvp(numbers, (arrays,), (dots,))[1], in_axes=-1, out_axes=-1)
    return problem_of(scene), along(slopes)


class Memory(NamedTuple):
    """What contacts with friction remember, and its derivatives along a last axis."""

    places: Places | None  # where contacts stick after each node of the path
    slopes: Any
    control_slopes: Float[Array, "nodes directions"]  # derivatives of the positions of events


def _memory(
    problem: Problem,
    path: Path,
    stops: Float[Array, " stops"],
    directions: Float[Array, "numbers directions"],
    stop_slopes: Float[Array, "stops directions"],
) -> Memory | None:
    if problem.friction_angle is None:
        return None
    numbers, rebuilt = ravel_pytree(problem.numbers())

    def chain(numbers, stops):
        controls, places, _ = chained(path, eqx.combine(rebuilt(numbers), problem), stops, events=True)
        return controls, places

    def towards(*dots):
        return jax.jvp(chain, (numbers, stops), dots)[1]

    controls, slopes = jax.vmap(towards, in_axes=-1, out_axes=-1)(directions, stop_slopes)
    return Memory(path.nodes.state.places, slopes, controls)


def _events_and_slopes(
    problem: Problem, path: Path, memory: Memory | None, directions: Float[Array, "numbers directions"]
) -> tuple[EventTable, Float[Array, "events directions"]]:
    """The events, and derivatives of their positions."""
    if memory is not None:
        nodes = event_nodes(path)
        return event_table(problem, path), memory.control_slopes[nodes.index] * problem.unit.control
    numbers, rebuilt = ravel_pytree(problem.numbers())

    def control(numbers):
        table = event_table(eqx.combine(rebuilt(numbers), problem), path)
        return table.control, table

    _, slopes, table = jax.vmap(
        lambda dots: jax.jvp(control, (numbers,), (dots,), has_aux=True), in_axes=-1, out_axes=(None, -1, None)
    )(directions)
    return table, slopes


class Signals(NamedTuple):
    """The signals of the channels at some steps, and their derivatives; NaN where a step failed."""

    values: Any  # (steps, whiskers, 3), or (steps, 1, names) from a function
    slopes: Any  # (steps, whiskers, 3, directions)


def _states_and_slopes(
    fields: tuple[str, ...] | None,
    problem: Problem,
    control: Float[Array, " steps"],
    solutions: Solutions,
    memory: Memory | None,
    directions: Float[Array, "numbers directions"],
    control_slopes: Float[Array, "steps directions"],
) -> tuple[Any, Any]:
    """Some fields of the states, stacked along a last axis, or whole states; and their derivatives."""
    numbers, rebuilt = ravel_pytree(problem.numbers())
    places, place_slopes = (None, None) if memory is None else (memory.places, memory.slopes)

    def solved(numbers, control, places):
        state, _ = states(eqx.combine(rebuilt(numbers), problem), control, with_places(solutions, places))
        if fields is not None:
            return jnp.stack([getattr(state, name) for name in fields], axis=-1), None
        return eqx.partition(state, eqx.is_inexact_array)

    def towards(*dots):
        return jax.jvp(solved, (numbers, control, places), dots, has_aux=True)

    dots = directions, control_slopes, place_slopes
    smooth, slopes, rest = jax.vmap(towards, in_axes=-1, out_axes=(None, -1, None))(*dots)
    return eqx.combine(smooth, rest), slopes


scene_and_slopes_now = Program(_scene_and_slopes, quick=True)
problem_and_slopes_now = Program(_problem_and_slopes, quick=True)
memory_now = Program(_memory, quick=True)
events_and_slopes_now = Program(_events_and_slopes, quick=True)
states_and_slopes_now = Program(_states_and_slopes)


class AbstractLinearisedScan:
    """The events and signals of a scene, with derivatives with respect to parameters.

    Derivatives have a last axis of directions: one for each parameter, then any further ones that the control depends
    on. They are padded with zeros to a multiple of `WIDTH`.

    Args:
        scene: the scene, and derivatives of its numbers.
        first: number of parameters of the scene.
        channels: what is measured.
        values: of further arguments of its function, (values,); derivatives by them follow those by the parameters.
        shift: whether the last direction is a shift of all stops.
    """

    _directions: Any  # (numbers, directions) derivatives of the numbers of the problem
    start: Any  # position where the scan begins
    status: Any  # of the path
    events: EventTable
    event_slopes: Any  # (events, directions)

    def __init__(self, scene: tuple[Any, Any], first: int, channels: Channels, values: Any, shift: bool):
        self._scene, self._first, self._channels = scene, first, channels
        self._values, self._shift = np.asarray(values, dtype=float), shift

    @property
    def width(self) -> int:
        """Number of directions."""
        return self._directions.shape[1]

    @property
    def shift_slopes(self) -> Float[np.ndarray, " directions"]:
        """Derivatives of a shift of all stops."""
        return (np.arange(self.width) == self._first + self._values.size) * float(self._shift)

    def signals(self, control: np.ndarray, travel: np.ndarray, control_slopes: np.ndarray | None = None) -> Signals:
        """Signals at controls that the drive passes after travelling `travel`; arrays of NumPy.

        Args:
            control: drive positions, (steps,).
            travel: (steps,).
            control_slopes: derivatives of the control, (steps, directions). Default: zero.
        """
        slopes = np.zeros((control.size, self.width)) if control_slopes is None else control_slopes
        count, blocks = control.size, range(0, control.size, BLOCK)
        control, travel, slopes = (
            np.pad(values, [(0, -count % BLOCK)] + [(0, 0)] * (values.ndim - 1), mode="edge")
            for values in (control, travel, slopes)
        )
        each = [self._block(*(values[k : k + BLOCK] for values in (control, travel, slopes))) for k in blocks]
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *each)

    def _block(self, control: np.ndarray, travel: np.ndarray, slopes: np.ndarray) -> Signals:
        state = self._states(control, travel, slopes)
        if self._channels.fields is not None:
            return Signals(*state)
        values = self._values, np.eye(self._values.size, self.width, self._first)
        # The function may be slow, and most steps of a block may be padding: copies of the last one.
        size = _padded(control, travel)
        *some, control, slopes = jax.tree.map(lambda leaf: np.asarray(leaf)[:size], (*state, control, slopes))
        found = channels_and_slopes_now(self._channels, *self._scene, *some, control, slopes, values)
        return Signals(*(np.pad(leaf, [(0, BLOCK - size), *[(0, 0)] * (leaf.ndim - 1)], mode="edge") for leaf in found))

    @abc.abstractmethod
    def _states(self, control: np.ndarray, travel: np.ndarray, slopes: np.ndarray) -> tuple[Any, Any]:
        """The channels' fields of the states stacked, or whole states if there are none; and their derivatives."""


class LinearisedScan(AbstractLinearisedScan):
    """The events and signals of a scene from `build`, with derivatives with respect to the parameters.

    Args:
        build: makes a Scene from named numbers.
        x: values of the parameters by which derivatives are taken, by name.
        stops: of the drive, as in a Route.
        last: index of the last stop.
        known: values of further arguments of `build`.
        channels: what is measured.
        values: of further arguments of its function, (values,).
        shift: whether the last direction is a shift of all stops.
    """

    def __init__(
        self,
        build: Callable[..., AbstractScene],
        x: Mapping[str, Any],
        stops: np.ndarray,
        last: Any,
        known: Mapping[str, float] | None = None,
        channels: Channels = REACTION_CHANNELS,
        values: Any = (),
        shift: bool = False,
    ):
        scene, slopes = scene_with_slopes(build, x, known or {}, len(values) + shift)
        super().__init__((scene, slopes), len(x), channels, values, shift)
        _prepare(scene, slopes, stops.shape[0], channels.fields)
        self.problem, self._directions = problem_and_slopes_now(scene, slopes)
        self._path, self.start, _ = path_through(self.problem, kinds_of(scene), stops, np.asarray(last))
        self.status = self._path.status
        at_stops = np.nan_to_num(stops), self._directions, np.tile(self.shift_slopes, (stops.size, 1))
        self._memory = memory_now(self.problem, self._path, *at_stops)
        found = events_and_slopes_now(self.problem, self._path, self._memory, self._directions)
        self.events, self.event_slopes = found

    def _states(self, control, travel, slopes):
        *_, solutions = solved_states_now(self.problem, self._path, control, travel)
        fields, memory = self._channels.fields, self._memory
        return states_and_slopes_now(fields, self.problem, control, solutions, memory, self._directions, slopes)


def _padded(control: np.ndarray, travel: np.ndarray) -> int:
    """How many steps of a block need to be computed if its last one is repeated: a power of 2, or the whole block."""
    other = np.flatnonzero((control != control[-1]) | (travel != travel[-1]))
    return min(BLOCK, max(LEAST_STEPS, 2 ** math.ceil(math.log2(other[-1] + 2 if other.size else 1))))


def check_used(build: Callable[..., AbstractScene], guess: Mapping[str, float]) -> None:
    """Check that the scene depends on every parameter.

    Raises:
        ValueError: if not; the message names the parameter.
    """
    _, slopes = scene_with_slopes(build, guess, {}, 0)
    for k, name in enumerate(guess):
        if not any(np.any(np.asarray(leaf)[..., k] != 0) for leaf in jax.tree.leaves(slopes)):
            raise ValueError(
                f"`guess` must name parameters that `build` uses, got {name}: nothing in the scene depends on {name}."
            )


def scene_with_slopes(build: Callable[..., Any], x: Mapping[str, Any], known: Mapping[str, Any], further: int):
    """The scene that `build` makes, and derivatives of its numbers along a last axis with room for further ones."""
    values = np.array(list(x.values()), dtype=float)
    width = WIDTH * math.ceil((values.size + further) / WIDTH)
    return scene_and_slopes_now(hashable(build), tuple(x), width, values, jax.tree.map(np.asarray, dict(known)))


def _prepare(scene: Any, slopes: Any, stops: int, fields: tuple[str, ...] | None) -> None:
    """Compile the programs for scenes of a kind at the same time: while one is traced, another one is compiled."""
    if problem_and_slopes_now.is_ready(scene, slopes):
        return
    ends, block = (np.zeros(stops), np.asarray(0)), np.zeros(BLOCK)
    with Compilers() as pool:
        problem, directions = problem_and_slopes_now.prepare(pool, scene, slopes)
        path = follow_path_now.prepare(pool, problem, *ends).path
        if kinds := kinds_of(scene):
            detect_now.prepare(pool, problem, path, kinds)
        *_, solutions = solved_states_now.prepare(pool, problem, path, block, block)
        along, at_stops = (np.zeros((size, directions.shape[1])) for size in (BLOCK, stops))
        memory = memory_now.prepare(pool, problem, path, ends[0], directions, at_stops)
        states_and_slopes_now.prepare(pool, fields, problem, block, solutions, memory, directions, along)
        # The last one takes longest to trace, and is compiled fastest.
        events_and_slopes_now.prepare(pool, problem, path, memory, directions)
