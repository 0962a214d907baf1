"""The summary of scans: peaks, contact and snaps of every scene, independent of the number of steps."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._path.path import SNAPS, EventKind
from jaxwhisker._scan.dataset import VARIABLES
from jaxwhisker._scan.quantities import (
    CONTACT,
    CONTROL,
    DIRECTORS,
    ENERGIES,
    REACTIONS_IN_SPACE,
    Quantity,
    is_of_contacts,
)
from jaxwhisker._scan.route import route_of

if TYPE_CHECKING:
    import xarray as xr

ROUNDING_NOISE = 1e-12  # relative to the largest value: smaller values are zero
REACH = 3  # steps on each side of a peak through which a polynomial is drawn, unless there is a corner
EXTREMUM_STEPS = 5  # to the extremum of that polynomial, which is at most half a step away
BLOCK_BYTES = 64e6  # bytes of a Dataset that are read at a time
WIDTHS = ("contact_width", "half_width_mz")
_EVENTS = ("event_kind", "event_control", "event_whisker", "event_count")
_PER_SCENE = ("control", "whisker", "spring", CONTACT, "event", *DIRECTORS)
STEP = 1e-30  # of complex-step derivatives (Squire and Trapp 1998), which are exact for any small step


def _summary() -> dict[str, Quantity]:
    each = ("whisker",)
    found = {}
    for name, (which, word) in product(REACTIONS_IN_SPACE, (("max", "largest"), ("min", "smallest"))):
        found[f"{which}_{name}"] = Quantity(f"{word} {name}", "", VARIABLES[name].kind, each)
        found[f"control_of_{which}_{name}"] = Quantity(f"drive position of the {word} {name}", "", CONTROL, each)
    return found | {
        "first_touch": Quantity("drive position of the first touch", "", CONTROL, each),
        "last_contact": Quantity("drive position where contact ends for good", "", CONTROL, each),
        "contact_width": Quantity("distance of the drive from first touch to last contact", "", CONTROL, each),
        "half_width_mz": Quantity("distance of the drive over which mz exceeds half its peak", "", CONTROL, each),
        "snap_work": Quantity("energy lost in all snaps", "", "energy", ()),
        "snaps": Quantity("number of snaps", "", "number", (), dtype="int32"),
        "steps_failed": Quantity("number of failed steps", "", "number", (), dtype="int32"),
    }


SUMMARY = _summary()


def summary_without(absent: Sequence[str]) -> dict[str, Quantity]:
    """The summary of scenes that do not have these quantities."""

    def needed(name: str) -> str:
        return ENERGIES[0] if name == "snap_work" else name.rpartition("_")[2]

    return {name: quantity for name, quantity in SUMMARY.items() if needed(name) not in absent}


@with_own_settings
def summary(data: xr.Dataset) -> xr.Dataset:
    """Summarise every scene of a study: peaks, contact, snaps.

    Args:
        data: the Dataset that `study` returns, with at least one of the outputs "reactions", "status" and "events". It
            is read in blocks of scenes, so a store may be larger than the memory.

    Returns:
        A Dataset over the study's axes (and `whisker`): max_fx, min_fx, ..., max_mz, min_mz, each with its
        control_of_...; first_touch, last_contact, contact_width; half_width_mz; snap_work, snaps, steps_failed; in the
        units of the study. The control may rise or fall; widths are positive. They are NaN, with a `comment`, if the
        control changes direction. Values are NaN where steps failed or contact begins or ends outside the control; so
        is the position of a peak that is zero. If the data have derivatives of their variables (see `derivatives` of
        `study`), the Dataset has those of the summary, such as d_max_mz_d_stiffness.

    Raises:
        ValueError: if `data` is not the Dataset of a study with its steps.
    """
    import xarray as xr

    if not isinstance(data, xr.Dataset):
        raise ValueError(f"`data` must be the Dataset of a study, got a {type(data).__name__}.")
    known = [name for name in VARIABLES if name in data.variables and VARIABLES[name].axes != ("control", "spring")]
    known = [name for name in known if CONTACT not in data[name].dims]  # which no variable of the summary needs
    if not known or "control" not in data.variables or "whisker" not in data.variables:
        has = ", ".join(map(str, data.variables)) or "nothing"
        raise ValueError(f"`data` must be the Dataset of a study with its steps or events, got one with {has}.")
    axes = [dim for dim in data.sizes if dim not in _PER_SCENE]
    control = data["control"].values
    parameters = [str(name) for name in data.coords if any(derivative_name(own, str(name)) in data for own in known)]
    found = _in_blocks(data, known, axes, control, parameters)
    variables = {}
    for parameter in (None, *parameters):
        label = str if parameter is None else partial(derivative_name, parameter=parameter)
        shown = {VARIABLES[name].kind: data[label(name)] for name in known if label(name) in data}
        units = {kind: variable.attrs.get("units", "1") for kind, variable in shown.items()}
        if parameter is None:
            units |= {CONTROL: data["control"].attrs.get("units", "1"), "number": "1"}
        for name, quantity in SUMMARY.items():
            if label(name) in found:
                words = quantity.description if parameter is None else derivative_in_words(quantity, parameter)
                attributes = {"long_name": words, "units": units[quantity.kind]} | comment_on(name, control)
                variables[label(name)] = ((*axes, *quantity.axes), found[label(name)], attributes)
    kept = {name: c for name, c in data.coords.items() if set(c.dims) <= {*axes, "whisker"}}
    return xr.Dataset(variables, kept, data.attrs)


def comment_on(name: str, control: np.ndarray) -> dict[str, str]:
    """An attribute that says why a variable of the summary is NaN everywhere."""
    if name not in WIDTHS or not _changes_direction(control):
        return {}
    return {"comment": "NaN because the control changes direction: two positions do not determine the distance between"}


def derivative_name(name: str, parameter: str) -> str:
    """The variable that holds the derivative of another one with respect to a parameter."""
    return f"d_{name}_d_{parameter}"


def derivative_in_words(quantity: Quantity, parameter: str) -> str:
    """Description of the derivative of a quantity with respect to a parameter."""
    return f"derivative of the {quantity.description} with respect to {parameter}"


def _in_blocks(
    data: xr.Dataset, known: list[str], axes: list[Hashable], control: np.ndarray, parameters: Sequence[str]
) -> dict[str, np.ndarray]:
    """The variables of the summary and their derivatives, computed in blocks of scenes."""
    slopes = {derivative_name(name, parameter): name for name, parameter in product(known, parameters)}
    own = {name: name for name in known} | {slope: name for slope, name in slopes.items() if slope in data}
    fields = {name: data[name].transpose(*axes, *VARIABLES[of].axes) for name, of in own.items()}
    found: dict[str, np.ndarray] = {}
    for block in _blocks(data, axes):
        arrays = {name: field.isel(block).values for name, field in fields.items()}
        for name, values in summarise(arrays, control, parameters).items():
            whole = tuple(data.sizes[dim] for dim in axes) + values.shape[len(axes) :]
            dtype = SUMMARY[name].dtype if name in SUMMARY else float
            found.setdefault(name, np.empty(whole, dtype))[tuple(block.values())] = values
    return found


def _blocks(data: xr.Dataset, axes: list[Hashable]) -> Iterator[dict[Hashable, slice]]:
    """Slices along the axes: whole chunks of a store, or at most BLOCK_BYTES."""
    sizes = {dim: data.sizes[dim] for dim in axes}
    stored = max((v.encoding.get("preferred_chunks", {}) for v in data.data_vars.values()), key=len, default={})
    lanes = max(1, int(BLOCK_BYTES / max(1, data.nbytes / max(1, math.prod(sizes.values())))))
    length = {}
    for dim in reversed(axes):
        length[dim] = stored.get(dim, max(1, min(sizes[dim], lanes)))
        lanes //= length[dim]
    starts = [range(0, sizes[dim], length[dim]) for dim in axes]
    for corner in product(*starts):
        yield {dim: slice(k, k + length[dim]) for dim, k in zip(axes, corner, strict=True)}


def summarise(
    arrays: Mapping[str, np.ndarray], control: np.ndarray, parameters: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """Summarise scans along one control; variables that need a missing array are left out.

    Args:
        arrays: variables of a study by name, (..., control, whisker), (..., control), (..., event, whisker) or
            (..., event): fx, fy, mz, base_x, status, event_*, and the states at events, before_* and after_*, if known.
        control: drive positions.
        parameters: parameters with respect to which the arrays include derivatives, by `derivative_name`.

    Returns:
        The variables of `SUMMARY`, (..., whisker) or (...), and their derivatives. Peaks, widths and work of a scan
        with failed steps are NaN.
    """
    found = _summarise(arrays, control)
    for parameter in parameters:
        slopes = {name: arrays.get(derivative_name(name, parameter)) for name in arrays}
        with np.errstate(invalid="ignore"):  # unlike real NaN, complex NaN warn when they are compared
            ahead = _summarise({name: _ahead(array, slopes[name]) for name, array in arrays.items()}, control)
        for name, values in ahead.items():
            if np.iscomplexobj(values):
                slope = np.where(np.isnan(found[name]), np.nan, np.imag(values) / STEP)
                found[derivative_name(name, parameter)] = slope
    return found


def _ahead(values: np.ndarray, slopes: np.ndarray | None) -> np.ndarray:
    """Values after a complex step along a parameter."""
    if slopes is None:
        return values
    found = np.array(values, dtype=complex)
    found.imag = STEP * np.asarray(slopes)
    return found


def _summarise(arrays: Mapping[str, np.ndarray], control: np.ndarray) -> dict[str, np.ndarray]:
    """The summary of real arrays, or of complex ones, whose real parts decide where peaks and events are."""
    scans = _StackedScans(arrays, np.asarray(control, dtype=float))
    found: dict[str, np.ndarray] = {}
    for name in scans.reactions:
        for which, sign in (("max", 1.0), ("min", -1.0)):
            found[f"{which}_{name}"], found[f"control_of_{which}_{name}"] = scans.peak(name, sign)
    if "mz" in scans.reactions:
        found["half_width_mz"] = scans.half_width("mz", np.maximum(_size(found["max_mz"]), _size(found["min_mz"])))
    if scans.reactions and scans.has_events:
        found["first_touch"], found["last_contact"] = scans.contact(1), scans.contact(-1)
        found["contact_width"] = scans.distance(found["first_touch"], found["last_contact"])
    if scans.has_events:
        found["snaps"] = np.where(scans.count < 0, -1, scans.snap.sum(axis=1))
        if set(ENERGIES) <= set(arrays):
            lost = np.where(scans.snap, np.subtract(*(scans.arrays[name] for name in ENERGIES)), 0.0)
            found["snap_work"] = np.where(scans.failed, np.nan, lost.sum(axis=1))
    if "status" in arrays:
        status = scans.arrays["status"]
        found["steps_failed"] = np.where(np.any(status < 0, axis=1), -1, np.sum(status > 0, axis=1))
    return {name: found[name].reshape((*scans.lead, *found[name].shape[1:])) for name in SUMMARY if name in found}


def _changes_direction(control: np.ndarray) -> bool:
    """Whether the control changes direction."""
    return bool(route_of(control).last > 1)


class _StackedScans:
    """Scans along one leading axis: arrays have shape (scans, ...)."""

    def __init__(self, arrays: Mapping[str, np.ndarray], control: np.ndarray):
        self.control, self.turns, self.lead = control, _changes_direction(control), ()
        self.arrays: dict[str, np.ndarray] = {}
        for name in (name for name in arrays if name in VARIABLES and not is_of_contacts(name)):
            array, own = np.asarray(arrays[name]), len(VARIABLES[name].axes)
            self.lead, shape = array.shape[: array.ndim - own], array.shape[array.ndim - own :]
            self.arrays[name] = array.reshape((math.prod(self.lead), *shape))
        self.reactions = [name for name in REACTIONS_IN_SPACE if name in arrays]
        self.has_events = set(_EVENTS) <= set(arrays)
        failures = [np.isnan(np.real(self.arrays[name])).any(axis=(1, 2)) for name in self.reactions]
        if "status" in arrays:
            failures.append(np.any(self.arrays["status"] != 0, axis=1))
        if self.has_events:
            self.kind, self.at, self.named, self.count = (self.arrays[name] for name in _EVENTS)
            self.snap = np.isin(self.kind, SNAPS)
            failures.append(self.count > self.kind.shape[1])  # events that are not stored cannot be summed
        self.failed = np.any(failures, axis=0)

    def distance(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Distance of the drive between two positions."""
        return np.full_like(start, np.nan) if self.turns else _size(end - start)

    def peak(self, name: str, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """Largest (sign 1) or smallest (-1) value of every whisker, and its position, NaN if the peak is zero."""
        values = sign * self.arrays[name]
        noise = ROUNDING_NOISE * np.max(np.abs(values), axis=1)
        best, where = self._peak_of_steps(values)
        for side in ("before", "after") if self.has_events else ():
            if f"{side}_{name}" in self.arrays:
                top, at = self._peak_of_events(sign * self.arrays[f"{side}_{name}"])
                better = top > best + noise
                best, where = np.where(better, top, best), np.where(better, at, where)
        best = np.where(np.abs(best) <= noise, 0.0, best)
        failed = self.failed[:, None]
        return np.where(failed, np.nan, sign * best + 0.0), np.where(failed | (best == 0), np.nan, where)

    def _peak_of_steps(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Largest value of the steps and its position, refined by polynomials where the signal is smooth."""
        steps = self.control.size
        step = np.argmax(np.where(np.isnan(values), -np.inf, values), axis=1)
        highest = _values_at(values, step)
        best, where = highest, self.control[step]
        if not self.has_events:  # which distinguish corners from smooth peaks
            return best, where
        corner = (self.kind >= 0) & (self.kind != EventKind.vertex)
        # A peak that the drive passes within a few steps is smoother over the position of the base than over the drive.
        over = self.arrays.get("base_x", np.broadcast_to(self.control[:, None], values.shape))
        for reach in range(1, REACH + 1):
            first, last = np.maximum(step - reach, 0), np.minimum(step + reach, steps - 1)
            events = _events_between(self.at, self.control[first], self.control[last]) & corner[:, :, None]
            smooth = (last - first == 2 * reach) & ~np.any(events, axis=1)
            around = [np.clip(step + k, 0, steps - 1) for k in range(-reach, reach + 1)]
            x, y = ([_values_at(of, k) for k in around] for of in (over, values))
            top, at = _extremum(x, y, [self.control[k] for k in around])
            better = smooth & (top > highest)  # False for NaN, where the drive stands still
            best, where = np.where(better, top, best), np.where(better, at, where)
        return best, where

    def _peak_of_events(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Largest value of the states at events, (scans, events, whiskers), and its position."""
        states = np.where(np.isnan(states), -np.inf, states)
        event = np.argmax(states, axis=1)
        return _values_at(states, event), np.take_along_axis(self.at, event, axis=1)

    def contact(self, way: int) -> np.ndarray:
        """Where every whisker first touches (way 1) or loses contact for good (-1); NaN if outside the control."""
        # Seen backwards, the end of contact is its beginning.
        ordered = slice(None, None, way)
        control, at = self.control[ordered], self.at[:, ordered]
        touching = np.any([self.arrays[name] != 0 for name in self.reactions], axis=0)[:, ordered]
        first, ever = np.argmax(touching, axis=1), touching.any(axis=1)
        begins = self.kind == EventKind.touch if way > 0 else (self.kind == EventKind.release) | self.snap
        named = (begins[:, :, None] & self.named)[:, ordered]
        inside = _events_between(at, control[np.maximum(first - 1, 0)], control[first])
        # A snap names the whiskers that slipped off their branch, but others may also come into contact or lose it.
        snaps = self.snap[:, ordered, None] & ever[:, None] & inside
        # The index of the first one; of the NaN behind all events if there is none.
        own, other = (np.pad(w, ((0, 0), (0, 1), (0, 0)), constant_values=True).argmax(axis=1) for w in (named, snaps))
        earlier = (other < own) & ~np.any(named & inside, axis=1)
        event = np.where((own == at.shape[1]) | earlier, other, own)
        where = np.take_along_axis(np.pad(at, ((0, 0), (0, 1)), constant_values=np.nan), event, axis=1)
        return np.where(self.failed[:, None] | (ever & (first == 0)), np.nan, where)

    def half_width(self, name: str, peak: np.ndarray) -> np.ndarray:
        """Distance of the drive between the first and the last position at which the magnitude is half its peak."""
        size, half = _size(self.arrays[name]), peak / 2
        above = size >= np.where(half > 0, half, np.inf)[:, None]
        end = self.control.size - 1
        first, last = np.argmax(above, axis=1), end - np.argmax(above[:, ::-1], axis=1)

        def crossing(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
            a, b = _values_at(size, inner), _values_at(size, outer)
            share = (a - half) / np.where(a == b, 1.0, a - b)
            return self.control[inner] + share * (self.control[outer] - self.control[inner])

        width = self.distance(crossing(first, np.maximum(first - 1, 0)), crossing(last, np.minimum(last + 1, end)))
        known = above.any(axis=1) & (first > 0) & (last < end) & ~self.failed[:, None]
        return np.where(known, width, np.nan)


def _size(values: np.ndarray) -> np.ndarray:
    """Magnitude; of values after a complex step, that of their real part, whose derivative it keeps."""
    return np.where(np.real(values) < 0, -values, values)


def _values_at(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Values, (scans, steps, whiskers), at one index for each scan and whisker."""
    return np.take_along_axis(values, index[:, None], axis=1)[:, 0]


def _events_between(at: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Which positions, (scans, events), lie between start and end, (scans, whiskers): (scans, events, whiskers)."""
    low, high = np.minimum(start, end)[:, None], np.maximum(start, end)[:, None]
    return (at[:, :, None] >= low) & (at[:, :, None] <= high)


def _divided_differences(x: list[np.ndarray], y: list[np.ndarray]) -> list[np.ndarray]:
    """Divided differences: coefficients of Newton's polynomial through the points."""
    factor = list(y)
    for order in range(1, len(x)):
        for k in range(len(x) - 1, order - 1, -1):
            factor[k] = (factor[k] - factor[k - 1]) / (x[k] - x[k - order])
    return factor


def _newton_polynomial(x: list[np.ndarray], factor: list[np.ndarray], at: np.ndarray) -> tuple[np.ndarray, ...]:
    """Newton's polynomial, its slope and second derivative."""
    value, slope, bend = factor[-1], np.zeros_like(at), np.zeros_like(at)
    for k in range(len(x) - 2, -1, -1):
        bend = 2 * slope + (at - x[k]) * bend
        slope = value + (at - x[k]) * slope
        value = factor[k] + (at - x[k]) * value
    return value, slope, bend


def _extremum(x: list[np.ndarray], y: list[np.ndarray], control: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Extremum of the polynomial through an odd number of points, and the control there; NaN unless in the middle."""
    middle = len(x) // 2
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        factor, at = _divided_differences(x, y), x[middle]
        for _ in range(EXTREMUM_STEPS):
            _, slope, bend = _newton_polynomial(x, factor, at)
            at = at - slope / bend
        beside = (at - x[middle - 1]) * (at - x[middle + 1]) <= 0
        where, *_ = _newton_polynomial(x, _divided_differences(x, control), at)
        # A polynomial needs a drive that does not turn.
        ways = np.sign(np.real(np.diff(np.stack(x), axis=0)))
        monotonic = np.abs(ways.sum(axis=0)) == len(ways)
        return np.where(beside & monotonic, _newton_polynomial(x, factor, at)[0], np.nan), where
