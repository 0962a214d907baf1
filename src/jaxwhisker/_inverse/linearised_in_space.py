"""Scans in space with derivatives with respect to the parameters of a user's `build`, outside of any jit."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._inverse.channels import Channels
from jaxwhisker._inverse.linearised import AbstractLinearisedScan, EventTable, scene_with_slopes
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.space_scan import follow_path_now, solved_states_now
from jaxwhisker._scan.space_signals import events
from jaxwhisker._scan.space_steps import SpaceSolutions, states
from jaxwhisker._space.march_state import SpacePath
from jaxwhisker._space.problem import SpaceProblem, problem_in_space


def _numbers(tree: Any) -> Any:
    return eqx.filter(tree, eqx.is_inexact_array)


def _problem_and_slopes(scene: SpaceScene, slopes: Any) -> tuple[SpaceProblem, Float[Array, "numbers directions"]]:
    """The problem, and derivatives of its numbers."""
    arrays, static = eqx.partition(scene, eqx.is_array)

    def numbers(arrays):
        return ravel_pytree(_numbers(problem_in_space(eqx.combine(arrays, static))))[0]

    along = jax.vmap(lambda dots: jax.jvp(numbers, (arrays,), (dots,))[1], in_axes=-1, out_axes=-1)
    return problem_in_space(scene), along(slopes)


def _events_and_slopes(
    problem: SpaceProblem, path: SpacePath, directions: Float[Array, "numbers directions"]
) -> tuple[EventTable, Float[Array, "events directions"]]:
    """The events, and derivatives of their positions."""
    numbers, rebuilt = ravel_pytree(_numbers(problem))

    def control(numbers):
        found = events(eqx.combine(rebuilt(numbers), problem), path)
        lost = (found.before.phase != Phase.free) & (found.after.phase == Phase.free)
        freed = lost & (found.kind >= EventKind.release)[:, None]
        table = EventTable(found.kind, found.whiskers, freed, found.control, found.travel)
        return found.control, table

    _, slopes, table = jax.vmap(
        lambda dots: jax.jvp(control, (numbers,), (dots,), has_aux=True), in_axes=-1, out_axes=(None, -1, None)
    )(directions)
    return table, slopes


def _states_and_slopes(
    fields: tuple[str, ...] | None,
    problem: SpaceProblem,
    control: Float[Array, " steps"],
    solutions: SpaceSolutions,
    directions: Float[Array, "numbers directions"],
    control_slopes: Float[Array, "steps directions"],
) -> tuple[Any, Any]:
    """Some fields of the states, stacked along a last axis, or states and displacements; and their derivatives."""
    numbers, rebuilt = ravel_pytree(_numbers(problem))

    def solved(numbers, control):
        state, _, displacement = states(eqx.combine(rebuilt(numbers), problem), control, solutions)
        if fields is not None:
            return jnp.stack([getattr(state, name) for name in fields], axis=-1), None
        return eqx.partition((state, displacement), eqx.is_inexact_array)

    def towards(*dots):
        return jax.jvp(solved, (numbers, control), dots, has_aux=True)

    smooth, slopes, rest = jax.vmap(towards, in_axes=-1, out_axes=(None, -1, None))(directions, control_slopes)
    return eqx.combine(smooth, rest), slopes


problem_and_slopes_now = Program(_problem_and_slopes, quick=True)
events_and_slopes_now = Program(_events_and_slopes, quick=True)
states_and_slopes_now = Program(_states_and_slopes)


class LinearisedSpaceScan(AbstractLinearisedScan):
    """The events and signals of a scene in space without friction from `build`; arguments as for `LinearisedScan`."""

    def __init__(
        self,
        build: Callable[..., SpaceScene],
        x: Mapping[str, Any],
        stops: np.ndarray,
        last: Any,
        known: Mapping[str, float] | None,
        channels: Channels,
        values: Any = (),
        shift: bool = False,
    ):
        scene = scene_with_slopes(build, x, known or {}, len(values) + shift)
        super().__init__(scene, len(x), channels, values, shift)
        self.problem, self._directions = problem_and_slopes_now(*scene)
        self._path, self.start, _ = follow_path_now(self.problem, stops, np.asarray(last))
        self.status = self._path.status
        self.events, self.event_slopes = events_and_slopes_now(self.problem, self._path, self._directions)

    def _states(self, control, travel, slopes):
        *_, solutions = solved_states_now(self.problem, self._path, control, travel, None)
        fields = self._channels.fields
        return states_and_slopes_now(fields, self.problem, control, solutions, self._directions, slopes)
