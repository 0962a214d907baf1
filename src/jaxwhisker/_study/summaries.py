"""The summary of scans: peaks, contact, work lost in snaps, per scene; small, whatever the study's size."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from jaxwhisker._path.path import EventKind

if TYPE_CHECKING:
    import xarray as xr

REACTIONS = {"fx": "force", "fy": "force", "mz": "moment"}
NOISE = 1e-12  # of the largest value: what a state at an event may have for a zero
REACH = 3  # steps on either side through which the polynomial of a peak goes, as far as there is no corner
NEWTON_STEPS = 5  # to its extremum, from at most half a step away
BLOCK = 64e6  # bytes of a dataset read at a time
_EVENTS = ("event_kind", "event_control", "event_whisker", "event_count")
_ENERGIES = ("event_energy_before", "event_energy_after")
_PER_SCENE = ("control", "whisker", "spring", "event")


def _fields() -> dict[str, tuple[str, str]]:
    known = {}
    for (name, kind), which in product(REACTIONS.items(), ("max", "min")):
        words = f"{'largest' if which == 'max' else 'smallest'} {name}"
        known[f"{which}_{name}"] = words, kind
        known[f"control_of_{which}_{name}"] = f"drive position of the {words}", "length"
    return known | {
        "first_touch": ("drive position of the first touch", "length"),
        "last_contact": ("drive position where contact ends for good", "length"),
        "contact_width": ("way of the drive from first touch to last contact", "length"),
        "half_width_mz": ("way of the drive over which mz exceeds half its peak", "length"),
        "snap_work": ("energy lost in all snaps", "energy"),
        "snaps": ("number of snaps", "number"),
        "steps_failed": ("number of failed steps", "number"),
    }


FIELDS = _fields()  # name -> long name, kind of quantity


def summary(data: xr.Dataset) -> xr.Dataset:
    """Summarise every scene of a study: peaks, contact, snaps.

    Args:
        data: of `study`, with at least one of its groups of outputs "reactions", "status" and "events". It is read in
            blocks of scenes, so that a store larger than the memory will do.

    Returns:
        A Dataset over the study's axes (and `whisker`): max_fx, min_fx, ..., max_mz, min_mz, each with its
        control_of_...; first_touch, last_contact, contact_width; half_width_mz; snap_work, snaps, steps_failed. NaN
        where steps failed, where contact begins or ends outside the control, and for the place of a peak that is zero.

    Raises:
        ValueError: if `data` is no Dataset of a study with its steps.
    """
    import xarray as xr

    from jaxwhisker._study.fields import FIELDS as STUDY
    from jaxwhisker._study.fields import SUMMARY, attributes, unit

    if not isinstance(data, xr.Dataset):
        raise ValueError(f"`data` must be the Dataset of a study, but is a {type(data).__name__}.")
    known = [name for name in STUDY if name in data.variables and STUDY[name].dims != ("control", "spring")]
    if not known or "control" not in data.variables or "whisker" not in data.variables:
        has = ", ".join(map(str, data.variables)) or "nothing"
        raise ValueError(f"`data` must be the Dataset of a study with its steps or events, but has {has}.")
    axes = [dim for dim in data.sizes if dim not in _PER_SCENE]
    control, whiskers = data["control"].values, data.sizes["whisker"]
    fields = {name: data[name].transpose(*axes, *STUDY[name].dims) for name in known}
    found: dict[str, np.ndarray] = {}
    for block in _blocks(data, axes):
        arrays = {name: field.isel(block).values for name, field in fields.items()}
        for name, values in summarise(arrays, control, whiskers).items():
            whole = tuple(data.sizes[dim] for dim in (*axes, *SUMMARY[name].dims))
            found.setdefault(name, np.empty(whole, SUMMARY[name].dtype))[tuple(block.values())] = values
    dimensionless = data["control"].attrs.get("units") == unit("length", True)
    kept = {name: c for name, c in data.coords.items() if set(c.dims) <= {*axes, "whisker"}}
    variables = {
        name: ((*axes, *SUMMARY[name].dims), values, attributes(name, SUMMARY[name], dimensionless))
        for name, values in found.items()
    }
    return xr.Dataset(variables, kept, data.attrs)


def _blocks(data: xr.Dataset, axes: list[Hashable]) -> Iterator[dict[Hashable, slice]]:
    """Slices along the axes: whole chunks of a store, or of BLOCK bytes at most."""
    sizes = {dim: data.sizes[dim] for dim in axes}
    stored = max((v.encoding.get("preferred_chunks", {}) for v in data.data_vars.values()), key=len, default={})
    lanes = max(1, int(BLOCK / max(1, data.nbytes / max(1, int(np.prod(list(sizes.values())))))))
    length = {}
    for dim in reversed(axes):
        length[dim] = stored.get(dim, max(1, min(sizes[dim], lanes)))
        lanes //= length[dim]
    starts = [range(0, sizes[dim], length[dim]) for dim in axes]
    for corner in product(*starts):
        yield {dim: slice(k, k + length[dim]) for dim, k in zip(axes, corner, strict=True)}


def summarise(arrays: Mapping[str, np.ndarray], control: np.ndarray, whiskers: int) -> dict[str, np.ndarray]:
    """Summarise scans along one control; what needs an array that is missing is left out.

    Args:
        arrays: variables of a study by name, (..., control, whisker), (..., control), (..., event, whisker) or
            (..., event): fx, fy, mz, base_x, status, event_*, and the states at events, before_* and after_*, if known.
        control: drive positions.
        whiskers: their number.

    Returns:
        The variables of `FIELDS`, (..., whisker) or (...). A scan with failed steps has no peaks, widths or work: NaN.
    """
    scans = _Scans(arrays, np.asarray(control, dtype=float), whiskers)
    found: dict[str, np.ndarray] = {}
    for name in scans.reactions:
        for which, sign in (("max", 1.0), ("min", -1.0)):
            found[f"{which}_{name}"], found[f"control_of_{which}_{name}"] = scans.peak(name, sign)
    if "mz" in scans.reactions:
        found["half_width_mz"] = scans.half_width("mz", np.maximum(np.abs(found["max_mz"]), np.abs(found["min_mz"])))
    if scans.reactions and scans.has_events:
        found["first_touch"], found["last_contact"] = scans.contact()
        found["contact_width"] = found["first_touch"] - found["last_contact"]
    if scans.has_events:
        found["snaps"] = np.where(scans.count < 0, -1, scans.snap.sum(axis=1))
        if set(_ENERGIES) <= set(arrays):
            before, after = (scans.lanes(name, 1) for name in _ENERGIES)
            lost = np.sum(np.where(scans.snap, before - after, 0.0), axis=1)
            found["snap_work"] = np.where(scans.failed, np.nan, lost)
    if "status" in arrays:
        status = scans.lanes("status", 1)
        found["steps_failed"] = np.where(np.any(status < 0, axis=1), -1, np.sum(status > 0, axis=1))
    return {name: found[name].reshape((*scans.lead, *found[name].shape[1:])) for name in FIELDS if name in found}


class _Scans:
    """The arrays with one leading axis for all scans."""

    def __init__(self, arrays: Mapping[str, np.ndarray], control: np.ndarray, whiskers: int):
        self.arrays, self.control, self.whiskers = arrays, control, whiskers
        self.reactions = [name for name in REACTIONS if name in arrays]
        self.has_events = set(_EVENTS) <= set(arrays)
        trailing = {"status": 1, "event_kind": 1} | dict.fromkeys(self.reactions, 2)
        shapes = [np.shape(arrays[name])[:-count] for name, count in trailing.items() if name in arrays]
        self.lead = shapes[0] if shapes else ()
        scans = int(np.prod(self.lead))
        self.failed = np.zeros(scans, bool)
        if "status" in arrays:
            self.failed |= np.any(self.lanes("status", 1) != 0, axis=1)
        for name in self.reactions:
            self.failed |= np.isnan(self.lanes(name, 2)).any(axis=(1, 2))
        self.kind, self.at = np.full((scans, 0), -1), np.zeros((scans, 0))
        self.named = np.zeros((scans, 0, whiskers), bool)
        if self.has_events:
            self.kind, self.at = self.lanes("event_kind", 1), self.lanes("event_control", 1)
            self.named = self.lanes("event_whisker", 2)
            self.count = np.asarray(arrays["event_count"]).reshape(scans)
            # More events than there was room for: what is not known is not summed.
            self.failed |= self.count > self.kind.shape[1]
        self.snap = self.kind >= EventKind.snap_through

    def lanes(self, name: str, trailing: int) -> np.ndarray:
        array = np.asarray(self.arrays[name])
        return array.reshape(int(np.prod(self.lead)), *array.shape[array.ndim - trailing :])

    def _inside(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Which events, (scans, events, whiskers), lie in the steps from first to last, (scans, whiskers)."""
        ends = self.control[first][:, None, :], self.control[last][:, None, :]
        at = self.at[:, :, None]
        return (at >= np.minimum(*ends)) & (at <= np.maximum(*ends))

    def peak(self, name: str, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """Largest value (sign 1) or smallest (-1) of every whisker, and where; nowhere in particular if it is zero."""
        values = sign * self.lanes(name, 2)
        steps = self.control.size
        step = np.argmax(np.where(np.isnan(values), -np.inf, values), axis=1)

        # A peak that the drive passes at once is a smooth one over the position of the base.
        over = self.lanes("base_x", 2) if "base_x" in self.arrays else None

        def near(k, of=values):
            return np.take_along_axis(of, np.clip(step + k, 0, steps - 1)[:, None, :], axis=1)[:, 0]

        highest = near(0)
        best, where = highest, self.control[step]
        corner = (self.kind >= 0) & (self.kind != EventKind.vertex)
        # Without events nothing tells corners from peaks.
        for reach in range(1, REACH + 1 if self.has_events else 1):
            first, last = np.maximum(step - reach, 0), np.minimum(step + reach, steps - 1)
            smooth = (last - first == 2 * reach) & ~np.any(self._inside(first, last) & corner[:, :, None], axis=1)
            around = range(-reach, reach + 1)
            drive = [self.control[(step + k) % steps] for k in around]
            x = drive if over is None else [near(k, over) for k in around]
            top, at = _vertex(x, [near(k) for k in around], drive)
            better = smooth & (top > highest)  # False for NaN: a drive that stands still
            best, where = np.where(better, top, best), np.where(better, at, where)
        for side in ("before", "after"):
            if f"{side}_{name}" in self.arrays and self.has_events:
                states = sign * self.lanes(f"{side}_{name}", 2)
                states = np.where(np.isnan(states), -np.inf, states)
                event = np.argmax(states, axis=1)
                top = np.take_along_axis(states, event[:, None, :], axis=1)[:, 0]
                at = np.take_along_axis(self.at, event, axis=1)
                better = top > best + NOISE * np.max(np.abs(values), axis=1)
                best, where = np.where(better, top, best), np.where(better, at, where)
        failed = self.failed[:, None]
        return np.where(failed, np.nan, sign * best + 0.0), np.where(failed | (best == 0), np.nan, where)

    def contact(self) -> tuple[np.ndarray, np.ndarray]:
        """Where every whisker first touches and where it loses contact for good; NaN where the scan sees neither."""
        touching = np.any([self.lanes(name, 2) != 0 for name in self.reactions], axis=0)
        steps = self.control.size
        ever = touching.any(axis=1)
        first = np.argmax(touching, axis=1)
        last = steps - 1 - np.argmax(touching[:, ::-1], axis=1)
        snap, release = self.snap[:, :, None], (self.kind == EventKind.release)[:, :, None]
        # In a snap others than those that it names may come into contact or lose it.
        begins = (self.kind == EventKind.touch)[:, :, None] & self.named
        ends = (release | snap) & self.named
        begun = self._index(begins, snap & ever[:, None], np.maximum(first - 1, 0), first, 1)
        ended = self._index(ends, snap & ever[:, None], last, np.minimum(last + 1, steps - 1), -1)
        unseen_start = ever & (first == 0)
        unseen_end = ever & (last == steps - 1)
        padded = np.concatenate([self.at, np.full((self.at.shape[0], 1), np.nan)], axis=1)
        lost = self.failed[:, None]
        start, end = (np.take_along_axis(padded, index, axis=1) for index in (begun, ended))
        return np.where(lost | unseen_start, np.nan, start), np.where(lost | unseen_end, np.nan, end)

    def _index(self, named, snaps, low, high, way: int) -> np.ndarray:
        """Index of the first (way 1) or last (-1) event of `named`, unless one of `snaps` in the steps comes before."""
        inside = self._inside(low, high)
        none = named.shape[1]

        def pick(which):
            index = np.argmax(which[:, ::way], axis=1)
            return np.where(which.any(axis=1), index if way > 0 else none - 1 - index, none)

        if none == 0:
            return np.zeros(low.shape, int)
        own, other, own_inside = pick(named), pick(snaps & inside), np.any(named & inside, axis=1)
        before = (other < own) if way > 0 else (other > own)
        return np.where((own == none) | (before & (other < none) & ~own_inside), other, own)

    def half_width(self, name: str, peak: np.ndarray) -> np.ndarray:
        """Way of the drive between the first and the last time that the magnitude passes half its peak."""
        size, half = np.abs(self.lanes(name, 2)), peak[:, None, :] / 2
        above = size >= np.where(half > 0, half, np.inf)
        steps = self.control.size
        first, last = np.argmax(above, axis=1), steps - 1 - np.argmax(above[:, ::-1], axis=1)

        def crossing(inner, outer):
            a, b = (np.take_along_axis(size, k[:, None, :], axis=1)[:, 0] for k in (inner, outer))
            share = (a - half[:, 0]) / np.where(a == b, 1.0, a - b)
            return self.control[inner] + share * (self.control[outer] - self.control[inner])

        start, end = crossing(first, np.maximum(first - 1, 0)), crossing(last, np.minimum(last + 1, steps - 1))
        known = above.any(axis=1) & (first > 0) & (last < steps - 1) & ~self.failed[:, None]
        return np.where(known, np.abs(start - end), np.nan)


def _differences(x: list[np.ndarray], y: list[np.ndarray]) -> list[np.ndarray]:
    """Divided differences: the coefficients of Newton's polynomial through the points."""
    factor = list(y)
    for order in range(1, len(x)):
        for k in range(len(x) - 1, order - 1, -1):
            factor[k] = (factor[k] - factor[k - 1]) / (x[k] - x[k - order])
    return factor


def _polynomial(x: list[np.ndarray], factor: list[np.ndarray], at: np.ndarray) -> tuple[np.ndarray, ...]:
    """Newton's polynomial, its slope and second derivative."""
    value, slope, bend = factor[-1], np.zeros_like(at), np.zeros_like(at)
    for k in range(len(x) - 2, -1, -1):
        bend = 2 * slope + (at - x[k]) * bend
        slope = value + (at - x[k]) * slope
        value = factor[k] + (at - x[k]) * value
    return value, slope, bend


def _vertex(x: list[np.ndarray], y: list[np.ndarray], control: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Extremum of the polynomial through an odd number of points, and the control there; NaN if not in the middle."""
    middle = len(x) // 2
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        factor, at = _differences(x, y), x[middle]
        for _ in range(NEWTON_STEPS):
            _, slope, bend = _polynomial(x, factor, at)
            at = at - slope / bend
        beside = (at - x[middle - 1]) * (at - x[middle + 1]) <= 0
        where, *_ = _polynomial(x, _differences(x, control), at)
        steps = np.diff(np.stack(x), axis=0)
        one_way = np.all(steps > 0, axis=0) | np.all(steps < 0, axis=0)  # no polynomial goes through a drive that turns
        return np.where(beside & one_way, _polynomial(x, factor, at)[0], np.nan), where
