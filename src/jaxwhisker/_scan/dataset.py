"""The Dataset of a scan: variables, coordinates, attributes and flags. A study adds its own axes."""

import platform
from collections.abc import Collection, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from jaxwhisker._base.checks import is_traced
from jaxwhisker._base.types import NamedInt
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.scene import AbstractScene
from jaxwhisker._model.scene import units as natural_units
from jaxwhisker._path.path import EventKind, Status
from jaxwhisker._scan.quantities import (
    ABSENT_IN_SPACE,
    ASSUMED,
    CONTACT,
    CONTROL,
    DIRECTORS,
    QUANTITIES,
    Quantity,
    control_kind,
    control_name,
    in_si,
    in_space,
    is_dimensionless,
    unit_in_words,
    with_contacts,
)
from jaxwhisker._scan.state import FRICTION, FRICTION_IN_SPACE, IN_SPACE, OBJECTS

if TYPE_CHECKING:
    import xarray as xr


class SlipDirection(NamedInt):
    """Direction of slip along the object."""

    backwards = -1  # towards -x
    sticks = 0
    forwards = 1


class SlipInSpace(NamedInt):
    """Whether a contact slips along the object."""

    sticks = 0
    slips = 1


VARIABLES = {name: quantity for name, quantity in QUANTITIES.items() if name != "control"}
# Integers that stand for words, and the word for -1.
FLAGS: dict[str, tuple[type[NamedInt], str | None]] = {
    "phase": (Phase, None),
    "status": (Status, "not_computed"),
    "event_kind": (EventKind, "none"),
    "slip": (SlipDirection, None),
}

SIGNS = (
    "x along the scan, y up from the bases to the object; fx, fy and mz (counter-clockwise positive) are what the "
    "support exerts on the whisker at its base"
)
SIGNS_IN_SPACE = (
    "x along the scan, y up, z = x cross y; fx, fy, fz and mx, my, mz (right-handed, about the displaced base) are "
    "what the support exerts on the whisker"
)


class SceneLayout(NamedTuple):
    """Everything that the Dataset of a scene depends on, except for numbers."""

    description: str
    whiskers: int
    springs: tuple[str, ...]  # the two ends of each, and its axis if that is not x
    control_name: str
    control_kind: str  # of quantities.KINDS
    onwards: int  # +1 if the control grows during a scan, else -1
    absent: tuple[str, ...]  # fields of a state that the scene does not have
    dimensionless: bool  # the first whisker's length and bending stiffness are 1
    sizes: dict[str, float]  # typical force and length, unless dimensionless; empty if unknown
    in_space: bool = False
    contacts: int = 1  # of one whisker at most

    def attributes(self, name: str, quantity: Quantity) -> dict[str, Any]:
        """Attributes of a variable: long name, units, and the meaning of a positive sign and of flags."""
        quantity = in_space(quantity) if self.in_space else quantity
        kind = self.control_kind if quantity.kind == CONTROL else quantity.kind
        found: dict[str, Any] = {"long_name": quantity.description}
        if kind:
            found["units"] = unit_in_words(kind, self.dimensionless, quantity.per)
        if quantity.sign:
            found["positive_means"] = quantity.sign
        if name == "spring_length" and any(" phi" in spring for spring in self.springs):
            ends = "phi, phi_x or phi_y" if self.in_space else "phi"
            found["comment"] = f"torsion springs (`between` ends in {ends}) have an angle instead, in rad"
        plain = name.removeprefix("before_").removeprefix("after_").removeprefix("point_")
        if plain in FLAGS:
            words, missing = (SlipInSpace, None) if self.in_space and plain == "slip" else FLAGS[plain]
            flags = ({-1: missing} if missing else {}) | {int(w): w.name for w in words}
            found |= {"flag_values": np.array(list(flags), dtype=np.int8), "flag_meanings": " ".join(flags.values())}
        return found

    def coordinates(self, control: np.ndarray, dimensions: Collection[str]) -> dict[str, tuple]:
        """Coordinates along the control, and along whiskers and springs if these are among the dimensions."""
        units = unit_in_words(self.control_kind, self.dimensionless)
        found: dict[str, tuple] = {"control": ("control", control, {"long_name": self.control_name, "units": units})}
        sizes = ("whisker", self.whiskers), ("spring", len(self.springs)), (CONTACT, self.contacts)
        for dim, size in sizes:
            if dim in dimensions:
                found[dim] = (dim, np.arange(1, size + 1), {"long_name": f"number of the {dim}", "units": "1"})
        if "spring" in dimensions:
            ends = np.array(self.springs, dtype=object)
            found["between"] = ("spring", ends, {"long_name": "ends of the spring, 0 the drive", "units": "1"})
        for dim in (dim for dim in DIRECTORS if dim in dimensions):
            found[dim] = (dim, np.array(DIRECTORS[dim], dtype=object), {"long_name": dim, "units": "1"})
        return found

    def dataset_attributes(self) -> dict[str, Any]:
        """Attributes of the whole Dataset."""
        return {
            "title": f"scans with tactile whiskers: {self.description}",
            "scene": self.description,
            "signs": SIGNS_IN_SPACE if self.in_space else SIGNS,
            "source": f"jaxwhisker {version('jaxwhisker')}",
            "jaxwhisker_version": version("jaxwhisker"),
            "jax_version": jax.__version__,
            "jax_backend": jax.default_backend(),
            "python_version": platform.python_version(),
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "Conventions": "CF-1.11",
            **({} if self.dimensionless else {"units_comment": ASSUMED}),
        } | {f"typical_{name}": size for name, size in self.sizes.items()}


