"""Figures of studies: a summary over one or two parameters, with the critical stiffness; tactile images."""

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxwhisker._base import checks
from jaxwhisker._path.path import Status
from jaxwhisker._scan.dataset import in_shown_units
from jaxwhisker._scan.quantities import REACTIONS_IN_SPACE, STATE
from jaxwhisker.plot.axes import COLOURS, colour, grid_of_axes, legend_above, several_axes, title

if TYPE_CHECKING:
    import xarray as xr

_CRITICAL = COLOURS[1]
STORED_UNITS = ("auto", "stored")
HEIGHT = "object_height"
SIGNED, UNSIGNED, NOT_OK = "RdBu_r", "viridis", "#AAAAAA"  # colours of images
ZERO = 1e-9  # of the largest signal of its unit: a smaller one is zero but for rounding


def study(
    data: "xr.Dataset",
    name: str = "max_mz",
    *,
    critical: "xr.DataArray | None" = None,
    units: str = "auto",
    axs: Iterable[Axes] | None = None,
) -> np.ndarray:
    """Draw a variable of a summary over the study's one or two axes.

    Over one axis, there is one Axes with a line for every whisker; over two, a map for each whisker.

    Args:
        data: result of `summary`, or of `study` with `summary=True`.
        name: a variable with one value per whisker.
        critical: critical stiffness (`jw.critical_stiffness`) divided by the stiffness, over the same axes, with any
            values along them. The figure marks where it is 1: softer springs snap through the vertex.
        units: "auto" (SI with prefixes, such as mm and mN, for scenes whose L and EI are not 1) or "stored" (the
            Dataset's own numbers).
        axs: where to draw: one Axes, or one per whisker for two axes of the study; a new figure by default.

    Returns:
        The Axes, in an array.

    Raises:
        ValueError: if `data` is not a Dataset with such a variable over one or two axes, the number of `axs` is
            wrong, or `units` is invalid.
    """
    _check_dataset(data, name)
    _check_units(units)
    if not (critical is None or hasattr(critical, "dims")):
        checks.fail("critical", "a DataArray", repr(critical))
    dims = [str(dim) for dim in data[name].dims if dim != "whisker"]
    for dim in dims:  # no axis can show infinite parameters, such as the stiffness of a clamp
        data = data.isel({dim: np.isfinite(data[dim].values)}).sortby(dim)
    if units == "auto":
        critical = None if critical is None else in_shown_units(_with_units(critical, data, dims), data.attrs)
        data = in_shown_units(data, data.attrs)
    word = "critical" if data.sizes["whisker"] == 1 else "critical, estimated"
    count = 1 if len(dims) == 1 else data.sizes["whisker"]
    size: dict[str, Any] = {"figsize": (2.0 + 3.6 * count, 4.0)} if count > 1 else {}
    axes = grid_of_axes(axs, columns=count, sharex=True, sharey=True, **size)
    if len(dims) == 1:
        _lines(data[name], critical, dims[0], word, axes[0])
        return axes
    limits = float(data[name].min()), float(data[name].max())
    for whisker, ax in zip(data.whisker.values, axes, strict=True):
        mesh = _map(data[name].sel(whisker=whisker), critical, word, ax, limits)
        if axes.size > 1:
            title(ax, f"whisker {whisker}")
        if axs is None:
            ax.label_outer()
    axes[0].figure.colorbar(mesh, ax=list(axes), label=_name_and_unit(data[name]))
    return axes


