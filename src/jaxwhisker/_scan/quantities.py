"""Quantities: the single table of names, symbols, units, axes and signs of everything that a scan returns.

Results, datasets, CSV headers, axis labels, printed tables and the reference pages all read this table.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from jaxwhisker._base.checks import is_traced
from jaxwhisker._model.scene import AbstractScene, Sensor, Units, time_unit
from jaxwhisker._model.scene import units as natural_units
from jaxwhisker._scan.state import FRICTION, IN_SPACE, OBJECTS

# Kinds of quantities, as powers of force and length.
KINDS = {
    "length": (0, 1),
    "force": (1, 0),
    "moment": (1, 1),
    "energy": (1, 1),
    "stiffness": (1, -1),
    "curvature": (0, -1),
    "bending stiffness": (1, 2),
    "angle": (0, 0),
    "number": (0, 0),
}
ASSUMED = "the numbers of the scene are taken to be in SI units"  # unless it is dimensionless
CONTROL = "control"  # kind of drive positions: a length, an angle or a number, depending on the motion


class Quantity(NamedTuple):
    """A quantity of a scan."""

    description: str
    symbol: str  # LaTeX
    kind: str  # a key of KINDS, or CONTROL; empty if the unit is unknown
    axes: tuple[str, ...]
    sign: str = ""  # meaning of a positive value, unless it is obvious
    dtype: str = "float64"
    missing: int = -1  # for an integer, the value that marks missing data
    per: str = "number"  # for a derivative, the kind of the parameter

    @property
    def fill(self) -> float | int | bool:
        """The value that marks missing data."""
        return {"f": np.nan, "i": self.missing, "b": False}[np.dtype(self.dtype).kind]


_STEP, _EVENT = ("control", "whisker"), ("event", "whisker")
# Labels of the further axes of a rotation. The directors of a base are d1, d2 and d3, its tangent.
DIRECTORS = {"component": ("x", "y", "z"), "director": ("d1", "d2", "d3")}
_MOMENT = "moment of the support reaction"

# Fields of a state, for every whisker, in the plane or in space.
STATE = {
    "fx": Quantity("support reaction along x", "f_x", "force", _STEP, "the support pushes the whisker towards +x"),
    "fy": Quantity("support reaction along y", "f_y", "force", _STEP, "the support pushes the whisker towards +y"),
    "fz": Quantity("support reaction along z", "f_z", "force", _STEP, "the support pushes the whisker towards +z"),
    "mx": Quantity(f"{_MOMENT} about x", "m_x", "moment", _STEP, "right-handed about +x"),
    "my": Quantity(f"{_MOMENT} about y", "m_y", "moment", _STEP, "right-handed about +y"),
    "mz": Quantity("support reaction, moment", "m_z", "moment", _STEP, "counter-clockwise on the whisker"),
    "base_x": Quantity("position of the base", "x_0", "length", _STEP),
    "base_y": Quantity("height of the base", "y_0", "length", _STEP),
    "base_z": Quantity("position of the base along z", "z_0", "length", _STEP),
    "base_rotation": Quantity("directors of the base along x, y and z", "", "number", (*_STEP, *DIRECTORS)),
    "base_angle": Quantity("angle of the base to the upright", r"\varphi_0", "angle", _STEP, "counter-clockwise"),
    "contact_force": Quantity("contact force", "f", "force", _STEP, "never negative: the object only pushes"),
    "contact_slope": Quantity("slope of the object at the contact", r"\alpha", "angle", _STEP, "rising towards +x"),
    "contact_arc": Quantity("arc length from base to contact", "s_1", "length", _STEP),
    "contact_x": Quantity("contact point, x", r"\xi", "length", _STEP),
    "contact_y": Quantity("contact point, y", r"\eta", "length", _STEP),
    "contact_z": Quantity("contact point, z", r"\zeta", "length", _STEP),
    "phase": Quantity("phase of contact", "", "number", _STEP, dtype="int8"),
    # With friction only:
    "slip": Quantity("direction of slip along the object", "", "number", _STEP, dtype="int8", missing=-128),
    "normal_force": Quantity("contact force along the normal", "f_n", "force", _STEP, "never negative"),
    "friction_force": Quantity("contact force along the object", "f_t", "force", _STEP, "towards +x on the whisker"),
    "friction_x": Quantity("contact force along the object, along x", "f_{t,x}", "force", _STEP, "towards +x"),
    "friction_y": Quantity("contact force along the object, along y", "f_{t,y}", "force", _STEP, "towards +y"),
    "friction_z": Quantity("contact force along the object, along z", "f_{t,z}", "force", _STEP, "towards +z"),
    # With several objects only:
    "contact_object": Quantity("number of the object, 0 without contact", "", "number", _STEP, dtype="int8"),
}
# Fields of a state that belong to contacts. If a whisker may have several, they have a further axis, from the tip on.
OF_CONTACTS = (
    "contact_force",
    "contact_slope",
    "contact_arc",
    "contact_x",
    "contact_y",
    "contact_z",
    "phase",
    *FRICTION,
    *OBJECTS,
)
CONTACT = "contact"  # this axis
QUANTITIES = (
    {"control": Quantity("drive position", "u", CONTROL, ("control",))}
    | STATE
    | {
        "spring_length": Quantity("length of the spring", r"\ell", "length", ("control", "spring")),
        "status": Quantity("status of the step", "", "number", ("control",), dtype="int8"),
        "event_kind": Quantity("kind of event", "", "number", ("event",), dtype="int8"),
        "event_control": Quantity("drive position of the event", "u", CONTROL, ("event",)),
        "event_whisker": Quantity("whether the event concerns the whisker", "", "number", _EVENT, dtype="bool"),
        "event_count": Quantity("number of events", "", "number", (), dtype="int32"),
        "event_energy_before": Quantity("stored elastic energy before the event", "U", "energy", ("event",)),
        "event_energy_after": Quantity("stored elastic energy after the event", "U", "energy", ("event",)),
    }
    | {
        f"{when}_{name}": quantity._replace(
            description=f"{quantity.description}, {when} the event", axes=("event", *quantity.axes[1:])
        )
        for when in ("before", "after")
        for name, quantity in STATE.items()
    }
)
# What a simulation has besides, over time.
_SAMPLE = ("time", "whisker")
MOTION = {
    "time": Quantity("time", "t", "time", ("time",)),
    "gap": Quantity("distance between whisker and object", "g", "length", _SAMPLE),
    "tip_x": Quantity("position of the tip", "x_1", "length", _SAMPLE),
    "tip_y": Quantity("height of the tip", "y_1", "length", _SAMPLE),
}
REACTIONS = ("fx", "fy", "mz")
REACTIONS_IN_SPACE = ("fx", "fy", "fz", "mx", "my", "mz")
ENERGIES = ("event_energy_before", "event_energy_after")
# Quantities, also before and after events, that scenes in space do not have.
ABSENT_IN_SPACE = ("base_angle", "contact_slope", "friction_force", *ENERGIES)
# What figures compute from a run.
DERIVED = {"spring_extension": Quantity("extension of the spring", r"\Delta\ell", "length", ("control", "spring"))}
OF_SPRINGS = ("spring_length", "spring_extension")
# Quantities that can be plotted against the control.
DRAWN = (*(name for name in STATE if name not in ("phase", "slip", *OBJECTS, *IN_SPACE)), *OF_SPRINGS)
_NOT_DRAWN_IN_SPACE = ("phase", "slip", "base_rotation", *OBJECTS, *ABSENT_IN_SPACE)
DRAWN_IN_SPACE = (*(name for name in STATE if name not in _NOT_DRAWN_IN_SPACE), *OF_SPRINGS)


def quantity(name: str) -> Quantity:
    """The quantity of a scan or a simulation with this name."""
    return (QUANTITIES | MOTION | DERIVED)[name]


def is_of_contacts(name: str) -> bool:
    """Whether the quantity with this name, also before or after an event, belongs to contacts."""
    return name.removeprefix("before_").removeprefix("after_") in OF_CONTACTS


def with_contacts(name: str, quantity: Quantity, contacts: int) -> Quantity:
    """The quantity with this name of whiskers that may have so many contacts."""
    several = contacts > 1 and is_of_contacts(name)
    return quantity._replace(axes=(*quantity.axes, CONTACT)) if several else quantity


def in_space(quantity: Quantity) -> Quantity:
    """The quantity in the words of a scene in space, where mz is one of three moments, and slip has no sign."""
    words = quantity.description.replace(STATE["mz"].description, f"{_MOMENT} about z")
    words = words.replace(STATE["slip"].description, "whether the contact slips along the object")
    sign = quantity.sign.replace(STATE["mz"].sign, "right-handed about +z")
    return quantity._replace(description=words, sign=sign)


def kind_of(name: str, scene: AbstractScene | Sensor) -> str:
    """The kind of a quantity of a scene; for a drive position, a length, angle or number."""
    kind = quantity(name).kind
    return control_kind(scene) if kind == CONTROL else kind


def control_kind(scene: AbstractScene | Sensor) -> str:
    """The kind of the control of a scene: a length, angle or number."""
    return scene.motion.control_kind


def reactions_of(scene: AbstractScene | Sensor) -> tuple[str, ...]:
    """Names of the reactions of the support: three in the plane, six in space."""
    return REACTIONS_IN_SPACE if isinstance(scene, AbstractScene) and scene.in_space else REACTIONS


def control_name(scene: AbstractScene | Sensor) -> str:
    """Name of the control of a scene."""
    return {"length": "drive position", "angle": "angle of the drive", "number": "control"}[control_kind(scene)]


def is_dimensionless(scene: AbstractScene | Sensor) -> bool:
    """Whether the first whisker has length 1 and bending stiffness 1 at its base; other scenes are shown in SI."""
    first = scene.whiskers[0]
    values = (first.length, first.base_stiffness)
    return not any(is_traced(value) or np.any(np.asarray(value) != 1.0) for value in values)


class Unit(NamedTuple):
    """A unit that quantities of a scene are shown in."""

    name: str  # such as "mN mm"; empty for a number, or for a quantity divided by the scene's own unit
    size: float  # in the scene's units


UNITS = ("auto", "SI", "dimensionless")


def check_units(units: Any) -> None:
    """Check the name of a system of units.

    Raises:
        ValueError: if it is not one of `UNITS`.
    """
    if units not in UNITS:
        raise ValueError(f"`units` must be one of {', '.join(UNITS)}, got {units!r}.")


_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


class UnitSystem:
    """The units in which figures, films and tables show a scene.

    Args:
        scene: a concrete scene or sensor.
        units: "dimensionless" divides by L, EI/L^2 and EI/L of the first whisker, and times by
            T = L^2 sqrt(rho A / EI); "SI" takes the scene's numbers to be
            in SI units and adds prefixes that suit the scene's size (mm, mN, mN mm); "auto" is "dimensionless" for a
            whisker with L = EI = 1, else "SI".
        prefixes_of: the scene whose size decides the prefixes. Default: `scene`.

    Raises:
        ValueError: if `units` is none of these.
    """

    def __init__(
        self,
        scene: AbstractScene | Sensor,
        units: str = "auto",
        *,
        prefixes_of: AbstractScene | Sensor | None = None,
    ):
        check_units(units)
        self.scene: Any = scene
        self.dimensionless = is_dimensionless(scene) if units == "auto" else units == "dimensionless"
        self.natural = natural_units(scene)
        self._prefixes_of = scene if prefixes_of is None else prefixes_of

    def unit(self, name: str) -> Unit:
        """The unit of the quantity with this name."""
        return self.of_kind(kind_of(name, self.scene))

    def of_kind(self, kind: str) -> Unit:
        """The unit of a kind of quantity."""
        if kind == "angle":
            return Unit("rad", 1.0)
        if kind == "number":
            return Unit("", 1.0)
        if self.dimensionless:
            return Unit("", self._natural(kind))
        if kind == "time":
            return with_prefix("s", _unit_of_time(self._prefixes_of))
        force, length = KINDS[kind]
        sizes = natural_units(self._prefixes_of)
        newton, metre = with_prefix("N", float(sizes.force)), with_prefix("m", float(sizes.length))
        return _combined(newton, metre, force, length)

    def shown(self, name: str, values: Any) -> np.ndarray:
        """Values of a quantity in the unit in which it is shown."""
        values = np.asarray(values)
        if name in OF_SPRINGS:  # torsion springs have an angle, in rad
            size = self.unit(name).size
            return values / [1.0 if spring.turns else size for spring in self.scene.support.springs]
        return np.asarray(values / self.unit(name).size)

    def scale(self, kind: str) -> float:
        """The number that is shown for L, EI/L^2, EI/L, T and the like of the scene: 1 if dimensionless."""
        return 1.0 if kind in ("angle", "number") else self._natural(kind) / self.of_kind(kind).size

    def _natural(self, kind: str) -> float:
        return _unit_of_time(self.scene) if kind == "time" else _natural(self.natural, kind)

    def label(self, name: str) -> str:
        """Symbol and unit of a quantity, for an axis."""
        kind = kind_of(name, self.scene)
        if name == "control" and kind != "length":
            return control_name(self.scene) + (" (rad)" if kind == "angle" else "")
        return self.label_of(quantity(name).symbol, kind)

    def label_of(self, symbol: str, kind: str) -> str:
        """A symbol with the unit of a kind of quantity, for an axis."""
        if self.dimensionless:
            return dimensionless_label(symbol, kind)
        unit = self.of_kind(kind).name
        return f"${symbol}$" + f" ({unit})" * bool(unit)


def dimensionless_label(symbol: str, kind: str) -> str:
    """A symbol made dimensionless with L and EI, or a time with T, for an axis."""
    if kind == "time":
        return f"${symbol}/T$"
    force, length = KINDS[kind]
    times = rf"\,{_power('L', 2 * force - length)}" if 2 * force > length else ""
    return f"${symbol}{times}{'/EI' if force else '/L' if length > 0 else ''}$" + " (rad)" * (kind == "angle")


def _unit_of_time(scene: AbstractScene | Sensor) -> float:
    return float(time_unit(scene.whiskers[0]))


def _natural(sizes: Units, kind: str) -> float:
    """The natural unit of a kind of quantity, formed from L and EI of the first whisker, in the scene's units."""
    force, length = KINDS[kind]
    return float(sizes.force) ** force * float(sizes.length) ** length


