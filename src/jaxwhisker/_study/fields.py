"""Fields of a study: names, dimensions, units and types of the variables that its Dataset can hold."""

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.path import EventKind, Status
from jaxwhisker._study import summaries

# Powers of force and length in a kind of quantity.
KINDS = {
    "length": (0, 1),
    "force": (1, 0),
    "moment": (1, 1),
    "energy": (1, 1),
    "stiffness": (1, -1),
    "bending stiffness": (1, 2),
    "angle": (0, 0),
    "number": (0, 0),
}


class Field(NamedTuple):
    """A variable for every point of a study."""

    long_name: str
    kind: str  # of KINDS
    dims: tuple[str, ...]  # behind those of the points
    dtype: str = "float64"
    per: str = "number"  # of a derivative: the kind of what it is taken by

    @property
    def fill(self) -> float | int | bool:
        """What stands where nothing is known."""
        return {"f": np.nan, "i": -1, "b": False}[np.dtype(self.dtype).kind]


STEP, EVENT = ("control", "whisker"), ("event", "whisker")

_STATE = {
    "fx": Field("support reaction along x", "force", STEP),
    "fy": Field("support reaction along y", "force", STEP),
    "mz": Field("support reaction, moment", "moment", STEP),
    "base_x": Field("position of the base", "length", STEP),
    "base_y": Field("height of the base", "length", STEP),
    "base_angle": Field("angle of the base to the upright", "angle", STEP),
    "contact_force": Field("contact force", "force", STEP),
    "contact_slope": Field("slope of the object at the contact", "angle", STEP),
    "contact_arc": Field("arc length from base to contact", "length", STEP),
    "contact_x": Field("contact point, x", "length", STEP),
    "contact_y": Field("contact point, y", "length", STEP),
    "phase": Field("phase of contact", "number", STEP, "int8"),
}
FIELDS = _STATE | {
    "spring_length": Field("length of the spring", "length", ("control", "spring")),
    "status": Field("what became of the step", "number", ("control",), "int8"),
    "event_kind": Field("what happens at the event", "number", ("event",), "int8"),
    "event_control": Field("drive position of the event", "length", ("event",)),
    "event_whisker": Field("whether the event concerns the whisker", "number", EVENT, "bool"),
    "event_count": Field("number of events", "number", (), "int32"),
    "event_energy_before": Field("stored elastic energy before the event", "energy", ("event",)),
    "event_energy_after": Field("stored elastic energy after the event", "energy", ("event",)),
}
for _side in ("before", "after"):
    for _name, _field in _STATE.items():
        FIELDS[f"{_side}_{_name}"] = _field._replace(long_name=f"{_field.long_name}, {_side} the event", dims=EVENT)

# What a summary has for a scene as a whole, in place of one for each whisker.
_WHOLE = {"snap_work": "float64", "snaps": "int32", "steps_failed": "int32"}
SUMMARY = {
    name: Field(long_name, kind, () if name in _WHOLE else ("whisker",), _WHOLE.get(name, "float64"))
    for name, (long_name, kind) in summaries.FIELDS.items()
}

GROUPS = {
    "reactions": ("fx", "fy", "mz"),
    "status": ("status",),
    "events": tuple(name for name in FIELDS if name.startswith("event_")),
    "contact": ("phase", *(name for name in FIELDS if name.startswith("contact_"))),
    "springs": ("base_x", "base_y", "base_angle", "spring_length"),
    "event_states": tuple(name for name in FIELDS if name.startswith(("before_", "after_"))),
    "all": tuple(FIELDS),
}
DEFAULT = ("reactions", "status", "events")

_FLAGS: dict[str, tuple[type[IntEnum], str | None]] = {
    "phase": (Phase, None),
    "status": (Status, "not_computed"),
    "event_kind": (EventKind, "none"),
}


def chosen(outputs: Sequence[str] | str) -> tuple[str, ...]:
    """Names of the fields that `outputs`, names of fields and groups, stand for."""
    wanted: set[str] = set()
    for name in (outputs,) if isinstance(outputs, str) else outputs:
        if name not in GROUPS and name not in FIELDS:
            raise ValueError(f"`outputs` must be names among {', '.join([*GROUPS, *FIELDS])}, but one is {name!r}.")
        wanted |= set(GROUPS.get(name, (name,)))
    return tuple(name for name in FIELDS if name in wanted)


def variables(outputs: Sequence[str] | str, derivatives: Sequence[str], summarised: bool) -> dict[str, Field]:
    """The variables of a study; where signals are summarised, those along the control are not kept."""
    found = {name: FIELDS[name] for name in chosen(outputs)}
    if summarised:
        found = {name: field for name, field in found.items() if "control" not in field.dims}
    for name, field in list(found.items()):
        for parameter in derivatives if field.dtype == "float64" else ():
            words = f"derivative by {parameter} of the {field.long_name}"
            found[derivative_name(name, parameter)] = field._replace(long_name=words, per=kind_of_axis(parameter))
    return found | (SUMMARY if summarised else {})


def derivative_name(name: str, parameter: str) -> str:
    """The variable that holds the derivative of another one by a parameter."""
    return f"d_{name}_d_{parameter}"


def unit(kind: str, dimensionless: bool, per: str = "number") -> str:
    """The unit of a kind of quantity, or of its derivative by another kind, in L and EI or in words."""
    force, length = (a - b for a, b in zip(KINDS[kind], KINDS[per], strict=True))
    powers = {"EI": force, "L": length - 2 * force} if dimensionless else {"force": force, "length": length}
    powers = {"rad": (kind == "angle") - (per == "angle")} | powers
    above, below = ([_power(n, sign * p) for n, p in powers.items() if sign * p > 0] for sign in (1, -1))
    return "/".join([" ".join(above) or "1", *[" ".join(below)] * bool(below)])


def _power(name: str, power: int) -> str:
    return name if power == 1 else f"{name}^{power}"


def kind_of_axis(name: str) -> str:
    """What a parameter of that name most likely is; a number if the name tells nothing."""
    name = name.rstrip("_0123456789")
    for kind, endings in {
        "bending stiffness": ("bending_stiffness",),
        "stiffness": ("stiffness",),
        "length": ("length", "distance", "radius", "position"),
    }.items():
        if name.endswith(endings):
            return kind
    return "number"


def attributes(name: str, field: Field, dimensionless: bool) -> dict:
    """Long name, units and, for numbers that stand for words, their meanings."""
    found: dict = {"long_name": field.long_name, "units": unit(field.kind, dimensionless, field.per)}
    if field.dtype == "int8":
        words, missing = _FLAGS[name.removeprefix("before_").removeprefix("after_")]
        flags = ({-1: missing} if missing else {}) | {int(w): w.name for w in words}
        found |= {"flag_values": np.array(list(flags), dtype=np.int8), "flag_meanings": " ".join(flags.values())}
    return found
