"""Draw the figures of the catalogue and write the data behind them."""

import re
from collections.abc import Mapping
from functools import singledispatch
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Canvas
from matplotlib.transforms import Bbox

from jaxwhisker import plot
from jaxwhisker._scan.report import write_columns
from jaxwhisker._scan.result import Result
from jaxwhisker._scan.shapes import shapes
from jaxwhisker.thesis.catalogue import Deflections, Detail, EventOf, Figure, Signals, States
from jaxwhisker.thesis.scans import Case, Scans, first_event
from jaxwhisker.thesis.tables import TABLES, bend

DPI = 110
POINTS = 60  # per whisker in the data of a state
DETAIL = 50  # steps shown on both sides of an event


def draw(figure: Figure, scans: Scans, folder: Path) -> tuple[Path, Path]:
    """Write a figure as PNG and its data as CSV, and return both paths."""
    picture, data = folder / f"{figure.file}.png", folder / f"{figure.file}.csv"
    canvas, columns = _draw(figure.shows, scans)
    canvas.suptitle(f"Figure {figure.number}: {figure.title}", fontsize=10, y=1 - 0.1 / canvas.get_figheight())
    canvas.savefig(picture, dpi=DPI)
    write_columns(columns, data, f"figure {figure.number}: {plain(figure.title)}; units L = EI = 1")
    return picture, data


def plain(text: str) -> str:
    """A label without LaTeX."""
    for symbol, word in ((r"$\infty$", "inf"), (r"$\lambda$", "lambda"), ("λ", "lambda"), ("$", "")):
        text = text.replace(symbol, word)
    return re.sub(r"\s*=\s*", "=", text)


@singledispatch
def _draw(shows, scans: Scans) -> tuple[Canvas, dict[str, np.ndarray]]:
    raise TypeError(f"`shows` must be an entry of the catalogue, got {shows!r}.")


@_draw.register
def _(shows: Deflections, scans: Scans):
    bent = bend(TABLES[shows.table])
    canvas = Canvas(figsize=(7, 5))
    ax = plot.deflection(bent, ax=canvas.add_axes((0.09, 0.11, 0.66, 0.8)))
    table = TABLES[shows.table]
    loads = list(table.loads)
    for load, colour, deflection in zip(loads, plot.COLOURS, bent.values(), strict=False):
        _force_arrow(ax, deflection, load.position, table.follower, 0.06 + 0.022 * load.force, colour)
    ax.plot([0, 0], [0, 1], color="0.5", linewidth=1, linestyle="--", zorder=1, label="unloaded")
    ax.set_xlim(right=max(ax.get_xlim()[1], 0.4))
    ax.legend(fontsize=9, loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False)
    columns = {}
    for name, deflection in bent.items():
        for quantity in ("s", "x", "y", "angle", "curvature"):
            columns[f"{quantity} ({plain(name)})"] = np.asarray(getattr(deflection, quantity))
    return canvas, columns


def _force_arrow(ax, deflection, position: float, follower: bool, size: float, colour: str) -> None:
    s, x, y, angle = (np.asarray(getattr(deflection, name)) for name in ("s", "x", "y", "angle"))
    at = np.array([np.interp(position, s, x), np.interp(position, s, y)])
    # Before bending, the force points towards -x, 90 degrees ahead of the whisker; a follower force turns with it.
    direction = np.interp(position, s, angle) + np.pi / 2 if follower else np.pi
    tip = at + size * np.array([np.cos(direction), np.sin(direction)])
    arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", xy=tuple(tip), xytext=tuple(at), arrowprops=arrow, zorder=5)
    ax.update_datalim([tuple(at), tuple(tip)])
    ax.autoscale_view()


def _control_of(result: Result, which: EventOf) -> float:
    kind, whisker = which
    event = first_event(result, kind, whisker)
    if event is None:
        raise RuntimeError(f"The scan of {result.scene} must have a {kind} of whisker {whisker}, got none.")
    return event.control


def _midway(result: Result, pair: tuple[EventOf, EventOf]) -> float:
    return sum(_control_of(result, which) for which in pair) / 2


@_draw.register
def _(shows: States, scans: Scans):
    result = scans(shows.case)
    ats = [_midway(result, pair) for pair in shows.between]
    canvas = Canvas()
    axes = canvas.subplots(2, 2)
    for ax, at, letter in zip(axes.flat, ats, "abcd", strict=True):
        plot.shapes(result, at, whole=not shows.case.semicircle, ax=ax)
        if legend := ax.get_legend():
            legend.remove()  # one legend is enough
        ax.set_title(f"{letter}) $u/L$ = {at:.3f}; {_state_in_words(result, at)}", fontsize=9)
        ax.label_outer()
    plot.same_window(axes.flat)
    (left, right), (bottom, top) = axes[0, 0].get_xlim(), axes[0, 0].get_ylim()
    panel = 4.2 * (top - bottom) / (right - left)
    _arrange(canvas, width=9.6, panel=panel, rows=2, head=0.7, between=0.35)
    canvas.subplots_adjust(wspace=0.05)
    axes[0, 0].legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 0.25))
    lines = shapes(result, at=ats, points=POINTS)
    columns = {}
    for k, at in enumerate(ats):
        for whisker in range(np.asarray(lines.x).shape[1]):
            for axis in ("x", "y"):
                columns[f"{axis}_{whisker + 1} (u={at:.6f})"] = np.asarray(getattr(lines, axis))[k, whisker]
    return canvas, columns


