"""Draw the frames of a film: the background once, and the moving artists again for every frame."""

import itertools
from collections.abc import Iterable
from typing import Any

import jax
import numpy as np
from jaxtyping import UInt8
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.scene import objects_of
from jaxwhisker._path.path import SNAPS, EventKind, Status
from jaxwhisker._scan.contacts import has_several
from jaxwhisker._scan.quantities import UnitSystem, control_kind, kind_of
from jaxwhisker._scan.result import Event, SpaceResult
from jaxwhisker._scan.state import State
from jaxwhisker.film.frames import SNAP_FRAMES, Frames, Mark
from jaxwhisker.plot.axes import GREY, SUPPORT, colour
from jaxwhisker.plot.drawing import Drawing, drawing, largest_force
from jaxwhisker.plot.runs import PlaneRun, Run, abscissa, places, reactions_of
from jaxwhisker.plot.signals import LEAST_HEIGHT
from jaxwhisker.plot.states import decimals, draw_object
from jaxwhisker.plot.view import RING, Drawn

# Inches; the pixels follow from the width of the film.
WIDTH, LOWEST, TALLEST = 9.6, 3.9, 6.4  # the height follows from the scene
LEAST_CURVE = 0.9  # height of a row of curves
BELOW, ABOVE, GAP = 0.55, 0.4, 0.1  # around axes
STAGE, CURVES = (0.67, 4.7), (6.35, 3.1)  # position from the left, and width

STAGE_ROOM = 0.03  # around moving parts, as a share of the window
WORDS_ROOM = 0.1  # above them
CURVE_ROOM = 0.08  # above and below curves, as a share of their height
NUMBER_ROOM = 0.06  # half the height of a number, as a share of the lowest row
FLASH = 0.5  # seconds for which an event flashes; a snap flashes for so long after it is over
MOST_LABELS = 3  # largest number of events that flash at once; only the latest are shown
WARNING = "#B00000"
CONTACT = "contact_x", "contact_y"
# Other events are described by their names.
_EVENT_WORDS = {
    EventKind.tip_to_tangential: "tangential contact of {}",
    EventKind.vertex: "{} at the vertex",
    EventKind.tangential_to_tip: "tip contact of {}",
    EventKind.stick: "{} sticks",
    EventKind.slip: "{} slips",
    EventKind.edge: "{} passes a corner",
    EventKind.bifurcation: "{} may go either way",
}

Place = tuple[float, float, float, float]  # left, bottom, width and height of axes, as shares of the figure


class Canvas:
    """Draws the frames of a film."""

    def __init__(
        self,
        result: Run,
        shown: Frames,
        marks: list[Mark],
        *,
        fps: int,
        width: int,
        units: str = "auto",
        pace: str = "",
        view: Any = None,
    ):
        self.count, names = shown.step.size, reactions_of(result)
        system = UnitSystem(result.scene, units)
        if isinstance(result, SpaceResult):
            from jaxwhisker.film.space import SpaceStage

            self.stage = SpaceStage(result, shown, system, view)
        else:
            self.stage = Stage(result, shown, system)
        lowest = max(LOWEST, LEAST_CURVE * len(names) + BELOW + ABOVE)
        height = float(np.clip(self.stage.shape * STAGE[1] + BELOW + ABOVE, lowest, TALLEST))
        inner = height - BELOW - ABOVE
        self.figure = _figure(width, height)

        def place(column: tuple[float, float], bottom: float, tall: float) -> Place:
            return column[0] / WIDTH, bottom / height, column[1] / WIDTH, tall / height

        self.stage.draw(self.figure, place(STAGE, BELOW, inner), inner / STAGE[1])
        each = (inner + GAP) / len(names)
        bottoms = [BELOW + row * each for row in reversed(range(len(names)))]
        boxes = [place(CURVES, bottom, each - GAP) for bottom in bottoms]
        self.curves = Curves(self.figure, boxes, result, shown, system)
        over = abscissa(result)
        self.captions = Captions(self.stage, self.curves.axes, shown, marks, fps, system, over, pace)
        _name_whiskers(self.figure, shown.state.fx.shape[1], 1 - ABOVE / height)
        self._moving = [*self.stage.moving, *self.captions.behind, *self.curves.moving, *self.captions.in_front]
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas, self._background = FigureCanvasAgg(self.figure), None

    def draw(self, frame: int) -> None:
        """Draw a frame."""
        if self._background is None:  # only now: a writer may have adjusted the size of the figure
            self._canvas.draw()
            self._background = self._canvas.copy_from_bbox(self.figure.bbox)
        self._canvas.restore_region(self._background)
        self.stage.move(frame)
        self.curves.move(frame)
        self.captions.move(frame)
        for artist in self._moving:
            self.figure.draw_artist(artist)

    def image(self, frame: int) -> UInt8[np.ndarray, "height width 3"]:
        """Draw a frame; return its pixels."""
        self.draw(frame)
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()


