"""The description of a study: what has to agree for the blocks of two runs to belong together."""

import hashlib
from typing import Any

import jax
import numpy as np

import jaxwhisker
from jaxwhisker._study.parameters import Parameters

Description = dict[str, Any]  # goes to JSON and back unchanged


def described(parameters: Parameters, control: np.ndarray | None, variables: list[str]) -> Description:
    """What can be said about a study before its function is traced."""
    return {
        "dimensions": list(parameters.dims),
        "axes": {name: _numbers(values) for name, values in parameters.values.items()},
        "control": "the default one" if control is None else _numbers(control),
        "variables": variables,
        "jaxwhisker": jaxwhisker.__version__,
        "jax": jax.__version__,
        "platform": jax.default_backend(),
    }


def _numbers(values: np.ndarray) -> dict[str, Any]:
    return {"values": values.size, "hash": hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()}


def difference(this: Description, other: Description) -> str | None:
    """The first thing in which another study differs from this one, in words."""
    mine, its = this["axes"], other["axes"]
    if list(mine) != list(its) or this["dimensions"] != other["dimensions"]:
        kinds = ["points" if d["dimensions"] == ["point"] else "axes" for d in (other, this)]
        return f"its {kinds[0]} are {', '.join(its)}, here {kinds[1]} are {', '.join(mine)}"
    for name in mine:
        if mine[name] != its[name]:
            return f"its axis `{name}` {_other_numbers(mine[name], its[name])}"
    if this["control"] != other["control"]:
        if isinstance(this["control"], dict) and isinstance(other["control"], dict):
            return f"its control {_other_numbers(this['control'], other['control'])}"
        return f"its control is {'a given one' if isinstance(other['control'], dict) else other['control']}"
    if this["variables"] != other["variables"]:
        return f"its variables are {', '.join(other['variables'])}, here {', '.join(this['variables'])}"
    for name in ("jaxwhisker", "jax", "platform"):
        if this[name] != other[name]:
            return f"its {name} is {other[name]}, here {this[name]}"
    if "build" in this and this["build"] != other["build"]:
        return "its `build` makes other scenes"
    return None


def _other_numbers(mine: dict[str, Any], its: dict[str, Any]) -> str:
    if mine["values"] != its["values"]:
        return f"has {its['values']} values, this one {mine['values']}"
    return "has other values"
