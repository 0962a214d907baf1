"""Figures of inverse problems: fitted signals, information along a scan, reconstructed contours."""

from collections.abc import Iterable
from types import NoneType

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._inverse.fit import Fit
from jaxwhisker._inverse.fit_contour import Band, ContourFit
from jaxwhisker._inverse.fit_profile import ProfileFit
from jaxwhisker._inverse.information import Information
from jaxwhisker._inverse.points import Reconstruction, bar_ends
from jaxwhisker._inverse.statistics import NORMAL_95, FitStatus
from jaxwhisker._model.profile import AbstractProfile, ContactPoint
from jaxwhisker._scan.quantities import REACTIONS, UnitSystem
from jaxwhisker.plot.axes import (
    COLOURS,
    GREY,
    colour,
    grid_of_axes,
    label_coordinates,
    legend_above,
    length_unit,
    mark_events,
    one_axes,
    title,
)

DRAWN_POINTS = 241  # of a profile that is drawn for comparison


def fit(result: Fit, *, recording: int = 0, units: str = "auto", axs: Iterable[Axes] | None = None) -> np.ndarray:
    """Draw measured signals (dots) and those of the fit (lines), and their differences beside them.

    Each measured channel has two Axes. The grey band of the residuals, measured - fitted, holds 95 % of the noise that
    the fit assumes. Samples that the fit leaves out, beside snaps, have no residual.

    Args:
        result: result of `identify`.
        recording: which recording of a fit to several, from 0.
        units: "auto", "SI" (with prefixes: mm, mN) or "dimensionless" (in L and EI of the first whisker). "auto" is
            "dimensionless" for a first whisker with L = EI = 1, else "SI".
        axs: where to draw, two Axes for each measured channel (signals, residuals); a new figure by default.

    Returns:
        The Axes, channel by channel.

    Raises:
        ValueError: if `result` is not a Fit, there is no such recording, the number of `axs` is wrong, or `units` is
            invalid.
    """
    checks.instance("result", result, Fit, "the Fit of jw.identify")
    if recording not in range(len(result.recordings)):
        raise ValueError(f"`recording` must be a number from 0 to {len(result.recordings) - 1}, got {recording!r}.")
    fitted = result.recordings[recording]
    measured, system = fitted.measured, UnitSystem(fitted.scene, units)
    kinds = measured.kinds
    channels = [c for c in range(len(kinds)) if measured.known[:, :, c].any()]
    in_units = kinds == REACTIONS and fitted.in_units

    def shown(kind: str, values: np.ndarray) -> np.ndarray:
        return system.shown(kind, values) if in_units else values

    axes = grid_of_axes(axs, rows=len(channels), columns=2, sharex=True, figsize=(9.0, 1.2 + 1.5 * len(channels)))
    control = system.shown("control", measured.control)
    for ax, beside, c in zip(axes[::2], axes[1::2], channels, strict=True):
        arrays = measured.values, fitted.signals, fitted.residuals, NORMAL_95 * measured.sigma
        dots, lines, residuals, noise = (shown(kinds[c], values[..., c]) for values in arrays)
        for k in range(measured.values.shape[1]):
            ax.plot(control, dots[:, k], ".", color=colour(k), markersize=2, alpha=0.4)
            ax.plot(control, lines[:, k], color=colour(k), linewidth=1, label=f"whisker {k + 1}")
            beside.plot(control, residuals[:, k], ".", color=colour(k), markersize=2)
        widest = np.max(noise, axis=1)
        beside.fill_between(control, -widest, widest, color=GREY, alpha=0.2, linewidth=0, zorder=0)
        ax.set_ylabel(system.label(kinds[c]) if in_units else kinds[c])
    for ax in axes[-2:]:
        ax.set_xlabel(system.label("control"))
    if measured.values.shape[1] > 1:
        legend_above(axes[0])
    title(axes[0], "measured (dots) and fitted" + ("" if result.status == FitStatus.ok else f": {result.status}"))
    title(axes[1], "measured $-$ fitted; grey: 95 % of the noise")
    return axes


def information(result: Information, *, units: str = "auto", ax: Axes | None = None) -> Axes:
    """Draw the share of the information about each parameter that has been collected up to each step of a scan.

    The signals are most informative where a line is steep; thin lines with markers are events.

    Args:
        result: result of `jw.information`.
        units: "auto", "SI" or "dimensionless", see `fit`.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not an Information or `units` is invalid.
    """
    checks.instance("result", result, Information, "the Information of jw.information")
    system = UnitSystem(result.scene, units)
    axes, control = one_axes(ax), system.shown("control", result.control)
    for k, name in enumerate(result.names):
        collected = np.cumsum(result.density[:, k])
        if collected[-1] > 0:
            axes.plot(control, collected / collected[-1], color=colour(k), label=name)
    entries = mark_events(axes, system.shown("control", [event.control for event in result.events]), result.events)
    axes.set_xlabel(system.label("control"))
    axes.set_ylabel("share of information")
    legend_above(axes, axes.get_legend_handles_labels()[0] + entries, least=1)
    return axes


