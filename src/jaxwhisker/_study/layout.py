"""The Dataset of a study: its variables, dimensions, coordinates and attributes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxwhisker._scan.dataset import VARIABLES, SceneLayout
from jaxwhisker._scan.quantities import (
    CONTACT,
    DIRECTORS,
    REACTIONS_IN_SPACE,
    STATE,
    Quantity,
    unit_in_words,
    with_contacts,
)
from jaxwhisker._scan.state import FRICTION, FRICTION_IN_SPACE, IN_SPACE, OBJECTS, OPTIONAL
from jaxwhisker._study.parameters import Parameters
from jaxwhisker._study.summary import comment_on, derivative_in_words, derivative_name, summary_without

if TYPE_CHECKING:
    import xarray as xr

GROUPS = {  # scenes have those of these variables that are not absent
    "reactions": REACTIONS_IN_SPACE,
    "status": ("status",),
    "events": tuple(name for name in VARIABLES if name.startswith("event_")),
    "contact": ("phase", *(name for name in STATE if name.startswith("contact_")), *FRICTION, *FRICTION_IN_SPACE),
    "springs": ("base_x", "base_y", "base_z", "base_rotation", "base_angle", "spring_length"),
    "event_states": tuple(name for name in VARIABLES if name.startswith(("before_", "after_"))),
    "all": tuple(VARIABLES),
}
DEFAULT = ("reactions", "status", "events")
# What scenes lack without all of these fields.
LACKS = (
    ("object in space", set(IN_SPACE)),
    ("friction", set(FRICTION)),
    ("friction", set(FRICTION_IN_SPACE)),
    ("several objects", set(OBJECTS)),
)
POINT_STATUS = "point_status"
NOT_COMPUTED = -1  # status of a point that has not been computed yet
DEFAULT_CONTROL = "default: from the earliest start to the latest end of the default controls of all points"


def chosen(outputs: Sequence[str] | str, absent: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the variables, of scenes without the fields `absent`, that `outputs` selects by name or by group.

    Raises:
        ValueError: if there is no such variable or group.
    """
    wanted: set[str] = set()
    for name in (outputs,) if isinstance(outputs, str) else outputs:
        if name not in GROUPS and name not in VARIABLES:
            raise ValueError(f"`outputs` must be names among {', '.join([*GROUPS, *VARIABLES])}, got {name!r}.")
        wanted |= set(GROUPS.get(name, (name,)))
    return tuple(name for name in VARIABLES if name in wanted and field_of(name) not in absent)


def channel_quantities(names: Sequence[str]) -> dict[str, Quantity]:
    """The channels of a user's function, whose units are unknown."""
    return {name: Quantity(name.replace("_", " "), "", "", ("control",)) for name in names}


def variables_of(
    outputs: Sequence[str] | str,
    derivatives: Sequence[str],
    summarised: bool,
    absent: Sequence[str] = OPTIONAL,
    channels: Sequence[str] = (),
    contacts: int = 1,
) -> dict[str, Quantity]:
    """The variables of a study; those along the control, except for channels, are left out if they are summarised.

    Raises:
        ValueError: if `outputs` contains a name that is unknown, or one that the scenes do not have.
    """
    kept = {name: with_contacts(name, VARIABLES[name], contacts) for name in chosen(outputs, absent)}
    for name in (outputs,) if isinstance(outputs, str) else outputs:
        if name in VARIABLES and name not in kept:
            lack = next((one for one, fields in LACKS if field_of(name) in fields <= set(absent)), f"{name} in space")
            raise ValueError(f"`outputs` must be names of what the scenes have, but they have no {lack}: got {name!r}.")
    if summarised:
        kept = {name: quantity for name, quantity in kept.items() if "control" not in quantity.axes}
    kept |= channel_quantities(channels) | (summary_without(absent) if summarised else {})
    for name, quantity in list(kept.items()):
        for parameter in derivatives if quantity.dtype == "float64" else ():
            words = derivative_in_words(quantity, parameter)
            slope = quantity._replace(description=words, symbol="", sign="", per=kind_of_axis(parameter))
            kept[derivative_name(name, parameter)] = slope
    status = Quantity("first status of the point that is not ok", "", "number", (), dtype="int8")
    return kept | {POINT_STATUS: status}


def field_of(name: str) -> str:
    """The field of a state that a variable holds, also before or after an event."""
    return name.removeprefix("before_").removeprefix("after_")


