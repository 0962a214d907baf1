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
from jaxwhisker._inverse.linearised import EventTable, Signals, scene_with_slopes
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.quantities import REACTIONS_IN_SPACE
from jaxwhisker._scan.scan import BLOCK
from jaxwhisker._scan.space_scan import SpaceSolutions, follow_path_now, solve_steps_now, states
from jaxwhisker._scan.space_signals import events
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


def _signals_and_slopes(
    problem: SpaceProblem,
    control: Float[Array, " steps"],
    solutions: SpaceSolutions,
    directions: Float[Array, "numbers directions"],
    control_slopes: Float[Array, "steps directions"],
) -> tuple[Array, Array]:
    """The reactions (steps, whiskers, 6), and their derivatives."""
    numbers, rebuilt = ravel_pytree(_numbers(problem))

    def signals(numbers, control):
        state, *_ = states(eqx.combine(rebuilt(numbers), problem), control, solutions)
        return jnp.stack([getattr(state, name) for name in REACTIONS_IN_SPACE], axis=-1)

    along = jax.vmap(lambda *dots: jax.jvp(signals, (numbers, control), dots), in_axes=-1, out_axes=(None, -1))
    return along(directions, control_slopes)


problem_and_slopes_now = Program(_problem_and_slopes, quick=True)
events_and_slopes_now = Program(_events_and_slopes, quick=True)
signals_and_slopes_now = Program(_signals_and_slopes)


class LinearisedSpaceScan:
    """The events and reactions of a scene in space without friction, with derivatives, as `LinearisedScan` has them."""

    def __init__(
        self,
        build: Callable[..., SpaceScene],
        x: Mapping[str, Any],
        stops: np.ndarray,
        last: Any,
        known: Mapping[str, float] | None = None,
        shift: bool = False,
    ):
        self.problem, self._directions = problem_and_slopes_now(*scene_with_slopes(build, x, known or {}, int(shift)))
        self._path, self.start, _ = follow_path_now(self.problem, stops, np.asarray(last))
        self.status = self._path.status
        self.shift_slopes = (np.arange(self.width) == len(x)) * float(shift)
        self.events, self.event_slopes = events_and_slopes_now(self.problem, self._path, self._directions)

    @property
    def width(self) -> int:
        """Number of directions."""
        return self._directions.shape[1]

    def signals(self, control: np.ndarray, travel: np.ndarray, control_slopes: np.ndarray | None = None) -> Signals:
        """Reactions at controls that the drive passes after travelling `travel`; NaN where a step failed."""
        slopes = np.zeros((control.size, self.width)) if control_slopes is None else control_slopes
        count, blocks = control.size, range(0, control.size, BLOCK)
        control, travel, slopes = (
            np.pad(values, [(0, -count % BLOCK)] + [(0, 0)] * (values.ndim - 1), mode="edge")
            for values in (control, travel, slopes)
        )
        each = [self._block(*(values[k : k + BLOCK] for values in (control, travel, slopes))) for k in blocks]
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *each)

    def _block(self, control: np.ndarray, travel: np.ndarray, slopes: np.ndarray) -> Signals:
        solutions = solve_steps_now(self.problem, self._path, control, travel)
        return Signals(*signals_and_slopes_now(self.problem, control, solutions, self._directions, slopes))
