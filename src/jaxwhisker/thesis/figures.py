"""The kinds of figures of the thesis: the scans that they need, how they are drawn, and the data behind them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure as Canvas
from matplotlib.transforms import Bbox

from jaxwhisker import plot
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.export import columns
from jaxwhisker._scan.report import write_columns
from jaxwhisker._scan.result import Result
from jaxwhisker._scan.shapes import shapes
from jaxwhisker.plot.states import draw_arrow
from jaxwhisker.thesis.scans import Case, Scans, first_event
from jaxwhisker.thesis.tables import TABLES, bend

DPI = 110
OUTLINE = 60  # points per whisker in the data of a state
AROUND = 50  # steps shown on both sides of an event

EventOf = tuple[str, int]  # kind of event, whisker
Results = Mapping[str, Result]
Drawn = tuple[Canvas, dict[str, np.ndarray]]  # a figure and the columns of its data


@dataclass(frozen=True)
class Deflections:
    """Whiskers bent by the loads of a table."""

    table: str
    cases: ClassVar[Mapping[str, Case]] = {}

    def draw(self, _: Results) -> Drawn:
        """Draw the whiskers and the forces on them."""
        table = TABLES[self.table]
        bent = bend(table)
        canvas = Canvas(figsize=(7, 5))
        ax = plot.deflection(bent, ax=canvas.add_axes((0.09, 0.11, 0.66, 0.8)))
        data = {}
        for load, colour, (name, deflection) in zip(table.loads, plot.COLOURS, bent.items(), strict=False):
            names = ("s", "x", "y", "angle", "curvature")
            s, *pose, _curvature = own = [np.asarray(getattr(deflection, quantity)) for quantity in names]
            data |= {f"{quantity} ({plain(name)})": values for quantity, values in zip(names, own, strict=True)}
            x, y, angle = (float(np.interp(load.position, s, values)) for values in pose)
            # Before bending, the force points towards -x, 90 degrees ahead of the whisker; a follower force turns.
            direction, size = angle + np.pi / 2 if table.follower else np.pi, 0.06 + 0.022 * load.force
            tip = x + size * np.cos(direction), y + size * np.sin(direction)
            draw_arrow((x, y), tip, colour, ax)
            ax.update_datalim([(x, y), tip])
        ax.autoscale_view()
        ax.plot([0, 0], [0, 1], color="0.5", linewidth=1, linestyle="--", zorder=1, label="unloaded")
        ax.set_xlim(right=max(ax.get_xlim()[1], 0.4))
        ax.legend(fontsize=9, loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False)
        return canvas, data


@dataclass(frozen=True)
class States:
    """Four states of a scan, each midway between two events."""

    cases: Mapping[str, Case]
    between: tuple[tuple[EventOf, EventOf], ...]

    def draw(self, results: Results) -> Drawn:
        """Draw four panels with the same window."""
        (case,), (result,) = self.cases.values(), results.values()
        ats = [(_control_of(result, first) + _control_of(result, second)) / 2 for first, second in self.between]
        canvas = Canvas()
        axes = canvas.subplots(2, 2)
        for ax, at, letter in zip(axes.flat, ats, "abcd", strict=True):
            plot.shapes(result, at, whole=not case.semicircle, ax=ax)
            if legend := ax.get_legend():
                legend.remove()  # one legend is enough
            words = plot.in_words(result, at)
            words = "whisker " + words if "," in words else words.removeprefix("1: ") + " contact"
            ax.set_title(f"{letter}) $u/L$ = {at:.3f}; {words}", fontsize=9)
            ax.label_outer()
        plot.same_window(axes.flat)
        (left, right), (bottom, top) = axes[0, 0].get_xlim(), axes[0, 0].get_ylim()
        _arrange(canvas, 9.6, 4.2 * (top - bottom) / (right - left), rows=2, head=0.7, between=0.35)
        canvas.subplots_adjust(wspace=0.05)
        axes[0, 0].legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 0.25))
        lines = shapes(result, at=ats, points=OUTLINE)
        panels = product(enumerate(ats), case.whiskers, ("x", "y"))
        return canvas, {
            f"{axis}_{whisker} (u={at:.6f})": np.asarray(getattr(lines, axis))[k, whisker - 1]
            for (k, at), whisker, axis in panels
        }


@dataclass(frozen=True)
class Signals:
    """Quantities of several scans over the drive position: one row per quantity, one column per whisker or spring.

    All whiskers of a single scan share one column. Where whiskers of the plane model would leave it, beyond the vertex,
    panels are shaded.
    """

    cases: Mapping[str, Case]
    quantities: tuple[str, ...]
    indices: tuple[int, ...]

    def draw(self, results: Results) -> Drawn:
        """Draw the curves within the drive positions at which any whisker is in contact."""
        low, high = plot.contact_range(list(results.values()))
        together = len(results) == 1 and len(self.indices) > 1
        rows, indices = len(self.quantities), self.indices[:1] if together else self.indices
        lengths = "spring_length" in self.quantities
        canvas = Canvas()
        axes = canvas.subplots(rows, len(indices), sharex=True, sharey="none" if lengths else "row", squeeze=False)
        panels = product(enumerate(self.quantities), enumerate(indices))
        for ax, ((row, quantity), (column, index)) in zip(axes.flat, panels, strict=True):
            if together:
                plot.signal(next(iter(results.values())), quantity, ax=ax)
            else:
                plot.compare(results, quantity, index=index, ax=ax, colours=_colours(self.cases))
            if legend := ax.get_legend():
                legend.remove()  # one legend above all panels is enough
            if row == 0 and len(indices) > 1:
                ax.set_title(f"{'spring' if lengths else 'whisker'} {index}", fontsize=9)
            ax.set_xlim(low, high)
            if not lengths:
                last = np.array([_vertices(results, whisker) for whisker in (self.indices if together else [index])])
                plot.lateral_losses(next(iter(results.values())), last, axs=[ax])
            ax.set_xlabel(ax.get_xlabel() if row == rows - 1 else "")
            ax.set_ylabel(ax.get_ylabel() if column == 0 else "")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        head = 0.45 + 0.27 * (len(handles) > 1) + 0.22 * (len(indices) > 1)
        _arrange(canvas, (7, 10, 12)[len(indices) - 1], 3.9 if rows == 1 else 1.75, rows, head)
        canvas.subplots_adjust(wspace=0.2 if lengths else 0.05)
        if len(handles) > 1:
            at = (0.5, 1 - 0.32 / canvas.get_figheight())
            canvas.legend(handles, labels, fontsize=9, loc="upper center", ncols=6, bbox_to_anchor=at, frameon=False)
        return canvas, self._data(results, low, high)

    def _data(self, results: Results, low: float, high: float) -> dict[str, np.ndarray]:
        """The curves that are visible."""
        tables = {f" ({plain(name)})" * (len(results) > 1): columns(result) for name, result in results.items()}
        control = next(iter(tables.values()))["control"]
        shown = (control >= low) & (control <= high)
        data = {"control": control[shown]}
        for (name, table), index, quantity in product(tables.items(), self.indices, self.quantities):
            own = f"{quantity.removesuffix('_length')}_{index}"
            data[own + name] = table[own][shown]
        return data


@dataclass(frozen=True)
class Detail:
    """One quantity of one whisker around an event of each of several scans."""

    cases: Mapping[str, Case]
    quantity: str
    index: int
    around: EventOf

    def draw(self, results: Results) -> Drawn:
        """Draw the curves over the distance from the event."""
        canvas = Canvas(figsize=(9, 5))
        ax = canvas.add_axes((0.08, 0.11, 0.66, 0.8))
        own, data = f"{self.quantity}_{self.index}", {}
        for (name, result), colour in zip(results.items(), _colours(self.cases), strict=True):
            table, at = columns(result), _control_of(result, self.around)
            near = int(np.argmin(np.abs(table["control"] - at)))
            control, values = (table[column][near - AROUND : near + AROUND + 1] for column in ("control", own))
            ax.plot(control - at, values, color=colour, linewidth=1.3, label=f"{name} (at $u/L$ = {at:.3f})")
            data |= {f"control ({plain(name)})": control, f"{own} ({plain(name)})": values}
        _, whisker = self.around
        ax.set_xlabel(f"$(u - u_{whisker})/L$, $u_{whisker}$: where whisker {whisker} detaches")
        ax.set_ylabel(plot.axis_label(self.quantity))
        ax.grid(alpha=0.3)
        ax.legend(fontsize=9, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
        return canvas, data


@dataclass(frozen=True)
class Figure:
    """A figure of the thesis."""

    number: str
    title: str
    shows: Deflections | States | Signals | Detail

    @property
    def cases(self) -> tuple[Case, ...]:
        """The scans that the figure needs."""
        return tuple(self.shows.cases.values())

    @property
    def file(self) -> str:
        """File name without suffix; names sort in the order of the figures."""
        chapter, number = self.number.split(".")
        return f"figure_{chapter}.{int(number):02d}"


def draw(figure: Figure, scans: Scans, folder: Path) -> tuple[Path, Path]:
    """Write a figure as PNG and its data as CSV, and return both paths."""
    picture, data = folder / f"{figure.file}.png", folder / f"{figure.file}.csv"
    canvas, values = figure.shows.draw({name: scans(case) for name, case in figure.shows.cases.items()})
    canvas.suptitle(f"Figure {figure.number}: {figure.title}", fontsize=10, y=1 - 0.1 / canvas.get_figheight())
    canvas.savefig(picture, dpi=DPI)
    write_columns(values, data, f"figure {figure.number}: {plain(figure.title)}; units L = EI = 1")
    return picture, data


def plain(text: str) -> str:
    """A label without LaTeX."""
    for symbol, word in ((r"$\infty$", "inf"), (r"$\lambda$", "lambda"), ("λ", "lambda"), ("$", "")):
        text = text.replace(symbol, word)
    return re.sub(r"\s*=\s*", "=", text)


def _control_of(result: Result, which: EventOf) -> float:
    event = first_event(result, *which)
    if event is None:
        raise RuntimeError(f"The scan of {result.scene} must have a {which[0]} of whisker {which[1]}, got none.")
    return event.control


def _vertices(results: Results, whisker: int) -> float:
    """The drive position beyond which a whisker needs lateral guidance in all scans: the last vertex; NaN without."""
    found = [event.control for result in results.values() for event in result.events.of(EventKind.vertex, whisker)]
    return min(found, default=np.nan)


def _arrange(canvas: Canvas, width: float, panel: float, rows: int, head: float, between: float = 0.1) -> None:
    """Set the size of a figure with rows of panels below a head of title and legend; all lengths in inches."""
    foot = 0.5
    height = head + rows * panel + (rows - 1) * between + foot
    canvas.set_size_inches(width, height)
    canvas.subplots_adjust(
        left=0.72 / width, right=1 - 0.15 / width, bottom=foot / height, top=1 - head / height, hspace=between / panel
    )


def _colours(cases: Mapping[str, Case]) -> list[str]:
    # The clamped whisker is black in every comparison.
    last = [np.isinf(case.stiffness) and len(cases) > 1 for case in cases.values()]
    return [plot.COLOURS[-1 if black else k] for k, black in enumerate(last)]


def draw_table(title: str, rows: list[list[str]], path: Path) -> None:
    """Write a table as PNG."""
    canvas = Canvas(figsize=(7.5, 0.8 + 0.27 * len(rows)))
    ax = canvas.add_axes((0.02, 0.02, 0.96, 0.88 - 0.2 / len(rows)))
    ax.set_axis_off()
    drawn = ax.table(cellText=rows[1:], colLabels=rows[0], loc="center", cellLoc="right", bbox=Bbox.unit())
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(9)
    for (row, _), cell in drawn.get_celld().items():
        cell.set_linewidth(0.4)
        if row == 0:
            cell.set_facecolor("#E6E6E6")
    canvas.suptitle(title, fontsize=10)
    canvas.savefig(path, dpi=DPI)
