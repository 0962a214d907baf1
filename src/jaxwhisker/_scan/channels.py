"""Channels: signals that a user's function computes from the result of a scan, for fits and studies."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import Deferred, name_of
from jaxwhisker._model.scene import AbstractScene, Scene
from jaxwhisker._path.path import Status
from jaxwhisker._scan.quantities import is_of_contacts
from jaxwhisker._scan.result import AbstractResult
from jaxwhisker._scan.scan import mechanics_of
from jaxwhisker._scan.state import FRICTION, FRICTION_IN_SPACE, OBJECTS, SpaceState, State

EXAMPLE_STEPS = 2  # with which a function is tried before it is compiled


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


class TracedChannels(NamedTuple):
    """The channels of a function, and what JAX has traced of it."""

    names: tuple[str, ...]
    code: Any  # a jax.stages.Traced


def traced_channels(
    function: Callable, signals: Callable[[Any], Mapping[str, Any]], values: Mapping[str, float]
) -> TracedChannels:
    """Trace a user's function of a result.

    Args:
        function: the function.
        signals: calls it with an example, from numbers by name.
        values: these numbers.

    Raises:
        ValueError: if JAX cannot trace the function, or it returns something else than signals.
    """
    names: list[str] = []

    def columns(values):
        found = columns_of(signals(values), EXAMPLE_STEPS)
        names.extend(found)
        return found

    with checks.traceable("channels", name_of(function)):
        code = jax.jit(columns).trace({name: jnp.asarray(value, dtype=float) for name, value in values.items()})
    return TracedChannels(tuple(dict.fromkeys(names)), code)


def example_of(scene: AbstractScene) -> AbstractResult:
    """A result of the scene with which a function is tried: every value is zero."""
    zero = jnp.zeros((EXAMPLE_STEPS, len(scene.whiskers)))
    if not isinstance(scene, Scene):
        return _example_in_space(scene, zero)
    of_contacts = jnp.zeros((*zero.shape, scene.contacts)) if scene.contacts > 1 else zero
    fields: dict[str, Any] = {n: of_contacts if is_of_contacts(n) else zero for n in State.__dataclass_fields__}
    fields["phase"] = of_contacts.astype(int)
    fields |= dict.fromkeys(FRICTION) if scene.friction is None else {"slip": zero.astype(int)}
    loads = scene.support.shaft_loads
    fields["shaft_loads"] = (zero,) * loads if loads else None
    fields |= dict.fromkeys(OBJECTS, None if len(scene.objects) == 1 else of_contacts.astype(int))
    return result_of(scene, State(**fields), None, jnp.zeros(EXAMPLE_STEPS))


def _example_in_space(scene: Any, zero: Float[Array, "steps whiskers"]) -> AbstractResult:
    of_contacts = jnp.zeros((*zero.shape, scene.contacts)) if scene.contacts > 1 else zero
    fields: dict[str, Any] = {n: of_contacts if is_of_contacts(n) else zero for n in SpaceState.__dataclass_fields__}
    fields["phase"] = of_contacts.astype(int)
    fields |= dict.fromkeys(FRICTION_IN_SPACE) if scene.friction is None else {"slip": zero.astype(int)}
    fields |= dict.fromkeys(OBJECTS, None if len(scene.objects) == 1 else of_contacts.astype(int))
    fields["base_rotation"] = jnp.zeros((*zero.shape, 3, 3))
    displacement = jnp.zeros((*zero.shape, 6)) if scene.support.springs else None
    return result_of(scene, SpaceState(**fields), displacement, jnp.zeros(EXAMPLE_STEPS))


def columns_of(signals: Any, steps: int) -> dict[str, Array]:
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


def result_of(scene: Any, state: Any, displacement: Any, control: Float[Array, " steps"]) -> AbstractResult:
    """The result of a scan from its states and the displacements of the bases, for a user's function; without events.

    Displacements are None in the plane, and if bases are clamped.
    """
    mechanics = mechanics_of(scene)
    lengths = mechanics.lengths(scene, state, displacement, control)
    return mechanics.result(
        **{name: getattr(state, name) for name in type(state).__dataclass_fields__},
        control=control,
        spring_length=lengths[:, : len(scene.support.springs)],
        status=jnp.where(jnp.isfinite(state.base_x[:, 0]), Status.ok, Status.lost),
        deferred_events=_WithoutEvents(tuple),
        scene=scene,
    )


class _WithoutEvents(Deferred):
    """The events of a result that has none; to JAX a leaf, so that nothing but the user's function asks for it."""

    @property
    def value(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        raise ValueError("`channels` must not depend on events, got a function that asks for them.")
