"""Arrays: many whiskers of different shapes, each with its own base point, orientation and springs.

On a rigid pad, whiskers do not feel each other: they are a batch of scenes with one whisker each. On a compliant pad,
springs couple their bases, and they are one scene.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.columns import cells_of, floats
from jaxwhisker._base.data_files import published
from jaxwhisker._base.suggest import Suggesting
from jaxwhisker._base.types import Control, Scalar
from jaxwhisker._model.along import ParabolicShape, PowerTaper
from jaxwhisker._model.drives import SpaceMotion, WhiskDrive
from jaxwhisker._model.motion import AbstractMotion, Mount
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._model.spring import Spring
from jaxwhisker._model.support import Support
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import AbstractRod, Shooting
from jaxwhisker._scan.array_results import array_dataset, touch_table
from jaxwhisker._scan.result import SpaceResult
from jaxwhisker._scan.scan import scan

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

MM, DEGREE = 1e-3, np.pi / 180
SHOOTING: AbstractRod = Shooting()
PLACES = ("x", "y", "z")
ANGLES = ("protraction", "elevation", "roll")
RATES = ("protraction_rate", "elevation_rate", "roll_rate")
ROUND = ("base_diameter", "tip_diameter", "youngs_modulus")
STIFF = ("base_stiffness", "taper")
SHAPE = ("parabola", "curvature", "lateral_curvature", "twist", "torsion_ratio", "lateral_ratio")
SPRINGS = {f"spring_{axis}": axis for axis in ("x", "y", "z", "phi_x", "phi", "phi_y")}
COLUMNS = ("name", *PLACES, *ANGLES, *RATES, "length", *ROUND, *STIFF, *SHAPE, *SPRINGS)
ALLOWED = f"among {', '.join(COLUMNS)}"


class Array(eqx.Module, metaclass=Suggesting):
    """Whiskers of different shapes on one pad.

    A table makes one, or `Array.rat`. Each row is a whisker; angles are in rad, everything else in one consistent set
    of units. The base point is (x, y, z), and the directions of the root at the control 0 are as for WhiskDrive: an
    upright whisker (along +y) is turned by the roll about its root, tilted by the elevation towards +z, and turned by
    the protraction about z. Unless a scan has another motion, every whisker turns about its own base point, and the
    control is the angle u by which it protracts.

    Args:
        table: a mapping of columns, a DataFrame, or the path of a CSV file:

            - `length`: L; the only column that must be there.
            - `x`, `y`, `z`: base point. Default: 0.
            - `protraction`, `elevation`, `roll`: angles at u = 0. Default: 0.
            - `protraction_rate`, `elevation_rate`, `roll_rate`: their changes per u. Default: 1, 0 and 0.
            - `base_diameter`, `tip_diameter`, `youngs_modulus`: of a cone of this material.
            - or `base_stiffness`: EI at the base, 1 by default, and `taper`: the share by which the diameter falls.
            - `parabola`: A of an unloaded shape y = A x^2, or `curvature`: intrinsic curvature, 1/length; and
              `lateral_curvature`, `twist`, `torsion_ratio`, `lateral_ratio`, as for a Whisker.
            - `spring_x`, `spring_y`, `spring_z`, `spring_phi_x`, `spring_phi`, `spring_phi_y`: stiffness of the springs
              between drive and base. Default: clamped.
            - `name`: a text. Default: the number of the row, from 1.

    Raises:
        ValueError: if there is no column `length`, a column is unknown, has another length or a wrong value, or columns
            exclude each other; it names the row.

    Examples:
        >>> array = jw.Array({"x": [0.0, 0.3], "length": [1.0, 0.8], "name": ["long", "short"]})
        >>> array
        2 whiskers: long, short
    """

    names: tuple[str, ...] = eqx.field(static=True)
    whiskers: tuple[Whisker, ...]
    mounts: tuple[Mount, ...]
    drives: tuple[WhiskDrive, ...]
    springs: tuple[tuple[Spring, ...], ...]

    def __init__(self, table: Any):
        columns = _columns(table)
        count = len(columns["length"])
        self.names = tuple(map(str, columns.pop("name", range(1, count + 1))))
        if len(set(self.names)) < count:
            checks.fail("table", "names that differ from each other", ", ".join(self.names))
        rows = [{name: float(values[k]) for name, values in columns.items()} for k in range(count)]
        made = [_made(name, row) for name, row in zip(self.names, rows, strict=True)]
        self.whiskers, self.mounts, self.drives, self.springs = map(tuple, zip(*made, strict=True))

    @classmethod
    def rat(
        cls,
        sides: Sequence[str] = ("right", "left"),
        *,
        youngs_modulus: float = 3e9,
        width: float = 10 * MM,
        curved: bool = True,
    ) -> "Array":
        """The vibrissae of a rat: 27 on each side, in the rows A to E and the columns 0 to 5, in SI units.

        The rat looks along -x, z points upwards, and its right side is at +y. The control is the protraction from rest.
        Names are those of the side, the row and the column, such as RC2.

        - Lengths and diameters: averages of Belli et al. (2017); see `Whisker.rat`.
        - Shapes: y = A x^2, with A between 38 per m for a length of 4.4 mm and 6 per m for 52.8 mm, the ends of the
          measured range. Between them, log A is taken as linear in the logarithm of the length.
        - Protraction at rest: Hobbs et al. (2015). Elevation at rest, and the changes of elevation and roll with the
          protraction: Knutsen et al. (2008).
        - Base points: two flat pads. Follicles are 2 mm apart in both directions, as those of a row are in Simony et
          al. (2010). The roll at rest is taken as 0: whiskers are concave towards the front. Both are simplifications:
          real pads are round, and every whisker has a roll of its own.

        Args:
            sides: "right", "left" or both.
            youngs_modulus: E, Pa; see `Whisker.rat`.
            width: distance between the pads, m.
            curved: whether whiskers have their unloaded shapes; otherwise they are straight.

        Raises:
            ValueError: if a side is unknown, or a number is not positive.

        Examples:
            >>> jw.Array.rat(["right"])
            27 whiskers: RA0, RA1, RA2, RA3, RA4, RB0, ...
        """
        checks.number("width", width, positive=True)
        unknown = [side for side in sides if side not in ("right", "left")]
        if unknown or not sides or isinstance(sides, str):
            checks.fail("sides", 'a list of "right" and "left"', repr(sides))
        rows: list[dict[str, Any]] = []
        for side in sides:
            mirrored = side == "left"
            for row, angles in published("rats")["array"]["protraction"].items():
                known = np.flatnonzero(np.isfinite(angles)).tolist()
                rows += [_rat_row(row, column, mirrored, youngs_modulus, width, curved) for column in known]
        return cls({name: [row[name] for row in rows] for name in rows[0]})

    def __len__(self) -> int:
        return len(self.names)

    def scene(self, whisker: str | int, surface: AbstractSurface, **options: Any) -> SpaceScene:
        """The scene of one whisker on a rigid pad, by its name or its number from 0; options as for `scenes`."""
        names = ", ".join(self.names)
        if isinstance(whisker, str) and whisker not in self.names:
            checks.fail("whisker", f"one of {names}", repr(whisker))
        k = self.names.index(whisker) if isinstance(whisker, str) else whisker
        if not isinstance(k, int) or not 0 <= k < len(self):
            checks.fail("whisker", f"one of {names}, or a number from 0 to {len(self) - 1}", repr(whisker))
        return self._one(k, surface, **options)

    def scenes(
        self,
        surface: AbstractSurface,
        *,
        motion: SpaceMotion | AbstractMotion | None = None,
        friction: Scalar | None = None,
        rod: AbstractRod = SHOOTING,
    ) -> SpaceScene:
        """All whiskers on a rigid pad: one scene whose numbers have a leading axis of whiskers, for `jax.vmap`.

            forces = jax.vmap(lambda scene: jw.scan(scene, control).force)(array.scenes(surface))

        Args:
            surface: the object.
            motion: of the pad, to which the angles of the table are those of mounts. Default: every whisker protracts.
            friction: coefficient, as for a Scene.
            rod: how rods are computed.

        Raises:
            ValueError: as for a Scene and a Mount.
        """
        every = [self._one(k, surface, motion=motion, friction=friction, rod=rod) for k in range(len(self))]
        floats = [jax.tree.map(checks.as_float, scene) for scene in every]
        return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *floats)

    def coupled(
        self,
        surface: AbstractSurface,
        springs: Sequence[Spring],
        motion: SpaceMotion | AbstractMotion,
        *,
        friction: Scalar | None = None,
        rod: AbstractRod = SHOOTING,
    ) -> SpaceScene:
        """All whiskers on a compliant pad: one scene.

        Args:
            surface: the object.
            springs: between bases (numbered from 1) and drive (0), as for a Support, besides those of the table.
            motion: of the drive, to which the angles of the table are those of mounts.
            friction: coefficient, as for a Scene.
            rod: how rods are computed.

        Raises:
            ValueError: as for a Scene, a Support and a Mount.
        """
        own = [
            Spring((0, k + 1), one.stiffness, axis=one.axis) for k, every in enumerate(self.springs) for one in every
        ]
        mounts = tuple(self._mount(k, motion) for k in range(len(self)))
        support = Support((*own, *springs), mounts)
        return SpaceScene(self.whiskers, surface, support, rod, motion, friction)

    def scan(self, surface: AbstractSurface, control: Control, **options: Any) -> "xr.Dataset":
        """Scan with all whiskers on a rigid pad.

        Args:
            surface: the object.
            control: angles of protraction, or positions of the motion that is given, shape (steps,).
            **options: as for `scenes`.

        Returns:
            A Dataset as of `to_xarray`, with names along `whisker`; status and events have this dimension, too.

        Raises:
            ValueError: as for `scenes` and `scan`.
            ImportError: if xarray is missing: `pip install jaxwhisker[study]`.
        """
        checks.vector("control", control)
        control = np.asarray(control, dtype=float)
        results = jax.vmap(lambda scene: scan(scene, control))(self.scenes(surface, **options))
        return self.dataset(results)

    def dataset(self, results: SpaceResult) -> "xr.Dataset":
        """The Dataset of results that have a leading axis of whiskers, as `jax.vmap` of `scan` over `scenes` has.

        Raises:
            ImportError: if xarray is missing: `pip install jaxwhisker[study]`.
        """
        return array_dataset(self.names, results)

    def touches(self, data: "xr.Dataset") -> "pd.DataFrame":
        """The table of touches: one row for each whisker, by its name.

        Columns: `first_touch` and `release`, the drive positions where the whisker first touches the object and where
        it last comes free; `peak_force`, the largest contact force of all steps and just before events, and
        `peak_control`, where it occurs; `status`, ok or the first failure. Positions are NaN for whiskers that touch
        nothing, and `release` for those that still touch the object at their last step. `attrs["units"]` has the units.

        Args:
            data: the Dataset of `scan` or `dataset`.

        Raises:
            ValueError: if `data` is not such a Dataset.
            ImportError: if pandas is missing.
        """
        return touch_table(self.names, data)

    def _one(
        self, k: int, surface: AbstractSurface, *, motion=None, friction=None, rod: AbstractRod = SHOOTING
    ) -> SpaceScene:
        support = Support(self.springs[k], self._mount(k, motion))
        return SpaceScene(self.whiskers[k], surface, support, rod, motion or self.drives[k], friction)

    def _mount(self, k: int, motion: Any) -> Mount:
        mount, drive = self.mounts[k], self.drives[k]
        if motion is None:
            return mount
        return Mount(mount.x, mount.y, drive.protraction, z=mount.z, elevation=drive.elevation, roll=drive.roll)

    def __str__(self) -> str:
        shown = ", ".join(self.names[:6]) + (", ..." if len(self) > 6 else "")
        return f"{len(self)} whisker{'s' * (len(self) > 1)}: {shown}"

    __repr__ = __str__


def _columns(table: Any) -> dict[str, Any]:
    """The columns of a table as arrays of floats; names as they are."""
    if isinstance(table, str | Path):
        cells = cells_of("table", table)
        table = {name: own if name == "name" else floats("table", table, name, own) for name, own in cells.items()}
    if not isinstance(table, Mapping) and not hasattr(table, "columns"):
        checks.fail("table", "a mapping of columns, a DataFrame or the path of a CSV file", type(table).__name__)
    columns = {str(name): list(checks.unmasked(table[name])) for name in table}
    for name in columns:
        if name not in COLUMNS:
            checks.fail("table", f"columns {ALLOWED}", repr(name))
    if not columns.get("length"):
        checks.fail("table", "a column `length`", ", ".join(columns) or "no columns")
    count = len(columns["length"])
    for name, values in columns.items():
        if len(values) != count:
            checks.fail("table", f"columns of the same length ({count}, as `length`)", f"{len(values)} in `{name}`")
        if name != "name":
            if not all(isinstance(value, int | float | np.number) for value in values):
                checks.fail(f"table[{name!r}]", "numbers", repr(values))
            checks.vector(f"table[{name!r}]", np.asarray(values, dtype=float))
    for one, other in ((ROUND, STIFF), (("parabola",), ("curvature",))):
        both = [name for name in columns if name in one], [name for name in columns if name in other]
        if all(both):
            checks.fail("table", f"either {', '.join(one)} or {', '.join(other)}", " and ".join(map(", ".join, both)))
    missing = [name for name in ROUND if name not in columns]
    if 0 < len(missing) < len(ROUND):
        checks.fail("table", f"all of {', '.join(ROUND)}, or none", f"none of {', '.join(missing)}")
    return columns


def _made(name: str, row: dict[str, float]) -> tuple[Whisker, Mount, WhiskDrive, tuple[Spring, ...]]:
    """A whisker of a table."""
    try:
        x, y, z = (row.get(axis, 0.0) for axis in PLACES)
        angles = {key: row.get(key, 1.0 if key == "protraction_rate" else 0.0) for key in (*ANGLES, *RATES)}
        drive = WhiskDrive(**angles, pivot=(x, y, z))
        springs = tuple(Spring((0, 1), row[key], axis=axis) for key, axis in SPRINGS.items() if key in row)
        return _whisker(row), Mount(x, y, z=z), drive, springs
    except ValueError as error:
        raise ValueError(f"`table`, whisker {name}: {error}") from error


def _whisker(row: dict[str, float]) -> Whisker:
    length, curvature = row["length"], row.get("curvature")
    if "parabola" in row:
        curvature = ParabolicShape(row["parabola"])
    stiffness = row.get("base_stiffness", 1.0)
    if "base_diameter" in row:
        stiffness = Whisker.conical(
            length, row["youngs_modulus"], row["base_diameter"], row["tip_diameter"]
        ).bending_stiffness
    elif "taper" in row:
        if not 0 <= row["taper"] <= 1:
            checks.fail("taper", "a number from 0 to 1", row["taper"])
        stiffness = PowerTaper(stiffness, row["taper"], length)
    others = {key: row[key] for key in SHAPE[2:] if key in row}
    return Whisker(length, stiffness, curvature, **others)


def _rat_row(row: str, column: int, mirrored: bool, modulus: float, width: float, curved: bool) -> dict[str, Any]:
    """A row of the table of a rat. The left side is the mirror image of the right one, y being opposite."""
    whisker = Whisker.rat(row, column, youngs_modulus=modulus)
    diameter: Any = whisker.bending_stiffness.diameter
    length = float(whisker.length)
    array = published("rats")["array"]
    own, spacing = array["rows"][row], array["spacing"] * MM
    rest = (array["protraction"][row][column] - 90) * DEGREE
    short, long = array["shapes"]["short"], array["shapes"]["long"]
    power = np.log(long["parabola"] / short["parabola"]) / np.log(long["arc"] / short["arc"])
    parabola = short["parabola"] * (length / MM / short["arc"]) ** power
    side, sign = ("L", -1) if mirrored else ("R", 1)
    return {
        "name": f"{side}{row}{column}",
        "x": -spacing * column,
        "y": sign * width / 2,
        "z": -spacing * list(array["rows"]).index(row),
        "protraction": np.pi - rest if mirrored else rest,
        "elevation": own["elevation"] * DEGREE,
        "roll": np.pi if mirrored else 0.0,
        "protraction_rate": sign,
        "elevation_rate": own["elevation_rate"],
        "roll_rate": sign * own["roll_rate"],
        "length": length,
        "base_diameter": float(diameter.base),
        "tip_diameter": float(diameter.tip),
        "youngs_modulus": modulus,
        **({"parabola": parabola} if curved else {}),
    }
