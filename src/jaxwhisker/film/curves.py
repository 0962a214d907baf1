"""The right half of a film: the reactions of all whiskers, growing with the control."""

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from jaxwhisker._model.scene import units
from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker._scan.result import Result
from jaxwhisker.film.frames import Frames
from jaxwhisker.plot.axes import axis_label, colour, control_axis, control_of, control_size, in_units

ROOM = 0.08  # above and below, of what is shown
LEAST_HEIGHT = 1e-3  # of an axis: what is constant but for rounding looks constant


class Curves:
    """Axes for fx, fy and mz with the limits of the whole film, one below the other, and what moves in them."""

    def __init__(self, figure: Figure, places: list[tuple[float, float, float, float]], result: Result, shown: Frames):
        self.axes = [figure.add_axes(place) for place in places]
        self._steps, self._control = shown.step, shown.control / control_size(result.scene)
        self._over = control_of(result)
        self._curves, self._heads, self._values = [], [], []
        for ax, quantity in zip(self.axes, REACTIONS, strict=True):
            values, now = in_units(result, quantity), _now(result, shown, quantity)
            self._values.append((values, now))
            ax.set_xlim(*_around(self._over, 0.02))
            # A snap may go beyond what the scan's steps reach.
            ax.set_ylim(*_around(np.concatenate([values, now]), ROOM))
            ax.set_ylabel(axis_label(quantity))
            ax.grid(alpha=0.3)
            ax.locator_params(axis="y", nbins=4)
            ax.tick_params(labelbottom=ax is self.axes[-1])
            own = [colour(k) for k in range(values.shape[1])]
            self._curves.append([ax.plot([], [], color=c, linewidth=1.4)[0] for c in own])
            self._heads.append([ax.plot([], [], color=c, marker="o", markersize=5, linestyle="none")[0] for c in own])
        self.axes[-1].set_xlabel(control_axis(result.scene))

    @property
    def moving(self) -> list[Artist]:
        """From the back to the front."""
        return [line for lines in (*self._curves, *self._heads) for line in lines]

    def move(self, frame: int) -> None:
        """Draw the curves up to a frame."""
        upto, here = self._steps[frame] + 1, self._control[frame]
        for curves, heads, (values, now) in zip(self._curves, self._heads, self._values, strict=True):
            for k, (curve, head) in enumerate(zip(curves, heads, strict=True)):
                curve.set_data(self._over[:upto], values[:upto, k])
                head.set_data([here], [now[frame, k]])


def _now(result: Result, shown: Frames, quantity: str) -> Float[np.ndarray, "frames whiskers"]:
    """A reaction in every frame, without dimensions."""
    size = units(result.scene).moment if quantity == "mz" else units(result.scene).force
    return np.asarray(getattr(shown.state, quantity)) / float(size)


def _around(values: np.ndarray, room: float) -> tuple[float, float]:
    known = np.append(values[np.isfinite(values)], [0.0] * (not np.isfinite(values).any()))
    low, high = float(known.min()), float(known.max())
    room = max(room * (high - low), LEAST_HEIGHT)
    return low - room, high + room
