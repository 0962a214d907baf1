"""From the parts of a scene to the tables of a file."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import PlainFunction, name_of
from jaxwhisker._file.kinds import FAMILIES, NONE, RENAMED, Argument, arguments_of, scene_arguments
from jaxwhisker._file.named import named_call
from jaxwhisker._file.reading import KIND
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.drives import SpaceMotion
from jaxwhisker._model.motion import AbstractMotion
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.surface import AbstractSurface

# What can stand in a file instead of a part that holds a Python function; by the class of the part.
INSTEAD = {
    AbstractProfile: "a Contour or Polygon through points, or a Graph of a Polynomial",
    AbstractSurface: "an Ellipsoid, a Capsule, a RoundedBox, a Paraboloid, or a Revolved or Extruded profile",
    AbstractMotion: "a Translation or Rotation",
    SpaceMotion: "a LinearDrive, RotaryDrive or WhiskDrive",
    object: "a Table or a Polynomial",
}


def tables_of(scene: AbstractScene) -> dict[str, Any]:
    """The tables of a scene.

    Raises:
        ValueError: if a part of it is a Python function or a class of the user, or is traced.
    """
    if checks.is_traced(scene):
        checks.fail("scene", "concrete", "a traced one")
    tables, arguments = {}, scene_arguments()
    for name in arguments_of(type(scene)):
        key, value = RENAMED.get(name, name), getattr(scene, name)
        if key == "objects":
            value = value.objects
        if not _is_default(value, arguments[key]):
            tables[key] = _written(value, arguments[key], key, scene)
    return tables


def _is_default(value: Any, argument: Argument) -> bool:
    """Whether a value need not be written."""
    default = argument.default
    if isinstance(value, eqx.Module) or isinstance(default, eqx.Module):
        return type(value) is type(default) and bool(eqx.tree_equal(value, default))
    # 0.0 and -0.0 are equal, but not the same.
    return repr(np.asarray(value).tolist() if hasattr(value, "dtype") else value) == repr(default)


def _written(value: Any, argument: Argument, key: str, owner: Any) -> Any:
    if value is None:
        return NONE
    if isinstance(value, bool | str):
        return value
    if isinstance(value, tuple):
        return [_written(one, argument, key, owner) for one in value]
    if checks.is_numeric(value):
        return np.asarray(value).tolist()
    kinds = [kind for kind in argument.kinds.values() if kind.is_class and type(value) is kind.makes]
    if not kinds:
        raise ValueError(_cannot(value, argument, key, owner))
    if (named := named_call(value)) is None:
        kind, parts = kinds[0], {name: getattr(value, name) for name in kinds[0].arguments}
    else:
        kind, parts = named
    table = {} if kind is argument.usual else {KIND: kind.name}
    for name, own in kind.arguments.items():
        if name in parts and not _is_default(parts[name], own):
            table[name] = _written(parts[name], own, name, value)
    return table


def _cannot(value: Any, argument: Argument, key: str, owner: Any) -> str:
    """Why a value cannot be written, and what can."""
    called = callable(value)
    what = f"the function {name_of(value)}" if isinstance(value, PlainFunction) else f"a {type(value).__name__}"
    known = ", ".join(made.__name__ for family in argument.families for made in FAMILIES[family])
    instead = next(text for kind, text in INSTEAD.items() if isinstance(owner, kind)) if called else f"one of {known}"
    return (
        f"`{key}` must consist of numbers to be written to a file, got {what} in a {type(owner).__name__}. Use "
        f"{instead}, or keep the scene in Python."
    )