def contour(
    result: Reconstruction | ProfileFit | ContourFit,
    *,
    profile: AbstractProfile | None = None,
    units: str = "auto",
    ax: Axes | None = None,
) -> Axes:
    """Draw reconstructed points with 95 % bars across the contour, or a fitted profile or contour with its 95 % band.

    Only points clear of the noise are drawn, only the part of a fitted profile that has points, and only the part of a
    fitted contour that the signals determine. Both axes have the same scale.

    Args:
        result: result of `reconstruct`, `fit_profile` or `fit_contour`.
        profile: a profile to draw as a black line for comparison: the true object, or one that was fitted to points.
        units: "auto", "SI" (with prefixes: mm) or "dimensionless" (in L of the first whisker). "auto" is "SI" unless
            L = 1.
        ax: where to draw; a new figure by default.

    Returns:
        The Axes.

    Raises:
        ValueError: if `result` is not one of these, `profile` is not a profile, or `units` is invalid.
    """
    words = "the result of jw.reconstruct, jw.fit_profile or jw.fit_contour"
    checks.instance("result", result, (Reconstruction, ProfileFit, ContourFit), words)
    checks.instance("profile", profile, (AbstractProfile, NoneType), "a profile such as jw.Parabola(0.2)")
    axes = one_axes(ax)
    length = result.sensor.whiskers[0].length if isinstance(result, ContourFit) else result.length
    unit = length_unit(float(length), units)
    if isinstance(result, Reconstruction):
        slopes, left, right = _draw_points(result, unit.size, axes)
    else:
        slopes, left, right = _draw_fitted(result, unit.size, axes)
    if profile is not None:
        at = _between(jax.tree.map(checks.as_float, profile), jnp.asarray(slopes))
        # Slopes are less certain than points, so the range of the points limits the line as well.
        x, y = at.x / unit.size, at.y / unit.size
        known = (x >= left) & (x <= right)
        axes.plot(x[known], y[known], color="black", linewidth=0.8, label=str(profile))
    label_coordinates(axes, unit)
    legend_above(axes, least=1)
    return axes


def _draw_fitted(result: ProfileFit | ContourFit, unit: float, axes: Axes) -> tuple[np.ndarray, float, float]:
    """Draw a fitted profile or contour and its band; return the slopes at its ends and its range in x."""
    if isinstance(result, ProfileFit):
        at = np.linspace(*result.slopes, DRAWN_POINTS)
        band = Band(at, *result.band(at))
    else:
        band = result.band()
    certain = np.isfinite(band.error).any()  # a fit whose status is not ok has no band
    known = np.isfinite(band.error) if certain else np.ones(band.error.shape, bool)
    slope, x, y, error = (values[known] / size for values, size in zip(band, (1.0, unit, unit, unit), strict=True))
    (x_out, x_in), (y_out, y_in) = _bars(x, y, slope, error)
    axes.fill(np.append(x_out, x_in[::-1]), np.append(y_out, y_in[::-1]), color=COLOURS[0], alpha=0.25, linewidth=0)
    axes.plot(x, y, color=COLOURS[0], label="fitted, 95 % band" if certain else "fitted")
    return slope[[0, -1]], x.min(), x.max()


def _draw_points(result: Reconstruction, unit: float, axes: Axes) -> tuple[np.ndarray, float, float]:
    """Draw points with bars; return the range of their slopes and of x, both without outliers."""
    x, y, error = (np.asarray(values) / unit for values in (result.x, result.y, result.normal_error))
    slope = np.asarray(result.slope)
    clear = np.asarray(result.clear)
    for k in range(x.shape[1]):
        own = clear[:, k], k
        axes.plot(*_bars(x[own], y[own], slope[own], error[own]), color=colour(k), linewidth=0.5, alpha=0.3)
        axes.plot(x[own], y[own], ".", color=colour(k), markersize=2.5, label=f"whisker {k + 1}")
    if not clear.any():
        return np.array([-1.0, 1.0]), -np.inf, np.inf
    left, right = np.quantile(x[clear], [0.02, 0.98])
    return np.quantile(slope[clear], [0.02, 0.98]), left, right


def _bars(x: np.ndarray, y: np.ndarray, slope: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x and y of both ends of 95 % bars across a contour: the outer ends first."""
    ends_x, ends_y = bar_ends(x, y, slope, NORMAL_95 * np.nan_to_num(error))
    return np.asarray(ends_x), np.asarray(ends_y)


@Program
def _between(profile: AbstractProfile, slopes: Float[jax.Array, " 2"]) -> ContactPoint:
    """Points of a profile between two slope angles."""
    ends = jnp.asarray(jax.vmap(profile.at_slope)(slopes))
    return jax.vmap(profile.point)(jnp.linspace(ends[0], ends[1], DRAWN_POINTS))