def kind_of_axis(name: str) -> str:
    """The kind of quantity that a parameter's name suggests; "number" if it suggests none."""
    name = name.rstrip("_0123456789")
    if name.endswith("stiffness"):
        return "bending stiffness" if name.endswith("bending_stiffness") else "stiffness"
    return "length" if name.endswith(("length", "distance", "radius", "position")) else "number"


class Layout(NamedTuple):
    """Everything about the Dataset of a study except the values of its variables."""

    parameters: Parameters
    scene: SceneLayout
    build: str  # hash of the scenes and channels, see structure.fingerprint
    control: Float[np.ndarray, " steps"]
    default_control: bool
    variables: dict[str, Quantity]
    events: int = 0  # number of events that are stored per scan

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes of the dimensions that follow those of the points."""
        own = {"control": self.control.size, "event": self.events} | {dim: len(DIRECTORS[dim]) for dim in DIRECTORS}
        return own | {"whisker": self.scene.whiskers, "spring": len(self.scene.springs), CONTACT: self.scene.contacts}

    def dims(self, name: str) -> tuple[str, ...]:
        """Dimensions of a variable."""
        return self.parameters.dims + self.variables[name].axes

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of a variable."""
        return self.parameters.shape + tuple(self.sizes[dim] for dim in self.variables[name].axes)

    def attributes(self, name: str) -> dict:
        """Attributes of a variable."""
        return self.scene.attributes(name, self.variables[name]) | comment_on(name, self.control)

    def frame(self) -> "xr.Dataset":
        """Coordinates and global attributes."""
        import xarray as xr

        paired = self.parameters.paired
        coordinates: dict = {}
        for name, values in self.parameters.values.items():
            units = unit_in_words(kind_of_axis(name), self.scene.dimensionless)
            known = {"long_name": name.replace("_", " "), "units": units}
            coordinates[name] = ("point" if paired else name, values, known)
        if paired:
            rows = np.arange(self.parameters.shape[0])
            coordinates["point"] = ("point", rows, {"long_name": "row of the table of points", "units": "1"})
        used = {dim for quantity in self.variables.values() for dim in quantity.axes}
        coordinates |= self.scene.coordinates(self.control, used)
        if self.default_control:
            coordinates["control"][2]["comment"] = DEFAULT_CONTROL
        return xr.Dataset(coords=coordinates, attrs=self.scene.dataset_attributes() | {"build": self.build})

    def difference(self, stored: "xr.Dataset") -> str | None:
        """The first difference between a stored study and this one, in words; None if they agree."""
        frame, own = self.frame(), list(self.parameters.values)
        other = [str(name) for name in stored.coords if name not in RESERVED]
        if set(own) != set(other) or ("point" in stored.dims) != self.parameters.paired:
            kinds = ["points" if paired else "axes" for paired in ("point" in stored.dims, self.parameters.paired)]
            return f"its {kinds[0]} are {', '.join(sorted(other))}, here {kinds[1]} are {', '.join(sorted(own))}"
        for name in own:
            if words := _other_values(frame[name].values, stored[name].values):
                return f"its axis `{name}` {words}"
        if (stored["control"].attrs.get("comment") == DEFAULT_CONTROL) != self.default_control:
            return f"its control is {'an explicit one' if self.default_control else 'the default'}"
        if not self.default_control and (words := _other_values(self.control, stored["control"].values)):
            return f"its control {words}"
        names, here = set(map(str, stored.data_vars)), set(self.variables)
        if names != here:
            parts = (("lack", here - names), ("also contain", names - here))
            return "its variables " + " and ".join(f"{verb} {', '.join(sorted(some))}" for verb, some in parts if some)
        versions = {"jaxwhisker": "jaxwhisker_version", "jax": "jax_version", "backend": "jax_backend"}
        for name, attribute in versions.items():
            if stored.attrs[attribute] != frame.attrs[attribute]:
                return f"its {name} is {stored.attrs[attribute]}, here {frame.attrs[attribute]}"
        if stored.attrs["build"] != self.build:
            return "its `build` makes other scenes, or its `channels` other signals"
        return None


RESERVED = {"control", "whisker", "spring", CONTACT, "event", "point", "between", *DIRECTORS}


def _other_values(here: np.ndarray, stored: np.ndarray) -> str | None:
    if here.size != stored.size:
        return f"has {stored.size} values, this one {here.size}"
    return None if np.array_equal(here, stored, equal_nan=True) else "has other values"
