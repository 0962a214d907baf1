"""Scans, simulations, deflections and studies as tables: every signal by name, for other programs."""

import math
import re
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._model.scene import AbstractScene, Sensor, time_unit
from jaxwhisker._scan.contacts import has_several
from jaxwhisker._scan.deflect import Deflection
from jaxwhisker._scan.quantities import (
    ASSUMED,
    CONTACT,
    DIRECTORS,
    MOTION,
    STATE,
    is_dimensionless,
    kind_of,
    quantity,
    unit_in_words,
    with_contacts,
)
from jaxwhisker._scan.report import write_columns
from jaxwhisker._scan.result import AbstractResult, check_not_batched
from jaxwhisker._scan.state import State

if TYPE_CHECKING:
    import pandas as pd

# Columns of a deflection, and their kinds.
POINTS = {"s": "length", "x": "length", "y": "length", "angle": "angle", "curvature": "curvature"}
NUMBERED = ("whisker", "spring", CONTACT, *DIRECTORS)  # dimensions of a Dataset whose labels become parts of names
CODES = "phase 0 free, 1 tip, 2 tangential; status 0 ok"


def columns(result: Any) -> dict[str, np.ndarray]:
    """Every signal by name: control, fx_1, fy_1, mz_1, base_x_1, ..., spring_1, ..., phase_1, status."""
    if hasattr(result, "data_vars"):
        return _columns_of_dataset(result)
    if isinstance(result, Deflection):
        if np.ndim(result.status):
            checks.fail("result", "a single deflection", f"a batch of shape {np.shape(result.status)}")
        return {name: np.asarray(getattr(result, name)) for name in POINTS}
    moves = _is_motion(result)
    if not moves:
        checks.instance("result", result, AbstractResult, "the Result of a scan")
    check_not_batched(result, "a single simulation" if moves else "the result of a single scan")
    found = {name: np.asarray(getattr(result, name)) for name in ("time",) * moves + ("control",)}
    whiskers = range(result.fx.shape[1])
    for k, name in product(whiskers, _signals(result)):
        found |= _columns_of_whisker(result, name, k)
    found |= {f"spring_{k + 1}": column for k, column in enumerate(np.asarray(result.spring_length).T)}
    for k in whiskers:
        found |= _columns_of_whisker(result, "phase", k)
    return found | {"status": np.asarray(result.status)}


def _columns_of_whisker(result: Any, name: str, whisker: int) -> dict[str, np.ndarray]:
    """The columns of a signal of one whisker, counted from 0; the names of further axes are parts of their names."""
    contacts = result.phase.shape[2] if has_several(result) else 1
    known: dict[str, Any] = {**DIRECTORS, CONTACT: map(str, range(1, contacts + 1))}
    labels = product(*(known[dim] for dim in with_contacts(name, quantity(name), contacts).axes[2:]))
    names = ["_".join([f"{name}_{whisker + 1}", *own]) for own in labels]
    values = np.asarray(getattr(result, name))[:, whisker]
    return dict(zip(names, values.reshape(-1, len(names)).T, strict=True))


def _is_motion(result: Any) -> bool:
    return isinstance(result, State) and hasattr(result, "time")


def _signals(result: Any) -> list[str]:
    """Names of the signals of every whisker, without the phase."""
    further = [name for name in MOTION if _is_motion(result) and name != "time"]
    return [name for name in (*STATE, *further) if name != "phase" and getattr(result, name, None) is not None]


def _columns_of_dataset(data: Any) -> dict[str, np.ndarray]:
    """One row for each point, and for each position of the control if the Dataset has signals; without events."""
    variables = {name: variable for name, variable in data.data_vars.items() if "event" not in variable.dims}
    if not variables:
        checks.fail("result", "a Dataset with variables that do not belong to events", f"{list(data.data_vars)}")
    dims = {dim for variable in variables.values() for dim in variable.dims}
    rows = [dim for dim in data.dims if dim in dims and dim not in NUMBERED]
    places = {name: data[name] for name in data.coords if set(data[name].dims) <= set(rows)}
    found = {}
    for name, variable in (places | variables).items():
        numbered = [dim for dim in variable.dims if dim in NUMBERED]
        whole = variable.variable.set_dims({dim: data.sizes[dim] for dim in (*rows, *numbered)})
        name = "spring" if name == "spring_length" else name
        names = ["_".join([name, *map(str, own)]) for own in product(*(data[dim].values for dim in numbered))]
        values = whole.values.reshape(math.prod(data.sizes[dim] for dim in rows), len(names))
        found |= dict(zip(names, values.T, strict=True))
    return found


