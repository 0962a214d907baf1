"""What holds for the scenes of a study at all of its points: one structure, only numbers differ."""

import types
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeGuard

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from jaxwhisker._model.motion import Rotation, Translation
from jaxwhisker._model.scene import Scene
from jaxwhisker._study.parameters import Parameters

SAMPLES = 64  # points at most at which scenes are built to be compared; the first few that can be built
COMPARED = 5


class Structure(NamedTuple):
    """What the scenes of a study have in common."""

    whiskers: int
    springs: tuple[str, ...]  # between what, and along which axis if not x
    control: tuple[str, str]  # what the control is, and its kind (fields.KINDS)
    dimensionless: bool  # the first whisker's length and bending stiffness are 1 at every point
    words: str


def structure_of(build: Callable, parameters: Parameters) -> Structure:
    """Build scenes at a few points and from traced parameters, and compare them.

    Raises:
        ValueError: if `build` returns no Scene, depends on the value of a parameter where it is traced, or returns
            scenes that differ by more than numbers.
    """
    samples = _samples(build, parameters)
    traced = _traced(build, parameters)
    for scene in [*samples[1:], traced]:
        different = _difference(samples[0], scene, "scene") if samples else None
        if different:
            raise ValueError(
                f"`build` must return scenes of one structure at all points, but `{different}` changes with the "
                "parameters."
            )
    first = traced.whiskers[0]
    units = (first.length, first.bending_stiffness)
    known = not any(callable(unit) or isinstance(unit, Tracer) for unit in units)
    plain = known and all(np.all(u == 1.0) for u in units)
    springs = tuple("-".join(map(str, s.between)) + f" {s.axis}" * (s.axis != "x") for s in traced.support.springs)
    return Structure(traced.support.whiskers, springs, _control(traced), plain, str(traced))


def _control(scene: Scene) -> tuple[str, str]:
    if isinstance(scene.motion, Translation):
        return "drive position", "length"
    return ("angle of the drive", "angle") if isinstance(scene.motion, Rotation) else ("control", "number")


def _checked(scene: Any) -> Scene:
    if not isinstance(scene, Scene):
        raise _NoSceneError(f"`build` must return a Scene, but returned {scene!r}.")
    return scene


class _NoSceneError(ValueError):
    """What is wrong with `build` itself, not with a point."""


def _samples(build: Callable, parameters: Parameters) -> list[Scene]:
    """Scenes at a few points spread over all, bad points left out."""
    total = int(np.prod(parameters.shape))
    numbers = np.unique(np.linspace(0, total - 1, min(total, SAMPLES)).astype(int))
    found: list[Scene] = []
    # From the ends inwards, so that the first few are far apart.
    for k in [n for pair in zip(numbers, numbers[::-1], strict=True) for n in pair][: numbers.size]:
        if len(found) == COMPARED:
            break
        try:
            found.append(_checked(build(**parameters.one(int(k)))))
        except _NoSceneError:
            raise
        except ValueError:  # a bad point: NaN later
            pass
    return found


def _traced(build: Callable, parameters: Parameters) -> Scene:
    """The scene of abstract parameters."""
    try:
        return _trace(build, tuple(parameters.values), {})
    except jax.errors.JAXTypeError as error:
        blamed = _blamed(build, parameters)
        raise ValueError(
            f"`build` must not decide by the value of a parameter, but does by {blamed}: all points of a study are "
            "computed by one compiled function (use jnp.where, or leave Python's float() and if away)."
        ) from error


def _trace(build: Callable, names: tuple[str, ...], fixed: dict) -> Scene:
    scenes: list[Any] = []

    def probe(values):
        scenes.append(build(**values, **fixed))
        return ()

    jax.eval_shape(probe, {name: jax.ShapeDtypeStruct((), float) for name in names})
    return _checked(scenes[0])


def _blamed(build: Callable, parameters: Parameters) -> str:
    """Which parameters alone make tracing fail."""
    point = parameters.one(0)
    found = []
    for name in point:
        try:
            _trace(build, (name,), {n: v for n, v in point.items() if n != name})
        except jax.errors.JAXTypeError:
            found.append(f"`{name}`")
        except ValueError:  # the others' values are bad at this point
            pass
    return ", ".join(found or [f"`{name}`" for name in point])


def _difference(one: Any, other: Any, path: str) -> str | None:
    """Where two trees differ by more than numbers; None if nowhere."""
    if isinstance(one, eqx.Module) and type(one) is type(other):
        fields = one.__dataclass_fields__.items()
        parts = [(getattr(one, n), getattr(other, n), f"{path}.{n}", f.metadata.get("static")) for n, f in fields]
        return _first(_differs(*part[:3]) if part[3] else _difference(*part[:3]) for part in parts)
    if isinstance(one, tuple | list) and type(one) is type(other) and len(one) == len(other):
        parts = ((a, b, f"{path}[{k}]") for k, (a, b) in enumerate(zip(one, other, strict=True)))
        return _first(_difference(*part) for part in parts)
    if _is_number(one) and _is_number(other):
        return None if np.shape(one) == np.shape(other) else path
    return _differs(one, other, path)


def _differs(one: Any, other: Any, path: str) -> str | None:
    if isinstance(one, types.FunctionType) and isinstance(other, types.FunctionType):
        # A function made anew by every call of `build` is the same one if its code is.
        return None if one.__code__ is other.__code__ else path
    return None if type(one) is type(other) and one == other else path


def _is_number(value: Any) -> TypeGuard[Any]:
    return isinstance(value, int | float | np.ndarray | np.generic | jax.Array) and not isinstance(value, bool)


def _first(found: Iterator[str | None]) -> str | None:
    return next((path for path in found if path), None)
