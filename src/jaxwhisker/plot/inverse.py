"""Pictures of what signals tell: fits beside what was measured, information along a scan, reconstructed contours."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from jaxwhisker._base import checks
from jaxwhisker._inverse.fit_contour import ContourFit
from jaxwhisker._inverse.measured import CHANNELS
from jaxwhisker._model.profile import AbstractProfile, ContactPoint
from jaxwhisker._model.scene import units
from jaxwhisker.plot.axes import (
    COLOURS,
    axis_label,
    colour,
    column,
    control_axis,
    control_size,
    legend_above,
    mark_events,
    one_axes,
    title,
)

if TYPE_CHECKING:
    from jaxwhisker._inverse.fit import Fit
    from jaxwhisker._inverse.information import Information
    from jaxwhisker._inverse.points import Reconstruction

BAND = 1.959964  # standard deviations that hold 95 %
POINTS = 241  # of a known profile
_UNIT = "(scan's unit)"


def fit(fit: "Fit", *, axs: Iterable[Axes] | None = None) -> np.ndarray:
    """Draw measured signals (dots) and those of the fit (lines), one Axes a measured channel.

    Args:
        fit: of `identify`.
        axs: where to draw, one per measured channel; a new figure by default.

    Raises:
        ValueError: if the number of `axs` is another one.
    """
    measured = fit.measured
    channels = [c for c in range(len(CHANNELS)) if measured.known[:, :, c].any()]
    axes, unit = column(axs, len(channels)), units(fit.scene)
    control = measured.control / control_size(fit.scene)
    for ax, c in zip(axes, channels, strict=True):
        size = float(unit.moment if CHANNELS[c] == "mz" else unit.force)
        for k in range(measured.values.shape[1]):
            ax.plot(control, measured.values[:, k, c] / size, ".", color=colour(k), markersize=2, alpha=0.4)
            ax.plot(control, fit.signals[:, k, c] / size, color=colour(k), linewidth=1, label=f"whisker {k + 1}")
        ax.set_ylabel(axis_label(CHANNELS[c]))
    axes[-1].set_xlabel(control_axis(fit.scene))
    if measured.values.shape[1] > 1:
        legend_above(axes[0], axes[0].get_legend_handles_labels()[0])
    title(axes[0], "measured (dots) and fitted" + ("" if fit.status == 0 else f": {fit.status.name}"))
    _onwards(axes, control)
    return axes


def information(information: "Information", *, ax: Axes | None = None) -> Axes:
    """Draw where along the scan the signals know about each parameter: the share of its information that has come in.

    A steep line is where the signals tell most; grey lines are events.

    Args:
        information: of `jw.information`.
        ax: where to draw; a new figure by default.
    """
    axes = one_axes(ax)
    for k, name in enumerate(information.names):
        gained = np.cumsum(information.density[:, k])
        if gained[-1] > 0:
            axes.plot(information.control, gained / gained[-1], color=colour(k), label=name)
    mark_events(axes, [event.control for event in information.events])
    axes.set_xlabel(f"$u$ {_UNIT}")
    axes.set_ylabel("share of information")
    legend_above(axes, axes.get_legend_handles_labels()[0], least=1)
    _onwards([axes], information.control)
    return axes


def contour(
    found: "Reconstruction | ContourFit", *, profile: AbstractProfile | None = None, ax: Axes | None = None
) -> Axes:
    """Draw reconstructed points, or a fitted contour with its 95 % band where it is known, equal scales on both axes.

    Args:
        found: of `reconstruct` (points clear of the noise are drawn, with bars across the contour) or `fit_contour`.
        profile: drawn beside it: the object, where it is known, or one that was fitted to points.
        ax: where to draw; a new figure by default.
    """
    axes = one_axes(ax)
    if isinstance(found, ContourFit):
        band = found.band()
        known = np.isfinite(band.error) if np.isfinite(band.error).any() else np.ones(band.error.shape, bool)
        slope, x, y, error = (v[known] for v in band)
        across = BAND * np.nan_to_num(error) * np.array([[1.0], [-1.0]])
        x_out, x_in = x + across * np.sin(slope)
        y_out, y_in = y - across * np.cos(slope)
        axes.fill(np.append(x_out, x_in[::-1]), np.append(y_out, y_in[::-1]), color=COLOURS[0], alpha=0.25, linewidth=0)
        axes.plot(x, y, color=COLOURS[0], label="fitted, 95 % band")
        ends, left, right = slope[[0, -1]], x.min(), x.max()
    else:
        x, y, slope, error = (np.asarray(v) for v in (found.x, found.y, found.slope, found.normal_error))
        clear = np.asarray(found.clear)
        for k in range(x.shape[1]):
            own = clear[:, k]
            reach = BAND * np.nan_to_num(error[own, k]) * np.array([[1.0], [-1.0]])
            bars_x, bars_y = x[own, k] + reach * np.sin(slope[own, k]), y[own, k] - reach * np.cos(slope[own, k])
            axes.plot(bars_x, bars_y, color=colour(k), linewidth=0.5, alpha=0.3)
            axes.plot(x[own, k], y[own, k], ".", color=colour(k), markersize=2.5, label=f"whisker {k + 1}")
        ends, left, right = np.array([-1.0, 1.0]), -np.inf, np.inf
        if clear.any():
            ends, (left, right) = np.quantile(slope[clear], [0.02, 0.98]), np.quantile(x[clear], [0.02, 0.98])
    if profile is not None:
        at = _between(jax.tree.map(checks.as_float, profile), jnp.asarray(ends))
        # Slopes are known less well than points are: not beyond these.
        known = (at.x >= left) & (at.x <= right)
        axes.plot(at.x[known], at.y[known], color="black", linewidth=0.8, label=str(profile))
    axes.set_aspect("equal")
    axes.set_xlabel(f"$x$ {_UNIT}")
    axes.set_ylabel(f"$y$ {_UNIT}")
    legend_above(axes, axes.get_legend_handles_labels()[0], least=1)
    return axes


@eqx.filter_jit
def _between(profile: AbstractProfile, slopes: Float[jax.Array, " 2"]) -> ContactPoint:
    """Points of a profile between two slope angles."""
    ends = jnp.asarray(jax.vmap(profile.at_slope)(slopes))
    return jax.vmap(profile.point)(jnp.linspace(ends[0], ends[1], POINTS))


def _onwards(axes: Iterable[Axes], control: np.ndarray) -> None:
    """What is read in the order of time runs to the right."""
    if control[-1] < control[0]:
        for ax in axes:
            ax.set_xlim(float(np.max(control)), float(np.min(control)))