def header(result: Any) -> str:
    """What a table contains, with the unit of every signal that has one."""
    if hasattr(result, "data_vars"):
        text, codes = result.attrs.get("scene", "study"), f"; {CODES}"
    elif isinstance(result, Deflection):
        sensor, codes = Sensor(result.whisker, result.support), ""
        reaction = ", ".join(f"{name} = {float(getattr(result, name))!r}" for name in ("fx", "fy", "mz"))
        text = f"{sensor}, deflected; reaction {reaction} in {_unit('force', sensor)} and {_unit('moment', sensor)}"
    else:
        text, codes = str(result.scene), f"; {CODES}"
    units = ", ".join(f"{name} ({unit})" for name, unit in _units(result).items() if unit != "1")
    assumed = f"; {ASSUMED}" * bool(re.search(r"[( /](N|m|s)\b", units))
    return f"{text}; units: {units}{assumed}{codes}"


def _units(result: Any) -> dict[str, str]:
    """The unit of every signal, without the numbers of whiskers."""
    if hasattr(result, "data_vars"):
        return {name: result[name].attrs.get("units", "1") for name in (*result.coords, *result.data_vars)}
    if isinstance(result, Deflection):
        return {name: _unit(kind, Sensor(result.whisker, result.support)) for name, kind in POINTS.items()}
    scene = result.scene
    found = {name: _unit(kind_of(name, scene), scene) for name in ("control", *_signals(result))}
    found |= {f"spring_{k + 1}": _unit_of_spring(s, scene) for k, s in enumerate(scene.support.springs)}
    return ({"time": _unit("time", scene)} if _is_motion(result) else {}) | found


def _units_of_columns(result: Any, names: Iterable[str]) -> dict[str, str]:
    """The unit of every column that has one: that of the signal with the longest name at its beginning."""
    units = {"spring" if name == "spring_length" else name: unit for name, unit in _units(result).items()}
    found = {}
    for name in names:
        signals = [one for one in units if name == one or name.startswith(f"{one}_")]
        found[name] = units[max(signals, key=len)] if signals else "1"
    return {name: unit for name, unit in found.items() if unit != "1"}


def _unit(kind: str, scene: AbstractScene | Sensor) -> str:
    """The unit of stored numbers, in words."""
    dimensionless = is_dimensionless(scene)
    if kind == "time" and dimensionless and time_unit(scene.whiskers[0]) != 1:
        return "time"  # L = EI = 1, but the mass per length is another one
    return unit_in_words(kind, dimensionless)


def _unit_of_spring(spring: Any, scene: AbstractScene | Sensor) -> str:
    return _unit("angle" if spring.turns else "length", scene)


def to_dataframe(result: Any) -> "pd.DataFrame":
    """Return the signals of a result as a pandas DataFrame with one row per step, in the scene's units.

    Columns of a scan: control; fx_1, fy_1, mz_1, base_x_1, base_y_1, base_angle_1, contact_force_1, contact_slope_1,
    contact_arc_1, contact_x_1, contact_y_1 and the same for further whiskers; spring_1, ...; phase_1, ... (0 free,
    1 tip, 2 tangential); status (0 ok); with friction, also slip_1, ..., normal_force_1, ..., friction_force_1, ...;
    with several objects, also contact_object_1, ... A simulation has the column time before control, and gap_1,
    tip_x_1 and tip_y_1. Failed steps are NaN. `identify` and `reconstruct` read such tables.

    If a whisker may have several contacts, the columns of contacts are contact_force_1_1 (of whisker 1 and contact 1,
    the outermost one), contact_force_1_2, ..., phase_1_1, ...

    A scan in space has no angles base_angle_1 and contact_slope_1, but also fz_1, mx_1, my_1, base_z_1, contact_z_1,
    and the directors of the base: base_rotation_1_x_d1, the component of d1 along x, to base_rotation_1_z_d3. With
    friction, it has friction_x_1, friction_y_1 and friction_z_1 in place of friction_force_1.

    A study has one row for each scene, and for each drive position if it contains signals: the parameters, then all
    variables with the number of the whisker, such as max_mz_1. Variables of events are left out; `summary` has the
    positions of the main ones. A deflection has one row for each point: s, x, y, angle and curvature.

    `attrs["units"]` has the units of the columns by name, without those that are numbers.

    Args:
        result: the Result or SpaceResult of a scan, a Simulation, a Deflection, or the Dataset of `study`, `summary`
            or `Result.to_xarray`.

    Raises:
        ValueError: if `result` is none of these, or a batch.
        ImportError: if pandas is missing.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise ImportError("`to_dataframe` needs pandas: pip install pandas") from error
    frame = pd.DataFrame(table := columns(result))
    frame.attrs["units"] = _units_of_columns(result, table)
    return frame


def to_csv(result: Any, path: str | Path) -> None:
    """Write the signals of a result to a CSV file, in full precision and the scene's own units.

    There is one row per step or sample, or per scene of a study. A comment line, `# ...`, precedes the columns, which
    are those of `to_dataframe`: it describes the scene and names the units. `identify` and `reconstruct` read the files
    of scans and simulations.

    Args:
        result: the Result or SpaceResult of a scan, a Simulation, a Deflection, or the Dataset of `study`, `summary`
            or `Result.to_xarray`.
        path: path of the file; an existing file is overwritten.

    Raises:
        ValueError: if `result` is none of these, or a batch.
    """
    table = columns(result)
    write_columns(table, Path(path), header(result))
