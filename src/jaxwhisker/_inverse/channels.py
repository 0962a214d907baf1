"""The channels of a sensor: the reactions of every whisker, or what a function computes from the result of a scan."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.program import Program
from jaxwhisker._inverse.parameters import hashable
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._scan.channels import (
    arguments_of,
    columns_of,
    example_of,
    result_of,
    traced_channels,
)
from jaxwhisker._scan.quantities import REACTIONS, REACTIONS_IN_SPACE
from jaxwhisker._scan.result import AbstractResult


class Channels(NamedTuple):
    """What is measured at every step: an array (whiskers, names), or (1, names) from a function of the result."""

    names: tuple[str, ...] = REACTIONS
    function: Callable[..., Mapping[str, Any]] | None = None
    parameters: tuple[str, ...] = ()  # further arguments of the function
    in_space: bool = False  # whether the scene is in space

    @property
    def fields(self) -> tuple[str, ...] | None:
        """The fields of a state that are the signals; None for a function, which may ask for any field."""
        return self.names if self.function is None else None

    def of_result(self, result: AbstractResult, values: Mapping[str, Any]) -> Float[Array, "steps whiskers names"]:
        """The signals of a scan, with values of the function's further arguments."""
        if self.function is None:
            return jnp.stack([getattr(result, name) for name in self.names], axis=-1)
        columns = columns_of(self.function(result, **values), result.control.shape[0])
        return jnp.stack([columns[name] for name in self.names], axis=-1)[:, None]


def reactions_of(scene: AbstractScene) -> Channels:
    """The reactions of every whisker of a scene."""
    return Channels(REACTIONS_IN_SPACE if scene.in_space else REACTIONS, in_space=scene.in_space)


def channels_from(function: Any, scene: AbstractScene, guess: Mapping[str, float]) -> tuple[Channels, dict[str, float]]:
    """The channels that a function of the result computes, and the rest of the guess, which is not an argument of it.

    None stands for the reactions.

    Raises:
        ValueError: if it is not such a function, or JAX cannot trace it.
    """
    if function is None:
        return reactions_of(scene), dict(guess)
    for name in arguments_of(function):
        if name not in guess:
            raise ValueError(f"`guess` must hold a value of every argument of `channels`, got none of {name}.")
    own = {name: guess[name] for name in arguments_of(function)}
    traced = traced_channels(function, lambda values: function(example_of(scene), **values), own)
    rest = {name: value for name, value in guess.items() if name not in own}
    return Channels(traced.names, hashable(function), tuple(own), scene.in_space), rest


def table_of_result(channels: Channels, result: AbstractResult) -> dict[str, Any]:
    """Control and signals of a scan by name.

    Raises:
        ValueError: if the function has further arguments, whose values are unknown.
    """
    if channels.parameters:
        raise ValueError(
            "`measured` must hold the signals themselves if `channels` has parameters "
            f"({', '.join(channels.parameters)}), got a Result."
        )
    signals = channels.of_result(result, {})
    return {"control": result.control} | {name: signals[:, 0, c] for c, name in enumerate(channels.names)}


def _signals_and_slopes(
    channels: Channels,
    scene: Any,
    scene_slopes: Any,
    state: Any,
    state_slopes: Any,
    control: Float[Array, " steps"],
    control_slopes: Float[Array, "steps directions"],
    arguments: tuple[Float[Array, " values"], Float[Array, "values directions"]],
) -> tuple[Array, Array]:
    """Signals from a function, (steps, 1, names), and their derivatives along a last axis of directions.

    The state is a pair of states and displacements of the bases. Values of the function's further arguments
    come with their own derivatives.
    """
    values, value_slopes = arguments
    smooth, rest = eqx.partition((scene, state), eqx.is_inexact_array)

    def signals(smooth, control, values):
        scene, (state, displacement) = eqx.combine(smooth, rest)
        return channels.of_result(
            result_of(scene, state, displacement, control), dict(zip(channels.parameters, values, strict=True))
        )

    def towards(*dots):
        return jax.jvp(signals, (smooth, control, values), dots)

    dots = eqx.filter((scene_slopes, state_slopes), eqx.is_inexact_array), control_slopes, value_slopes
    return jax.vmap(towards, in_axes=-1, out_axes=(None, -1))(*dots)


channels_and_slopes_now = Program(_signals_and_slopes, quick=True)
