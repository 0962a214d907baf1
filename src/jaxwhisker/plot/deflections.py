"""Pictures of whiskers bent by given loads."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from jaxwhisker.plot.axes import SUPPORT, colour, one_axes


def deflection(results: Mapping[str, Any], *, length: float = 1.0, ax: Axes | None = None) -> Axes:
    """Draw whiskers bent by given loads.

    Args:
        results: label -> result of `deflect`.
        length: what is drawn as one.
        ax: where to draw; a new figure by default.
    """
    ax = one_axes(ax)
    for k, (label, result) in enumerate(results.items()):
        x, y = np.asarray(result.x) / length, np.asarray(result.y) / length
        ax.plot(x, y, color=colour(k), linewidth=2, label=label)
    ax.plot(0, 0, marker="s", markersize=8, color=SUPPORT, zorder=4)
    ax.grid(alpha=0.3)
    ax.set_aspect("equal")
    ax.set_xlabel(r"$x/L$")
    ax.set_ylabel(r"$y/L$")
    return ax
