"""Films of scans in space: their frames, and the scene in the left half."""

from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure

from jaxwhisker._scan.quantities import UnitSystem
from jaxwhisker._scan.result import SpaceResult
from jaxwhisker._scan.shapes import shapes_of
from jaxwhisker._scan.state import SpaceState, state_of
from jaxwhisker.film.frames import FILMED_POINTS, Frames, Mark, first_steps
from jaxwhisker.plot import space
from jaxwhisker.plot.contacts_in_space import contacts_of
from jaxwhisker.plot.runs import events_of, places_of_events
from jaxwhisker.plot.view import RING, VIEWS, Drawn, check_view, picture

WORDS_ROOM = 0.1  # above a projection, as a share of its height


def frames_in_space(result: SpaceResult, count: int) -> tuple[Frames, list[Mark]]:
    """Frames for evenly spaced steps of a scan, and the events. A snap has no frames."""
    control = np.asarray(result.control)
    shown = np.round(np.linspace(0, control.size - 1, count)).astype(int)
    states = jax.tree.map(lambda leaf: np.asarray(leaf)[shown], state_of(result))
    lines: Any = jax.tree.map(np.asarray, shapes_of(result.scene, states, control[shown], points=FILMED_POINTS))
    status, snap = np.asarray(result.status)[shown], np.zeros(count, bool)
    begins = np.searchsorted(shown, first_steps(result))
    where = places_of_events(result, "control")
    marks = [
        Mark(int(min(first, count - 1)), event, float(place))
        for first, event, place in zip(begins, events_of(result), where, strict=True)
    ]
    return Frames(shown, control[shown], control[shown], status, states, lines, snap), marks


class SpaceStage:
    """Left half of a film in space: object, drive, springs, whiskers, directors and contact forces."""

    def __init__(self, result: SpaceResult, shown: Frames, system: UnitSystem, view: Any = None):
        scene, self._view = result.scene, check_view(view)
        largest = float(np.nan_to_num(np.asarray(result.contact_force)).max())
        state: Any = shown.state
        lines: Any = shown.lines
        self._drawings = space.drawing(scene, shown.control, state, lines=lines, largest=largest)
        self._system, self._scale = system, system.scale("length")
        self._body, self._low, self._high = space.surroundings(scene, self._drawings)
        self.shape = 1.0  # height over width
        if isinstance(self._view, str):
            width, height = (self._high - self._low)[list(VIEWS[self._view])]
            self.shape = (1 + WORDS_ROOM) * height / width

    def draw(self, figure: Figure, place: Any, shape: float) -> None:
        """Draw what does not move, and all artists that do, into axes of this shape at a place in a figure."""
        low, high, scale, system = self._low.copy(), self._high.copy(), self._scale, self._system
        self._picture = picture(self._view, figure=figure, place=place)
        self.axes = self._picture.ax
        if isinstance(self._view, str):
            across, up = VIEWS[self._view]
            width, height = high[across] - low[across], (1 + WORDS_ROOM) * (high[up] - low[up])
            beside = max(height / shape - width, 0.0) / 2
            low[across], high[across] = low[across] - beside, high[across] + beside
            high[up] = low[up] + max(height, shape * width)
        body = None if self._body is None else self._body.scaled(scale)
        if body is not None:
            self._picture.body(body)
        first = self._drawings.at(0).scaled(scale)
        self._parts = space.SpaceArtists(self._picture, first, body, scale, system.scene.support.springs)
        self.moving: list[Any] = self._parts.parts
        self._picture.window(scale * low, scale * high, [system.label_of(name, "length") for name in "xyz"])

    def ring(self, own: str) -> Drawn:
        """A ring in a colour, which moves to the points of a contact."""
        return self._picture.line(np.full((1, 3), np.nan), color=own, **RING)

    def contact(self, state: SpaceState, whisker: int) -> np.ndarray:
        """The contact point of a whisker, as a row; those of several contacts, NaN where it has none."""
        points = self._scale * contacts_of(state, float(self._system.natural.length))
        return points.reshape(len(state.fx), -1, 3)[whisker]

    def move(self, frame: int) -> None:
        """Move all artists to a frame."""
        self._parts.move(self._drawings.at(frame).scaled(self._scale))
