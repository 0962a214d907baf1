"""The canvas of a film: what stands still is drawn once, what moves again for every frame."""

import jax
import numpy as np
from jaxtyping import UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxwhisker._model.scene import Scene, units
from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker._scan.result import Event, Result
from jaxwhisker.film.captions import Captions
from jaxwhisker.film.curves import Curves
from jaxwhisker.film.frames import Frames
from jaxwhisker.film.stage import Stage, window
from jaxwhisker.plot.axes import colour
from jaxwhisker.plot.drawing import Drawing, drawing, largest_force

# Inches; pixels follow from the width asked for.
WIDTH, LOWEST, TALLEST = 9.6, 3.9, 6.4  # the height follows from the scene
BELOW, ABOVE, GAP = 0.55, 0.4, 0.1  # of axes
STAGE, CURVES = (0.67, 4.7), (6.35, 3.1)  # from the left, and how wide


class Canvas:
    """Draws the frames of a film."""

    def __init__(self, result: Result, shown: Frames, events: list[tuple[int, Event]], *, fps: int, width: int):
        self.count, scene, largest = shown.step.size, result.scene, largest_force(result)
        self._drawings = [_drawing(scene, shown, k, largest) for k in range(self.count)]
        seen, wide = window(scene, self._drawings), STAGE[1]
        height = float(np.clip(seen.shape * wide + BELOW + ABOVE, LOWEST, TALLEST))
        inner = height - BELOW - ABOVE
        self._figure = _figure(width, height)
        self._canvas = FigureCanvasAgg(self._figure)

        def place(column: tuple[float, float], bottom: float, tall: float):
            return column[0] / WIDTH, bottom / height, column[1] / WIDTH, tall / height

        self.stage = Stage(self._figure, place(STAGE, BELOW, inner), scene, self._drawings[0])
        self.stage.show(seen.shaped(inner / wide))
        each = (inner + GAP) / len(REACTIONS)
        bottoms = [BELOW + row * each for row in reversed(range(len(REACTIONS)))]
        places = [place(CURVES, bottom, each - GAP) for bottom in bottoms]
        self.curves = Curves(self._figure, places, result, shown)
        self.captions = Captions(self.stage.axes, self.curves.axes, result, shown, events, fps)
        _name_whiskers(self._figure, len(self._drawings[0].whiskers), 1 - ABOVE / height)
        self._moving = [*self.stage.moving, *self.captions.behind, *self.curves.moving, *self.captions.in_front]
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(self._figure.bbox)

    def image(self, frame: int) -> UInt8[np.ndarray, "height width 3"]:
        """One frame."""
        self._canvas.restore_region(self._still)
        self.stage.move(self._drawings[frame])
        self.curves.move(frame)
        self.captions.move(frame)
        for artist in self._moving:
            self._figure.draw_artist(artist)
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()


def _drawing(scene: Scene, shown: Frames, frame: int, largest: float) -> Drawing:
    state, lines = jax.tree.map(lambda leaf: leaf[frame], (shown.state, shown.lines))
    found, size = drawing(scene, float(shown.control[frame]), state, largest=largest), float(units(scene).length)
    # During a snap whiskers may have shapes that no state tells.
    own = [line._replace(x=lines.x[k] / size, y=lines.y[k] / size) for k, line in enumerate(found.whiskers)]
    return found._replace(whiskers=tuple(own))


def _figure(width: int, height: float) -> Figure:
    """A figure of even sizes in pixels, which video codecs ask for."""
    wide = 2 * (width // 2)
    dpi = wide / WIDTH
    pixels = wide, 2 * round(height * dpi / 2)
    # Sizes are rounded down.
    return Figure(figsize=((pixels[0] + 0.1) / dpi, (pixels[1] + 0.1) / dpi), dpi=dpi)


def _name_whiskers(figure: Figure, count: int, bottom: float) -> None:
    """Tell which whisker has which colour, where there are several."""
    if count == 1:
        return
    names = [f"whisker {k + 1}" if k < 3 else str(k + 1) for k in range(count)]
    handles = [Line2D([], [], color=colour(k), linewidth=2.2, label=name) for k, name in enumerate(names)]
    right = sum(CURVES) / WIDTH
    place = {"loc": "lower right", "bbox_to_anchor": (right, bottom), "borderaxespad": 0.1, "frameon": False}
    style = {"handlelength": 1.2, "columnspacing": 1.0, "fontsize": 10, "handletextpad": 0.5}
    figure.legend(handles=handles, ncols=count, **place, **style)