def tactile_image(
    data: "xr.Dataset",
    names: Sequence[str] | str = REACTIONS_IN_SPACE,
    *,
    whisker: int = 1,
    units: str = "auto",
    axs: Iterable[Axes] | None = None,
) -> np.ndarray:
    """Draw the height of the object and signals as images over drive position (to the right) and lateral offset (up).

    Images are grey where a status is not ok. The colours of reactions, and of other signals with negative values, are
    symmetric about zero: red is positive. Thin lines are contours of the height, whose colours end a whisker's length
    above the lowest point.

    Args:
        data: result of `tactile_image`.
        names: a signal or several of them: variables of the Dataset along the control.
        whisker: number of the whisker, from 1.
        units: "auto" or "stored", as in `study`.
        axs: where to draw: one Axes for the height and one for each signal; a new figure by default.

    Returns:
        The Axes: first that of the height, then those of the signals.

    Raises:
        ValueError: if `data` is not such a Dataset or does not have these signals or this whisker, the number of `axs`
            is wrong, or `units` is invalid.
    """
    names = (names,) if isinstance(names, str) else tuple(names)
    if HEIGHT not in getattr(data, "data_vars", ()):
        checks.fail("data", "a Dataset of jw.tactile_image", repr(data))
    signals = (str(name) for name in data.data_vars if name not in (HEIGHT, "status"))
    known = [name for name in signals if "control" in data[name].dims and {*data[name].dims} <= {*data[HEIGHT].dims}]
    for name in names or ("",):
        if name not in known:
            checks.fail("names", f"among {', '.join(known)}", repr(name))
    if whisker not in data.whisker:
        checks.fail("whisker", f"a number from 1 to {data.sizes['whisker']}", repr(whisker))
    _check_units(units)
    highest = float(data[HEIGHT].min()) + data.attrs.get("typical_length", 1.0)
    data = data.assign({HEIGHT: data[HEIGHT].clip(max=highest, keep_attrs=True)}).sel(whisker=whisker)
    data = in_shown_units(data, data.attrs) if units == "auto" else data
    failed = data["status"] != Status.ok if "status" in data else None
    axes = _places_of_images(len(names)) if axs is None else several_axes(axs, 1 + len(names))
    _image(data, HEIGHT, UNSIGNED, (None, None), axes[0])
    shown = {name: data[name] if failed is None else data[name].where(~failed) for name in names}
    largest = {name: float(np.abs(values).max().fillna(0.0)) for name, values in shown.items()}
    for ax, (name, values) in zip(axes[1:], shown.items(), strict=True):
        scale = max(largest[one] for one in names if data[one].attrs.get("units") == data[name].attrs.get("units"))
        top = largest[name] if largest[name] > ZERO * scale else scale
        signed = name in REACTIONS_IN_SPACE or bool((values < 0).any())
        look = (SIGNED, (-top, top)) if signed else (UNSIGNED, (None, None))
        _image(data.assign({name: values.assign_attrs(data[name].attrs)}), name, *look, ax)
        if failed is not None:
            ax.set_facecolor(NOT_OK)
    if axs is None:
        for ax in axes:
            ax.label_outer()
    if failed is not None and bool(failed.any()):
        legend_above(axes[1], [Patch(color=NOT_OK, label="status not ok")], least=1)
    return axes


