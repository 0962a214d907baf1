"""Design: which sensor tells best what one wants to know, from the information of a study's scenes."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.jit import COMPILER_OPTIONS
from jaxwhisker._base.types import Control
from jaxwhisker._inverse.information import noise_by_channel, of_rates, rates_of
from jaxwhisker._inverse.measured import CHANNELS
from jaxwhisker._inverse.transforms import checked_scene, checked_values, transforms_of
from jaxwhisker._model.scene import Scene
from jaxwhisker._scan.route import route_of
from jaxwhisker._scan.scan import default_control

if TYPE_CHECKING:
    import xarray as xr

STEPS = 512  # of the default control


def design(
    build: Callable[..., Scene],
    at: Mapping[str, float],
    *,
    sigma: Any,
    control: Control | None = None,
    channels: Sequence[str] = CHANNELS,
    **axes: Any,
) -> "xr.Dataset":
    """How well parameters can be told, over all combinations of what can be chosen.

        told = jw.design(build, at=dict(a=1.0), sigma=0.02, stiffness=[20.0, 70.0, 200.0], distance=[0.2, 0.3, 0.4])
        told.relative_error.sel(parameter="a").idxmin("stiffness")

    Args:
        build: makes a Scene from numbers given by name: those that are sought and those that can be chosen.
        at: what one wants to know, all of it at once, with the values around which it is expected.
        sigma: standard deviation of the signals' noise, as of `information`.
        control: drive positions, the same for all. Default: 512 across the contact of all.
        channels: those that are measured.
        **axes: values of what can be chosen, one-dimensional.

    Returns:
        A Dataset over the axes: standard_error and relative_error of each parameter (NaN for what the signals do not
        tell), condition and rank of the information matrix. `attrs["best"]` names the choice with the least geometric
        mean of relative errors.

    Raises:
        ValueError: if an argument is wrong.
        ImportError: if xarray is missing: `pip install jaxwhisker[study]`.
    """
    import xarray as xr

    checks.float64_mode()
    values = checked_values("at", at)
    if not axes:
        raise ValueError("`axes` must be at least one parameter of `build` with its values, but there is none.")
    for name, choices in axes.items():
        checks.vector(name, choices)
        if name in values:
            raise ValueError(f"`{name}` must be sought or chosen, but is in `at` and among the axes.")
    grids = {name: np.asarray(choices, dtype=float) for name, choices in axes.items()}
    points = [dict(zip(grids, chosen, strict=True)) for chosen in itertools.product(*grids.values())]
    scenes = [checked_scene("at` and `axes", build, {**values, **point}) for point in points]
    transforms = transforms_of(build, {**values, **points[0]}, {}, {})
    log = np.array([transforms[name].log for name in values])
    if control is None:
        ends = [default_control(scene)[[0, -1]] for scene in scenes]
        onwards = np.sign(ends[0][1] - ends[0][0])
        first, last = (onwards * pick([onwards * e[k] for e in ends]) for k, pick in ((0, min), (1, max)))
        control = np.linspace(first, last, STEPS)
    checks.vector("control", control)
    control = np.asarray(control, dtype=float)
    noise = noise_by_channel(len(scenes[0].whiskers), control.size, sigma, channels)

    def of_point(x, chosen, control, stops, last):
        return rates_of(lambda **sought: build(**sought, **chosen), tuple(values))(x, control, stops, last)

    x, stops = (
        jnp.array(list(values.values())),
        [jnp.asarray(v) for v in route_of(np.asarray(control, dtype=float))[2:]],
    )
    first = {name: jnp.asarray(value) for name, value in points[0].items()}
    compiled = jax.jit(of_point).lower(x, first, jnp.asarray(control), *stops).compile(COMPILER_OPTIONS)
    found = {name: [] for name in ("standard_error", "relative_error", "condition", "rank")}
    for point in points:
        chosen = {name: jnp.asarray(value) for name, value in point.items()}
        rates = jax.tree.map(np.asarray, compiled(x, chosen, jnp.asarray(control), *stops))
        one = of_rates(rates, values, control, noise, log)
        errors = np.array(list(one.standard_error.values()))
        size = np.abs(np.array(list(values.values())))
        found["standard_error"].append(errors)
        found["relative_error"].append(errors / np.where(size > 0, size, 1.0))
        found["condition"].append(one.condition)
        found["rank"].append(one.rank)
    shape, dims = tuple(v.size for v in grids.values()), tuple(grids)
    data = xr.Dataset(
        {
            "standard_error": ((*dims, "parameter"), np.reshape(found["standard_error"], (*shape, -1))),
            "relative_error": ((*dims, "parameter"), np.reshape(found["relative_error"], (*shape, -1))),
            "condition": (dims, np.reshape(found["condition"], shape)),
            "rank": (dims, np.reshape(found["rank"], shape)),
        },
        {**grids, "parameter": list(values)},
    )
    mean = np.exp(np.mean(np.log(data.relative_error.values), axis=-1)).ravel()
    if np.isfinite(mean).any():
        best = points[int(np.nanargmin(mean))]
        data.attrs["best"] = ", ".join(f"{name} = {value:g}" for name, value in best.items())
    return data
