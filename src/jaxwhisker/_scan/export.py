"""Scans as tables and Datasets: every signal by name, for other programs."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import Status
from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker._scan.result import Result, State, check_one_scan

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

_REALS = (*REACTIONS, *(name for name in State.__dataclass_fields__ if name not in (*REACTIONS, "phase")))


def columns(result: Result) -> dict[str, np.ndarray]:
    """Every signal of a scan by name: control, fx_1, fy_1, mz_1, base_x_1, ..., spring_1, ..., phase_1, status."""
    check_one_scan(result)
    found = {"control": np.asarray(result.control)}
    for k in range(np.asarray(result.fx).shape[1]):
        found |= {f"{name}_{k + 1}": np.asarray(getattr(result, name))[:, k] for name in _REALS}
    for name, values in (("spring", result.spring_length), ("phase", result.phase)):
        found |= {f"{name}_{k + 1}": column for k, column in enumerate(np.asarray(values).T)}
    return found | {"status": np.asarray(result.status)}


def to_dataframe(result: Result) -> "pd.DataFrame":
    """The signals of a scan as a table of pandas, one row a step, in the scene's own units.

    Columns: control; fx_1, fy_1, mz_1, base_x_1, base_y_1, base_angle_1, contact_force_1, contact_slope_1,
    contact_arc_1, contact_x_1, contact_y_1 and the same of further whiskers; spring_1, ...; phase_1, ... (0 free,
    1 tip, 2 tangential); status (0 ok). `identify` and `reconstruct` read it. Failed steps are NaN.

    Args:
        result: of `scan`.

    Raises:
        ValueError: if `result` is none of one scan.
        ImportError: if pandas is missing.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise ImportError("`to_dataframe` needs pandas: pip install pandas") from error
    return pd.DataFrame(columns(result))


def to_csv(result: Result, path: str | Path) -> None:
    """Write the signals of a scan as CSV, one row a step, every digit of them, in the scene's own units.

    Columns are those of `to_dataframe` below a comment line, `# ...`; `identify` and `reconstruct` read the file.

    Args:
        result: of `scan`.
        path: of the file, which is written anew.

    Raises:
        ValueError: if `result` is none of one scan.
    """
    table = columns(result)
    comment = (
        f"# {result.scene}; lengths in the unit of L, forces in EI/L^2, moments in EI/L, angles and slopes in rad; "
        "phase 0 free, 1 tip, 2 tangential; status 0 ok"
    )
    # The shortest digits that tell a float from its neighbours; no minus sign before a zero.
    rows = zip(*((column + 0).tolist() for column in table.values()), strict=True)
    lines = [comment, ",".join(table), *(",".join(map(repr, row)) for row in rows)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def to_xarray(result: Result) -> "xr.Dataset":
    """See `Result.to_xarray`."""
    check_one_scan(result)
    try:
        import xarray  # noqa: F401
    except ImportError as error:
        raise ImportError("`to_xarray` needs xarray: pip install jaxwhisker[study]") from error
    from jaxwhisker._study.fields import FIELDS
    from jaxwhisker._study.kernel import fields_of
    from jaxwhisker._study.layout import Layout
    from jaxwhisker._study.parameters import Parameters
    from jaxwhisker._study.points import Points
    from jaxwhisker._study.structure import structure_of

    def build() -> Scene:
        return result.scene

    # A study of no parameters, with one point.
    alone, status = Parameters({}, paired=False), np.asarray(result.status)
    events = result.events.kind.shape[0]
    layout = Layout(alone, structure_of(build, alone), np.asarray(result.control), events, FIELDS)
    arrays = fields_of(result.scene, result)
    found = {
        name: (layout.dims(name), np.asarray(arrays[name]).astype(field.dtype), layout.attributes(name))
        for name, field in FIELDS.items()
    }
    points = Points(build, alone)
    points.add(np.array([0]), status[[np.argmax(status != Status.ok)]])
    return layout.frame().assign(found).assign_attrs(points=points.words())
