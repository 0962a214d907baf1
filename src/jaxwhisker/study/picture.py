"""The picture of a study: a peak over one or two parameters, and where scans begin to snap through the vertex."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import numpy as np

from jaxwhisker.critical import softest, steepest
from jaxwhisker.scene import Scene

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

FINE = 33  # the critical stiffness is read between that many values of each parameter
_CRITICAL = "#D55E00"


def steepness(build: Callable[..., Scene], data: xr.Dataset) -> xr.DataArray:
    """Steepest slope of the clamped whisker's force times the softest base's flexibility, over the range of a study.

    Above 1 a scan snaps through the vertex: the springs are softer than the critical stiffness (for coupled whiskers
    an estimate). NaN where a scene is impossible or there is no steepest slope. Its grid has `FINE` values an axis.

    Args:
        build: of the study.
        data: its Dataset, or the summary of it, over one axis or more.
    """
    import xarray as xr

    slopes: dict[str, float] = {}

    def at(values: tuple[float, ...]) -> float:
        try:
            scene = build(**dict(zip(axes, values, strict=True)))
        except ValueError:
            return np.nan
        whisker = scene.whiskers[0]
        # The springs have no part in it: one search serves all of them.
        leaves, structure = jax.tree.flatten(whisker)
        same = repr(([np.asarray(leaf).tolist() for leaf in leaves], structure, scene.profile))
        if same not in slopes:
            slopes[same] = steepest(whisker, scene.profile).slope
        return slopes[same] * softest(scene.support)

    axes = [str(dim) for dim in data.sizes if dim not in ("control", "whisker", "spring", "event")]
    ranges = [data[axis].values[np.isfinite(data[axis].values)] for axis in axes]
    values = [np.linspace(known.min(), known.max(), FINE) for known in ranges]
    grid = np.meshgrid(*values, indexing="ij")
    found = [at(tuple(map(float, point))) for point in zip(*[g.ravel() for g in grid], strict=True)]
    return xr.DataArray(np.reshape(found, grid[0].shape), dict(zip(axes, values, strict=True)), axes)


def picture(data: xr.Dataset, critical: xr.DataArray | None = None, name: str = "max_mz"):
    """Draw a variable of a summary for every whisker, over the study's one or two axes; return the Figure.

    Args:
        data: of `summary`, or of `study` with `summary=True`.
        critical: of `steepness`: drawn in where it is 1.
        name: a variable with one value per whisker.
    """
    from matplotlib.figure import Figure

    data = _finite(data)
    axes = [dim for dim in data[name].dims if dim != "whisker"]
    count = data.sizes["whisker"]
    word = "critical" if count == 1 else "critical, estimated"
    if len(axes) == 1:
        figure = Figure(figsize=(7, 4.5), layout="constrained")
        _lines(data[name], critical, str(axes[0]), word, figure.add_subplot())
    else:
        figure = Figure(figsize=(1.2 + 4.6 * count, 4.5), layout="constrained")
        panels = figure.subplots(1, count, sharex=True, sharey=True, squeeze=False)[0]
        low, high = float(data[name].min()), float(data[name].max())
        for whisker, ax in zip(data.whisker.values, panels, strict=True):
            mesh = _map(data[name].sel(whisker=whisker), critical, word, ax, low, high)
            ax.set_title(f"whisker {whisker}", fontsize=10)
        figure.colorbar(mesh, ax=list(panels), label=_label(data[name]))
    figure.suptitle(data.attrs.get("scene", ""), fontsize=10)
    return figure


def _finite(data):
    """Without the points at infinity, which have no place in a picture."""
    for dim in data.dims:
        if dim != "whisker":
            data = data.isel({dim: np.isfinite(data[dim].values)}).sortby(dim)
    return data


def _label(variable: xr.DataArray) -> str:
    name, unit = variable.attrs.get("long_name", str(variable.name)), variable.attrs.get("units", "1")
    return name if unit == "1" else f"{name} [{unit}]"


def _lines(values: xr.DataArray, critical: xr.DataArray | None, axis: str, word: str, ax: Axes) -> None:
    from jaxwhisker.plot import COLOURS

    for k, whisker in enumerate(values.whisker.values):
        y = values.sel(whisker=whisker).values
        ax.plot(values[axis].values, y, marker=".", color=COLOURS[k % len(COLOURS)], label=f"whisker {whisker}")
    for k, at in enumerate([] if critical is None else _crossings(critical[axis].values, critical.values)):
        ax.axvline(at, color="black", linestyle="--", label=None if k else f"{word}: {at:.4g}")
    ax.set_xlabel(_label(values[axis]))
    ax.set_ylabel(_label(values))
    ax.grid(alpha=0.3)
    ax.legend(fontsize=9)


def _crossings(x: np.ndarray, steepness: np.ndarray) -> list[float]:
    """Where the steepness passes 1; its logarithm is nearly straight over the logarithm of x."""
    if not np.all(x > 0):
        return []
    height, at = np.log(steepness), np.log(x)
    turn = np.flatnonzero(height[:-1] * height[1:] <= 0)
    share = height[turn] / (height[turn] - height[turn + 1])
    return np.exp(at[turn] + share * (at[turn + 1] - at[turn])).tolist()


def _map(values: xr.DataArray, critical: xr.DataArray | None, word: str, ax: Axes, low: float, high: float):
    from matplotlib.lines import Line2D

    first, second = (str(dim) for dim in values.dims)
    x, y = values[first].values, values[second].values
    mesh = ax.pcolormesh(x, y, values.values.T, shading="nearest", cmap="viridis", vmin=low, vmax=high)
    if critical is not None:
        x, y = critical[first].values, critical[second].values
        height = np.ma.log(np.ma.masked_invalid(critical.transpose(first, second).values.T))
        if np.ma.min(height) < 0 < np.ma.max(height):
            ax.contour(x, y, height, levels=[0.0], colors=_CRITICAL, linewidths=2)
            ax.legend([Line2D([], [], color=_CRITICAL, linewidth=2)], [word], fontsize=8, loc="best")
    ax.set_xlabel(_label(values[first]))
    ax.set_ylabel(_label(values[second]))
    return mesh
