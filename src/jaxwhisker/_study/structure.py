"""Check that all scenes of a study have the same structure, and compute hashes of scenes."""

import hashlib
import types
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._model.scene import AbstractScene
from jaxwhisker._scan.channels import arguments_of, example_of, traced_channels
from jaxwhisker._scan.dataset import SceneLayout, layout_of
from jaxwhisker._study.parameters import Parameters

SCENES = 64  # most points at which scenes are built to be compared and hashed
COMPARED = 5  # scenes whose structure is compared
PROBES = np.geomspace(1e-3, 1e3, 19)  # functions in a scene are hashed by their values at these, both signs and 0
REMEDY = (
    "all points of a study are computed by one compiled function (use jnp.where instead of `if`, jnp.interp instead of "
    "np.interp, jnp.exp instead of math.exp, and no float())"
)


def layout_of_scenes(build: Callable, parameters: Parameters) -> SceneLayout:
    """Build scenes at a few points and from traced parameters, compare them, and return their common layout.

    Raises:
        ValueError: if `build` does not return a Scene, cannot be traced, or returns scenes that differ by more than
            numbers.
    """
    samples = _samples(build, parameters)
    traced, layout = _traced(build, parameters, bool(samples))
    for one, other in pairwise([*samples, traced]):
        for path in _differences(one, other, "scene"):
            raise ValueError(
                f"`build` must return scenes of the same structure at all points, got scenes whose `{path}` differs."
            )
    # The parameters of a traced scene have no size.
    return layout._replace(sizes=layout_of(samples[0]).sizes if samples else {})


def _checked(scene: Any) -> AbstractScene:
    if not isinstance(scene, AbstractScene):
        raise _NoSceneError(f"`build` must return a Scene, got {scene!r}.")
    return scene


class _NoSceneError(ValueError):
    """`build` itself is wrong, rather than its arguments at one point."""


def _samples(build: Callable, parameters: Parameters) -> list[AbstractScene]:
    """Scenes at a few points spread over all; points that `build` rejects are left out."""
    found: list[AbstractScene] = []
    for point in sampled(parameters):
        with suppress(Exception):  # a bad point: it gets a status and NaN
            found.append(build(**point))
        if len(found) == COMPARED:
            break
    return [_checked(scene) for scene in found]


def _traced(build: Callable, parameters: Parameters, built: bool) -> tuple[AbstractScene, SceneLayout]:
    """The scene of traced parameters, of which only the structure is used, and its layout.

    `built` says whether `build` succeeded at a concrete point.
    """
    try:
        return _trace(build, tuple(parameters.values), {})
    except _NoSceneError:
        raise
    except jax.errors.JAXTypeError as error:
        raise ValueError(
            "`build` must not depend on the value of a parameter while JAX traces it, got such a dependence on "
            f"{_blamed(build, parameters)}: {REMEDY}."
        ) from error
    except Exception as error:
        if isinstance(error, ValueError) and not built:
            raise  # a constructor of the scene rejects a constant, and names it
        failed = f"{type(error).__name__} ({error})"
        if built:
            raise ValueError(f"`build` must be traceable by JAX, got {failed}: {REMEDY}.") from error
        raise ValueError(f"`build` must return a Scene, got {failed} at every point that was tried.") from error


def _trace(build: Callable, names: tuple[str, ...], fixed: dict) -> tuple[AbstractScene, SceneLayout]:
    found: list[Any] = []

    def probe(values):
        scene = _checked(build(**values, **fixed))
        found.append((scene, layout_of(scene)))  # a layout may compute numbers, which are known only here
        return ()

    jax.eval_shape(probe, {name: jax.ShapeDtypeStruct((), float) for name in names})
    return found[0]


def _blamed(build: Callable, parameters: Parameters) -> str:
    """The parameters that make tracing fail on their own, or all of them."""
    point = parameters.one(0)
    found = []
    for name in point:
        try:
            _trace(build, (name,), {n: v for n, v in point.items() if n != name})
        except jax.errors.JAXTypeError:
            found.append(name)
        except Exception:  # the other parameters' values are bad at this point
            continue
    return ", ".join(f"`{name}`" for name in found or point)


def _differences(one: Any, other: Any, path: str) -> Iterator[str]:
    """Where two trees differ by more than numbers."""
    if isinstance(one, eqx.Module) and type(one) is type(other):
        for name, field in one.__dataclass_fields__.items():
            differences = _other_statics if field.metadata.get("static") else _differences
            yield from differences(getattr(one, name), getattr(other, name), f"{path}.{name}")
    elif isinstance(one, tuple | list) and type(one) is type(other) and len(one) == len(other):
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from _differences(a, b, f"{path}[{k}]")
    elif all(checks.is_numeric(value) and not isinstance(value, bool) for value in (one, other)):
        if np.shape(one) != np.shape(other):  # pyright: ignore[reportArgumentType, reportCallIssue]
            yield path
    else:
        yield from _other_statics(one, other, path)


def _other_statics(one: Any, other: Any, path: str) -> Iterator[str]:
    if isinstance(one, types.FunctionType) and isinstance(other, types.FunctionType):
        # Each call of `build` may define a function anew; equal code means that it is the same function.
        one, other = one.__code__, other.__code__
    if type(one) is not type(other) or one != other:
        yield path


def channels_of(function: Callable, build: Callable, points: list[dict[str, float]]) -> tuple[tuple[str, ...], str]:
    """Names of the channels that a function computes from the results of these scenes, and a hash of its code.

    Raises:
        ValueError: if it is not such a function, or JAX cannot trace it.
    """
    if further := arguments_of(function):
        raise ValueError(
            f"`channels` must be a function of the result alone, got further arguments {', '.join(further)}."
        )
    names, code = traced_channels(function, lambda values: function(example_of(build(**values))), points[0])
    return names, f"sha256:{hashlib.sha256(code.lower().as_text().encode()).hexdigest()}"


def sampled(parameters: Parameters) -> list[dict[str, float]]:
    """Points at which the scenes of two `build` functions are compared."""
    return [parameters.one(int(number)) for number in parameters.spread(SCENES)]


def fingerprint(build: Callable, points: list[dict[str, float]]) -> str:
    """A hash of the scenes at some points: their structure, their numbers, and values of the functions in them.

    Two different `build` functions have the same hash if they make the same scenes at these points.
    """
    digest = hashlib.sha256()
    for point in points:
        try:
            scene = build(**point)
        except Exception as error:  # a bad point
            digest.update(type(error).__name__.encode())
            continue
        leaves, structure = jax.tree.flatten(scene, is_leaf=callable)
        digest.update(b"".join([str(structure).encode(), *map(_bytes_of, leaves)]))
    return f"sha256:{digest.hexdigest()}"


def _bytes_of(leaf: Any) -> bytes:
    if checks.is_numeric(leaf):
        return np.asarray(leaf, dtype=float).tobytes()
    if not callable(leaf):
        return repr(leaf).encode()
    parameters = [leaf for leaf in jax.tree.leaves(leaf) if checks.is_numeric(leaf)]
    values = [_value_of(leaf, argument) for argument in (*-PROBES, 0.0, *PROBES)]
    return b"".join([*map(_bytes_of, parameters), *values])


def _value_of(function: Callable, argument: float) -> bytes:
    try:
        with np.errstate(all="ignore"):
            return b"".join(map(_bytes_of, jax.tree.leaves(function(argument))))
    except Exception as error:  # outside the function's domain
        return type(error).__name__.encode()