def _arrange(canvas: Canvas, width: float, panel: float, rows: int, head: float, between: float = 0.1) -> None:
    """Set the size of a figure with rows of panels below a head of title and legend; all lengths in inches."""
    foot = 0.5
    height = head + rows * panel + (rows - 1) * between + foot
    canvas.set_size_inches(width, height)
    canvas.subplots_adjust(
        left=0.72 / width, right=1 - 0.15 / width, bottom=foot / height, top=1 - head / height, hspace=between / panel
    )


def _state_in_words(result: Result, at: float) -> str:
    words = plot.in_words(result, at)
    return words.removeprefix("1: ") + " contact" if "," not in words else "whisker " + words


@_draw.register
def _(shows: Signals, scans: Scans):
    results = {name: scans(case) for name, case in shows.cases.items()}
    low, high = plot.contact_range(list(results.values()))
    rows, columns = len(shows.quantities), 1 if shows.overlay else len(shows.indices)
    lengths = "spring_length" in shows.quantities
    canvas = Canvas()
    axes = canvas.subplots(rows, columns, sharex=True, sharey="none" if lengths else "row", squeeze=False)
    for row, quantity in enumerate(shows.quantities):
        for column, index in enumerate(shows.indices[:columns]):
            ax = axes[row, column]
            if shows.overlay:
                plot.signal(next(iter(results.values())), quantity, ax=ax)
            else:
                plot.compare(results, quantity, index=index, ax=ax, colours=_colours(shows.cases))
                ax.set_ylabel(ax.get_ylabel() if column == 0 else "")
                if row == 0 and columns > 1:
                    ax.set_title(f"{'spring' if lengths else 'whisker'} {index}", fontsize=9)
            ax.set_xlim(low, high)
            ax.set_xlabel(ax.get_xlabel() if row == rows - 1 else "")
            ax.tick_params(labelbottom=row == rows - 1)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    head = 0.45 + 0.27 * (len(handles) > 1) + 0.22 * (columns > 1)
    _arrange(canvas, (7, 10, 12)[columns - 1], 3.9 if rows == 1 else 1.75, rows, head=head)
    canvas.subplots_adjust(wspace=0.2 if lengths else 0.05)
    if len(handles) > 1:
        at = (0.5, 1 - 0.32 / canvas.get_figheight())
        canvas.legend(handles, labels, fontsize=9, loc="upper center", ncols=6, bbox_to_anchor=at, frameon=False)
    return canvas, _signal_columns(shows, results, (low, high))


def _signal_columns(shows: Signals, results: Mapping[str, Result], shown: tuple[float, float]) -> dict[str, np.ndarray]:
    """The curves of a figure within the range of drive positions that it shows."""
    control = np.asarray(next(iter(results.values())).control)
    inside = (control >= shown[0]) & (control <= shown[1])
    columns = {"control": control[inside]}
    for name, result in results.items():
        for index in shows.indices:
            for quantity in shows.quantities:
                short = "spring" if quantity == "spring_length" else quantity
                column = f"{short}_{index}" + f" ({plain(name)})" * (len(results) > 1)
                columns[column] = np.asarray(getattr(result, quantity))[inside, index - 1]
    return columns


def _colours(cases: Mapping[str, Case]) -> tuple[str, ...]:
    # The clamped whisker is black in every comparison.
    return tuple(
        plot.COLOURS[-1] if np.isinf(case.stiffness) and len(cases) > 1 else plot.COLOURS[k]
        for k, case in enumerate(cases.values())
    )


@_draw.register
def _(shows: Detail, scans: Scans):
    canvas = Canvas(figsize=(9, 5))
    ax = canvas.add_axes((0.08, 0.11, 0.66, 0.8))
    columns = {}
    for (name, case), colour in zip(shows.cases.items(), _colours(shows.cases), strict=True):
        result = scans(case)
        at = _control_of(result, shows.around)
        control = np.asarray(result.control)
        near = int(np.argmin(np.abs(control - at)))
        steps = slice(near - DETAIL, near + DETAIL + 1)
        u = control[steps] - at
        values = np.asarray(getattr(result, shows.quantity))[steps, shows.index - 1]
        ax.plot(u, values, color=colour, linewidth=1.3, label=f"{name} (at $u/L$ = {at:.3f})")
        columns |= {
            f"control ({plain(name)})": control[steps],
            f"{shows.quantity}_{shows.index} ({plain(name)})": values,
        }
    ax.set_xlabel(f"$(u - u_{shows.around[1]})/L$, $u_{shows.around[1]}$: where whisker {shows.around[1]} detaches")
    ax.set_ylabel(plot.axis_label(shows.quantity))
    ax.grid(alpha=0.3)
    ax.legend(fontsize=9, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    return canvas, columns


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
