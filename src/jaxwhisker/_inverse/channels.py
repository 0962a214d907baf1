"""The channels of a sensor: the reactions of every whisker, or what a function computes from the result of a scan."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.leaves import Deferred
from jaxwhisker._base.program import Program
from jaxwhisker._inverse.parameters import check_traceable, hashable
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import Status
from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker._scan.result import Result
from jaxwhisker._scan.springs import bases_of, spring_lengths
from jaxwhisker._scan.state import FRICTION, OBJECTS, State

EXAMPLE_STEPS = 2  # with which a function is tried before it is compiled


class Channels(NamedTuple):
    """What is measured at every step: an array (whiskers, names), or (1, names) from a function of the result."""

    names: tuple[str, ...] = REACTIONS
    function: Callable[..., Mapping[str, Any]] | None = None
    parameters: tuple[str, ...] = ()  # further arguments of the function

    @property
    def fields(self) -> tuple[str, ...] | None:
        """The fields of a state that are the signals; None for a function, which may ask for any field."""
        return self.names if self.function is None else None

    def of_result(self, result: Result, values: Mapping[str, Any]) -> Float[Array, "steps whiskers names"]:
        """The signals of a scan, with values of the function's further arguments."""
        if self.function is None:
            return jnp.stack([getattr(result, name) for name in self.names], axis=-1)
        columns = _columns(self.function(result, **values), result.control.shape[0])
        return jnp.stack([columns[name] for name in self.names], axis=-1)[:, None]


def channels_from(function: Any, scene: Scene, guess: Mapping[str, float]) -> tuple[Channels, dict[str, float]]:
    """The channels that a function of the result computes, and the rest of the guess, which is not an argument of it.

    None stands for the reactions.

    Raises:
        ValueError: if it is not such a function, or JAX cannot trace it.
    """
    if function is None:
        return Channels(), dict(guess)
    for name in arguments_of(function):
        if name not in guess:
            raise ValueError(f"`guess` must hold a value of every argument of `channels`, got none of {name}.")
    own = {name: guess[name] for name in arguments_of(function)}
    names: list[str] = []

    def numbers(**values):
        control = jnp.zeros(EXAMPLE_STEPS)
        columns = _columns(function(result_of(scene, _example(scene), control), **values), EXAMPLE_STEPS)
        names.extend(columns)
        return list(columns.values())

    check_traceable(numbers, own, called="channels", name=getattr(function, "__name__", type(function).__name__))
    rest = {name: value for name, value in guess.items() if name not in own}
    return Channels(tuple(dict.fromkeys(names)), hashable(function), tuple(own)), rest


def arguments_of(function: Any) -> tuple[str, ...]:
    """Names of the arguments of a channels' function, after the result.

    Raises:
        ValueError: if it is not a function of the result.
    """
    if function is None:
        return ()
    try:
        _, *further = inspect.signature(function).parameters
    except (TypeError, ValueError):
        raise ValueError(f"`channels` must be a function of the result of a scan, got {function!r}.") from None
    return tuple(further)


def table_of_result(channels: Channels, result: Result) -> dict[str, Any]:
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


def _example(scene: Scene) -> State:
    """A state of the scene, at every step of an example."""
    zero = jnp.zeros((EXAMPLE_STEPS, len(scene.whiskers)))
    fields: dict[str, Any] = dict.fromkeys(State.__dataclass_fields__, zero) | {"phase": zero.astype(int)}
    fields |= dict.fromkeys(FRICTION) if scene.friction is None else {"slip": zero.astype(int)}
    loads = scene.support.shaft_loads
    fields["shaft_loads"] = (zero,) * loads if loads else None
    fields |= dict.fromkeys(OBJECTS, None if len(scene.profile.objects) == 1 else zero.astype(int))
    return State(**fields)


def _columns(signals: Any, steps: int) -> dict[str, Array]:
    """One column (steps,) for each channel: arrays (steps, n) of several whiskers or springs become n channels."""
    if not isinstance(signals, Mapping) or not signals:
        raise ValueError(f"`channels` must return a mapping from names to arrays (steps,), got {signals!r}.")
    columns = {}
    for name, values in signals.items():
        values = jnp.asarray(values, dtype=float)
        if values.ndim not in (1, 2) or values.shape[0] != steps:
            raise ValueError(
                f"`channels` must return arrays of shape (steps,) or (steps, n), got {values.shape} for {name} of "
                f"{steps} steps."
            )
        parts = jnp.reshape(values, (steps, -1)).T
        columns |= {name if len(parts) == 1 else f"{name}_{k}": part for k, part in enumerate(parts, 1)}
    return columns


def result_of(scene: Scene, state: State, control: Float[Array, " steps"]) -> Result:
    """The result of a scan from its states, for a user's function; without events."""
    return Result(
        **{name: getattr(state, name) for name in State.__dataclass_fields__},
        control=control,
        spring_length=spring_lengths(scene, bases_of(scene, state), control),
        status=jnp.where(jnp.isfinite(state.base_x[:, 0]), Status.ok, Status.lost),
        deferred_events=_WithoutEvents(tuple),
        scene=scene,
    )


class _WithoutEvents(Deferred):
    """The events of a result that has none; to JAX a leaf, so that nothing but the user's function asks for it."""

    @property
    def value(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        raise ValueError("`channels` must not depend on events, got a function that asks for them.")


def _signals_and_slopes(
    channels: Channels,
    scene: Scene,
    scene_slopes: Any,
    state: State,
    state_slopes: Any,
    control: Float[Array, " steps"],
    control_slopes: Float[Array, "steps directions"],
    arguments: tuple[Float[Array, " values"], Float[Array, "values directions"]],
) -> tuple[Array, Array]:
    """Signals from a function, (steps, 1, names), and their derivatives along a last axis of directions.

    Values of the function's further arguments come with their own derivatives.
    """
    values, value_slopes = arguments
    smooth, rest = eqx.partition((scene, state), eqx.is_inexact_array)

    def signals(smooth, control, values):
        scene, state = eqx.combine(smooth, rest)
        return channels.of_result(result_of(scene, state, control), dict(zip(channels.parameters, values, strict=True)))

    def towards(*dots):
        return jax.jvp(signals, (smooth, control, values), dots)

    dots = eqx.filter((scene_slopes, state_slopes), eqx.is_inexact_array), control_slopes, value_slopes
    return jax.vmap(towards, in_axes=-1, out_axes=(None, -1))(*dots)


channels_and_slopes_now = Program(_signals_and_slopes, quick=True)