def _places_of_images(count: int) -> np.ndarray:
    """Axes of a new figure: one on the left, and up to three in each row beside it."""
    from matplotlib import pyplot

    rows, columns = -(-count // 3), min(count, 3)
    places: Any = [[0, *(1 + columns * row + k if columns * row + k < count else -1 for k in range(columns))]
              for row in range(rows)]  # fmt: skip
    size = 0.6 + 3.3 * (1 + columns), 0.6 + 2.3 * rows
    options: dict[str, Any] = {"sharex": True, "sharey": True, "figsize": size, "layout": "constrained"}
    _, axes = pyplot.subplot_mosaic(places, empty_sentinel=-1, **options)
    return np.array([axes[k] for k in range(count + 1)])


def _image(data: "xr.Dataset", name: str, colours: str, limits: tuple[float | None, float | None], ax: Axes) -> None:
    """Draw a variable over control and offset, with contours of the height."""
    (offset,) = (dim for dim in data[HEIGHT].dims if dim != "control")
    values, height = (data[one].transpose(offset, "control") for one in (name, HEIGHT))
    x, y = data["control"].values, data[offset].values
    mesh = ax.pcolormesh(x, y, values.values, shading="nearest", cmap=colours, vmin=limits[0], vmax=limits[1])
    known = np.ma.masked_invalid(height.values)
    if known.count() and known.max() > known.min():
        levels = np.linspace(known.min(), known.max(), 8)[1:4]  # higher ones break off at the outline
        ax.contour(x, y, known, levels=levels, colors="black", linewidths=0.5, alpha=0.5)
    words = f"${STATE[name].symbol}$" + _unit(values) if name in STATE else _name_and_unit(values)
    ax.figure.colorbar(mesh, cax=ax.inset_axes((1.03, 0.0, 0.05, 1.0)), label=words)
    lengths = data["control"].attrs.get("units") == data[offset].attrs.get("units")
    ax.set(xlabel=_name_and_unit(data["control"]), ylabel=_name_and_unit(data[offset]))
    ax.set_aspect("equal" if lengths else "auto")


def _check_units(units: str) -> None:
    if units not in STORED_UNITS:
        checks.fail("units", f"one of {', '.join(STORED_UNITS)}", repr(units))


def _with_units(critical: "xr.DataArray", data: "xr.Dataset", dims: list[str]) -> "xr.DataArray":
    """The array with units of its axes: its own if they are known, else those of the Dataset."""
    axes = {dim: (dim, critical[dim].values, data[dim].attrs | critical[dim].attrs) for dim in dims}
    return critical.assign_coords(axes)


def _check_dataset(data: Any, name: str) -> None:
    # xarray is optional, so it must not be imported for a check.
    if not hasattr(data, "data_vars"):
        checks.fail("data", "a Dataset of jw.summary", repr(data))
    known = [str(n) for n, variable in data.data_vars.items() if "whisker" in variable.dims]
    if name not in known:
        checks.fail("name", f"one of {', '.join(known)}", repr(name))
    dims = [str(dim) for dim in data[name].dims if dim != "whisker"]
    if len(dims) not in (1, 2) or {"control", "event"} & set(dims):
        raise ValueError(f"`data` must have {name} over one or two axes, got {', '.join(dims) or 'none'}.")


def _name_and_unit(variable: "xr.DataArray") -> str:
    name = variable.attrs.get("long_name", str(variable.name))
    for reaction in REACTIONS_IN_SPACE:
        name = re.sub(rf"\b{reaction}\b", f"${STATE[reaction].symbol}$", name)
    return name + _unit(variable)


def _unit(variable: "xr.DataArray") -> str:
    """The unit of a variable in parentheses; nothing for a number."""
    unit = variable.attrs.get("units", "1")
    raised = re.sub(r"\^(\d+)", r"$^{\1}$", unit)
    return "" if unit == "1" else f" ({raised})"


def _lines(values: "xr.DataArray", critical: "xr.DataArray | None", axis: str, word: str, ax: Axes) -> None:
    for k, whisker in enumerate(values.whisker.values):
        y = values.sel(whisker=whisker).values
        ax.plot(values[axis].values, y, marker=".", color=colour(k), label=f"whisker {whisker}")
    for k, at in enumerate([] if critical is None else _crossings(critical[axis].values, critical.values)):
        ax.axvline(at, color="black", linestyle="--", label=None if k else f"{word}: {at:.4g}")
    ax.set_xlabel(_name_and_unit(values[axis]))
    ax.set_ylabel(_name_and_unit(values))
    ax.grid(alpha=0.3)
    legend_above(ax, columns=2)


def _crossings(x: np.ndarray, steepness: np.ndarray) -> list[float]:
    """Where the steepness crosses 1; its logarithm is nearly linear in the logarithm of x."""
    if not np.all(x > 0):
        return []
    height, at = np.log(steepness), np.log(x)
    below = np.flatnonzero(height[:-1] * height[1:] <= 0)
    share = height[below] / (height[below] - height[below + 1])
    return np.exp(at[below] + share * (at[below + 1] - at[below])).tolist()


def _map(values: "xr.DataArray", critical: "xr.DataArray | None", word: str, ax: Axes, limits: tuple[float, float]):
    first, second = (str(dim) for dim in values.dims)
    x, y = values[first].values, values[second].values
    mesh = ax.pcolormesh(x, y, values.values.T, shading="nearest", cmap="viridis", clim=limits)
    if critical is not None:
        x, y = critical[first].values, critical[second].values
        height = np.ma.log(np.ma.masked_invalid(critical.transpose(first, second).values.T))
        if np.ma.min(height) < 0 < np.ma.max(height):
            ax.contour(x, y, height, levels=[0.0], colors=_CRITICAL, linewidths=2)
            legend_above(ax, [Line2D([], [], color=_CRITICAL, linewidth=2, label=word)], least=1)
    ax.set_xlabel(_name_and_unit(values[first]))
    ax.set_ylabel(_name_and_unit(values[second]))
    return mesh
