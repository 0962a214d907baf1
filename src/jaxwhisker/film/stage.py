"""The left half of a film: object, drive, springs, whiskers and contact forces in one window."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from jaxwhisker._model.scene import Scene, moves_along_x, units
from jaxwhisker._model.silhouette import silhouette_of
from jaxwhisker.film.swing import Outline
from jaxwhisker.plot.axes import SUPPORT, colour
from jaxwhisker.plot.drawing import Drawing
from jaxwhisker.plot.states import profile

ROOM = 0.03  # around what moves, of the window
FOR_WORDS = 0.1  # above it


class Window(NamedTuple):
    """What of the plane is seen."""

    left: float
    right: float
    bottom: float
    top: float

    @property
    def shape(self) -> float:
        """Height over width."""
        return (self.top - self.bottom) / (self.right - self.left)

    def shaped(self, shape: float) -> "Window":
        """A larger one of that shape: more above, where the object is, or more on both sides."""
        wide, tall = self.right - self.left, self.top - self.bottom
        wider = max(tall / shape - wide, 0.0) / 2
        return Window(self.left - wider, self.right + wider, self.bottom, self.bottom + max(tall, shape * wide))


def window(scene: Scene, drawn: list[Drawing]) -> Window:
    """One window for all drawings, that holds whatever moves, and the object down to its vertex."""
    x, y = (np.concatenate(coordinate) for coordinate in zip(*(one.extent() for one in drawn), strict=True))
    vertex_x, vertex_y = (float(v) / float(units(scene).length) for v in scene.profile.vertex())
    x, y = np.append(x, vertex_x), np.append(y, [vertex_y, 0.0])
    left, right, bottom, top = x.min(), x.max(), y.min(), max(y.max(), 1.0)
    beside, around = ROOM * (right - left), ROOM * (top - bottom)
    top += FOR_WORDS * (top - bottom)
    return Window(float(left - beside), float(right + beside), float(bottom - around), float(top + around))


def outline(scene: Scene) -> Outline:
    """The contour of the object as it is drawn, in the scene's units."""
    return Outline(*silhouette_of(scene.profile, float(units(scene).length)))


class Stage:
    """Axes with what stands still, and the artists that move."""

    def __init__(self, figure: Figure, place: tuple[float, float, float, float], scene: Scene, first: Drawing):
        ax = self.axes = figure.add_axes(place)
        profile(scene.profile, length=float(units(scene).length), ax=ax)
        if moves_along_x(scene):
            ax.axhline(0, color=SUPPORT, linewidth=0.5, alpha=0.5, zorder=0)
        ax.set(xlabel="$x/L$", ylabel="$y/L$")
        own = [colour(k) for k in range(len(first.whiskers))]
        (self._arm,) = ax.plot([], [], color=SUPPORT, linewidth=0.8, linestyle=":", marker="+", markevery=[0])
        (self._drive,) = ax.plot([], [], color=SUPPORT, markersize=10, linestyle="none")
        self._springs = [ax.plot([], [], color=SUPPORT, linewidth=line.width)[0] for line in first.springs]
        self._whiskers = [ax.plot([], [], color=c, linewidth=2.2, solid_capstyle="round")[0] for c in own]
        self._bases = [ax.plot([], [], color=c, marker="o", markersize=5, linestyle="none")[0] for c in own]
        style = {"arrowstyle": "-|>", "mutation_scale": 12, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
        self._arrows = [FancyArrowPatch((0, 0), (0, 0), color=c, **style) for c in own]
        for arrow in self._arrows:
            ax.add_patch(arrow)

    @property
    def moving(self) -> list[Artist]:
        """From the back to the front."""
        return [self._arm, self._drive, *self._springs, *self._whiskers, *self._bases, *self._arrows]

    def show(self, window: Window) -> None:
        """Set what is seen."""
        self.axes.set(xlim=(window.left, window.right), ylim=(window.bottom, window.top))

    def move(self, drawn: Drawing) -> None:
        """Move everything to where a drawing has it."""
        x, y, angle = (float(value) for value in drawn.drive)
        turned: Any = (4, 0, 45 + float(np.degrees(angle)))  # a square that turns
        self._drive.set_data([x], [y])
        self._drive.set_marker(turned)
        if drawn.arm is not None:
            self._arm.set_data(drawn.arm.x, drawn.arm.y)
        for artist, line in zip([*self._springs, *self._whiskers], [*drawn.springs, *drawn.whiskers], strict=True):
            artist.set_data(line.x, line.y)
        for k, (base, patch, arrow) in enumerate(zip(self._bases, self._arrows, drawn.arrows, strict=True)):
            base.set_data(drawn.bases.x[k : k + 1], drawn.bases.y[k : k + 1])
            patch.set_visible(arrow is not None)
            if arrow is not None:
                patch.set_positions(arrow.tail, arrow.head)