def _drawing(shown: Frames, frame: int, largest: float, system: UnitSystem) -> Drawing:
    state, lines = jax.tree.map(lambda leaf: leaf[frame], (shown.state, shown.lines))
    # During a snap and in motion, centre lines do not follow from the state.
    drawn = drawing(system.scene, float(shown.control[frame]), state, lines=lines, largest=largest)
    return drawn.scaled(system.scale("length"))


def _figure(width: int, height: float) -> Figure:
    """Make a figure with an even number of pixels in both directions, as video codecs require."""
    wide = 2 * (width // 2)
    dpi = wide / WIDTH
    pixels = wide, 2 * round(height * dpi / 2)
    # matplotlib rounds down to whole pixels.
    return Figure(figsize=((pixels[0] + 0.1) / dpi, (pixels[1] + 0.1) / dpi), dpi=dpi)


def _name_whiskers(figure: Figure, count: int, bottom: float) -> None:
    """Add a legend if there are several whiskers."""
    if count == 1:
        return
    names = [f"whisker {k + 1}" if k < 3 else str(k + 1) for k in range(count)]
    handles = [Line2D([], [], color=colour(k), linewidth=2.2, label=name) for k, name in enumerate(names)]
    right = sum(CURVES) / WIDTH
    place = {"loc": "lower right", "bbox_to_anchor": (right, bottom), "borderaxespad": 0.1, "frameon": False}
    style = {"handlelength": 1.2, "columnspacing": 1.0, "fontsize": 10, "handletextpad": 0.5}
    figure.legend(handles=handles, ncols=count, **place, **style)


def _window(system: UnitSystem, drawn: list[Drawing]) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of a window that holds all moving parts, and the object down to its vertex."""
    x, y = (np.concatenate(coordinate) for coordinate in zip(*(one.extent() for one in drawn), strict=True))
    vertices = [system.shown("contact_x", np.asarray(one.vertex())) for one in objects_of(system.scene)]
    x, y = np.append(x, [at[0] for at in vertices]), np.append(y, [*(at[1] for at in vertices), 0.0])
    left, right, bottom, top = x.min(), x.max(), y.min(), max(y.max(), system.scale("length"))
    beside, around = STAGE_ROOM * (right - left), STAGE_ROOM * (top - bottom)
    top += WORDS_ROOM * (top - bottom)
    return float(left - beside), float(right + beside), float(bottom - around), float(top + around)


class Stage:
    """Left half of a film in the plane: object, drive, springs, whiskers and contact forces."""

    def __init__(self, result: PlaneRun, shown: Frames, system: UnitSystem):
        largest = largest_force(result)
        self._drawings = [_drawing(shown, k, largest, system) for k in range(shown.step.size)]
        self._system, self._window = system, _window(system, self._drawings)
        left, right, bottom, top = self._window
        self.shape = (top - bottom) / (right - left)  # height over width

    def draw(self, figure: Figure, place: Place, shape: float) -> None:
        """Draw what does not move, and all artists that do, into axes of this shape at a place in a figure."""
        first = self._drawings[0]
        ax = self.axes = figure.add_axes(place)
        draw_object(self._system, ax)
        left, right, bottom, top = self._window
        # Enlarge the window to the shape of the stage: upwards, where the object is, or to both sides.
        taller = shape / self.shape
        beside = max(1 / taller - 1, 0.0) * (right - left) / 2
        upwards = max(taller, 1.0) * (top - bottom)
        ax.set(xlim=(left - beside, right + beside), ylim=(bottom, bottom + upwards))
        own = [colour(k) for k in range(len(first.whiskers))]
        contacts = len(first.arrows) // len(own)
        (self._arm,) = ax.plot([], [], color=SUPPORT, linewidth=0.8, linestyle=":", marker="+", markevery=[0])
        (self._drive,) = ax.plot([], [], color=SUPPORT, markersize=10, linestyle="none")
        self._springs = [ax.plot([], [], color=SUPPORT, linewidth=line.width)[0] for line in first.springs]
        self._whiskers = [ax.plot([], [], color=c, linewidth=2.2, solid_capstyle="round")[0] for c in own]
        self._bases = [ax.plot([], [], color=c, marker="o", markersize=5, linestyle="none")[0] for c in own]
        style = {"arrowstyle": "-|>", "mutation_scale": 12, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
        self._arrows = [FancyArrowPatch((0, 0), (0, 0), color=c, **style) for c in own for _ in range(contacts)]
        for arrow in self._arrows:
            ax.add_patch(arrow)
        lines = [self._arm, self._drive, *self._springs, *self._whiskers, *self._bases]
        self.moving: list[Artist] = [*lines, *self._arrows]  # from back to front

    def ring(self, own: str) -> Drawn:
        """A ring in a colour, which moves to the points of a contact."""
        (ring,) = self.axes.plot([], [], color=own, **RING)
        return Drawn([ring], lambda point: ring.set_data(*point.T))

    def contact(self, state: State, whisker: int) -> np.ndarray:
        """The contact point of a whisker, as a row; those of several contacts, NaN where it has none."""
        points = np.array([np.atleast_1d(self._system.shown(name, getattr(state, name)[whisker])) for name in CONTACT])
        known = np.atleast_1d(state.phase[whisker]) != Phase.free
        return points.T if known.size == 1 else np.where(known[:, None], points.T, np.nan)

    def move(self, frame: int) -> None:
        """Move all artists to a frame."""
        drawn = self._drawings[frame]
        x, y, angle = (float(value) for value in drawn.drive)
        square: Any = (4, 0, 45 + float(np.degrees(angle)))
        self._drive.set_data([x], [y])
        self._drive.set_marker(square)
        if drawn.arm is not None:
            self._arm.set_data(drawn.arm.x, drawn.arm.y)
        for artist, line in zip([*self._springs, *self._whiskers], [*drawn.springs, *drawn.whiskers], strict=True):
            artist.set_data(line.x, line.y)
        for k, base in enumerate(self._bases):
            base.set_data(drawn.bases.x[k : k + 1], drawn.bases.y[k : k + 1])
        for patch, arrow in zip(self._arrows, drawn.arrows, strict=True):
            patch.set_visible(arrow is not None)
            if arrow is not None:
                patch.set_positions(arrow.tail, arrow.head)


class Curves:
    """Right half of a film: fx, fy and mz of all whiskers up to the frame, in axes with fixed limits."""

    def __init__(self, figure: Figure, boxes: list[Place], result: Run, shown: Frames, system: UnitSystem):
        self.axes, over = [figure.add_axes(box) for box in boxes], abscissa(result)
        self._steps, self._places = shown.step, system.shown(over, shown.place)
        self._over = system.shown(over, places(result, over))
        self._curves, self._heads, self._values = [], [], []
        least = LEAST_HEIGHT * system.scale(kind_of(over, system.scene))
        for ax, name in zip(self.axes, reactions_of(result), strict=True):
            values, now = (system.shown(name, getattr(fields, name)) for fields in (result, shown.state))
            self._values.append((values, now))
            ax.set_xlim(*_limits(self._over, 0.02, least))
            # During a snap, values may exceed those of the steps.
            both = np.concatenate([values, now])
            ax.set_ylim(*_limits(both, CURVE_ROOM, LEAST_HEIGHT * system.scale(kind_of(name, system.scene))))
            ax.set_ylabel(system.label(name))
            ax.grid(alpha=0.3)
            _break_label(ax)
            ax.yaxis.set_major_locator(_InnerTicks(nbins=4, steps=[1, 2, 2.5, 5, 10]))
            ax.tick_params(labelbottom=ax is self.axes[-1])
            own = [colour(k) for k in range(values.shape[1])]
            self._curves.append([ax.plot([], [], color=c, linewidth=1.4)[0] for c in own])
            self._heads.append([ax.plot([], [], color=c, marker="o", markersize=5, linestyle="none")[0] for c in own])
        self.axes[-1].set_xlabel(system.label(over))
        self.moving = [*itertools.chain(*self._curves, *self._heads)]  # from back to front

    def move(self, frame: int) -> None:
        """Draw the curves up to a frame."""
        upto, here = self._steps[frame] + 1, self._places[frame]
        for curves, heads, (values, now) in zip(self._curves, self._heads, self._values, strict=True):
            for k, (curve, head) in enumerate(zip(curves, heads, strict=True)):
                curve.set_data(self._over[:upto], values[:upto, k])
                head.set_data([here], [now[frame, k]])


class _InnerTicks(MaxNLocator):
    """Ticks away from the ends of an axis, where numbers would reach into the next row."""

    def tick_values(self, vmin: float, vmax: float) -> np.ndarray:
        ticks, room = np.asarray(super().tick_values(vmin, vmax)), NUMBER_ROOM * (vmax - vmin)
        return ticks[(vmin + room <= ticks) & (ticks <= vmax - room)]


def _break_label(ax: Axes) -> None:
    """Put the unit of the y axis on a line of its own if the label is longer than the axis."""
    if ax.yaxis.label.get_window_extent().height > ax.bbox.height:
        ax.set_ylabel(ax.get_ylabel().replace(" (", "\n("))


def _limits(values: np.ndarray, share: float, least: float) -> tuple[float, float]:
    known = np.append(values[np.isfinite(values)], [0.0] * (not np.isfinite(values).any()))
    low, high = float(known.min()), float(known.max())
    room = max(share * (high - low), least)
    return low - room, high + room


def event_in_words(event: Event) -> str:
    """Event and its whiskers, such as "touch of whisker 1"."""
    # A snap of the whole network names no whisker, because all of them move.
    *others, last = event.whiskers or range(1, event.before.fx.size + 1)
    who = f"whiskers {', '.join(map(str, others))} and {last}" if others else f"whisker {last}"
    return _EVENT_WORDS.get(event.kind, event.kind.name.replace("_", "-") + " of {}").format(who) + event.place


class Captions:
    """Text on the stage; rings at contacts and vertical lines across the curves while an event flashes."""

    def __init__(
        self,
        stage: Any,
        curves: list[Axes],
        shown: Frames,
        marks: list[Mark],
        fps: int,
        system: UnitSystem,
        over: str,
        pace: str,
    ):
        self._frames, self._system, self._over, self._pace = shown, system, over, pace
        self._marks = [(mark.first, mark.first + _duration(mark.event, fps), mark) for mark in marks]
        self._stage, axes, whiskers = stage, stage.axes, range(shown.state.fx.shape[1])
        self._rings = [[stage.ring(colour(k)) for k in whiskers] for _ in range(MOST_LABELS)]
        halo = [withStroke(linewidth=3, foreground="white")]
        text = {"textcoords": "offset points", "fontsize": 11}
        corner = {"xy": (0.0, 1.0), "xycoords": axes.transAxes}
        bold = text | corner | {"va": "top", "fontweight": "bold", "path_effects": halo}
        self._labels = [axes.annotate("", xytext=(8, -8 - 17 * k), **bold) for k in range(MOST_LABELS)]
        above = text | corner | {"xytext": (0, 5), "va": "bottom"}
        self._control = axes.annotate("", **above)
        self._note = axes.annotate("", **above | {"xy": (1.0, 1.0), "ha": "right", "color": WARNING})

        def across(width: float) -> list[Line2D]:
            return [ax.plot([], [], linewidth=width, transform=ax.get_xaxis_transform())[0] for ax in curves]

        self._past, self._present = across(0.5), [across(1.6) for _ in range(MOST_LABELS)]
        for line in self._past:
            line.set_color(GREY)
        self.behind = [*self._past, *itertools.chain(*self._present)]  # artists behind the curves
        self.in_front = [*self._circles(range(MOST_LABELS)), *self._labels, self._control, self._note]  # of the stage

    @property
    def words(self) -> list[str]:
        """Visible texts from top to bottom."""
        texts = [self._control, self._note, *self._labels]
        return [text.get_text() for text in texts if text.get_visible() and text.get_text()]

    def move(self, frame: int) -> None:
        """Set texts and flashing marks of a frame."""
        words = _control_in_words(self._system, self._frames.control[frame])
        if self._over == "time":
            words = f"{_in_words(self._system, 'time', self._frames.place[frame])}{self._pace}, {words}"
        self._control.set_text(words)
        self._note.set_text("snap: not to scale in time" if self._frames.snap[frame] else self._failure(frame))
        past = self._system.shown(self._over, [mark.place for first, _, mark in self._marks if first <= frame])
        for line in self._past:
            line.set_data(np.repeat(past, 3), np.tile([0.0, 1.0, np.nan], past.size))
        now = [flash for flash in self._marks if flash[0] <= frame < flash[1]][-MOST_LABELS:]
        for slot in range(MOST_LABELS):
            for artist in (self._labels[slot], *self._present[slot], *self._circles([slot])):
                artist.set_visible(slot < len(now))
            if slot < len(now):
                first, last, mark = now[slot]
                self._flash(slot, mark, (frame - first) / (last - first))

    def _failure(self, frame: int) -> str:
        """Why a frame shows no state, or the last one of a simulation that fails."""
        status = Status(int(self._frames.status[frame]))
        if status == Status.ok:
            return ""
        known = np.isfinite(self._frames.state.base_x[frame]).all()
        return f"no state{' after this' if known else ''}: {status.name.replace('_', ' ')}"

    def _flash(self, slot: int, mark: Mark, share: float) -> None:
        event = mark.event
        own = colour(event.whiskers[0] - 1) if len(event.whiskers) == 1 else "black"
        self._labels[slot].set(text=event_in_words(event), color=own)
        at = float(self._system.shown(self._over, mark.place))
        for line in self._present[slot]:
            line.set_data([at] * 2, [0.0, 1.0])
            line.set(color=own, alpha=1 - 0.7 * share)
        for k, ring in enumerate(self._rings[slot]):
            state = event.side if has_several(event.after) else event.before
            state = state if np.any(state.phase[k] != Phase.free) else event.after
            points, contact = self._stage.contact(state, k), event.contact
            ring.move(points if contact is None or len(points) == 1 else points[contact - 1 : contact])
            for circle in ring.artists:
                circle.set_visible(k + 1 in event.whiskers and bool(np.any(state.phase[k] != Phase.free)))
                circle.set(markersize=8 + 16 * share, alpha=1 - 0.8 * share)

    def _circles(self, slots: Iterable[int]) -> list[Artist]:
        return [circle for slot in slots for ring in self._rings[slot] for circle in ring.artists]


def _control_in_words(system: UnitSystem, control: float) -> str:
    """Control as text, such as "u = -0.441 L" or "u = -22.1 mm", without a formula, which would be slow to draw."""
    symbol = {"length": "u", "angle": "angle", "number": "control"}[control_kind(system.scene)]
    return _in_words(system, "control", control, symbol, sign="+")


def _in_words(system: UnitSystem, name: str, value: float, symbol: str = "t", sign: str = "") -> str:
    number = f"{float(system.shown(name, value)):{sign}.{decimals(system, name)}f}".replace("-", "\N{MINUS SIGN}")
    kind = kind_of(name, system.scene)
    return f"{symbol} = {number} {system.of_kind(kind).name or {'length': 'L', 'time': 'T'}.get(kind, '')}".rstrip()


def _duration(event: Event, fps: int) -> int:
    """Number of frames for which an event flashes."""
    snap = SNAP_FRAMES if event.kind in SNAPS else 0
    return max(2, round(FLASH * fps)) + snap
