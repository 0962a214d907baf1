"""The words of a film, and what flashes: where the drive is, what happens and to whom, and what is wrong."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.motion import Rotation, Translation
from jaxwhisker._model.scene import units
from jaxwhisker._path.path import EventKind, Status
from jaxwhisker._scan.result import Event, Result
from jaxwhisker.film.frames import SNAP_FRAMES, Frames
from jaxwhisker.plot.axes import GREY, colour, control_size

FLASH = 0.5  # seconds; of a snap, after it
SHOWN = 3  # of the events that flash at once, the latest
WARNING = "#B00000"
_WORDS = {
    EventKind.touch: "touch of {}",
    EventKind.tip_to_tangential: "tangential contact of {}",
    EventKind.vertex: "{} at the vertex",
    EventKind.tangential_to_tip: "tip contact of {}",
    EventKind.release: "release of {}",
    EventKind.snap_through: "snap-through of {}",
    EventKind.snap_off: "snap-off of {}",
}


def in_words(event: Event) -> str:
    """What happens, and to whom."""
    # A snap of the network as a whole names no whisker: all of them move.
    *others, last = event.whiskers or range(1, event.before.phase.size + 1)
    who = f"whiskers {', '.join(map(str, others))} and {last}" if others else f"whisker {last}"
    return _WORDS[event.kind].format(who)


class Captions:
    """Words on the stage; rings there and lines across the curves for what happens."""

    def __init__(
        self, stage: Axes, curves: list[Axes], result: Result, shown: Frames, events: list[tuple[int, Event]], fps: int
    ):
        self._frames, self._status = shown, np.asarray(result.status)
        self._events = [(first, first + _length(event, fps), event) for first, event in events]
        self._length, self._per_control = float(units(result.scene).length), control_size(result.scene)
        ring = {"marker": "o", "linestyle": "none", "markerfacecolor": "none", "markeredgewidth": 2}
        whiskers = range(result.fx.shape[1])
        self._rings = [[stage.plot([], [], color=colour(k), **ring)[0] for k in whiskers] for _ in range(SHOWN)]
        halo = [withStroke(linewidth=3, foreground="white")]
        text = {"textcoords": "offset points", "fontsize": 11}
        corner = {"xy": (0.0, 1.0), "xycoords": stage.transAxes}
        bold = text | corner | {"va": "top", "fontweight": "bold", "path_effects": halo}
        self._labels = [stage.annotate("", xytext=(8, -8 - 17 * k), **bold) for k in range(SHOWN)]
        # Plain text: formulas are slow to set.
        along_x, turns = (isinstance(result.scene.motion, kind) for kind in (Translation, Rotation))
        self._told = "u = {} L" if along_x else "angle = {} rad" if turns else "control = {}"
        above = text | corner | {"xytext": (0, 5), "va": "bottom"}
        self._control = stage.annotate("", **above)
        self._note = stage.annotate("", **above | {"xy": (1.0, 1.0), "ha": "right", "color": WARNING})

        def across(width: float):
            return [ax.plot([], [], linewidth=width, transform=ax.get_xaxis_transform())[0] for ax in curves]

        self._past, self._present = across(0.5), [across(1.6) for _ in range(SHOWN)]
        for line in self._past:
            line.set_color(GREY)

    @property
    def behind(self) -> list[Artist]:
        """What the curves are drawn on."""
        return [*self._past, *(line for lines in self._present for line in lines)]

    @property
    def in_front(self) -> list[Artist]:
        """What is drawn on the stage."""
        return [*(ring for rings in self._rings for ring in rings), *self._labels, self._control, self._note]

    @property
    def words(self) -> list[str]:
        """What is to be read, from the top down."""
        texts = [self._control, self._note, *self._labels]
        return [text.get_text() for text in texts if text.get_visible() and text.get_text()]

    def move(self, frame: int) -> None:
        """Tell of a frame."""
        control = f"{self._frames.control[frame] / self._per_control:+.3f}".replace("-", "\N{MINUS SIGN}")
        self._control.set_text(self._told.format(control))
        snap, status = self._frames.snap[frame], Status(int(self._status[max(self._frames.step[frame], 0)]))
        unknown = "" if status == Status.ok else f"no state: {status.name.replace('_', ' ')}"
        self._note.set_text("snap: not to scale in time" if snap else unknown)
        begun = np.array([event.control for first, _, event in self._events if first <= frame]) / self._per_control
        for past in self._past:
            past.set_data(np.repeat(begun, 3), np.tile([0.0, 1.0, np.nan], begun.size))
        now = [found for found in self._events if found[0] <= frame < found[1]][-SHOWN:]
        for slot in range(SHOWN):
            for artist in (self._labels[slot], *self._present[slot], *self._rings[slot]):
                artist.set_visible(slot < len(now))
            if slot < len(now):
                first, last, event = now[slot]
                self._flash(slot, event, (frame - first) / (last - first))

    def _flash(self, slot: int, event: Event, share: float) -> None:
        own = colour(event.whiskers[0] - 1) if len(event.whiskers) == 1 else "black"
        self._labels[slot].set(text=in_words(event), color=own)
        for line in self._present[slot]:
            line.set_data([event.control / self._per_control] * 2, [0.0, 1.0])
            line.set(color=own, alpha=1 - 0.7 * share)
        for k, ring in enumerate(self._rings[slot]):
            state = event.before if event.before.phase[k] != Phase.free else event.after
            ring.set_visible(k + 1 in event.whiskers and bool(state.phase[k] != Phase.free))
            ring.set_data([state.contact_x[k] / self._length], [state.contact_y[k] / self._length])
            ring.set(markersize=8 + 16 * share, alpha=1 - 0.8 * share)


def _length(event: Event, fps: int) -> int:
    """For how many frames an event flashes."""
    snap = SNAP_FRAMES if event.kind >= EventKind.snap_through else 0
    return max(2, round(FLASH * fps)) + snap