def layout_of(scene: AbstractScene) -> SceneLayout:
    """The layout of a scene, traced or not."""
    springs = tuple("-".join(map(str, s.between)) + f" {s.axis}" * (s.axis != "x") for s in scene.support.springs)
    control = control_name(scene), control_kind(scene), scene.motion.onwards
    friction, missing = (FRICTION_IN_SPACE, ABSENT_IN_SPACE) if scene.in_space else (FRICTION, IN_SPACE)
    absent = friction * (scene.friction is None) + OBJECTS * (len(scene.objects) == 1) + missing
    dimensionless, sizes = is_dimensionless(scene), {}
    if not dimensionless and not is_traced(scene.whiskers[0]):
        natural = natural_units(scene)
        sizes = {"force": float(natural.force), "length": float(natural.length)}
    own = str(scene), scene.support.whiskers, springs
    contacts = scene.contacts
    return SceneLayout(*own, *control, absent, dimensionless, sizes, scene.in_space, contacts)


def in_shown_units(data: Any, attributes: Mapping[str, Any]) -> Any:
    """A Dataset or DataArray in the units in which figures and tables show it.

    The numbers of scenes that are not dimensionless are taken to be in SI units; prefixes suit their sizes.

    Args:
        data: a study, its summary, or a variable of them.
        attributes: those of the Dataset.
    """
    if "typical_length" not in attributes:
        return data

    force, length = attributes["typical_force"], attributes["typical_length"]

    def shown(variable):
        words = variable.attrs.get("units", "1")
        unit = in_si(words, force, length)
        if unit.name == words:
            return variable
        scaled = variable / unit.size
        scaled.attrs = variable.attrs | {"units": unit.name}
        return scaled

    coordinates = {name: shown(data[name].variable) for name in data.coords}
    if hasattr(data, "data_vars"):
        data = data.assign({name: shown(variable) for name, variable in data.data_vars.items()})
    return data.assign_coords(coordinates)


def scan_dataset(scene: AbstractScene, arrays: Mapping[str, Any]) -> "xr.Dataset":
    """The Dataset of one scan.

    Args:
        scene: the scene that was scanned.
        arrays: all quantities of the scan by their names in `QUANTITIES`, in the scene's units.

    Raises:
        ImportError: if xarray is missing.
    """
    try:
        import xarray as xr
    except ImportError as error:
        raise ImportError("`to_xarray` needs xarray: pip install jaxwhisker[study]") from error
    layout, arrays = layout_of(scene), {name: np.asarray(array) for name, array in arrays.items()}
    variables = {
        name: (
            with_contacts(name, quantity, layout.contacts).axes,
            arrays[name].astype(quantity.dtype),
            layout.attributes(name, quantity),
        )
        for name, quantity in VARIABLES.items()
        if name in arrays
    }
    used = {dim for axes, *_ in variables.values() for dim in axes}
    coordinates = layout.coordinates(arrays["control"], used)
    attributes = layout.dataset_attributes() | {"points": points_in_words(first_failure(arrays["status"]))}
    attributes |= omitted_events(arrays["event_count"], arrays["event_kind"].size)
    return xr.Dataset(variables, coordinates, attributes)


def first_failure(status: np.ndarray) -> np.ndarray:
    """The first status along the control (the last axis) that is not ok; ok if there is none."""
    first = np.argmax(status != Status.ok, axis=-1)
    return np.take_along_axis(status, first[..., None], axis=-1)[..., 0]


def counted(status: Any) -> dict[str, int]:
    """How often each status occurs, by name."""
    kinds, counts = np.unique(np.asarray(status), return_counts=True)
    return {Status(int(kind)).name: int(count) for kind, count in zip(kinds, counts, strict=True)}


def points_in_words(status: np.ndarray) -> str:
    """Text that says how many points are ok, and how many failed with which status."""
    failed = counted(status)
    ok = failed.pop("ok", 0)
    counts = [f"{failed[name]:,} {name}" for name in sorted(failed, key=lambda name: -failed[name])]
    return "; ".join([f"{ok:,} of {status.size:,} ok", *counts])


def omitted_events(count: np.ndarray, room: int) -> dict[str, str]:
    """An attribute that says whether some points have more events than the Dataset has room for."""
    more = count > room
    if not more.any():
        return {}
    words = f"{more.sum():,} of {count.size:,} points have more than the {room} events stored, up to {count.max():,}"
    return {"omitted_events": words}
