"""Scans and simulations as tables: every signal by name, for other programs."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxwhisker._scan.quantities import MOTION, STATE
from jaxwhisker._scan.report import write_columns
from jaxwhisker._scan.result import check_not_batched, check_one_scan
from jaxwhisker._scan.state import State

if TYPE_CHECKING:
    import pandas as pd


def columns(result: Any) -> dict[str, np.ndarray]:
    """Every signal by name: control, fx_1, fy_1, mz_1, base_x_1, ..., spring_1, ..., phase_1, status."""
    moves = _is_motion(result)
    if moves:
        check_not_batched(result, "a single simulation")
    else:
        check_one_scan(result)
    found = {name: np.asarray(getattr(result, name)) for name in ("time",) * moves + ("control",)}
    further = [name for name in MOTION if moves and name != "time"]
    signals = [name for name in (*STATE, *further) if name != "phase" and getattr(result, name) is not None]
    for k in range(result.fx.shape[1]):
        found |= {f"{name}_{k + 1}": np.asarray(getattr(result, name))[:, k] for name in signals}
    for name, values in (("spring", result.spring_length), ("phase", result.phase)):
        found |= {f"{name}_{k + 1}": column for k, column in enumerate(np.asarray(values).T)}
    return found | {"status": np.asarray(result.status)}


def _is_motion(result: Any) -> bool:
    return isinstance(result, State) and hasattr(result, "time")


def to_dataframe(result: Any) -> "pd.DataFrame":
    """Return the signals of a scan or a simulation as a pandas DataFrame with one row per step, in the scene's units.

    Columns: control; fx_1, fy_1, mz_1, base_x_1, base_y_1, base_angle_1, contact_force_1, contact_slope_1,
    contact_arc_1, contact_x_1, contact_y_1 and the same for further whiskers; spring_1, ...; phase_1, ... (0 free,
    1 tip, 2 tangential); status (0 ok); with friction, also slip_1, ..., normal_force_1, ..., friction_force_1, ...;
    with several objects, also contact_object_1, ... A simulation has the column time before control, and gap_1, tip_x_1
    and tip_y_1. Failed steps are NaN. `identify` and `reconstruct` read such tables.

    Args:
        result: the Result of a scan, or a Simulation.

    Raises:
        ValueError: if `result` is not the result of a single scan or simulation.
        ImportError: if pandas is missing.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise ImportError("`to_dataframe` needs pandas: pip install pandas") from error
    return pd.DataFrame(columns(result))


def to_csv(result: Any, path: str | Path) -> None:
    """Write the signals of a scan or a simulation to a CSV file, in full precision and the scene's own units.

    There is one row per step or sample. A comment line, `# ...`, precedes the columns, which are those of
    `to_dataframe`. `identify` and `reconstruct` read such files.

    Args:
        result: the Result of a scan, or a Simulation.
        path: path of the file; an existing file is overwritten.

    Raises:
        ValueError: if `result` is not the result of a single scan or simulation.
    """
    table = columns(result)
    comment = (
        f"{result.scene}; lengths in the unit of L, forces in EI/L^2, moments in EI/L, "
        + "times in L^2 sqrt(rho A/EI), " * ("time" in table)
        + "angles and slopes in rad; phase 0 free, 1 tip, 2 tangential; status 0 ok"
    )
    write_columns(table, Path(path), comment)
