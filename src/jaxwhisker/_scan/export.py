"""Scans as tables: every signal by name, for other programs."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxwhisker._scan.quantities import STATE
from jaxwhisker._scan.report import write_columns
from jaxwhisker._scan.result import Result, check_one_scan

if TYPE_CHECKING:
    import pandas as pd


def columns(result: Result) -> dict[str, np.ndarray]:
    """Every signal of a scan by name: control, fx_1, fy_1, mz_1, base_x_1, ..., spring_1, ..., phase_1, status."""
    check_one_scan(result)
    found = {"control": np.asarray(result.control)}
    signals = [name for name in STATE if name != "phase" and getattr(result, name) is not None]
    for k in range(result.fx.shape[1]):
        found |= {f"{name}_{k + 1}": np.asarray(getattr(result, name))[:, k] for name in signals}
    for name, values in (("spring", result.spring_length), ("phase", result.phase)):
        found |= {f"{name}_{k + 1}": column for k, column in enumerate(np.asarray(values).T)}
    return found | {"status": np.asarray(result.status)}


def to_dataframe(result: Result) -> "pd.DataFrame":
    """Return the signals of a scan as a pandas DataFrame with one row per step, in the scene's own units.

    Columns: control; fx_1, fy_1, mz_1, base_x_1, base_y_1, base_angle_1, contact_force_1, contact_slope_1,
    contact_arc_1, contact_x_1, contact_y_1 and the same for further whiskers; spring_1, ...; phase_1, ... (0 free,
    1 tip, 2 tangential); status (0 ok); with friction, also slip_1, ..., normal_force_1, ..., friction_force_1, ...;
    with several objects, also contact_object_1, ... Failed steps are NaN. `identify` and `reconstruct` read such
    tables.

    Args:
        result: the Result of a scan.

    Raises:
        ValueError: if `result` is not the result of a single scan.
        ImportError: if pandas is missing.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise ImportError("`to_dataframe` needs pandas: pip install pandas") from error
    return pd.DataFrame(columns(result))


def to_csv(result: Result, path: str | Path) -> None:
    """Write the signals of a scan to a CSV file with one row per step, in full precision and the scene's own units.

    A comment line, `# ...`, precedes the columns, which are those of `to_dataframe`. `identify` and `reconstruct` read
    such files.

    Args:
        result: the Result of a scan.
        path: path of the file; an existing file is overwritten.

    Raises:
        ValueError: if `result` is not the result of a single scan.
    """
    table = columns(result)
    comment = (
        f"{result.scene}; lengths in the unit of L, forces in EI/L^2, moments in EI/L, angles and slopes in rad; "
        "phase 0 free, 1 tip, 2 tangential; status 0 ok"
    )
    write_columns(table, Path(path), comment)
