"""Steepness: where the scans of a study begin to snap through the vertex."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import numpy as np

from jaxwhisker._model.scene import Scene
from jaxwhisker._study.critical import softest, steepest

if TYPE_CHECKING:
    import xarray as xr

FINE = 33  # the critical stiffness is read between that many values of each parameter


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
