"""Results of an array's scan: the Dataset of all whiskers, and the table of their touches."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._path.path import Status
from jaxwhisker._scan.dataset import first_failure, points_in_words, scan_dataset
from jaxwhisker._scan.result import SpaceResult, arrays_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

NEEDED = ("status", "phase", "contact_force", "event_control", "before_phase", "after_phase", "before_contact_force")


def array_dataset(names: Sequence[str], results: SpaceResult) -> "xr.Dataset":
    """The Dataset of results with a leading axis of whiskers; see `Array.dataset`."""
    arrays = {name: np.asarray(array) for name, array in jax.vmap(arrays_of)(results).items()}
    first = jax.tree.map(lambda leaf: np.asarray(leaf)[0], results.scene)
    each = []
    for k, name in enumerate(names):
        data = scan_dataset(first, {key: array[k] for key, array in arrays.items()})
        each.append(data.drop_vars("spring", errors="ignore").assign_coords(whisker=[name]))
    import xarray as xr

    alone = [name for name, variable in each[0].items() if "whisker" not in variable.dims]
    each = [data.assign({name: data[name].expand_dims("whisker") for name in alone}) for data in each]
    both: Any = xr.concat(each, "whisker", combine_attrs="override")
    both.attrs["points"] = points_in_words(first_failure(arrays["status"]))
    return both


def touch_table(names: Sequence[str], data: "xr.Dataset") -> "pd.DataFrame":
    """The touches of every whisker in the Dataset of an array's scan; see `Array.touches`."""
    try:
        import pandas as pd
    except ImportError as error:
        raise ImportError("`touches` needs pandas: pip install pandas") from error
    missing = [name for name in NEEDED if name not in getattr(data, "data_vars", ())]
    if missing or "whisker" not in data.status.dims:
        checks.fail("data", "a Dataset of `Array.scan`", f"one without {', '.join(missing) or 'a status per whisker'}")
    if list(data.whisker.values) != list(names):
        checks.fail("data", f"a Dataset of the whiskers {', '.join(names)}", ", ".join(map(str, data.whisker.values)))
    rows = [_touches(data.isel(whisker=k)) for k in range(len(names))]
    table = pd.DataFrame(rows, index=pd.Index(names, name="whisker"))
    control, force = data.control.attrs["units"], data.contact_force.attrs["units"]
    table.attrs["units"] = {"first_touch": control, "release": control, "peak_force": force, "peak_control": control}
    return table


def _touches(one: "xr.Dataset") -> dict[str, Any]:
    """The row of one whisker."""
    control, events = one.control.values, one.event_control.values
    ok = one.status.values == Status.ok
    touching = (one.phase.values > 0) & ok
    before, after = one.before_phase.values > 0, one.after_phase.values > 0
    begins = np.concatenate([control[:1][touching[:1]], events[~before & after]])
    ends, last = events[before & ~after], np.flatnonzero(ok)
    free = last.size > 0 and not touching[last[-1]]
    force = np.concatenate([np.where(ok, one.contact_force.values, np.nan), one.before_contact_force.values])
    most = int(np.argmax(np.nan_to_num(force)))
    peak = float(np.nan_to_num(force)[most])
    return {
        "first_touch": float(begins[0]) if begins.size else np.nan,
        "release": float(ends[-1]) if ends.size and free else np.nan,
        "peak_force": peak,
        "peak_control": float(np.concatenate([control, events])[most]) if peak > 0 else np.nan,
        "status": Status(int(first_failure(one.status.values))).name,
    }
