"""Sensor design: how well parameters can be estimated with each of several sensors."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Control
from jaxwhisker._inverse.information import arguments_of_build, information_at, logs_of, measurement_of
from jaxwhisker._inverse.parameters import build_scene, check_traceable, read_parameters
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._scan.scan import default_control

if TYPE_CHECKING:
    import xarray as xr

DESIGN_STEPS = 512  # of the default control


@with_own_settings
def design(
    build: Callable[..., AbstractScene],
    at: Mapping[str, float],
    *,
    sigma: Any,
    control: Control | None = None,
    channels: Sequence[str] | Callable[..., Mapping[str, Any]] | None = None,
    gains: Any = False,
    offsets: bool = False,
    **axes: Any,
) -> "xr.Dataset":
    """Compare sensors: how well parameters can be estimated, for all combinations of design choices.

        data = jw.design(build, at=dict(a=1.0), sigma=0.02, stiffness=[20.0, 70.0, 200.0], distance=[0.2, 0.3, 0.4])
        data.relative_error.sel(parameter="a").idxmin("stiffness")

    Args:
        build: makes a Scene from named numbers: unknown parameters and design choices. JAX must be able to trace it.
        at: the unknown parameters, estimated together, with their expected values.
        sigma: standard deviation of the signals' noise, as in `information`.
        control: drive positions, (steps,), the same for all choices. Default: 512 over the range of contact of all.
        channels, gains, offsets: what is measured, as in `information`.
        **axes: values of each design choice, one-dimensional.

    Returns:
        A Dataset over the axes: `standard_error` and `relative_error` of each parameter (NaN if it is not
        identifiable), `condition` and `rank` of the information matrix. `attrs["best"]` names the choice with the least
        geometric mean of the relative errors.

    Raises:
        ValueError: if an argument is wrong, or JAX cannot trace `build`.
        ImportError: if xarray is missing: `pip install jaxwhisker[study]`.
    """
    checks.float64_mode()
    values = read_parameters("at", at)
    grids = _grids(axes, values)
    points = [dict(zip(grids, chosen, strict=True)) for chosen in itertools.product(*grids.values())]
    own = arguments_of_build(values, channels, gains)
    scenes = [build_scene("at` and `axes", build, {**own, **point}) for point in points]
    control = _common_control(scenes) if control is None else control
    measurement = measurement_of(control, scenes[0], sigma, channels, values, gains, offsets)
    check_traceable(build, {**own, **points[0]})
    log = logs_of(build, points[0], measurement)
    each = [information_at(build, point, measurement, log) for point in points]
    return _dataset(measurement.at, grids, points, each)


def _grids(axes: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Values of the design choices."""
    if not axes:
        raise ValueError("`axes` must be at least one parameter of `build` with its values, got none.")
    for name, choices in axes.items():
        checks.vector(name, choices)
        if name in values:
            raise ValueError(f"`{name}` must be in `at` or among the axes, got it in both.")
    return {name: np.asarray(choices, dtype=float) for name, choices in axes.items()}


def _common_control(scenes: Sequence[AbstractScene]) -> np.ndarray:
    """Drive positions over the contact of all scenes."""
    ends = np.array([default_control(scene)[[0, -1]] for scene in scenes])
    onwards = np.sign(ends[0, 1] - ends[0, 0])
    return onwards * np.linspace(np.min(onwards * ends[:, 0]), np.max(onwards * ends[:, 1]), DESIGN_STEPS)


def _dataset(values: Mapping[str, float], grids: Mapping[str, np.ndarray], points, of_points) -> "xr.Dataset":
    import xarray as xr

    size = np.abs(np.array(list(values.values())))
    error = np.array([list(one.standard_error.values()) for one in of_points])
    relative = error / np.where(size > 0, size, 1.0)
    shape, dims = tuple(grid.size for grid in grids.values()), tuple(grids)
    data = xr.Dataset(
        {
            "standard_error": ((*dims, "parameter"), error.reshape(*shape, -1)),
            "relative_error": ((*dims, "parameter"), relative.reshape(*shape, -1)),
            "condition": (dims, np.reshape([one.condition for one in of_points], shape)),
            "rank": (dims, np.reshape([one.rank for one in of_points], shape)),
        },
        {**grids, "parameter": list(values)},
    )
    mean = np.exp(np.mean(np.log(relative), axis=-1))
    if np.isfinite(mean).any():
        best = points[int(np.nanargmin(mean))]
        data.attrs["best"] = ", ".join(f"{name} = {value:g}" for name, value in best.items())
    return data
