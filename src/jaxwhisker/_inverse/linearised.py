"""Scans with derivatives with respect to the parameters of a user's `build`, outside of any jit.

Only `build` itself is compiled for each `build`. Path and solutions come from the programs of a plain scan. The other
programs compute values together with derivatives in a few directions, those of the parameters, and therefore cost less
than all derivatives of a scan.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.aside import Compilers
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._inverse.channels import Channels, channels_and_slopes_now
from jaxwhisker._inverse.parameters import hashable
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._path.path import Path, Stops
from jaxwhisker._scan.blocks import BLOCK
from jaxwhisker._scan.events import EventTable, event_table
from jaxwhisker._scan.mechanics import AnyProblem, Mechanics, Solutions
from jaxwhisker._scan.scan import mechanics_of
from jaxwhisker._scan.slopes import solved_states_now
from jaxwhisker._scan.steps import states

REACTION_CHANNELS = Channels()
LEAST_STEPS = 64  # for which a function of the result is compiled
WIDTH = 4  # directions are padded to a multiple of this, so that different numbers of parameters share programs


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


def _problem_and_slopes(
    mechanics: type[Mechanics], scene: Any, slopes: Any
) -> tuple[AnyProblem, Float[Array, "numbers directions"]]:
    """The problem, and derivatives of its numbers."""
    arrays, static = eqx.partition(scene, eqx.is_array)

    def numbers(arrays):
        return ravel_pytree(mechanics.problem(eqx.combine(arrays, static)).numbers())[0]

    along = jax.vmap(lambda dots: jax.jvp(numbers, (arrays,), (dots,))[1], in_axes=-1, out_axes=-1)
    return mechanics.problem(scene), along(slopes)


class Linearised(NamedTuple):
    """A tree, and derivatives of its numbers along a last axis, None for what has none."""

    values: Any
    slopes: Any


def _memory_and_slopes(
    mechanics: type[Mechanics],
    problem: AnyProblem,
    path: Path,
    stops: Stops,
    directions: Float[Array, "numbers directions"],
    stop_slopes: Float[Array, "stops directions"],
) -> Linearised:
    """What contacts with friction remember, and its derivatives."""
    numbers, rebuilt = ravel_pytree(problem.numbers())

    def remembered(numbers, stops):
        return mechanics.remember(eqx.combine(rebuilt(numbers), problem), path, stops)

    def towards(*dots):
        return jax.jvp(remembered, (numbers, stops), dots)

    return Linearised(*jax.vmap(towards, in_axes=-1, out_axes=(None, -1))(directions, stop_slopes))


def _events_and_slopes(
    mechanics: type[Mechanics],
    problem: AnyProblem,
    path: Path,
    memory: Linearised,
    directions: Float[Array, "numbers directions"],
) -> tuple[EventTable, Float[Array, "events directions"]]:
    """The events, and derivatives of their positions."""
    numbers, rebuilt = ravel_pytree(problem.numbers())

    def control(numbers, memory):
        table = event_table(mechanics, eqx.combine(rebuilt(numbers), problem), path, memory)
        return table.control, table

    def towards(*dots):
        return jax.jvp(control, (numbers, memory.values), dots, has_aux=True)

    _, slopes, table = jax.vmap(towards, in_axes=-1, out_axes=(None, -1, None))(directions, memory.slopes)
    return table, slopes


class ChannelSignals(NamedTuple):
    """The signals of the channels at some steps, and their derivatives; NaN where a step failed."""

    values: Any  # (steps, whiskers, 3), or (steps, 1, names) from a function
    slopes: Any  # (steps, whiskers, 3, directions)


def _states_and_slopes(
    mechanics: type[Mechanics],
    fields: tuple[str, ...] | None,
    problem: AnyProblem,
    path: Path | None,
    control: Float[Array, " steps"],
    solutions: Solutions,
    memory: Linearised,
    directions: Float[Array, "numbers directions"],
    control_slopes: Float[Array, "steps directions"],
) -> tuple[Any, Any]:
    """Some fields of the states, stacked along a last axis, or states and displacements; and their derivatives."""
    numbers, rebuilt = ravel_pytree(problem.numbers())

    def solved(numbers, control, memory):
        remembered = mechanics.remembered(memory, path, solutions)
        at = eqx.combine(rebuilt(numbers), problem)
        state, _, displacement = states(mechanics, at, control, solutions, remembered)
        if fields is not None:
            return jnp.stack([getattr(state, name) for name in fields], axis=-1), None
        return eqx.partition((state, displacement), eqx.is_inexact_array)

    def towards(*dots):
        return jax.jvp(solved, (numbers, control, memory.values), dots, has_aux=True)

    dots = directions, control_slopes, memory.slopes
    smooth, slopes, rest = jax.vmap(towards, in_axes=-1, out_axes=(None, -1, None))(*dots)
    return eqx.combine(smooth, rest), slopes


scene_and_slopes_now = Program(_scene_and_slopes, quick=True)
problem_and_slopes_now = Program(_problem_and_slopes, quick=True)
memory_and_slopes_now = Program(_memory_and_slopes, quick=True)
events_and_slopes_now = Program(_events_and_slopes, quick=True)
states_and_slopes_now = Program(_states_and_slopes)


class LinearisedScan:
    """The events and signals of a scene from `build`, with derivatives with respect to the parameters.

    Derivatives have a last axis of directions: one for each parameter, then any further ones that the control depends
    on. They are padded with zeros to a multiple of `WIDTH`.

    Args:
        build: makes a Scene from named numbers.
        x: values of the parameters by which derivatives are taken, by name.
        stops: of the drive, as in a Route.
        last: index of the last stop.
        known: values of further arguments of `build`.
        channels: what is measured.
        values: of further arguments of its function, (values,); derivatives by them follow those by the parameters.
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
        self._first, self._channels = len(x), channels
        self._values, self._shift = np.asarray(values, dtype=float), shift
        self._scene = scene, slopes = scene_with_slopes(build, x, known or {}, len(values) + shift)
        self._mechanics = mechanics = mechanics_of(scene)
        _prepare(mechanics, scene, slopes, stops.shape[0], channels.fields)
        self.problem, self._directions = problem_and_slopes_now(mechanics, scene, slopes)
        path, self.start, _ = mechanics.follow(self.problem, stops, np.asarray(last))
        self._path = mechanics.detected(scene, self.problem, path)
        self.status = self._path.status
        at_stops = np.nan_to_num(stops), self._directions, np.tile(self.shift_slopes, (stops.size, 1))
        self._memory = Linearised(None, None)
        if scene.friction is not None:
            self._memory = memory_and_slopes_now(mechanics, self.problem, self._path, *at_stops)
        self.events, self.event_slopes = events_and_slopes_now(
            mechanics, self.problem, self._path, self._memory, self._directions
        )

    @property
    def width(self) -> int:
        """Number of directions."""
        return self._directions.shape[1]

    @property
    def shift_slopes(self) -> Float[np.ndarray, " directions"]:
        """Derivatives of a shift of all stops."""
        return (np.arange(self.width) == self._first + self._values.size) * float(self._shift)

    def signals(
        self, control: np.ndarray, travel: np.ndarray, control_slopes: np.ndarray | None = None
    ) -> ChannelSignals:
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

    def _block(self, control: np.ndarray, travel: np.ndarray, slopes: np.ndarray) -> ChannelSignals:
        state = self._states(control, travel, slopes)
        if self._channels.fields is not None:
            return ChannelSignals(*state)
        values = self._values, np.eye(self._values.size, self.width, self._first)
        # The function may be slow, and most steps of a block may be padding: copies of the last one.
        size = _padded(control, travel)
        *some, control, slopes = jax.tree.map(lambda leaf: np.asarray(leaf)[:size], (*state, control, slopes))
        found = channels_and_slopes_now(self._channels, *self._scene, *some, control, slopes, values)
        return ChannelSignals(
            *(np.pad(leaf, [(0, BLOCK - size), *[(0, 0)] * (leaf.ndim - 1)], mode="edge") for leaf in found)
        )

    def _states(self, control: np.ndarray, travel: np.ndarray, slopes: np.ndarray) -> tuple[Any, Any]:
        """The channels' fields of the states stacked, or states and displacements; and their derivatives."""
        mechanics, memory, problem = self._mechanics, self._memory, self.problem
        *_, solutions = solved_states_now(mechanics, problem, self._path, control, travel, memory.values)
        fields, path = self._channels.fields, None if memory.values is None else self._path
        known = fields, problem, path, control, solutions, memory
        return states_and_slopes_now(mechanics, *known, self._directions, slopes)


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


def _prepare(mechanics: type[Mechanics], scene: Any, slopes: Any, stops: int, fields: tuple[str, ...] | None) -> None:
    """Compile the programs for scenes of a kind at the same time: while one is traced, another one is compiled."""
    if problem_and_slopes_now.is_ready(mechanics, scene, slopes):
        return
    block = np.zeros(BLOCK)
    with Compilers() as pool:
        problem, directions = problem_and_slopes_now.prepare(pool, mechanics, scene, slopes)
        path, plain = mechanics.prepare(pool, scene, problem, stops)
        *_, solutions = solved_states_now.prepare(pool, mechanics, problem, path, block, block, plain)
        along, at_stops = (np.zeros((size, directions.shape[1])) for size in (BLOCK, stops))
        memory = Linearised(None, None)
        if plain is not None:
            memory = memory_and_slopes_now.prepare(
                pool, mechanics, problem, path, np.zeros(stops), directions, at_stops
            )
        known = fields, problem, None if plain is None else path, block, solutions, memory
        states_and_slopes_now.prepare(pool, mechanics, *known, directions, along)
        # The last one takes longest to trace, and is compiled fastest.
        events_and_slopes_now.prepare(pool, mechanics, problem, path, memory, directions)
