"""A map of the bending strain or stress along a shaft, over the control of a scan."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar
from jaxwhisker._scan.quantities import Unit, UnitSystem, with_prefix
from jaxwhisker._scan.result import Result, SpaceResult
from jaxwhisker._scan.route import turns_of
from jaxwhisker._scan.strain import bending
from jaxwhisker.plot.axes import one_axes, title
from jaxwhisker.plot.runs import check_one_run, progress

_PLACES = 97  # along the shaft


def strain(
    result: Result | SpaceResult,
    radius: float | Callable[[Scalar], Scalar],
    *,
    modulus: float | None = None,
    whisker: int = 1,
    units: str = "auto",
    ax: Axes | None = None,
) -> Axes:
    """Draw the largest bending strain of each cross-section, over the control and the arc length from the base.

    That is the strain on the surface of a round shaft where it is stretched most: the radius times the change of
    curvature. A cross marks the largest value of the scan, which the title states. If the drive reverses, the
    horizontal axis is its travel. Failed steps are white.

    Args:
        result: of a single scan, in the plane or in space.
        radius: of the shaft, a length: a number, or a function of the arc length from the base, a traced scalar.
        modulus: Young's modulus, in the scene's units of force over length squared. With it, the stress is drawn.
        whisker: which whisker, counted from 1.
        units: "auto", "SI" or "dimensionless", see `overview`.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not that of a single scan, `whisker` is not one of its whiskers, `radius` or
            `modulus` is not positive, or `units` is invalid.
    """
    checks.instance("result", result, (Result, SpaceResult), "the Result of a scan")
    scene: Any = check_one_run(result).scene
    checks.count("whisker", whisker, least=1)
    if whisker > len(scene.whiskers):
        checks.fail("whisker", f"one of the {len(scene.whiskers)} whiskers", whisker)
    system = UnitSystem(scene, units)
    if not callable(radius):
        checks.number("radius", radius, positive=True)
    at = float(scene.whiskers[whisker - 1].length) * np.linspace(0.0, 1.0, _PLACES)
    radii = np.array([float(radius(s)) for s in at]) if callable(radius) else np.full(at.size, radius, dtype=float)
    if not (np.isfinite(radii).all() and np.min(radii) >= 0 and np.max(radii) > 0):
        checks.fail("radius", "positive, or zero at a pointed tip", np.min(radii))
    if modulus is not None:
        checks.number("modulus", modulus, positive=True)
    curvature = np.asarray(bending(result, at).curvature)[:, whisker - 1]
    curvature = np.linalg.norm(curvature[..., :2], axis=-1) if scene.in_space else np.abs(curvature)
    values = radii * curvature * (1.0 if modulus is None else modulus)
    travel, control = progress(result)[0], np.asarray(result.control)
    reverses = turns_of(control).size > 0
    x, y = system.shown("control", travel if reverses else control), system.shown("contact_arc", at)
    ax = one_axes(ax)
    largest = float(np.nanmax(values)) if np.isfinite(values).any() else np.nan
    drawn, unit = "strain" if modulus is None else "stress", Unit("", 1.0)
    if modulus is not None and not system.dimensionless and largest > 0:
        unit = with_prefix("Pa", largest)
    mesh = ax.pcolormesh(x, y, values.T / unit.size, shading="nearest", cmap="viridis", vmin=0.0)
    words = f"bending {drawn}" + (f" ({unit.name})" if unit.name else "")
    ax.figure.colorbar(mesh, cax=ax.inset_axes((1.03, 0.0, 0.04, 1.0)), label=words)
    if np.isfinite(largest):
        step, place = np.unravel_index(np.nanargmax(values), values.shape)
        ax.plot(x[step], y[place], "x", color="white", markeredgewidth=2, clip_on=False, zorder=4)
        title(ax, f"largest {drawn}: {largest / unit.size:.3g} {unit.name}".rstrip())
    label = system.label("control")
    ax.set_xlabel(label if not reverses else f"travel of the drive, {label}")
    ax.set_ylabel(system.label_of("s", "length"))
    return ax