def with_prefix(base: str, size: float) -> Unit:
    """The unit, with a prefix, in which a value of this size has one to three digits before the decimal point."""
    decade = min(max(3 * math.floor(math.log10(size) / 3), min(_PREFIXES)), max(_PREFIXES))
    return Unit(_PREFIXES[decade] + base, 10.0**decade)


def unit_in_words(kind: str, dimensionless: bool, per: str = "number") -> str:
    """The unit of a kind of quantity, or of its derivative by another kind: in L and EI, or in SI units.

    Datasets and files hold the scene's own numbers. Those of scenes that are not dimensionless are taken to be in SI
    units, as in figures.
    """
    if kind == "time":
        return "T" if dimensionless else "s"
    force, length = (a - b for a, b in zip(KINDS[kind], KINDS[per], strict=True))
    powers = {"EI": force, "L": length - 2 * force} if dimensionless else {"N": force, "m": length}
    return _product({"rad": (kind == "angle") - (per == "angle")} | powers)


_EARLIER = {"force": "N", "length": "m"}  # units in Datasets of earlier versions


def in_si(words: str, force: float, length: float) -> Unit:
    """The unit in words, with prefixes that suit the sizes of force and length, if it consists of N, m and rad.

    Datasets of earlier versions have `force` for N and `length` for m. Other units stay as they are.
    """
    powers = {"N": 0, "m": 0}
    for sign, product in zip((1, -1), words.split("/"), strict=False):
        for name, _, power in (part.partition("^") for part in product.split()):
            powers[_EARLIER.get(name, name)] = sign * int(power or 1)
    powers.pop("1", None)
    if not powers.keys() <= {"N", "m", "rad"}:
        return Unit(words, 1.0)
    own = with_prefix("N", force), with_prefix("m", length), powers.pop("N"), powers.pop("m")
    return _combined(*own, powers)


def _combined(
    newton: Unit, metre: Unit, force: int, length: int, others: Mapping[str, int] = MappingProxyType({})
) -> Unit:
    """A product of powers of the units of force and length, and of others, which have no prefix."""
    if (force, length) == (1, -1) and not others:  # N/m rather than mN/mm; the factor outweighs rounding
        return with_prefix("N/m", 1.5 * newton.size / metre.size)
    size = newton.size**force * metre.size**length
    return Unit(_product({newton.name: force} | dict(others) | {metre.name: length}), size)


def _product(powers: dict[str, int]) -> str:
    """A product of powers of units in words, such as `N/m`; 1 without units."""
    above, below = (" ".join(_power(n, sign * p) for n, p in powers.items() if sign * p > 0) for sign in (1, -1))
    return (above or "1") + f"/{below}" * bool(below)


def _power(name: str, power: int) -> str:
    return name if power == 1 else f"{name}^{power}"
