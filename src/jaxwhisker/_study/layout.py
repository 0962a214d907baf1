"""The layout of a study's Dataset: its dimensions, coordinates, variables and what they are called."""

import platform
from datetime import UTC, datetime
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

import jaxwhisker
from jaxwhisker._study.fields import Field, attributes, kind_of_axis, unit
from jaxwhisker._study.parameters import Parameters
from jaxwhisker._study.structure import Structure

if TYPE_CHECKING:
    import xarray as xr

SIGNS = (
    "x along the scan, y up from the bases to the object; the drive moves towards -x, fx, fy and mz (counter-clockwise "
    "positive) are what the support exerts on the whisker at its base"
)


class Layout(NamedTuple):
    """Everything about a Dataset but the values of its variables."""

    parameters: Parameters
    structure: Structure
    control: Float[np.ndarray, " steps"]
    events: int  # how many a scan has room for
    variables: dict[str, Field]

    @property
    def sizes(self) -> dict[str, int]:
        """Size of every dimension behind those of the points."""
        n, springs = self.structure.whiskers, len(self.structure.springs)
        return {"control": self.control.size, "whisker": n, "spring": springs, "event": self.events}

    def dims(self, name: str) -> tuple[str, ...]:
        """Dimensions of a variable."""
        return self.parameters.dims + self.variables[name].dims

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of a variable."""
        return self.parameters.shape + tuple(self.sizes[dim] for dim in self.variables[name].dims)

    def attributes(self, name: str) -> dict:
        """Attributes of a variable."""
        return attributes(name, self.variables[name], self.structure.dimensionless)

    def frame(self) -> "xr.Dataset":
        """Coordinates and global attributes."""
        import xarray as xr

        plain = self.structure.dimensionless
        used = {dim for field in self.variables.values() for dim in field.dims}
        coords: dict = {}
        for name, values in self.parameters.values.items():
            known = {"long_name": name.replace("_", " "), "units": unit(kind_of_axis(name), plain)}
            coords[name] = ("point" if self.parameters.paired else name, values, known)
        if self.parameters.paired:
            point = np.arange(self.parameters.shape[0])
            coords["point"] = ("point", point, {"long_name": "row of the table of points", "units": "1"})
        words, kind = self.structure.control
        drive = {"long_name": words, "units": unit(kind, plain)}
        coords["control"] = ("control", self.control, drive)
        for dim, words in (("whisker", "number of the whisker"), ("spring", "number of the spring")):
            if dim in used:
                coords[dim] = (dim, np.arange(1, self.sizes[dim] + 1), {"long_name": words, "units": "1"})
        if "spring" in used:
            ends = np.array(self.structure.springs, dtype=object)
            coords["between"] = ("spring", ends, {"long_name": "ends of the spring, 0 the drive", "units": "1"})
        attrs = {
            "title": f"scans with tactile whiskers: {self.structure.words}",
            "scene": self.structure.words,
            "signs": SIGNS,
            "source": f"jaxwhisker {jaxwhisker.__version__}",
            "jaxwhisker_version": jaxwhisker.__version__,
            "jax_version": jax.__version__,
            "python_version": platform.python_version(),
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "Conventions": "CF-1.11",
        }
        return xr.Dataset(coords=coords, attrs=attrs)
